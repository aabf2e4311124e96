"""Chooses the images of dwells that are compared, and makes an equation of their displacements from each comparison.

Dwells that follow each other are joined to a chain: its image has more to recognise than that of a dwell, and dwells
are compared with those of earlier chains.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from sal_height.adjustment.adjustment_settings import AdjustmentSettings
from sal_height.adjustment.equations import Form, Solution, mean_form
from sal_height.adjustment.known_ground import References
from sal_height.adjustment.matching import (
    COARSE,
    LEAST_POINTS,
    OUTLIERS,
    REACH_SPACINGS,
    REFERENCE,
    TEMPER,
    GriddedSurface,
    Match,
    Points,
    lattice,
    likelihood_of_shifts,
    match,
)
from sal_height.adjustment.network import Comparison, Network
from sal_height.adjustment.observed import ObservedDwell
from sal_height.numeric import F64, Index, in_threads

SURE = 7.5
"""Logarithm of the likelihood by which two images must be more likely to show the same ground. Of 240 pairs of dwells
of `sal_passes` without common ground, seven exceed 4, where a car ends as another does elsewhere, and the greatest is
7.1."""

ROUGH_POINTS, FINE_POINTS, STRIP_POINTS = 300, 800, 3000
"""Most points that are compared of joined dwells, whose search is far and rough, of single ones, and of joined images
of strips."""


@dataclass(frozen=True, eq=False)
class Rarity:
    """Misfit of the heights of an image to the same image elsewhere.

    Attributes:
        elsewhere: shift of the image east and north, m, shape (2,); 0: it continues in no direction.
        less: rarity of each point, as a mean over neighbours, shifted by `elsewhere` and by its opposite, shape
            (2, points); 0 where the image ends.
    """

    elsewhere: F64
    less: F64

    @classmethod
    def of(cls, points: Points) -> Rarity:
        """The rarity of each point where its image fits itself best."""
        return cls.shifted(points, _most_alike(points))

    @classmethod
    def shifted(cls, points: Points, elsewhere: F64) -> Rarity:
        """The rarity of each point for a given shift, m, shape (2,)."""
        cells = np.rint(elsewhere / points.surface.step).astype(int)
        if not cells.any():
            return cls(elsewhere, np.zeros((2, len(points.place))))
        return cls(elsewhere, np.stack([_less(points, cells), _less(points, -cells)]))


def _less(points: Points, shift: Index) -> F64:
    """The mean over neighbours of the misfit of each height once the image is shifted, shape (points,)."""
    (misfit,), count = _misfits(points, points.surface, shift[None]), len(points.place)
    met = np.isfinite(misfit)
    if not met.any():
        return np.zeros(count)
    place, reach = points.place[:, :2], REACH_SPACINGS * points.spacing
    near = cKDTree(place).sparse_distance_matrix(cKDTree(place[met]), reach, output_type="ndarray")
    total = np.bincount(near["i"], misfit[met][near["j"]], count)
    return np.asarray(total / np.maximum(np.bincount(near["i"], minlength=count), 1))


def evidence(points: Points, rarity: Rarity, other: Points, shift: F64) -> float:
    """Logarithm of the likelihood ratio of two images of the same ground against ground of the same kind.

    Args:
        points: points of the smaller image.
        rarity: their rarity; the other image is shifted over itself by the same distance.
        other: points of the other image.
        shift: offset of the first image from the other east, north and up, m, shape (3,).
    """
    surface = other.surface
    (misfit,) = _misfits(points, surface, np.rint(shift[None, :2] / surface.step).astype(int))
    met = np.isfinite(misfit)
    if not met.any():
        return 0.0
    _, nearest = cKDTree(other.place[:, :2]).query(points.place[met, :2] - shift[:2])
    less_in_other = Rarity.shifted(other, rarity.elsewhere).less
    in_both = np.minimum(rarity.less[:, met], less_in_other[:, nearest]).max(axis=0)
    rare = in_both >= 0.5  # the rarity of what continues is less than half of that, by noise
    return TEMPER * float(np.sum(in_both[rare] - misfit[met][rare]))


def _most_alike(points: Points) -> F64:
    """The shift (m) at which about half of an image overlaps itself and fits itself best; 0: no such shift."""
    some, surface = points.thinned(300), points.surface
    step = int(np.clip(min(surface.height.shape) // 8, 2, COARSE))  # eight steps over the narrower side
    cells = lattice(np.array(surface.height.shape) - 1, step)
    cells = cells[len(cells) // 2 :]  # the others are the same, the other way
    likelihood, _ = likelihood_of_shifts(some, surface, cells, np.inf)
    met = np.isfinite(likelihood[0]).sum(axis=1)
    # So little overlap that what is shown once does not fit, and enough of it for what continues to fit.
    low, high = (fraction * len(some.place) for fraction in (0.25, 0.55))
    half = (met >= max(LEAST_POINTS, low)) & (met <= high)
    if not half.any():
        return np.zeros(2)
    return np.asarray(surface.step * cells[half][np.argmax(np.nansum(likelihood[0, half], axis=1) / met[half])])


def _misfits(points: Points, surface: GriddedSurface, cells: Index) -> F64:
    """The greatest possible logarithm of the likelihood of each height less the one found, shape (shifts, points).

    NaN where a point does not meet the surface.
    """
    likelihood, _ = likelihood_of_shifts(points, surface, cells, np.inf)
    bins, kernel = points.binned
    counts = np.bincount(bins, minlength=int(bins.max()) + len(kernel))
    density = np.convolve(counts, kernel, "same")[bins] / len(bins)
    sigma = np.sqrt(2) * np.hypot(points.sigma, points.roughness)
    best = np.log((1 - OUTLIERS) / (np.sqrt(2 * np.pi) * sigma * density) + OUTLIERS)
    return np.asarray(best - likelihood[0])


@dataclass(frozen=True, eq=False)
class DwellChain:
    """Dwells that follow each other, joined.

    Attributes:
        shifts: shifts that were subtracted from the points of each dwell, m, shape (3,), by its number.
        points: connected points of all dwells.
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
        """Rarity of the points."""
        return Rarity.of(self.points)

    @classmethod
    def of(cls, dwells: range, network: Network, known: Solution) -> DwellChain:
        """Joins dwells of a network by their numbers, each without its known shift."""
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
    """True if a dwell belongs to the same chain as its first one, which has `count` dwells so far."""
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
    """Compares a chain with chains that were flown before, and with the terrain.

    Of a strip, the chain as a whole gives the horizontal position, and the parts give heights once that is known.

    Args:
        chain: all dwells.
        earlier: chains in the order of time.
        network: network of all dwells.
        known: solution of the displacements so far.
        references: known ground.
        most_points: greatest number of points that are compared of the chain or of a part.
        parts: parts of the chain, which are compared one by one; empty: it is compared as a whole.
    """
    spacing, sliding = chain.points.spacing, network.dwells[chain.middle].aperture.sliding
    met = _all_compared(chain, earlier, network, known, references)
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
            yield _comparison(one, part, other, network, 2 / (len(found) + 1))


