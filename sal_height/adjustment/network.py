"""Dwells that have come, their unknowns, and all equations between these."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sal_height.adjustment.equations import Equation, Form, Solution, System, without
from sal_height.adjustment.matching import REFERENCE
from sal_height.adjustment.observed import (
    GROUND,
    Layout,
    ObservedDwell,
    ambiguities_of,
    centroid,
    common_prior,
    displacement,
    own_priors,
    pose,
    seen,
    vibration_of,
)
from sal_height.adjustment.settings import AdjustmentSettings
from sal_height.geometry import Mounting
from sal_height.numeric import F64

FREEDOM = 4.0
"""Of Student's t: the fewer, the sooner a comparison loses weight."""

ROUNDS, SETTLED = 6, 0.02
"""Solutions after which the weights hardly change, at most, and the greatest change of a weight that is none."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """What a comparison of two images tells of the displacements of their dwells.

    Attributes:
        dwells: shares of the dwells of the one image, and of those of the other; REFERENCE: known ground.
        equation: between the displacements.
        between: displacement of the one from the other, without what edges make of it.
        is_target: whether a reference target was seen.
    """

    dwells: tuple[Mapping[int, float], Mapping[int, float]]
    equation: Equation
    between: Form
    is_target: bool = False

    @property
    def is_absolute(self) -> bool:
        """Whether the ground was known."""
        return REFERENCE in self.dwells[1]


class Network:
    """Dwells, what is known of them beforehand, and the solution of that and of comparisons.

    Attributes:
        mounting: of the sensor, as described.
        settings: what is known beforehand.
        layout: of the unknowns.
        dwells: by their numbers, in the order of time.
        poses: how they are off as forms of the unknowns (`observed.pose`), by number.
        displacements: how far their surfaces lie off, by number.
        seen: how far these are seen to lie off by their edges, by number.
        ground: how far the elevation model lies off.
    """

    def __init__(self, mounting: Mounting, settings: AdjustmentSettings, ground_sigma: float = 0.0) -> None:
        """Begin without dwells.

        Args:
            mounting: of the sensor, as described.
            settings: what is known beforehand.
            ground_sigma: standard deviation of what the elevation model lies off, m.
        """
        self.mounting, self.settings = mounting, settings
        self.layout, self._ground_sigma = Layout(settings.correlation_s), ground_sigma
        self.ground = Form(self.layout.common[GROUND], np.eye(3), np.zeros(3))
        self.dwells: dict[int, ObservedDwell] = {}
        self.poses: dict[int, Form] = {}
        self.displacements: dict[int, Form] = {}
        self.seen: dict[int, Form] = {}
        self._count = 0
        self._known: list[Equation] = []
        self._ambiguities: dict[int, float] = {}
        # Of the last solution.
        self._own: dict[int, Equation] = {}
        self._weights: dict[Comparison, float] = {}

    def add(self, dwell: ObservedDwell) -> int:
        """Add a dwell, not earlier than all others; returns its number."""
        number, self._count = self._count, self._count + 1
        if not number:
            self._known.append(common_prior(dwell.edges_sigma, self._ground_sigma, self.layout, self.settings))
        self._known += self.layout.add(number, dwell.stated)
        self.dwells[number] = dwell = replace(dwell, points=dwell.points.numbered(number))
        self.poses[number] = pose(number, dwell, self.layout, self.mounting)
        self.displacements[number] = displacement(self.poses[number], dwell)
        self.seen[number] = seen(dwell, self.displacements[number], self.layout)
        told = centroid(number, dwell, self.layout, self.settings)
        self._known += [told] if told else []
        return number

    def solved(self, joined: Iterable[range], compared: Sequence[Comparison] = ()) -> Solution:
        """The unknowns that fit best; those comparisons lose weight that contradict the others.

        What dwells have of their own is taken to be near what the last solution has found.

        Args:
            joined: numbers of the dwells that follow each other.
            compared: comparisons of the dwells.
        """
        vibration = vibration_of(self.dwells, joined)
        own = own_priors(self.dwells, self.layout, self.settings, vibration, self._ambiguities)
        self._own = dict(zip(self.dwells, own, strict=True))
        known = [*self._known, *self._own.values()]
        weights = np.array([self._weights.get(one, 1.0) for one in compared])
        solution, weights = solve(known, [one.equation for one in compared], weights)
        self._weights = dict(zip(compared, weights.tolist(), strict=True))
        self._ambiguities = ambiguities_of(self.dwells, self.layout, solution)
        return solution

    def forget(self, numbers: Collection[int]) -> list[Comparison]:
        """Forget the first dwells, but not what they told in the last solution of the unknowns that others share.

        Returns:
            The comparisons of that solution in which none of them is.
        """
        leave = [one for one in self._weights if any(number in numbers for side in one.dwells for number in side)]
        told = [replace(one.equation, information=self._weights.pop(one) * one.equation.information) for one in leave]
        own = [self._own.pop(number) for number in numbers]
        for number in numbers:
            for held in (self.dwells, self.poses, self.displacements, self.seen, self._ambiguities):
                del held[number]
        first = self.layout.drift.knot_before(next(iter(self.dwells.values())).seconds)
        self._known = without([*self._known, *own, *told], self.layout.forget(numbers, first))
        return list(self._weights)


def solve(known: Sequence[Equation], compared: Sequence[Equation], weights: F64) -> tuple[Solution, F64]:
    """The unknowns that fit all equations best; those in `compared` lose weight if they contradict the others.

    Args:
        known: equations whose weight is 1.
        compared: the others.
        weights: of these, to begin with, shape (comparisons,).

    Returns:
        The unknowns, and the weights.
    """
    system, ones = System([*known, *compared]), np.ones(len(known))
    solution = system.solved(np.append(ones, weights))
    for _ in range(ROUNDS if compared else 0):
        before, weights = weights, (FREEDOM + 3) / (FREEDOM + system.mismatches(solution)[len(known) :])
        if np.all(np.abs(weights - before) < SETTLED):
            break
        solution = system.solved(np.append(ones, weights))
    return solution, weights
