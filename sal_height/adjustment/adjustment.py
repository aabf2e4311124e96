"""The adjustment of dwells: navigation and mounting such that overlapping height images agree.

First joined dwells are compared with those of other passes, within the errors of navigation; then, from that solution,
each dwell by itself. Every comparison gives an equation between the displacements of the dwells that overlap
(`observed.displacement`), every Doppler centroid another, and the priors of navigation and mounting the others: a
sparse linear least-squares problem. Comparisons that contradict the others lose weight (`network.solve`), so that a
wrong one does no harm.

Images of a strip are rigidly connected: joined they determine the horizontal position, and one by one only the height.
By itself, an image that ends where a wall or a car starts fits any shift away from it, and all that show the same edge
err to the same side. A strip of which too little fits (`comparing.compared`) stays at its prior position.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from sal_height.adjustment.adjustment_settings import AdjustmentSettings
from sal_height.adjustment.comparing import (
    FINE_POINTS,
    ROUGH_POINTS,
    STRIP_POINTS,
    DwellChain,
    compared,
    joined,
    sighted,
)
from sal_height.adjustment.equations import Form, Solution, mean_form
from sal_height.adjustment.known_ground import UNKNOWN_GROUND, References
from sal_height.adjustment.network import Comparison, Network
from sal_height.adjustment.observed import COMMON, GROUND, ObservedDwell, Unknowns
from sal_height.geometry import Mounting
from sal_height.numeric import F64, ShortRepr, in_threads


@dataclass(frozen=True, eq=False)
class Adjustment(ShortRepr):
    """Navigation and mounting that fit best.

    Attributes:
        layout: numbers of the unknowns.
        solution: values of the unknowns, and their covariance.
        displacements: displacements of the dwells, as forms of the unknowns.
        comparisons: comparisons of overlapping dwells.
        ground_sigma: stated standard deviation of the offset of the elevation model, m.
        refused_ground: estimated offset of an elevation model that was left out, shape (3,), m.
    """

    layout: Unknowns
    solution: Solution
    displacements: list[Form]
    comparisons: list[Comparison]
    ground_sigma: float = 0.0
    refused_ground: F64 | None = None

    @property
    def common(self) -> tuple[F64, F64]:
        """Unknowns that all dwells have in common (`observed.common_prior`), and their covariance."""
        columns = self.layout.common
        (covariance,) = self.solution.covariance([Form(columns, np.eye(COMMON), np.zeros(COMMON))])
        return self.solution.of(columns), covariance

    @property
    def shifts(self) -> tuple[F64, F64]:
        """Displacement of each dwell's surfaces east, north and up, m, shape (dwells, 3), and its covariance."""
        shifts = [self.solution.at(form) for form in self.displacements]
        return np.array(shifts), np.array(self.solution.covariance(self.displacements))

    @property
    def spread(self) -> tuple[F64, F64]:
        """Covariance of each dwell's shift from the mean of all, m^2, shape (dwells, 3, 3), and of that mean."""
        forms = self.displacements
        middle = mean_form(dict.fromkeys(range(len(forms)), 1 / len(forms)), dict(enumerate(forms)))
        apart = self.solution.covariance([form.minus([(1.0, middle)]) for form in forms])
        return np.array(apart), self.solution.covariance([middle])[0]

    @property
    def differences(self) -> tuple[F64, F64]:
        """Offsets between compared dwells as published, and once adjusted, m, shape (comparisons, 3)."""
        apart = [
            (published := one.equation.right + one.between.constant, published - self.solution.at(one.between))
            for one in self.comparisons
        ]
        before, after = np.array(apart).reshape(-1, 2, 3).swapaxes(0, 1)
        return before, after

    @property
    def contradictions(self) -> int:
        """Number of comparisons that contradict the others: some dwells were matched with other ground.

        The square of the error of three numbers over its variance exceeds 30 by chance once in a million.
        """
        return sum(self.solution.mismatch(one.equation) > 30.0 for one in self.comparisons)

    @property
    def ground_off(self) -> tuple[F64, float]:
        """Offset of the elevation model by the dwells, m, shape (3,), and the square of that over its variance.

        The variance of the estimate is the prior variance less the posterior one.
        """
        values, covariance = self.common
        learnt = self.ground_sigma**2 * np.eye(3) - covariance[GROUND, GROUND]
        scaled = np.linalg.pinv(learnt, rcond=1e-6, hermitian=True) @ values[GROUND]
        return self.ground_sigma**2 * scaled, float(values[GROUND] @ scaled)

    @property
    def contradicts_ground(self) -> bool:
        """True if the offset of the elevation model exceeds its variance as it does by chance once in a thousand."""
        return self.ground_sigma > 0 and self.ground_off[1] > 16.0

    @property
    def knots(self) -> F64:
        """Errors of the navigation at the knots of `layout.drift`, shape (knots, STATE)."""
        return np.array([self.solution.of(knot.columns) for knot in self.layout.drift.knots])


def describe_ground(off: F64) -> str:
    """The start of a message on the offset of an elevation model, m, shape (3,)."""
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
    """Adjusts dwells to each other, and to known ground.

    Args:
        dwells: dwells in the order of time.
        mounting: mounting of their sensor, as described.
        settings: prior knowledge.
        references: targets, and an elevation model, which is left out if it contradicts odometry and dwells.
    """
    found = _adjusted(dwells, mounting, settings, references)
    if not found.contradicts_ground:
        return found
    without = _adjusted(dwells, mounting, settings, references.without_terrain())
    return replace(without, refused_ground=found.ground_off[0])


def _adjusted(
    dwells: Sequence[ObservedDwell], mounting: Mounting, settings: AdjustmentSettings, references: References
) -> Adjustment:
    """Adjusts dwells, with the elevation model even if it contradicts them."""
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
    """Compares each chain, or each of its dwells by itself, with chains that were flown before."""
    chains = [DwellChain.of(dwells, network, known) for dwells in numbers]
    in_threads(attrgetter("points.surface"), [chain for chain in chains if chain.points.place.size])  # kept for later
    found: list[Comparison] = []
    for number, chain in enumerate(chains):
        parts = [DwellChain.of(range(n, n + 1), network, known) for n in chain.shifts] if single else []
        found += compared(chain, chains[:number], network, known, references, most_points, parts)
    return found
