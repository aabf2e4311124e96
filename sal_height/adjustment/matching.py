"""Estimates the offset between two height images of the same ground, by their heights alone.

One image is shifted over the other. For every horizontal shift the shift in height is the robust mean of the
differences, and each point that meets the other image contributes the log likelihood ratio of its height h there
against anywhere,

    s = log((1 - o) N(h - h'; 0, sigma^2) / p(h) + o),

where h' is the height that it meets, o the fraction of outliers (another surface, shadow, something that moved), and p
the density of all heights of the image. The log likelihood of a shift is the sum of this over its points, each less its
mean over all shifts: that a point meets the image at all is no evidence. On level ground that is 0, so that only the
shift in height is estimated, and so it is along the contours of a slope. The result is the mean and the covariance of
the likelihood over all shifts of the window, less the information of the window alone.

Heights that are rare in the image fit by chance where little of it meets the other: a roof fits any level ground, and
is common in the part that meets. With the density of the heights that meet as p it is no evidence there; but on a slope
that density is greater the less of the image meets, which would be false information on shifts along the contour. Where
a match must be sure, both likelihoods are computed, and their mean is used: it is wide unless both are greatest at the
same shift. Each contribution is then less its mean over the likely shifts: only differences between these count.
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

from sal_height.adjustment._kernels import average_over_shifts, compare_shifts, sum_over_points
from sal_height.elevation import USABLE
from sal_height.geometry import sphere_coordinates
from sal_height.numeric import F64, Bool, Index, ShortRepr
from sal_height.relief import HeightField

OUTLIERS = 0.2
"""Fraction of points that need not fit: of cars seen from both sides, half is hidden from one of them."""

TEMPER = 0.25
"""Factor of log likelihoods, as errors of neighbours are not independent: looks have common speckle, and both images
the same edges."""

REACH_SPACINGS = 1.6
"""Distance up to which points are neighbours, in their spacings."""

COARSE = 4
"""Cells of a surface in a step of the coarse search."""

MOST_CONTRIBUTIONS = 2**25
"""Contributions of points to shifts in the coarse search, 0.3 GB: for far searches points are thinned to that."""

LEAST_INFORMATION = 1e-6
"""Information on an unknown coordinate, 1/m^2: a standard deviation of 1 km."""

LEAST_POINTS = 20
"""Points of one image that must meet the other."""

REFERENCE = -1
"""Number that stands for known ground instead of a dwell."""


@dataclass(frozen=True, eq=False)
class Points(ShortRepr):
    """The surfaces of one or more dwells as points.

    Attributes:
        place: east, north and height, m, shape (points, 3).
        sigma: standard deviation of the height without common errors of all points, m, shape (points,).
        cnr_db: carrier-to-noise ratio, dB, shape (points,).
        dwell: number of the dwell of each point, shape (points,).
        spacing: distance between points on the ground, m.
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
        """The points with two neighbours or more: what stands alone is a ghost or moves."""
        if not self.place.size:
            return self
        reach = REACH_SPACINGS * self.spacing
        climb = self.spacing + 4 * float(np.median(self.sigma))
        scaled = self.place * [1.0, 1.0, reach / climb]
        near = cKDTree(scaled).query_ball_point(scaled, reach, return_length=True)
        return self._chosen(near > 2)  # a point is its own neighbour, too

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
        """At most this number of the points, evenly spread over their order."""
        return self._chosen(slice(None, None, max(1, -(-len(self.place) // most))))

    @property
    def roughness(self) -> float:
        """Standard deviation of heights of the same ground seen at another time, m."""
        return 0.2 * self.spacing  # with its sampling

    @cached_property
    def middle(self) -> F64:
        """Median of the points, m, shape (3,)."""
        return np.asarray(np.median(self.place, axis=0))

    @cached_property
    def binned(self) -> tuple[Index, F64]:
        """The bin of each height, shape (points,), and what a point adds to the density (1/m) in the bins around it."""
        width = float(np.median(np.hypot(self.sigma, self.roughness)))
        per_sigma = 4  # bins in a standard deviation of the kernel
        step, half = width / per_sigma, 4 * per_sigma
        height = self.place[:, 2]
        bins = np.rint((height - height.min()) / step).astype(np.int64) + half
        off = np.arange(-half, half + 1) / per_sigma
        return bins, np.exp(-(off**2) / 2) / (np.sqrt(2 * np.pi) * width)

    @cached_property
    def surface(self) -> GriddedSurface:
        """The heights on a grid."""
        return GriddedSurface.of(self)


@dataclass(frozen=True, eq=False)
class GriddedSurface:
    """Heights on a grid on the ground; NaN where they are unknown.

    Attributes:
        origin: east and north of the middle of cell (0, 0), m, shape (2,).
        step: side of a cell, m.
        height: height of each cell, m, shape (east, north).
        sigma: standard deviation of the height, m, same shape.
        dwell: number of the dwell that saw the cell, same shape.
    """

    origin: F64
    step: float
    height: F64
    sigma: F64
    dwell: Index

    @classmethod
    def of(cls, points: Points) -> GriddedSurface:
        """Interpolates heights between the points, where the nearest is no farther than a spacing.

        The difference to the height of the nearest point, as at an edge, is part of the standard deviation.
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
    """Offset of one image from another.

    Attributes:
        shift: offset east, north and up, m, shape (3,).
        information: inverse of its covariance, 1/m^2, shape (3, 3).
        dwells: fraction of each dwell among the points of the first image that met the other, and among those of the
            other.
        share: fraction of the points of the first image that met the other.
        everywhere: least number of points that met at any searched shift, as a fraction of the greatest.
    """

    shift: F64
    information: F64
    dwells: tuple[dict[int, float], dict[int, float]]
    share: float
    everywhere: float = 1.0

    def of_place(self) -> Match:
        """The match with its information on the shift east and north only, for any shift in height."""
        return replace(self, information=self.information - self._of_height + LEAST_INFORMATION * np.eye(3))

    def of_height(self) -> Match:
        """The match with its information on the shift in height only, given the shift east and north."""
        return replace(self, information=self._of_height + LEAST_INFORMATION * np.eye(3))

    @property
    def _of_height(self) -> F64:
        """The part of the information that depends on the height; the rest is a function of east and north alone."""
        along = self.information[2]
        return np.outer(along, along) / along[2]


def match(points: Points, surface: GriddedSurface, reach: F64, kinds: int = 1) -> Match | None:
    """Estimates the offset of points from a surface.

    Args:
        points: points of one image.
        surface: surface of the other.
        reach: greatest shift east, north and up that is searched, m, shape (3,).
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
    points = points.thinned(max(LEAST_POINTS, MOST_CONTRIBUTIONS // (kinds * len(cells))))
    likelihood, up = likelihood_of_shifts(points, surface, cells, reach[2], kinds)
    usual = _means(likelihood)
    scores = _scores(likelihood, usual, up, reach[2])
    if not np.isfinite(scores).any():
        return None
    counts = np.isfinite(likelihood[0]).sum(axis=1)
    likely = cells[np.any(scores > scores.max(axis=1, keepdims=True) - 10.0, axis=0)]
    if len(likely) <= 200:  # where more are likely, their spread is what counts
        around = (likely[:, None] + lattice(np.full(2, COARSE // 2), 1)).reshape(-1, 2)
        cells, step = np.unique(around[np.all(np.abs(around) <= wide, axis=1)], axis=0), surface.step
        likelihood, up = likelihood_of_shifts(points, surface, cells, reach[2], kinds)
        usual = usual if kinds == 1 else _means(likelihood)
        scores = _scores(likelihood, usual, up, reach[2])
        if not np.isfinite(scores).any():
            return None
    # Mean and covariance of the likelihood, less the information of the window by itself.
    weight = np.exp(scores - logsumexp(scores, axis=1, keepdims=True)).mean(axis=0)
    shifts = np.column_stack([cells * surface.step, np.nan_to_num(up[:, 0])])
    mean = weight @ shifts
    off = shifts - mean
    covariance = (weight[:, None] * off).T @ off
    of_height = weight @ (1 / np.maximum(TEMPER * up[:, 1], 1e-9))
    of_place = step**2 / 12 + (0.25 * points.spacing) ** 2  # edges are offset by so much between images
    covariance += np.diag([of_place, of_place, of_height])
    window = np.diag([*(3 / ((wide + 0.5) * surface.step) ** 2), 0.0])
    values, vectors = np.linalg.eigh(np.linalg.inv(covariance) - window)
    information = (vectors * np.maximum(values, LEAST_INFORMATION)) @ vectors.T
    one, other = _met(points, surface, mean)
    fraction, everywhere = len(one) / len(points.place), float(counts.min() / counts.max())
    return Match(mean, information, (_fractions(one), _fractions(other)), fraction, everywhere)


def lattice(half: Index, step: int) -> Index:
    """Shifts in cells, up to `half` cells to each side, in steps, shape (shifts, 2)."""
    east, north = (np.arange(-(cells // step) * step, cells + 1, step) for cells in half.tolist())
    return np.stack(np.meshgrid(east, north, indexing="ij"), axis=-1).reshape(-1, 2)


def likelihood_of_shifts(
    points: Points, surface: GriddedSurface, cells: Index, reach: float, kinds: int = 1
) -> tuple[F64, F64]:
    """The contribution of each point to each shift, and shifts in height with weights (`_kernels.compare_shifts`)."""
    place = np.column_stack([(points.place[:, :2] - surface.origin) / surface.step, points.place[:, 2]])
    sigma = np.hypot(points.sigma, points.roughness)
    # Points meet up to 50 spacings above or below the surface, in addition to the shift that is searched.
    numbers = np.array([reach + 50.0 * points.spacing, OUTLIERS, LEAST_POINTS])
    likelihood, up = np.empty((kinds, len(cells), len(place))), np.empty((len(cells), 2))
    shifts = cells.astype(np.int64)
    compare_shifts(place, sigma, *points.binned, shifts, surface.height, surface.sigma, numbers, likelihood, up)
    return likelihood, up


def _means(likelihood: F64) -> F64:
    """The mean contribution of each point over all shifts at which it meets the surface; 0 without any."""
    usual = np.empty((len(likelihood), likelihood.shape[2]))
    for one, mean in zip(likelihood, usual, strict=True):
        average_over_shifts(one, mean)
    return usual


def _scores(likelihood: F64, usual: F64, up: F64, reach: float) -> F64:
    """Tempered log likelihoods of each shift; minus infinity where too few points meet, or too high or low."""
    scores = np.empty(likelihood.shape[:2])
    for one, mean, score in zip(likelihood, usual, scores, strict=True):
        sum_over_points(one, mean, score)
    return np.where(np.abs(up[:, 0]) <= reach, TEMPER * scores, -np.inf)


def _met(points: Points, surface: GriddedSurface, shift: F64) -> tuple[Index, Index]:
    """The dwells of points that meet a surface once they are shifted, and of the cells that they meet."""
    cell = np.floor((points.place[:, :2] - shift[:2] - surface.origin) / surface.step + 0.5).astype(int)
    inside = np.all((cell >= 0) & (cell < surface.height.shape), axis=-1)
    east, north = cell[inside].T
    there = np.isfinite(surface.height[east, north])
    return points.dwell[inside][there], surface.dwell[east, north][there]


def _fractions(dwells: Index) -> dict[int, float]:
    """Fraction of each dwell among the dwells of some points."""
    numbers, counts = np.unique(dwells, return_counts=True)
    return dict(zip(numbers.tolist(), (counts / counts.sum()).tolist(), strict=True))