@dataclass(frozen=True, eq=False)
class _Compared:
    """A surface that points are compared with.

    Attributes:
        surface: surface of a chain, or of known ground.
        count: number of points that it is made of; infinite: known ground.
        shifts: shifts that were subtracted from it, as of a chain; empty: known ground.
        since: change of its estimated shift since then, m, shape (3,).
        covariance: covariance of the offset of the points from it, m^2, shape (3, 3).
        chain: chain of the surface; None: known ground.
    """

    surface: GriddedSurface
    count: float
    shifts: Mapping[int, F64]
    since: F64
    covariance: F64
    chain: DwellChain | None = None

    @classmethod
    def of(cls, chain: DwellChain, network: Network, known: Solution, covariance: F64) -> _Compared:
        now = known.at(network.displacements[chain.middle])
        since = now - chain.shifts[chain.middle]
        return cls(chain.points.surface, len(chain.points.place), chain.shifts, since, covariance, chain)

    def reach(self, spacing: float, settings: AdjustmentSettings) -> F64:
        """Greatest offset of the points from their estimated positions, m, shape (3,)."""
        return _reach(self.covariance, spacing, settings)

    def is_placed(self, spacing: float) -> bool:
        """True if the horizontal offset of the points is known to three spacings, well enough to compare heights."""
        return float(np.linalg.eigvalsh(self.covariance[:2, :2])[-1]) <= (3.0 * spacing) ** 2

    def is_recognised(self, found: Match, part: DwellChain) -> bool:
        """True if the images overlap at every shift that was searched, or evidently show the same ground."""
        if self.chain is None or found.everywhere >= 0.1:
            return True
        return evidence(part.points.moved(-self.since), part.rarity, self.chain.points, found.shift) >= SURE

    def is_clear(self, found: Match, part: DwellChain) -> bool:
        """True if enough of a strip meets it, and the shift is not improbable.

        150 points and 0.4 of the smaller image must meet: the roof of a car fits any level ground if all around it
        falls outside the other image, and a short piece of a strip has nothing to be recognised by. The square of the
        shift over its variance is beyond 16.3 by chance once in a thousand.
        """
        count = len(part.points.place)
        variance = self.covariance + np.linalg.inv(found.information)
        return (
            found.share * count >= max(150, 0.4 * min(count, self.count))
            and float(found.shift @ np.linalg.solve(variance, found.shift)) <= 16.3
        )


