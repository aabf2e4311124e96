r"""The ground in an image without heights, and how far two such images lie apart: by how bright it is.

An image of one detector tells range and Doppler. Where its surfaces are taken to lie on a known level, it shows how
bright the ground is at each place east and north. Images taken from directions that differ by more than their
resolution share no speckle; what they share is what stands out of the ground. Compared is therefore the logarithm of
the power over its median, less its local mean: no single target decides, and neither does the beam, which lies on the
ground where it is and not where the image is.

The shift is that of the greatest correlation. Its covariance is that of the jackknife over T tiles of the ground,

    C = (T - 1) / T sum_t (s_t - s)(s_t - s)^T,

s_t the shift without tile t and s the mean of these (Efron and Stein, The Annals of Statistics 9, 1981): tiles are much
larger than what correlates within an image, so that they err independently, by whatever makes them differ.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft2, next_fast_len, rfft2
from scipy.ndimage import gaussian_filter, map_coordinates, minimum_filter

from sal_height.geometry import (
    ApertureState,
    Grid,
    locate_at_height,
    pixels_at,
    sphere_coordinates,
    sphere_point,
    without_range_phase,
)
from sal_height.imaging import Slc
from sal_height.numeric import F64, Bool, Index
from sal_height.sensor import Sensor

CELLS_PER_PIXEL = 2
"""Cells to each side of a pixel: power varies twice as fast as the samples of an image, and a parabola through shifts
of whole pixels would err by a tenth of one."""

MOST_CELLS = 1200
"""Cells of the ground to each side; a larger scene is looked at in its middle."""

LOCAL_CELLS = 40.0
"""Standard deviation of the local mean, in cells."""

LEAST_SHARE = 0.6
"""Share of the local mean that must be seen."""

SMOOTH_CELLS = 1.0
"""Standard deviation of the smoothing, in cells: the logarithm has kinks at the median, and correlations would have a
cusp at their maximum, which a parabola does not fit."""

TILES = 8
"""Tiles of the ground to each side over which the jackknife goes: 64 of them know a deviation to 9 %."""

LEAST_TILE = 8
"""Cells to each side of a tile that is not too small."""

DISTINCT = 7.0
"""Correlation over that of all shifts, in standard deviations, above which images show the same ground; by chance the
greatest of a million shifts has 5."""

LEAST_OVERLAP = 0.2
"""Share of the smaller image that two images must both show."""

SAMPLING = 0.03
"""Standard deviation of what a parabola through three shifts errs by, in cells."""

STEPS = np.arange(-2, 3)
"""Cells from the greatest correlation in which tiles are summed: as far as the shift without a tile may go."""


@dataclass(frozen=True, eq=False)
class GroundImage:
    """How bright the ground is, on cells that are the same in all images of the same step.

    Attributes:
        first: east and north of the middle of cell (0, 0), in cells, shape (2,).
        step: size of a cell, m.
        power: of the pixel there, shape (east, north); NaN where the image has none.
    """

    first: Index
    step: float
    power: F64

    @classmethod
    def of(cls, slc: Slc, sensor: Sensor, level: float, step: float) -> Self:
        """The ground at a level (m) in the images of a dwell; the power of detectors is added."""
        aperture = slc.aperture
        low, high = _bounds(slc.grid, aperture, sensor.look_side, level)
        middle, half = (low + high) / 2, np.minimum((high - low) / 2, MOST_CELLS // 2 * step)
        first, last = (
            np.ceil((middle - half) / step).astype(np.int64),
            np.floor((middle + half) / step).astype(np.int64),
        )
        east, north = (step * np.arange(begin, end + 1) for begin, end in zip(first, last, strict=True))
        sight = sphere_point(east[:, None], north[None], level) - aperture.position
        along = sight @ aperture.direction
        across = np.sqrt(np.sum(sight**2, axis=-1) - along**2)
        row, col = pixels_at(across, along, aperture, slc.grid)
        power = np.zeros(row.shape)
        for image in slc.images:
            pixels = without_range_phase(image, slc.grid, aperture, sensor.wavelength)
            for part in (pixels.real, pixels.imag):
                power += map_coordinates(part, [row, col], order=3, mode="nearest") ** 2
        power[(row < 0) | (row > slc.grid.rows - 1) | (col < 0) | (col > slc.grid.cols - 1)] = np.nan
        return cls(first, step, power)

    @cached_property
    def seen(self) -> Bool:
        """Whether the image shows what is around a cell, too, shape (east, north)."""
        there = np.isfinite(self.power).astype(np.float64)
        return np.asarray(gaussian_filter(there, LOCAL_CELLS, mode="constant") > LEAST_SHARE)

    @cached_property
    def contrast(self) -> F64:
        """Logarithm of the power over its median, at least 0, less its local mean; 0 where it is not `seen`."""
        there = np.isfinite(self.power)
        level = np.median(self.power[there]) if there.any() else 0.0
        if not level > 0:
            return np.zeros_like(self.power)
        over = np.log(np.maximum(np.where(there, self.power, 0.0) / level, 1.0))
        share = gaussian_filter(there.astype(np.float64), LOCAL_CELLS, mode="constant")
        mean = gaussian_filter(over, LOCAL_CELLS, mode="constant") / np.maximum(share, LEAST_SHARE)
        return np.where(self.seen, gaussian_filter(over, SMOOTH_CELLS) - mean, 0.0)

    @property
    def middle(self) -> F64:
        """East and north of its middle, m, shape (2,)."""
        return self.step * (self.first + (np.array(self.power.shape) - 1) / 2)


def cell_size(slc: Slc) -> float:
    """Size of the cells on the ground that suit the pixels of an image, m."""
    grid = slc.grid
    sight = grid.middle - slc.aperture.position
    level = float(np.linalg.norm(sight[:2]))
    down = grid.row_spacing * abs(float(grid.row_direction @ sight)) / level
    return min(down, grid.col_spacing) / CELLS_PER_PIXEL


def _bounds(grid: Grid, aperture: ApertureState, look_side: int, level: float) -> tuple[F64, F64]:
    """Least and greatest east and north of the corners of an image on the ground at a level, m, shape (2,) each."""
    sight = grid.points(np.array([0, 0, 1, 1]) * (grid.rows - 1), np.array([0, 1, 0, 1]) * (grid.cols - 1))
    sight = sight - aperture.position
    along = sight @ aperture.direction
    corners = locate_at_height(level, np.linalg.norm(sight, axis=-1), along, aperture, look_side)
    places = np.stack(sphere_coordinates(corners)[:2])
    return places.min(axis=1), places.max(axis=1)


def shift_between(one: GroundImage, other: GroundImage, expected: F64, reach: F64) -> tuple[F64, F64] | None:
    """How much farther east and north one image lies than another.

    Args:
        one: the one image.
        other: the other, of the same step.
        expected: that shift as it is known beforehand, m, shape (2,).
        reach: how far from that it may be, m, shape (2,).

    Returns:
        The shift, m, shape (2,), and its covariance; None: they do not show the same ground, or too little of it.
    """
    lag = _greatest(one, other, expected / one.step, reach / one.step)
    if lag is None:
        return None
    scores = _scores_of_tiles(one, other, lag)
    if scores is None:
        return None
    total = scores.sum(axis=0)
    shifts = lag + np.array([_peak(total), *(_peak(total - tile) for tile in scores)])
    if not np.isfinite(shifts).all():
        return None
    count, apart = len(scores), shifts[1:] - shifts[1:].mean(axis=0)
    covariance = (count - 1) / count * apart.T @ apart + SAMPLING**2 * np.eye(2)
    return one.step * shifts[0], one.step**2 * covariance


def _greatest(one: GroundImage, other: GroundImage, expected: F64, reach: F64) -> Index | None:
    """The shift in whole cells with the greatest correlation of those within reach; None: it does not stand out."""
    size = [next_fast_len(n + m, real=True) for n, m in zip(one.contrast.shape, other.contrast.shape, strict=True)]
    score = irfft2(rfft2(one.contrast, size) * np.conj(rfft2(other.contrast, size)), size)
    lags, shared, within = [], [], []
    for axis, (n, m) in enumerate(zip(one.contrast.shape, other.contrast.shape, strict=True)):
        lag = (np.arange(size[axis]) + m - 1) % size[axis] - (m - 1)
        shared.append(np.maximum(np.minimum(n, m + lag) - np.maximum(0, lag), 0) / min(n, m))
        lags.append(lag + one.first[axis] - other.first[axis])
        within.append(np.abs(lags[axis] - expected[axis]) <= reach[axis])
    # By chance a correlation is as the root of what the images share at that shift.
    overlap = np.outer(*shared)
    score = np.where(overlap > LEAST_OVERLAP, score / np.sqrt(np.maximum(overlap, LEAST_OVERLAP)), 0.0)
    usual = float(np.sqrt(np.mean(score[overlap > LEAST_OVERLAP] ** 2)))
    score[~np.outer(*within)] = 0.0
    place = np.unravel_index(np.argmax(score), score.shape)
    if not score[place] > DISTINCT * usual:
        return None
    return np.array([lags[axis][place[axis]] for axis in range(2)])


def _scores_of_tiles(one: GroundImage, other: GroundImage, lag: Index) -> F64 | None:
    """How well each tile fits at the STEPS around a shift, shape (tiles, steps, steps); None: they overlap too little.

    That is a b - g b^2 / 2, summed over cells of the one image's contrast a and the other's b, which is greatest where
    a - g b has least power. Without the second term what lies across the edge of all tiles would pull the shift.
    Compared are cells that the other image has at each of these shifts.
    """
    offset, reach = one.first - other.first - lag, int(STEPS[-1])  # a cell of the other is that of the one and offset
    low = np.maximum(0, reach - offset)
    high = np.minimum(one.power.shape, np.array(other.power.shape) - reach - offset)
    size = (high - low) // TILES
    if size.min() < LEAST_TILE:
        return None

    def part(values: NDArray[Any], begin: Index) -> NDArray[Any]:
        return values[begin[0] : begin[0] + TILES * size[0], begin[1] : begin[1] + TILES * size[1]]

    def of_tiles(values: F64) -> F64:
        return np.asarray(values.reshape(TILES, size[0], TILES, size[1]).sum(axis=(1, 3)).ravel())

    both = part(one.seen, low) & part(minimum_filter(other.seen, len(STEPS)), low + offset)
    fixed = np.where(both, part(one.contrast, low), 0.0)
    products, powers = np.empty((2, TILES**2, len(STEPS), len(STEPS)))
    for row, col in np.ndindex(len(STEPS), len(STEPS)):
        moved = part(other.contrast, low + offset - STEPS[[row, col]])
        products[:, row, col] = of_tiles(fixed * moved)
        powers[:, row, col] = of_tiles(both * moved**2)
    middle = reach, reach
    gain = products.sum(axis=0)[middle] / max(float(powers.sum(axis=0)[middle]), 1e-300)
    return np.asarray(products - gain / 2 * powers)


def _peak(score: F64) -> F64:
    """Where correlations (steps, steps) are greatest, in cells from the middle; NaN: at the edge."""
    row, col = np.unravel_index(np.argmax(score), score.shape)
    if not (0 < row < len(STEPS) - 1 and 0 < col < len(STEPS) - 1):
        return np.full(2, np.nan)
    return np.array([STEPS[row], STEPS[col]]) + vertex_of(score[row - 1 : row + 2, col - 1 : col + 2])


def vertex_of(values: F64) -> F64:
    """Where the paraboloid through nine values (3, 3) has its maximum, in steps from the middle; NaN: it has none."""
    slope = np.array([values[2, 1] - values[0, 1], values[1, 2] - values[1, 0]]) / 2
    mixed = (values[2, 2] - values[2, 0] - values[0, 2] + values[0, 0]) / 4
    east, north = values[2, 1] + values[0, 1] - 2 * values[1, 1], values[1, 2] + values[1, 0] - 2 * values[1, 1]
    curvature = np.array([[east, mixed], [mixed, north]])
    if not np.linalg.eigvalsh(curvature)[1] < 0:
        return np.full(2, np.nan)
    return np.asarray(-np.linalg.solve(curvature, slope))
