"""The adjustment of a flight in progress: each dwell as it arrives, with the information of all dwells before it.

A dwell is compared with earlier ones that saw the same ground: first joined with those that it follows, then by itself,
as in `adjustment`. So are those that it follows, once the ground is recognised of which they showed too little. Only
the latest dwells are kept; the information of the others on navigation and mounting stays (`Network.forget`), with the
weights that their comparisons had when they were removed.

Images of a strip are joined as they arrive. Whenever their number has grown by half, all of them are compared again,
from the solution without them: a match of the short strip does not count as evidence for the longer one. Until enough
of the strip fits (`comparing.compared`), its images are where navigation and earlier strips put them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from sal_height.adjustment.adjustment import Adjustment
from sal_height.adjustment.adjustment_settings import AdjustmentSettings
from sal_height.adjustment.comparing import (
    FINE_POINTS,
    ROUGH_POINTS,
    DwellChain,
    compared,
    continues,
    sighted,
)
from sal_height.adjustment.equations import Solution
from sal_height.adjustment.known_ground import UNKNOWN_GROUND, References
from sal_height.adjustment.network import Comparison, Network
from sal_height.adjustment.observed import STRETCH, ObservedDwell
from sal_height.geometry import Mounting
from sal_height.numeric import F64, ShortRepr

MOST_POINTS = 5_000_000
"""Points of all dwells that are kept, 1 GB: with the surfaces between them each takes 200 bytes."""


@dataclass(frozen=True, eq=False)
class PoseError(ShortRepr):
    """Error of the pose from which a dwell is seen.

    Attributes:
        error: the POSE numbers of `observed`, shape (POSE,).
        covariance: covariance of what is left of them, shape (POSE, POSE).
    """

    error: F64
    covariance: F64

    def uncertain_by(self, pose: F64) -> PoseError:
        """The same error, with the covariance of a pose, (6, 6), by what no comparison of dwells shows, in addition."""
        covariance = self.covariance.copy()
        covariance[:STRETCH, :STRETCH] += pose
        return PoseError(self.error, covariance)


class AdjustmentWindow:
    """The latest dwells of a flight, adjusted to each other as they arrive."""

    def __init__(
        self,
        mounting: Mounting,
        settings: AdjustmentSettings,
        most_dwells: int,
        most_points: int = MOST_POINTS,
        references: References = UNKNOWN_GROUND,
    ) -> None:
        """Starts without dwells.

        Args:
            mounting: mounting of the sensor, as described.
            settings: prior knowledge.
            most_dwells: greatest number of dwells that are kept; chains are kept as a whole, the last complete one
                always.
            most_points: greatest number of points of all kept dwells, likewise.
            references: targets, and an elevation model.
        """
        self._network = Network(mounting, settings, ground_sigma=references.ground_sigma)
        self._references, self._most_dwells, self._most_points = references, most_dwells, most_points
        self._over: list[DwellChain] = []
        self._growing = range(0)
        # Comparisons of complete chains, and of the growing one; its number of images when all were last compared.
        self._compared: list[Comparison] = []
        self._of_growing: list[Comparison] = []
        self._grown = 0
        self._solution: Solution | None = None

    def add(self, dwell: ObservedDwell) -> PoseError:
        """Adds a dwell, not earlier than all others, and estimates the error of its pose."""
        network = self._network
        self._begin_chain_with(dwell)
        number = network.add(dwell)
        self._growing = range(self._growing.start if self._growing else number, number + 1)
        known = self._place_strip() if dwell.aperture.sliding else self._place()
        self._of_growing += sighted(network, [number], known, self._references)
        self._solution = known = self._solved()
        pose = network.poses[number]
        return PoseError(known.at(pose), known.covariance([pose])[0])

    def _place(self) -> Solution:
        """Compares the growing chain as a whole, and then, from where that puts it, its dwells by themselves.

        That is the last one, and if the chain is recognised, all that have not been compared with others yet.
        """
        rough = self._compare(self._solved(), ROUGH_POINTS)
        known = self._solved(rough)
        fresh: Sequence[int] = self._growing[-1:]
        if not all(one.is_absolute for one in rough):
            done = {number for one in self._of_growing if not one.is_absolute for number in one.dwells[0]}
            fresh = [number for number in self._growing if number not in done]
            self._of_growing = [
                one for one in self._of_growing if one.is_target or one.dwells[0].keys().isdisjoint(fresh)
            ]
        self._of_growing += self._compare(known, FINE_POINTS, fresh)
        return known

    def _place_strip(self) -> Solution:
        """Compares the last image of the growing strip, or all of them, and the strip as a whole, if it has grown."""
        fresh: Sequence[int] = self._growing[-1:]
        if self._has_grown():
            self._grown, fresh = len(self._growing), self._growing
            self._of_growing = []
            self._of_growing = self._compare(self._solved(), FINE_POINTS)
        known = self._solved()
        self._of_growing += self._compare(known, FINE_POINTS, fresh)
        return known

    def _has_grown(self) -> bool:
        """True if the strip has grown by half since all of it was compared, or has reached the greatest length."""
        count = len(self._growing)
        return count >= 1.5 * self._grown or count == self._network.settings.strip_dwells

    def _solved(self, others: Sequence[Comparison] = ()) -> Solution:
        """The solution of all comparisons, and of some others."""
        return self._network.solved(self._chains(), [*self._compared, *self._of_growing, *others])

    def _compare(self, known: Solution, most_points: int, alone: Sequence[int] = ()) -> list[Comparison]:
        """Compares the growing chain with complete ones, or some of its dwells by themselves."""
        network = self._network
        chain = DwellChain.of(self._growing, network, known)
        parts = [DwellChain.of(range(number, number + 1), network, known) for number in alone]
        return list(compared(chain, self._over, network, known, self._references, most_points, parts))

    @property
    def latest_is_compared(self) -> bool:
        """True if the latest dwell shows ground of an earlier one, or known ground."""
        return any(not one.dwells[0].keys().isdisjoint(self._growing[-1:]) for one in self._of_growing)

    @property
    def dwells(self) -> int:
        """Number of dwells that are kept."""
        return len(self._network.dwells)

    @property
    def points(self) -> int:
        """Number of their points."""
        return sum(len(dwell.points.place) for dwell in self._network.dwells.values())

    @property
    def adjustment(self) -> Adjustment:
        """The current adjustment of the dwells that are kept.

        Raises:
            ValueError: no dwell was added.
        """
        if self._solution is None:
            raise ValueError("no dwell was added")
        forms = list(self._network.displacements.values())
        compared = [*self._compared, *self._of_growing]
        return Adjustment(self._network.layout, self._solution, forms, compared, self._references.ground_sigma)

    def _begin_chain_with(self, dwell: ObservedDwell) -> None:
        """Ends the growing chain if a dwell does not continue it, and forgets chains beyond the limits."""
        network, growing = self._network, self._growing
        if not growing or self._solution is None:
            return
        if continues(network.dwells[growing.start], len(growing), dwell, network.settings):
            return
        self._over.append(DwellChain.of(growing, network, self._solution))
        self._compared += self._of_growing
        self._growing, self._of_growing, self._grown = range(0), [], 0
        while len(self._over) > 1 and (self.dwells >= self._most_dwells or self.points >= self._most_points):
            self._compared = network.forget(list(self._over.pop(0).shifts))

    def _chains(self) -> Iterator[range]:
        for chain in self._over:
            yield range(min(chain.shifts), max(chain.shifts) + 1)
        if self._growing:
            yield self._growing
