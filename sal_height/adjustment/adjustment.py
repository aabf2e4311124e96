"""The adjustment of dwells: navigation and mounting such that overlapping height images agree.

First joined dwells are compared with those of other passes, which finds them wherever navigation leaves them; then,
with what that told, each dwell by itself. Every comparison gives an equation between the displacements of the dwells
that met (`observed.displacement`), every Doppler centroid another, and what navigation and mounting are known to be are
the others: a sparse linear least-squares problem. Comparisons that contradict the others lose weight (`network.solve`),
so that a wrong one does no harm.

Images of a strip lie to each other as they were made: joined, they tell where they are, and one by one only how high.
By itself, an image that ends where a wall or a car begins fits any shift away from it, and all that show the same edge
err to the same side. A strip of which too little fits (`comparing.compared`) stays where it is known to be.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from sal_height.adjustment.comparing import (
    FINE_POINTS,
    ROUGH_POINTS,
    STRIP_POINTS,
    Chain,
    compared,
    joined,
    sighted,
)
from sal_height.adjustment.equations import Form, Solution, mean_form
from sal_height.adjustment.network import Comparison, Network
from sal_height.adjustment.observed import COMMON, GROUND, Layout, ObservedDwell
from sal_height.adjustment.reference import UNKNOWN_GROUND, References
from sal_height.adjustment.settings import AdjustmentSettings
from sal_height.geometry import Mounting
from sal_height.numeric import F64, in_threads

CONTRADICTION = 30.0
"""Square of the error of a comparison, of three numbers, over its variance, from which it contradicts the others: by
chance one of a million."""

GROUND_CONTRADICTION = 16.0
"""The same of what the elevation model lies off, of which there is one: by chance one of a thousand."""


@dataclass(frozen=True, eq=False)
class Adjustment:
    """Navigation and mounting that fit best.

    Attributes:
        layout: of the unknowns.
        solution: their values and covariance.
        displacements: of the dwells, as forms of the unknowns.
        comparisons: of dwells that overlap.
        ground_sigma: standard deviation of what the elevation model lies off, as stated, m.
        refused_ground: how far the elevation model that the result is without was seen to lie off, m, shape (3,).
    """

    layout: Layout
    solution: Solution
    displacements: list[Form]
    comparisons: list[Comparison]
    ground_sigma: float = 0.0
    refused_ground: F64 | None = None

    @property
    def common(self) -> tuple[F64, F64]:
        """What all dwells share (`observed.common_prior`), and its covariance."""
        columns = self.layout.common
        (covariance,) = self.solution.covariance([Form(columns, np.eye(COMMON), np.zeros(COMMON))])
        return self.solution.of(columns), covariance

    @property
    def shifts(self) -> tuple[F64, F64]:
        """How far east, north and up (m) the surfaces of each dwell lie off, shape (dwells, 3), and the covariance."""
        shifts = [self.solution.at(form) for form in self.displacements]
        return np.array(shifts), np.array(self.solution.covariance(self.displacements))

    @property
    def spread(self) -> tuple[F64, F64]:
        """Covariance of each dwell's shift against the mean of all, m^2, shape (dwells, 3, 3), and of that mean."""
        forms = self.displacements
        middle = mean_form(dict.fromkeys(range(len(forms)), 1 / len(forms)), dict(enumerate(forms)))
        apart = self.solution.covariance([form.minus([(1.0, middle)]) for form in forms])
        return np.array(apart), self.solution.covariance([middle])[0]

    @property
    def differences(self) -> tuple[F64, F64]:
        """How far dwells that were compared lie apart as published, and once adjusted, m, shape (comparisons, 3)."""
        apart = [
            (told := one.equation.right + one.between.constant, told - self.solution.at(one.between))
            for one in self.comparisons
        ]
        before, after = np.array(apart).reshape(-1, 2, 3).swapaxes(0, 1)
        return before, after

    @property
    def contradictions(self) -> int:
        """Number of comparisons that contradict the others: a part of the dwells was taken for another place."""
        return sum(self.solution.mismatch(one.equation) > CONTRADICTION for one in self.comparisons)

    @property
    def ground_off(self) -> tuple[F64, float]:
        """How far the dwells put the elevation model off, m, shape (3,), and the square of that over its variance.

        An estimate varies, where all is as stated, by what it takes off the variance that was known beforehand.
        """
        values, covariance = self.common
        learnt = self.ground_sigma**2 * np.eye(3) - covariance[GROUND, GROUND]
        share = np.linalg.pinv(learnt, rcond=1e-6, hermitian=True) @ values[GROUND]
        return self.ground_sigma**2 * share, float(values[GROUND] @ share)

    @property
    def contradicts_ground(self) -> bool:
        """Whether the elevation model cannot lie where it is, by what is known of it and of the dwells."""
        return self.ground_sigma > 0 and self.ground_off[1] > GROUND_CONTRADICTION

    @property
    def knots(self) -> F64:
        """Errors of the navigation at the knots of `layout.drift`, shape (knots, STATE)."""
        return np.array([self.solution.of(knot.columns) for knot in self.layout.drift.knots])