def _all_compared(
    chain: DwellChain, earlier: Sequence[DwellChain], network: Network, known: Solution, references: References
) -> list[_Compared]:
    """Known ground around a chain, and earlier chains that may have seen the same ground."""
    before = [other for other in earlier if not _continues_strip(other, chain, network)]
    middle, near = network.displacements[chain.middle], _near(chain, before, network.settings)
    relative = [middle.minus([(1.0, network.displacements[other.middle])]) for other in near]
    own, *covariances = known.covariance([middle, *relative])
    met = [_Compared.of(other, network, known, one) for other, one in zip(near, covariances, strict=True)]
    if references.terrain and chain.points.place.size:
        ground = references.terrain.around(chain.points, _reach(own, chain.points.spacing, network.settings))
        if ground:
            met.insert(0, _Compared(ground, np.inf, {}, np.zeros(3), own))
    return met


def _comparison(found: Match, part: DwellChain, other: _Compared, network: Network, fraction: float) -> Comparison:
    """The equation of a match, with a fraction of its information."""
    one, two = found.dwells
    subtracted = _mean_shift(one, part.shifts) - _mean_shift(two, other.shifts) - other.since
    of_ground = [(two[REFERENCE], network.ground)] if REFERENCE in two else []
    moved, seen = (_between(one, two, forms).minus(of_ground) for forms in (network.displacements, network.seen))
    return Comparison(found.dwells, seen.equals(subtracted + found.shift, fraction * found.information), moved)


def _mean_shift(fractions: Mapping[int, float], shifts: Mapping[int, F64]) -> F64:
    """The mean of the shifts of some dwells, m; of known ground it is 0."""
    return sum((part * shifts[number] for number, part in fractions.items() if number != REFERENCE), np.zeros(3))


def _between(one: Mapping[int, float], two: Mapping[int, float], forms: Mapping[int, Form]) -> Form:
    """The mean displacement of some dwells less that of others, by their fractions."""
    return mean_form(one, forms).minus([(1.0, mean_form(two, forms))])


def sighted(network: Network, numbers: Iterable[int], known: Solution, references: References) -> Iterator[Comparison]:
    """Finds the reference targets in dwells.

    Args:
        network: network of the dwells.
        numbers: numbers of the dwells that are searched.
        known: solution of the displacements so far.
        references: known ground.
    """
    if not references.targets:
        return
    for number in numbers:
        points, form = network.dwells[number].points, network.displacements[number]
        reach = _reach(known.covariance([form])[0], points.spacing, network.settings)
        for target in references.targets:
            equation = target.sighted(points, form, known.at(form), reach)
            if equation is not None:
                yield Comparison(({number: 1.0}, {REFERENCE: 1.0}), equation, form, is_target=True)


def _reach(covariance: F64, spacing: float, settings: AdjustmentSettings) -> F64:
    """Search distance for a displacement of this covariance (m^2): four sigma and two spacings, m, shape (3,)."""
    farthest = 4.0 * np.sqrt(np.diag(covariance)) + 2.0 * spacing
    return np.minimum(farthest, settings.reach_spacings * spacing)


def _continues_strip(other: DwellChain, chain: DwellChain, network: Network) -> bool:
    """True if a chain continues the strip of another, and so shows the ground next to it."""
    last, first = (network.dwells[choose(one.shifts)] for one, choose in ((other, max), (chain, min)))
    return first.aperture.sliding and first.seconds - last.seconds <= network.settings.strip_s


def _near(chain: DwellChain, earlier: Sequence[DwellChain], settings: AdjustmentSettings) -> list[DwellChain]:
    """The latest of the earlier chains that may have seen the same ground."""
    reach = settings.reach_spacings * chain.points.spacing
    near = [
        other
        for other in earlier
        if np.all(other.low <= chain.high + reach) and np.all(other.high >= chain.low - reach)
    ]
    return near[-settings.partners :]
