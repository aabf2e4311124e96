"""How far two height images of the same ground lie apart: by their heights alone, wherever the ground is not level.

One image is shifted over the other. For every horizontal shift the shift in height is the robust mean of the
differences, and each point that meets the other image says how much more likely its height h is there than anywhere,

    s = log((1 - o) N(h - h'; 0, sigma^2) / p(h) + o),

where h' is the height that it meets, o the share of outliers (another surface, shadow, something that moved), and p the
density of all heights of the image. What a shift says is the sum of this over its points, each less its mean over all
shifts: that a point meets the image at all says nothing. On level ground that is 0, which tells the shift in height
only, and so it is along the contours of a slope. The result is the mean and the covariance of the likelihood over all
shifts of the window, less what the window alone says.

Heights that are rare in the image fit for nothing where little of it meets the other: a roof fits any level ground, and
is common in what meets. With the density of the heights that meet for p it says nothing there; but on a slope that
density is greater the less of the image meets, which tells of shifts along the contour what nobody knows. Where a match
must be sure, both likelihoods are made, and their mean is what is known: it is wide unless both find the same place.
What a point says is then less its mean over the likely shifts: only what tells these apart counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import LinearNDInterpolator
from scipy.ndimage import distance_transform_edt
from scipy.spatial import QhullError, cKDTree
from scipy.special import logsumexp

from sal_height.adjustment._kernels import average_said, compare_shifts, sum_said
from sal_height.elevation import USABLE
from sal_height.geometry import sphere_coordinates
from sal_height.numeric import F64, Bool, Index
from sal_height.relief import HeightField

OUTLIERS = 0.2
"""Share of points that need not fit: of cars seen from both sides, the half is hidden from one of them."""

RANGE_SPACINGS = 50.0
"""Difference of heights, beyond the shift that is looked for, up to which points meet, in spacings of the points."""

BINS_PER_SIGMA = 4
"""Bins of heights in a standard deviation of the kernel that makes a density of them."""

ROUGHNESS_SPACINGS = 0.2
"""Standard deviation of heights of the same ground seen at another time, and of its sampling, in spacings."""

TEMPER = 0.25
"""By which the likelihood is lowered, as errors of neighbours are not independent: looks share speckle, and both images
the same edges."""

REACH_SPACINGS, NEIGHBOURS = 1.6, 2
"""Distance up to which points hang together, in their spacings, and how many others must."""

EDGE_SPACINGS = 0.25
"""Standard deviation by which edges of one image are not where they are in another, in spacings of the points."""

COARSE = 4
"""Cells of a surface in a step of the coarse search."""

LIKELY = 10.0
"""Logarithm of the likelihood below the greatest, up to which a shift is searched finely."""

MOST_LIKELY = 200
"""Coarse steps around which a shift is searched finely: where more are likely, their spread is what counts."""

MOST_SAID = 2**25
"""Numbers of what points say of shifts in the coarse search, 0.3 GB: for far searches points are thinned to that."""

LEAST_INFORMATION = 1e-6
"""Of nothing, 1/m^2: a standard deviation of 1 km."""

LEAST_POINTS = 20
"""Points that two images must share."""

REFERENCE = -1
"""Stands for a dwell where the ground is known beforehand."""


@dataclass(frozen=True, eq=False)
class Points:
    """The surfaces of one or more dwells as points.

    Attributes:
        place: east, north and height, m, shape (points, 3).
        sigma: standard deviation of the height without what all points share, m, shape (points,).
        cnr_db: carrier-to-noise ratio, shape (points,).
        dwell: number of the dwell that each is of, shape (points,).
        spacing: between points on the ground, m.
    """

    place: F64
    sigma: F64
    cnr_db: F64
    dwell: Index
    spacing: float

    @classmethod
    def of(cls, field: HeightField) -> Points:
        """The strongest scatterers of all pixels of a dwell with a height; the number of the dwell is 0."""
        first = field.first
        usable = np.isfinite(first.height) & np.isin(field.validity, list(USABLE))
        place = np.stack(sphere_coordinates(first.positions[usable]), axis=-1)
        sigma = np.sqrt(first.own_covariance[usable][:, 2, 2])
        spacing = float(max(field.grid.row_spacing, field.grid.col_spacing))
        return cls(place, sigma, first.cnr_db[usable], np.zeros(len(place), np.int64), spacing)

    @cached_property
    def connected(self) -> Points:
        """The points that hang together with NEIGHBOURS others: what stands alone is a ghost or moves."""
        if not self.place.size:
            return self
        reach = REACH_SPACINGS * self.spacing
        climb = self.spacing + 4 * float(np.median(self.sigma))
        scaled = self.place * [1.0, 1.0, reach / climb]
        near = cKDTree(scaled).query_ball_point(scaled, reach, return_length=True)
        return self._chosen(near > NEIGHBOURS)

    def _chosen(self, which: Bool | slice) -> Points:
        names = ("place", "sigma", "cnr_db", "dwell")
        return replace(self, **{name: getattr(self, name)[which] for name in names})

    @classmethod
    def joined(cls, parts: Sequence[Points]) -> Points:
        """The points of all parts."""
        names = ("place", "sigma", "cnr_db", "dwell")
        place, sigma, cnr_db, dwell = (np.concatenate([getattr(part, name) for part in parts]) for name in names)
        return cls(place, sigma, cnr_db, dwell, max(part.spacing for part in parts))

    def numbered(self, dwell: int) -> Points:
        """The points of a dwell with its number."""
        return replace(self, dwell=np.full(len(self.place), dwell))

    def moved(self, shift: F64) -> Points:
        """The points less a shift, m, shape (3,)."""
        return replace(self, place=self.place - shift) if shift.any() else self

    def thinned(self, most: int) -> Points:
        """Not more than so many of the points, evenly spread over their order."""
        return self._chosen(slice(None, None, max(1, -(-len(self.place) // most))))

    @property
    def roughness(self) -> float:
        """Standard deviation of heights of the same ground seen at another time, m."""
        return ROUGHNESS_SPACINGS * self.spacing

    @cached_property
    def middle(self) -> F64:
        """Of the points, m, shape (3,)."""
        return np.asarray(np.median(self.place, axis=0))

    @cached_property
    def binned(self) -> tuple[Index, F64]:
        """The bin of each height, shape (points,), and what a point adds to the density (1/m) in the bins around it."""
        width = float(np.median(np.hypot(self.sigma, self.roughness)))
        step, half = width / BINS_PER_SIGMA, 4 * BINS_PER_SIGMA
        height = self.place[:, 2]
        bins = np.rint((height - height.min()) / step).astype(np.int64) + half
        off = np.arange(-half, half + 1) / BINS_PER_SIGMA
        return bins, np.exp(-(off**2) / 2) / (np.sqrt(2 * np.pi) * width)

    @cached_property
    def surface(self) -> GriddedSurface:
        """The heights on a grid."""
        return GriddedSurface.of(self)


@dataclass(frozen=True, eq=False)
class GriddedSurface:
    """Heights on a grid on the ground; NaN where there are none.

    Attributes:
        origin: east and north of the middle of cell (0, 0), m, shape (2,).
        step: cells, m.
        height: m, shape (east, north).
        sigma: m, same shape.
        dwell: that saw it, same shape.
    """

    origin: F64
    step: float
    height: F64
    sigma: F64
    dwell: Index

    @classmethod
    def of(cls, points: Points) -> GriddedSurface:
        """Heights between the points, where the nearest is no farther than a spacing.

        Where the height between points is not that of the nearest, as at an edge, it is known no better than that.
        """
        step = points.spacing / 2
        low = points.place[:, :2].min(axis=0) - points.spacing
        size = np.ceil((points.place[:, :2].max(axis=0) + points.spacing - low) / step).astype(int) + 1
        at = (points.place[:, :2] - low) / step
        cell = np.rint(at).astype(int)
        number = np.full(size, -1)
        number[cell[:, 0], cell[:, 1]] = np.arange(len(cell))
        far, nearest = distance_transform_edt(number < 0, return_indices=True)
        number = np.where(far * step <= points.spacing, number[nearest[0], nearest[1]], -1)
        height, sigma = np.full(size, np.nan), np.full(size, np.nan)
        there = number >= 0
        try:
            height[there] = LinearNDInterpolator(at, points.place[:, 2])(np.argwhere(there))
        except QhullError:  # all points on a line, or too few
            height[there] = points.place[number[there], 2]
        step_there = height[there] - points.place[number[there], 2]
        sigma[there] = np.hypot(points.sigma[number[there]], step_there)
        return cls(low, step, height, sigma, points.dwell[number])


@dataclass(frozen=True, eq=False)
class Match:
    """How much farther east, north and up one image lies than another.

    Attributes:
        shift: m, shape (3,).
        information: inverse of its covariance, 1/m^2, shape (3, 3).
        dwells: shares of the dwells of the one image among the points that met the other, and of those of the other.
        share: of the points of the one image, those that met the other.
        everywhere: of the most points that met at any shift, the share that did at every one that was looked at.
    """

    shift: F64
    information: F64
    dwells: tuple[dict[int, float], dict[int, float]]
    share: float
    everywhere: float = 1.0

    def of_place(self) -> Match:
        """What it says of the shift east and north, whatever that in height is."""
        return replace(self, information=self.information - self._of_height + LEAST_INFORMATION * np.eye(3))

    def of_height(self) -> Match:
        """What it says of the shift in height once that east and north is known."""
        return replace(self, information=self._of_height + LEAST_INFORMATION * np.eye(3))

    @property
    def _of_height(self) -> F64:
        """The part of the information that depends on the height; the rest is a function of east and north alone."""
        along = self.information[2]
        return np.outer(along, along) / along[2]


def match(points: Points, surface: GriddedSurface, reach: F64, kinds: int = 1) -> Match | None:
    """How far points lie from a surface.

    Args:
        points: of one image.
        surface: of the other.
        reach: greatest shift east, north and up that is looked for, m, shape (3,).
        kinds: 1: by the density of all heights; 2, where a match must be sure: by the mean of that likelihood and of
            the one by the density of the heights that meet.

    Returns:
        None: too few points meet the surface.
    """
    if len(points.place) < LEAST_POINTS:
        return None
    wide = np.maximum(np.ceil(reach[:2] / surface.step), COARSE).astype(int)
    # All shifts in coarse steps, and all around those that are likely.
    cells, step = lattice(wide, COARSE), COARSE * surface.step
    points = points.thinned(max(LEAST_POINTS, MOST_SAID // (kinds * len(cells))))
    said, up = said_of_shifts(points, surface, cells, reach[2], kinds)
    usual = _means(said)
    scores = _scores(said, usual, up, reach[2])
    if not np.isfinite(scores).any():
        return None
    counts = np.isfinite(said[0]).sum(axis=1)
    likely = cells[np.any(scores > scores.max(axis=1, keepdims=True) - LIKELY, axis=0)]
    if len(likely) <= MOST_LIKELY:
        around = (likely[:, None] + lattice(np.full(2, COARSE // 2), 1)).reshape(-1, 2)
        cells, step = np.unique(around[np.all(np.abs(around) <= wide, axis=1)], axis=0), surface.step
        said, up = said_of_shifts(points, surface, cells, reach[2], kinds)
        usual = usual if kinds == 1 else _means(said)
        scores = _scores(said, usual, up, reach[2])
        if not np.isfinite(scores).any():
            return None
    # Mean and covariance of the likelihood, less what the window says by itself.
    weight = np.exp(scores - logsumexp(scores, axis=1, keepdims=True)).mean(axis=0)
    shifts = np.column_stack([cells * surface.step, np.nan_to_num(up[:, 0])])
    mean = weight @ shifts
    off = shifts - mean
    covariance = (weight[:, None] * off).T @ off
    of_height = weight @ (1 / np.maximum(TEMPER * up[:, 1], 1e-9))
    of_place = step**2 / 12 + (EDGE_SPACINGS * points.spacing) ** 2
    covariance += np.diag([of_place, of_place, of_height])
    window = np.diag([*(3 / ((wide + 0.5) * surface.step) ** 2), 0.0])
    values, vectors = np.linalg.eigh(np.linalg.inv(covariance) - window)
    information = (vectors * np.maximum(values, LEAST_INFORMATION)) @ vectors.T
    one, other = _met(points, surface, mean)
    share, everywhere = len(one) / len(points.place), float(counts.min() / counts.max())
    return Match(mean, information, (_shares(one), _shares(other)), share, everywhere)


def lattice(half: Index, step: int) -> Index:
    """Shifts in cells, up to `half` of them to each side, in steps, shape (shifts, 2)."""
    east, north = (np.arange(-(cells // step) * step, cells + 1, step) for cells in half.tolist())
    return np.stack(np.meshgrid(east, north, indexing="ij"), axis=-1).reshape(-1, 2)


def said_of_shifts(
    points: Points, surface: GriddedSurface, cells: Index, reach: float, kinds: int = 1
) -> tuple[F64, F64]:
    """What each point says of each shift, and shifts in height with their weights (`_kernels.compare_shifts`)."""
    place = np.column_stack([(points.place[:, :2] - surface.origin) / surface.step, points.place[:, 2]])
    sigma = np.hypot(points.sigma, points.roughness)
    numbers = np.array([reach + RANGE_SPACINGS * points.spacing, OUTLIERS, LEAST_POINTS])
    said, up = np.empty((kinds, len(cells), len(place))), np.empty((len(cells), 2))
    shifts = cells.astype(np.int64)
    compare_shifts(place, sigma, *points.binned, shifts, surface.height, surface.sigma, numbers, said, up)
    return said, up


def _means(said: F64) -> F64:
    """What each point says on the average over all shifts at which it meets the surface; 0: at none."""
    usual = np.empty((len(said), said.shape[2]))
    for one, mean in zip(said, usual, strict=True):
        average_said(one, mean)
    return usual


def _scores(said: F64, usual: F64, up: F64, reach: float) -> F64:
    """Logarithm of the likelihoods of each shift, tempered; none where too few points meet, or too high or low."""
    scores = np.empty(said.shape[:2])
    for one, mean, score in zip(said, usual, scores, strict=True):
        sum_said(one, mean, score)
    return np.where(np.abs(up[:, 0]) <= reach, TEMPER * scores, -np.inf)


def _met(points: Points, surface: GriddedSurface, shift: F64) -> tuple[Index, Index]:
    """Dwells of the points that meet a surface once they are shifted, and of the cells that they meet."""
    cell = np.floor((points.place[:, :2] - shift[:2] - surface.origin) / surface.step + 0.5).astype(int)
    inside = np.all((cell >= 0) & (cell < surface.height.shape), axis=-1)
    east, north = cell[inside].T
    there = np.isfinite(surface.height[east, north])
    return points.dwell[inside][there], surface.dwell[east, north][there]


def _shares(dwells: Index) -> dict[int, float]:
    """Share of each dwell among some."""
    numbers, counts = np.unique(dwells, return_counts=True)
    return dict(zip(numbers.tolist(), (counts / counts.sum()).tolist(), strict=True))