def describe_ground(off: F64) -> str:
    """The begin of a sentence on an elevation model that lies off, m, shape (3,)."""
    east, north, up = off
    return (
        f"The elevation model contradicts odometry and dwells, by which it lies {east:.2g} m too far east, "
        f"{north:.2g} m too far north and {up:.2g} m too high"
    )


def adjust(
    dwells: Sequence[ObservedDwell],
    mounting: Mounting,
    settings: AdjustmentSettings,
    references: References = UNKNOWN_GROUND,
) -> Adjustment:
    """Adjust dwells to each other, and to what is known of the ground.

    Args:
        dwells: in the order of time.
        mounting: of their sensor, as described.
        settings: what is known beforehand.
        references: targets, and an elevation model; the result is without one that contradicts what is known.
    """
    found = _adjusted(dwells, mounting, settings, references)
    if not found.contradicts_ground:
        return found
    without = _adjusted(dwells, mounting, settings, references.without_terrain())
    return replace(without, refused_ground=found.ground_off[0])


def _adjusted(
    dwells: Sequence[ObservedDwell], mounting: Mounting, settings: AdjustmentSettings, references: References
) -> Adjustment:
    """The same, with the elevation model whatever it is."""
    network = Network(mounting, settings, ground_sigma=references.ground_sigma)
    for dwell in dwells:
        network.add(dwell)
    chains = joined(network.dwells, settings)
    # Navigation, mounting and Doppler centroids; then comparisons: first of joined dwells, then, where these have put
    # them, of single ones; and of targets.
    solution = network.solved(chains)
    solution = network.solved(chains, _all_compared(chains, network, solution, references, ROUGH_POINTS))
    found: list[Comparison] = []
    if any(dwell.aperture.sliding for dwell in dwells):
        found = _all_compared(chains, network, solution, references, STRIP_POINTS)
        solution = network.solved(chains, found)
    found += _all_compared(chains, network, solution, references, FINE_POINTS, single=True)
    found += sighted(network, network.dwells, solution, references)
    solution, displacements = network.solved(chains, found), list(network.displacements.values())
    return Adjustment(network.layout, solution, displacements, found, references.ground_sigma)


def _all_compared(
    numbers: Sequence[range],
    network: Network,
    known: Solution,
    references: References,
    most_points: int,
    *,
    single: bool = False,
) -> list[Comparison]:
    """Compare each chain, or each of its dwells by itself, with chains that were flown before."""
    chains = [Chain.of(dwells, network, known) for dwells in numbers]
    in_threads(attrgetter("points.surface"), [chain for chain in chains if chain.points.place.size])  # kept for later
    found: list[Comparison] = []
    for number, chain in enumerate(chains):
        parts = [Chain.of(range(n, n + 1), network, known) for n in chain.shifts] if single else []
        found += compared(chain, chains[:number], network, known, references, most_points, parts)
    return found
