"""Which images of dwells are compared, and what each comparison tells of their displacements.

Dwells that follow each other are joined to a chain: its image has more to recognise than that of a dwell, and dwells
are compared with those of earlier chains.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sal_height.adjustment.equations import Form, Solution, mean_form
from sal_height.adjustment.matching import REFERENCE, Match, Points, Surface, match
from sal_height.adjustment.network import Comparison, Network
from sal_height.adjustment.observed import ObservedDwell
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


@dataclass(frozen=True, eq=False)
class Chain:
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

    @classmethod
    def of(cls, dwells: range, network: Network, known: Solution) -> Chain:
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


def whole(found: Match) -> Match:
    """All that a match says."""
    return found


def compared(
    chain: Chain,
    parts: Sequence[Chain],
    earlier: Sequence[Chain],
    network: Network,
    known: Solution,
    references: References,
    most_points: int,
    of: Callable[[Match], Match] = whole,
) -> Iterator[Comparison]:
    """Compare the parts of a chain with chains that were flown before, and with the terrain.

    Args:
        chain: all dwells.
        parts: of them.
        earlier: chains in the order of time.
        network: of all dwells.
        known: of the displacements.
        references: known ground.
        most_points: of a part that are compared.
        of: what a match says that is to be told.
    """
    before = [other for other in earlier if not _goes_on(other, chain, network)]
    middle, near = network.displacements[chain.middle], _near(chain, before, network.settings)
    relative = [middle.minus([(1.0, network.displacements[other.middle])]) for other in near]
    reach, *reaches = search_reaches(known, [middle, *relative], chain.points.spacing, network.settings)
    met = [_Met.of(other, network, known) for other in near]
    if references.terrain and chain.points.place.size and (ground := references.terrain.around(chain.points, reach)):
        met, reaches = [_Met(ground, {}, np.zeros(3)), *met], [reach, *reaches]
    thinned = [part.points.thinned(most_points) for part in parts]
    pairs = [
        (points.moved(-other.since), other.surface, reach)
        for points in thinned
        for other, reach in zip(met, reaches, strict=True)
    ]
    matches = iter(in_threads(match, *zip(*pairs, strict=True)) if pairs else [])
    for part in parts:
        found = [(other, one) for other in met if (one := next(matches)) is not None]
        for other, one in found:
            # The noise of the dwell itself is in all its comparisons: half of the variance of each.
            yield _told(of(one), part, other, network, 2 / (len(found) + 1))


@dataclass(frozen=True, eq=False)
class _Met:
    """A surface that points are compared with.

    Attributes:
        surface: of a chain, or of known ground.
        shifts: that were taken out of it, as of a chain; none: known ground.
        since: how much farther off it is known to lie by now, m, shape (3,).
    """

    surface: Surface
    shifts: Mapping[int, F64]
    since: F64

    @classmethod
    def of(cls, chain: Chain, network: Network, known: Solution) -> _Met:
        now = known.at(network.displacements[chain.middle])
        return cls(chain.points.surface, chain.shifts, now - chain.shifts[chain.middle])


def _told(found: Match, part: Chain, other: _Met, network: Network, share: float) -> Comparison:
    """What a match tells, with a share of its information."""
    one, two = found.dwells
    taken_out = _mean(one, part.shifts) - _mean(two, other.shifts) - other.since
    moved, seen = (_between(one, two, forms) for forms in (network.displacements, network.seen))
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
    most, surplus = settings.reach_spacings * spacing, SURPLUS_SPACINGS * spacing
    deviations = (np.sqrt(np.diag(covariance)) for covariance in known.covariance(forms))
    return [np.minimum(REACH_SIGMAS * deviation + surplus, most) for deviation in deviations]


def _goes_on(other: Chain, chain: Chain, network: Network) -> bool:
    """Whether images of a strip go on with those of another chain, beside whose ground they show other ground."""
    last, first = (network.dwells[choose(one.shifts)] for one, choose in ((other, max), (chain, min)))
    return first.aperture.sliding and first.seconds - last.seconds <= network.settings.strip_s


def _near(chain: Chain, earlier: Sequence[Chain], settings: AdjustmentSettings) -> list[Chain]:
    """The latest of earlier chains that may have seen the same ground."""
    reach = settings.reach_spacings * chain.points.spacing
    near = [
        other
        for other in earlier
        if np.all(other.low <= chain.high + reach) and np.all(other.high >= chain.low - reach)
    ]
    return near[-settings.partners :]
