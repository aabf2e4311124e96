"""Dwells that have arrived, their unknowns, and all equations between these."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sal_height.adjustment.adjustment_settings import AdjustmentSettings
from sal_height.adjustment.equations import Equation, Form, Solution, System, without
from sal_height.adjustment.matching import REFERENCE
from sal_height.adjustment.observed import (
    GROUND,
    ObservedDwell,
    Unknowns,
    ambiguities_of,
    centroid,
    common_prior,
    displacement,
    own_priors,
    pose,
    seen,
    vibration_of,
)
from sal_height.geometry import Mounting
from sal_height.numeric import F64


@dataclass(frozen=True, eq=False)
class Comparison:
    """A comparison of two images, as an equation of the displacements of their dwells.

    Attributes:
        dwells: fractions of the dwells of the first image, and of those of the other; REFERENCE: known ground.
        equation: equation between the displacements.
        between: displacement of the first from the other, without the apparent shift of edges.
        is_target: True if it is of a reference target.
    """

    dwells: tuple[Mapping[int, float], Mapping[int, float]]
    equation: Equation
    between: Form
    is_target: bool = False

    @property
    def is_absolute(self) -> bool:
        """True if the ground was known."""
        return REFERENCE in self.dwells[1]


class Network:
    """Dwells, their priors, and the solution of these and of comparisons.

    Attributes:
        mounting: mounting of the sensor, as described.
        settings: prior knowledge.
        layout: numbers of the unknowns.
        dwells: dwells by their numbers, in the order of time.
        poses: errors of their poses as forms of the unknowns (`observed.pose`), by number.
        displacements: displacements of their surfaces, by number.
        seen: apparent displacements by edges, by number.
        ground: offset of the elevation model.
    """

    def __init__(self, mounting: Mounting, settings: AdjustmentSettings, ground_sigma: float = 0.0) -> None:
        """Starts without dwells.

        Args:
            mounting: mounting of the sensor, as described.
            settings: prior knowledge.
            ground_sigma: standard deviation of the offset of the elevation model, m.
        """
        self.mounting, self.settings = mounting, settings
        self.layout, self._ground_sigma = Unknowns(settings.correlation_s), ground_sigma
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
        """Adds a dwell, not earlier than all others; returns its number."""
        number, self._count = self._count, self._count + 1
        if not number:
            self._known.append(common_prior(dwell.edges_sigma, self._ground_sigma, self.layout, self.settings))
        self._known += self.layout.add(number, dwell.stated)
        self.dwells[number] = dwell = replace(dwell, points=dwell.points.numbered(number))
        self.poses[number] = pose(number, dwell, self.layout, self.mounting)
        self.displacements[number] = displacement(self.poses[number], dwell)
        self.seen[number] = seen(dwell, self.displacements[number], self.layout)
        by_centroid = centroid(number, dwell, self.layout, self.settings)
        self._known += [by_centroid] if by_centroid else []
        return number

    def solved(self, joined: Iterable[range], compared: Sequence[Comparison] = ()) -> Solution:
        """Solves for the unknowns that fit best; comparisons that contradict the others lose weight.

        The ambiguities of the dwells' own velocities are those of the last solution.

        Args:
            joined: numbers of consecutive dwells.
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
        """Forgets the first dwells, but not their information, in the last solution, on unknowns of other dwells.

        Returns:
            The comparisons of that solution without these dwells.
        """
        leave = [one for one in self._weights if any(number in numbers for side in one.dwells for number in side)]
        weighted = [
            replace(one.equation, information=self._weights.pop(one) * one.equation.information) for one in leave
        ]
        own = [self._own.pop(number) for number in numbers]
        for number in numbers:
            for kept in (self.dwells, self.poses, self.displacements, self.seen, self._ambiguities):
                del kept[number]
        first = self.layout.drift.knot_before(next(iter(self.dwells.values())).seconds)
        self._known = without([*self._known, *own, *weighted], self.layout.forget(numbers, first))
        return list(self._weights)


def solve(known: Sequence[Equation], compared: Sequence[Equation], weights: F64) -> tuple[Solution, F64]:
    """Solves for the unknowns that fit all equations best; those in `compared` lose weight if they contradict others.

    Args:
        known: equations whose weight is 1.
        compared: the others.
        weights: initial weights of these, shape (comparisons,).

    Returns:
        The unknowns, and the weights.
    """
    system, ones = System([*known, *compared]), np.ones(len(known))
    solution = system.solved(np.append(ones, weights))
    freedom = 4.0  # degrees of Student's t: the fewer, the sooner a comparison loses weight
    for _ in range(6 if compared else 0):
        before, weights = weights, (freedom + 3) / (freedom + system.mismatches(solution)[len(known) :])
        if np.all(np.abs(weights - before) < 0.02):  # hardly changes any more
            break
        solution = system.solved(np.append(ones, weights))
    return solution, weights
