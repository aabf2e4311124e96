"""Which images of dwells are compared, and what each comparison tells of their displacements.

Dwells that follow each other are joined to a chain: its image has more to recognise than that of a dwell, and dwells
are compared with those of earlier chains.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sal_height.adjustment.equations import Form, Solution, mean_form
from sal_height.adjustment.matching import REFERENCE, GriddedSurface, Match, Points, match
from sal_height.adjustment.network import Comparison, Network
from sal_height.adjustment.observed import ObservedDwell
from sal_height.adjustment.recognising import SURE, Rarity, evidence
from sal_height.adjustment.reference import References
from sal_height.adjustment.settings import AdjustmentSettings
from sal_height.numeric import F64, in_threads

REACH_SIGMAS = 4.0
"""Standard deviations up to which a shift is looked for."""

SURPLUS_SPACINGS = 2.0
"""By which it is looked for farther than that, in spacings of points."""

ROUGH_POINTS, FINE_POINTS, STRIP_POINTS = 300, 800, 3000
"""Most points that are compared of joined dwells, whose search is far and rough, of single ones, and of joined images
of strips."""


CLEAR_SHARE, CLEAR_POINTS = 0.4, 150
"""Of the smaller one of two images of strips, and points of it, that must meet the other: the roof of a car fits any
level ground if all around it falls beside the other image, and little of a strip has nothing to be recognised by."""

FAR_OFF = 16.3
"""Square of the shift of a strip over its variance as it was known before, from which it is not believed: by chance one
of a thousand."""

SURELY_MET = 0.1
"""Of the most points of an image that meet another at any shift, the share that meets it at each if they do overlap."""

PLACED_SPACINGS = 3.0
"""Standard deviation east or north of how far images of strips lie apart, in spacings of points, up to which they are
compared one by one: they do not tell where they are."""


@dataclass(frozen=True, eq=False)
class DwellChain:
    """Dwells that follow each other, joined.

    Attributes:
        shifts: that were taken out of the places of their points, m, shape (3,), by the number of the dwell.
        points: of all of them that hang together.
        low: least east and north, m, shape (2,); infinite without points.
        high: greatest east and north, m, shape (2,); minus infinite without points.
    """

    shifts: Mapping[int, F64]
    points: Points
    low: F64
    high: F64

    @property
    def middle(self) -> int:
        """Number of the dwell in the middle."""
        return list(self.shifts)[len(self.shifts) // 2]

    @cached_property
    def rarity(self) -> Rarity:
        """Of the points."""
        return Rarity.of(self.points)

    @classmethod
    def of(cls, dwells: range, network: Network, known: Solution) -> DwellChain:
        """Dwells of a network by their numbers, each without the shift that is known."""
        shifts = {number: known.at(network.displacements[number]) for number in dwells}
        points = Points.joined([network.dwells[n].points.connected.moved(shift) for n, shift in shifts.items()])
        east_north = points.place[:, :2]
        low, high = east_north.min(axis=0, initial=np.inf), east_north.max(axis=0, initial=-np.inf)
        return cls(shifts, points, low, high)


def joined(dwells: Mapping[int, ObservedDwell], settings: AdjustmentSettings) -> list[range]:
    """Numbers of dwells that follow each other closely."""
    found: list[range] = []
    for number, dwell in dwells.items():
        last = found[-1] if found else range(0)
        if last and continues(dwells[last.start], len(last), dwell, settings):
            found[-1] = range(last.start, number + 1)
        else:
            found.append(range(number, number + 1))
    return found


def continues(first: ObservedDwell, count: int, dwell: ObservedDwell, settings: AdjustmentSettings) -> bool:
    """Whether a dwell belongs to the same chain as its first one, which has so many dwells by now."""
    return count < settings.strip_dwells and dwell.seconds - first.seconds <= settings.strip_s


def compared(
    chain: DwellChain,
    earlier: Sequence[DwellChain],
    network: Network,
    known: Solution,
    references: References,
    most_points: int,
    parts: Sequence[DwellChain] = (),
) -> Iterator[Comparison]:
    """Compare a chain with chains that were flown before, and with the terrain.

    Of a strip the chain as a whole tells where it is, and the parts tell how high they are where that is known.

    Args:
        chain: all dwells.
        earlier: chains in the order of time.
        network: of all dwells.
        known: of the displacements.
        references: known ground.
        most_points: that are compared of the chain or of a part.
        parts: of the chain, which are compared one by one; none: it is compared as a whole.
    """
    spacing, sliding = chain.points.spacing, network.dwells[chain.middle].aperture.sliding
    met = _all_met(chain, earlier, network, known, references)
    if sliding and parts:
        met = [other for other in met if other.is_placed(spacing)]
    by_part = [(part, part.points.thinned(most_points)) for part in parts or [chain]]
    pairs = [
        (
            points.moved(-other.since),
            other.surface,
            other.reach(spacing, network.settings),
            2 if sliding else 1,
        )
        for _, points in by_part
        for other in met
    ]
    matches = iter(in_threads(match, *zip(*pairs, strict=True)) if pairs else [])
    for part, _ in by_part:
        found = [(other, one) for other in met if (one := next(matches)) is not None]
        if not sliding:
            found = [(other, one) for other, one in found if other.is_recognised(one, part)]
        elif not parts:
            found = [(other, one.of_place()) for other, one in found if other.is_clear(one, part)]
        else:
            found = [(other, one.of_height()) for other, one in found]
        for other, one in found:
            # The noise of the dwell itself is in all its comparisons: half of the variance of each.
            yield _told(one, part, other, network, 2 / (len(found) + 1))


@dataclass(frozen=True, eq=False)
class _Met:
    """A surface that points are compared with.

    Attributes:
        surface: of a chain, or of known ground.
        count: number of points that it is made of; infinite: known ground.
        shifts: that were taken out of it, as of a chain; none: known ground.
        since: how much farther off it is known to lie by now, m, shape (3,).
        covariance: of how far the points lie off from it, m^2, shape (3, 3).
        chain: that it is of; None: known ground.
    """

    surface: GriddedSurface
    count: float
    shifts: Mapping[int, F64]
    since: F64
    covariance: F64
    chain: DwellChain | None = None

    @classmethod
    def of(cls, chain: DwellChain, network: Network, known: Solution, covariance: F64) -> _Met:
        now = known.at(network.displacements[chain.middle])
        since = now - chain.shifts[chain.middle]
        return cls(chain.points.surface, len(chain.points.place), chain.shifts, since, covariance, chain)

    def reach(self, spacing: float, settings: AdjustmentSettings) -> F64:
        """How far the points may be from where they are known to be, m, shape (3,)."""
        return _reach(self.covariance, spacing, settings)

    def is_placed(self, spacing: float) -> bool:
        """Whether the points are known to be beside it well enough to tell how high they are."""
        return float(np.linalg.eigvalsh(self.covariance[:2, :2])[-1]) <= (PLACED_SPACINGS * spacing) ** 2

    def is_recognised(self, found: Match, part: DwellChain) -> bool:
        """Whether the images overlap wherever they may lie, or are seen to show the same ground."""
        if self.chain is None or found.everywhere >= SURELY_MET:
            return True
        return evidence(part.points.moved(-self.since), part.rarity, self.chain.points, found.shift) >= SURE

    def is_clear(self, found: Match, part: DwellChain) -> bool:
        """Whether enough of a strip meets it, not farther off than may be."""
        count = len(part.points.place)
        variance = self.covariance + np.linalg.inv(found.information)
        return (
            found.share * count >= max(CLEAR_POINTS, CLEAR_SHARE * min(count, self.count))
            and float(found.shift @ np.linalg.solve(variance, found.shift)) <= FAR_OFF
        )


def _all_met(
    chain: DwellChain, earlier: Sequence[DwellChain], network: Network, known: Solution, references: References
) -> list[_Met]:
    """Known ground about a chain, and earlier chains that may have seen the same ground."""
    before = [other for other in earlier if not _goes_on(other, chain, network)]
    middle, near = network.displacements[chain.middle], _near(chain, before, network.settings)
    relative = [middle.minus([(1.0, network.displacements[other.middle])]) for other in near]
    own, *covariances = known.covariance([middle, *relative])
    met = [_Met.of(other, network, known, one) for other, one in zip(near, covariances, strict=True)]
    if references.terrain and chain.points.place.size:
        ground = references.terrain.around(chain.points, _reach(own, chain.points.spacing, network.settings))
        if ground:
            met.insert(0, _Met(ground, np.inf, {}, np.zeros(3), own))
    return met


def _told(found: Match, part: DwellChain, other: _Met, network: Network, share: float) -> Comparison:
    """What a match tells, with a share of its information."""
    one, two = found.dwells
    taken_out = _mean(one, part.shifts) - _mean(two, other.shifts) - other.since
    of_ground = [(two[REFERENCE], network.ground)] if REFERENCE in two else []
    moved, seen = (_between(one, two, forms).minus(of_ground) for forms in (network.displacements, network.seen))
    return Comparison(found.dwells, seen.equals(taken_out + found.shift, share * found.information), moved)


def _mean(shares: Mapping[int, float], shifts: Mapping[int, F64]) -> F64:
    """The mean of the shifts of some dwells, m; of known ground it is 0."""
    return sum((share * shifts[number] for number, share in shares.items() if number != REFERENCE), np.zeros(3))


def _between(one: Mapping[int, float], two: Mapping[int, float], forms: Mapping[int, Form]) -> Form:
    """How far some dwells lie off from others, by their shares."""
    return mean_form(one, forms).minus([(1.0, mean_form(two, forms))])


def sighted(network: Network, numbers: Iterable[int], known: Solution, references: References) -> Iterator[Comparison]:
    """Find the reference targets in dwells.

    Args:
        network: of the dwells.
        numbers: of those in which they are looked for.
        known: of the displacements.
        references: known ground.
    """
    if not references.targets:
        return
    for number in numbers:
        points, form = network.dwells[number].points, network.displacements[number]
        (reach,) = search_reaches(known, [form], points.spacing, network.settings)
        for target in references.targets:
            equation = target.sighted(points, form, known.at(form), reach)
            if equation is not None:
                yield Comparison(({number: 1.0}, {REFERENCE: 1.0}), equation, form, is_target=True)


def search_reaches(known: Solution, forms: Sequence[Form], spacing: float, settings: AdjustmentSettings) -> list[F64]:
    """How far displacements, or differences of them, may be from what is known, m, shape (3,) each."""
    return [_reach(covariance, spacing, settings) for covariance in known.covariance(forms)]


def _reach(covariance: F64, spacing: float, settings: AdjustmentSettings) -> F64:
    """How far a displacement of this covariance (m^2) may be from what is known, m, shape (3,)."""
    farthest = REACH_SIGMAS * np.sqrt(np.diag(covariance)) + SURPLUS_SPACINGS * spacing
    return np.minimum(farthest, settings.reach_spacings * spacing)


def _goes_on(other: DwellChain, chain: DwellChain, network: Network) -> bool:
    """Whether images of a strip go on with those of another chain, beside whose ground they show other ground."""
    last, first = (network.dwells[choose(one.shifts)] for one, choose in ((other, max), (chain, min)))
    return first.aperture.sliding and first.seconds - last.seconds <= network.settings.strip_s


def _near(chain: DwellChain, earlier: Sequence[DwellChain], settings: AdjustmentSettings) -> list[DwellChain]:
    """The latest of earlier chains that may have seen the same ground."""
    reach = settings.reach_spacings * chain.points.spacing
    near = [
        other
        for other in earlier
        if np.all(other.low <= chain.high + reach) and np.all(other.high >= chain.low - reach)
    ]
    return near[-settings.partners :]
