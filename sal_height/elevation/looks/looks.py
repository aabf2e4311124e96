"""Multi-looking: the channels' covariance in each height pixel, summed over its looks; its noise floor."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol, Self, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.ndimage import uniform_filter
from scipy.special import fdtri

from sal_height.elevation.looks._look_kernels import find_edges, sum_covariances, sum_powers, sum_samples
from sal_height.elevation.looks.cell_response import CellResponse
from sal_height.elevation.looks.look_windows import EVEN_VARIANCE, AxisLooks, Bands, Window, axis_looks
from sal_height.errors import Rejected, UserError
from sal_height.geometry import Grid
from sal_height.numeric import C64, F32, F64, Bool, Index, ShortRepr, in_parallel
from sal_height.sensor import Channels

SPECKLE_RATE = 0.003
"""Fraction of pairs of pixels of level ground whose speckle differs as much as a shadow and its surroundings.

A pixel has 12 ordered pairs of neighbours; of the pixels between such a pair only the weak ones are affected.
"""

Values = npt.NDArray[Any]

Indices = slice | Index

Covariance: TypeAlias = F32 | C64

NUMBERS_KEPT = 2**20
"""Greatest number of elements of all covariances that are kept: 4 or 8 MB, 4096 pixels of 16 detectors."""


def foreign_power(power: F64, mean_power: F64, noise: float, down: AxisLooks, across: AxisLooks, deviation: F64) -> F64:
    """Expected power of scatterers elsewhere in each pixel, mean of its looks, shape of `mean_power`.

    It is that of sidelobes, and in dark pixels at the edge of a shadow that of the main lobes of brighter neighbours.

    Args:
        power: power of each sample over all channels, shape (rows, cols) of samples.
        mean_power: power of each pixel, mean of its looks, shape (rows, cols) of pixels.
        noise: expected power of the noise in it.
        down: looks along range.
        across: looks along azimuth.
        deviation: standard deviation of each pixel's noise power, mean of its looks and sum over channels.
    """
    if not (down.leakage and across.leakage):
        return np.zeros_like(deviation)
    sums = np.multiply.outer(down.looks.sums, across.looks.sums)

    def mean(samples: F64, along_range: Bands, along_azimuth: Bands) -> F64:
        return along_range.down(along_azimuth.across(samples)) / sums

    signal = np.maximum(power - noise, 0.0)
    near = mean(signal, down.leakage.near, across.leakage.near)
    of_neighbours = near - mean(signal, down.leakage.own, across.leakage.own)
    sidelobes = np.maximum(mean(signal, down.leakage.whole, across.leakage.whole) - near, 0.0)
    # Ground as bright as the pixel itself goes on beside it: only what brighter neighbours add to it is foreign.
    own = np.multiply.outer(down.leakage.own.sums, across.leakage.own.sums) / sums
    beside = np.multiply.outer(down.leakage.near.sums, across.leakage.near.sums) / sums - own
    received = mean_power - noise
    brightness = np.maximum(received - of_neighbours, 0.0) / own
    foreign = sidelobes + np.maximum(of_neighbours - beside * brightness, 0.0)
    # Where at most a quarter may be foreign, a scatterer that stands out is in the pixel: a wall, roof or kerb.
    edge = is_edge_of_shadow(received, down, across, deviation) & (foreign > 0.25 * received)
    return np.where(edge, foreign, sidelobes)


def is_edge_of_shadow(power: F64, down: AxisLooks, across: AxisLooks, deviation: F64) -> Bool:
    """Pixels with a dark and a bright neighbour whose powers differ more than by speckle and noise; shape of `power`.

    Noise counts with one standard deviation on either side.

    Args:
        power: power of the pixels less that of noise, shape (rows, cols).
        down: looks along range.
        across: looks along azimuth.
        deviation: standard deviation of the noise power, same shape as `power`.
    """
    edge = np.empty(power.shape, np.bool_)
    find_edges(power, _speckle_contrast(down, across), deviation, (down.apart, across.apart), edge)
    return edge


@lru_cache(maxsize=4)
def _speckle_contrast(down: AxisLooks, across: AxisLooks) -> F64:
    """Ratio of the powers of two pixels that speckle exceeds at SPECKLE_RATE, shape (rows, cols).

    The ratio of the powers of two pixels of K looks of speckle has the F distribution of 2 K and 2 K degrees.
    """
    (rows, row_of), (cols, col_of) = (np.unique(axis.count, return_inverse=True) for axis in (down, across))
    degrees = 2 * np.multiply.outer(rows, cols)
    return np.asarray(fdtri(degrees, degrees, 1 - SPECKLE_RATE)[row_of[:, None], col_of])


@dataclass(frozen=True)
class DwellColumns:
    """Dwells of equal width, side by side in one image; pixels of different dwells are not neighbours.

    Attributes:
        dwells: number of dwells.
        cols: number of columns of a dwell.
    """

    dwells: int
    cols: int

    @property
    def slices(self) -> list[slice]:
        """The columns of each dwell."""
        return [slice(dwell * self.cols, (dwell + 1) * self.cols) for dwell in range(self.dwells)]

    def split(self, values: Values) -> list[Values]:
        """The values of each dwell, contiguous.

        Args:
            values: array whose last axis is the columns, or the second one in (rows, cols, ...).
        """
        if self.dwells == 1:
            return [values]
        if values.ndim == 1:
            return [values[part] for part in self.slices]
        return [np.ascontiguousarray(values[:, part]) for part in self.slices]

    def each(self, function: Callable[..., Values], *values: Values) -> Values:
        """Apply a function to the values of each dwell alone, and put its results side by side.

        For results that depend on the other pixels of a dwell, and for matrix products over pixels, whose rounding in
        BLAS depends on their number.

        Args:
            function: function of arrays of one dwell that returns an array whose last axis is the columns.
            values: arrays as in `split`.
        """
        found = [function(*one) for one in zip(*map(self.split, values), strict=True)]
        return found[0] if self.dwells == 1 else np.concatenate(found, axis=-1)

    def mean_of_neighbours(self, values: F64, size: int) -> F64:
        """Mean over `size` x `size` pixels around each pixel; a dwell is continued beyond its border by its edge.

        Args:
            values: n images, shape (n, rows, cols).
            size: side of the square, odd, pixels.
        """
        by_dwell = values.reshape(*values.shape[:2], self.dwells, self.cols)
        mean: F64 = uniform_filter(by_dwell, size, axes=(1, 3), mode="nearest")
        return mean.reshape(values.shape)

    def has_another(self, there: Bool, size: int) -> Bool:
        """True where another pixel of the `size` x `size` pixels around each pixel is `there`, shape (rows, cols)."""
        by_dwell = there.reshape(len(there), self.dwells, self.cols).astype(np.float32)
        count = size**2 * uniform_filter(by_dwell, size, axes=(0, 2), mode="constant")
        return np.asarray(count.reshape(there.shape) > there + 0.5)


class Covariances(Protocol):
    """The covariance of every pixel, shape (rows, cols, channels, channels): an array, or computed when indexed."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the whole."""

    def __getitem__(self, pixels: tuple[Indices, Indices], /) -> Covariance:
        """The covariance of some pixels, indexed as the first two axes of an array."""


@dataclass(frozen=True, eq=False)
class Looks(ShortRepr):
    """Covariance of the channels in each pixel of the height image: with the beams, the input of an estimator.

    Attributes:
        covariance: sum_k w_k g_k g_k^H, shape (rows, cols, channels, channels): complex64, or its real part as float32.
            Real beams need no more (a^T R a = a^T Re(R) a for any real a).
        squint: squint of each column, shape (cols,), rad.
        noise_powers: E|n|^2 of the receivers' noise of one look in each channel, shape (channels,).
        floor: factor by which scatterers in other pixels raise the noise power of a pixel by their sidelobes, and in
            dark pixels at the edge of a shadow by their main lobes; 1 or more, shape (rows, cols). All their power
            counts, as it may be at one elevation.
        count: effective number of looks K = (sum w)^2 / sum w_i w_j |rho_ij|^2, shape (rows, cols), rho the correlation
            of the noise, and of the speckle, of two looks; sum w^2 below if they are independent. The weights w are
            scaled to have the sum K: mean and variance of the noise are then those of K independent looks.
        row_variance: variance of the position of the looks' speckle about `row`, shape (rows, cols), SLC rows squared.
        col_variance: variance about `col`, SLC columns squared.
        row: power-weighted mean row of the looks, shape (rows, cols), SLC pixels; the middle if there is no power.
        col: power-weighted mean column, SLC pixels.
        power: trace of the covariance, shape (rows, cols).
        finite: False where a sample was NaN or infinite, shape (rows, cols); the covariance is 0 there.
        level_spread: standard deviation of the elevations within a pixel on level ground, whose ranges differ, rad; 0:
            all its scatterers are at one elevation.
        unplaced: fraction of the variance of the ranges in a pixel that is within its samples, where the position of
            their power is unknown.
        dwells: number of dwells side by side (`registry.estimate_dwells`); with several, `level_spread` and `unplaced`
            are those of each column, shape (cols,).
    """

    covariance: Covariances
    squint: F64
    noise_powers: F64
    floor: F64
    count: F64
    row_variance: F64
    col_variance: F64
    row: F64
    col: F64
    power: F64
    finite: Bool
    level_spread: float | F64 = 0.0
    unplaced: float | F64 = 1.0
    dwells: int = 1

    @classmethod
    def of(
        cls, covariance: Covariance, count: float, squint: npt.ArrayLike = 0.0, noise_power: npt.ArrayLike = 1.0
    ) -> Self:
        """Looks of a known covariance (rows, cols, channels, channels), each pixel at its own row and column.

        `squint` (rad) broadcasts with the columns, `noise_power` with the channels.
        """
        rows, cols, channels, _ = covariance.shape
        row, col = np.indices((rows, cols), dtype=np.float64)
        return cls(
            covariance,
            squint=np.full(cols, squint, np.float64),
            noise_powers=np.full(channels, noise_power, np.float64),
            floor=np.ones((rows, cols)),
            count=np.full((rows, cols), count, np.float64),
            row_variance=np.full((rows, cols), EVEN_VARIANCE / count),
            col_variance=np.full((rows, cols), EVEN_VARIANCE / count),
            row=row,
            col=col,
            power=np.trace(covariance.real, axis1=-2, axis2=-1, dtype=np.float64),
            finite=np.ones((rows, cols), np.bool_),
        )

    @property
    def columns(self) -> DwellColumns:
        """The columns of each dwell."""
        return DwellColumns(self.dwells, len(self.squint) // self.dwells)

    @property
    def receiver_noise(self) -> float:
        """E|n|^2 of the receivers' noise of one look in every channel, if it is equal (`whitened_channels`)."""
        return float(self.noise_powers[0])

    @property
    def noise_power(self) -> F64:
        """E|n|^2 of one look in every channel, with the sidelobes of other pixels, shape (rows, cols)."""
        return self.receiver_noise * self.floor

    @property
    def leaked(self) -> F64:
        """Expected power of other pixels' sidelobes over the receivers' noise power, sum over looks, (rows, cols)."""
        return (self.floor - 1) * self.count


@dataclass(frozen=True)
class SlcCovariance:
    """The covariance of every pixel, summed from the images when it is indexed, so that it is never kept as a whole.

    The sums are in single precision: their error grows as 6e-8 times the number of looks. Indexing runs in the calling
    thread alone.

    Attributes:
        numbers: real and imaginary parts of the images, alternating, shape (channels, rows, 2 * cols), float32.
        down, across: looks in range and azimuth.
        gains: complex factor of each channel, shape (channels,).
        scale: factor of the weights in each pixel, shape (rows, cols); where it is 0 the covariance is 0.
        hermitian: True for complex covariances, False for their real part.
    """

    numbers: F32
    down: Window
    across: Window
    gains: C64
    scale: F32
    hermitian: bool

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """(rows, cols, channels, channels)."""
        return *self.scale.shape, len(self.numbers), len(self.numbers)

    def __getitem__(self, pixels: tuple[Indices, Indices], /) -> Covariance:
        """The covariance of some pixels, indexed as the first two axes of an array."""
        rows, cols = (np.arange(n)[index] for n, index in zip(self.shape, pixels, strict=False))
        if any(isinstance(index, slice) for index in pixels):
            rows = rows[:, None]
        shape, channels = np.broadcast_shapes(rows.shape, cols.shape), len(self.numbers)
        flat = np.broadcast_to(rows, shape).flatten(), np.broadcast_to(cols, shape).flatten()
        parts = np.empty((len(flat[0]), 1 + self.hermitian, channels, channels), np.float32)
        down, across = ((w.first, w.step, w.weights.astype(np.float32)) for w in (self.down, self.across))
        sum_covariances(self.numbers, self.gains, flat, down, across, self.scale, parts)
        return _joined(parts).reshape(*shape, channels, channels)


def covariance(samples: C64, hermitian: bool) -> Covariance:
    """Sum g g^H over the looks of each pixel; precision and threads as in `SlcCovariance`.

    Args:
        samples: g, shape (pixels, looks, channels), C-contiguous; finite.
        hermitian: True for a complex result, which complex beams need (`Beams.is_complex`); False for its real part.

    Returns:
        Shape (pixels, channels, channels), complex64 if `hermitian`, otherwise float32.
    """
    pixels, _, channels = samples.shape
    parts = np.empty((pixels, 1 + hermitian, channels, channels), np.float32)
    sum_samples(samples.view(np.float32), parts)
    return _joined(parts)


def _joined(parts: F32) -> Covariance:
    """Complex matrices from their real and imaginary parts (pixels, 2, M, M), or real ones from (pixels, 1, M, M)."""
    return parts[:, 0] + np.complex64(1j) * parts[:, 1] if parts.shape[1] == 2 else parts[:, 0]


def live_detectors(slc: C64) -> Index:
    """Find the channels of `slc` (channels, rows, cols) that have a finite sample other than 0 anywhere.

    Raises:
        Rejected: there are fewer than two.
    """
    dead = np.arange(len(slc))
    for row in range(slc.shape[1]):
        samples = slc[dead, row]
        dead = dead[~np.any(np.isfinite(samples) & (samples != 0), axis=-1)]
        if not dead.size:
            break
    live = np.setdiff1d(np.arange(len(slc)), dead) if dead.size else np.arange(len(slc))
    if len(live) < 2:
        raise Rejected(
            "dead detectors",
            f"Of {len(slc)} detectors {len(live)} have a finite sample other than 0 in the images; elevation needs 2 "
            "or more.",
        )
    return live


def windowed_looks(
    slc: C64,
    windows: tuple[Window, Window],
    squint: F64,
    channels: Channels,
    hermitian: bool,
    response: CellResponse | None = None,
    level_turn: float = 0.0,
) -> Looks:
    """Sum up the looks of every pixel of the height image.

    On sloping ground the looks of a pixel have different ranges and elevations; the power-weighted centre is the range
    of the estimated elevation, which is itself weighted by power. Pixels whose windows overlap have looks in common,
    and their errors.

    Args:
        slc: images of all channels, shape (channels, rows, cols); covariances of more than NUMBERS_KEPT elements
            are computed from them on demand.
        windows: looks in range and in azimuth.
        squint: squint of each column of the height image, shape (cols,), rad.
        channels: channels of the estimator, from those of the images.
        hermitian: True for a complex covariance, which complex beams need (`Beams.is_complex`).
        response: impulse response of the images, which correlates samples and has sidelobes in other pixels; None:
            samples are independent, without sidelobes.
        level_turn: difference in elevation of level ground from row to row of the images, rad.

    Raises:
        UserError: more looks than the image has pixels.
    """
    (down, across), transform, (rows, cols) = windows, channels.transform, slc.shape[1:]
    high, wide = len(down.weights), len(across.weights)
    if high > rows or wide > cols:
        raise UserError(f"Looks are {high} x {wide} in an image of {rows} x {cols} pixels; they must fit in it.")
    gains = np.diag(transform).astype(np.complex64)
    if np.count_nonzero(transform) > np.count_nonzero(np.diag(transform)):
        slc, gains = np.tensordot(transform.astype(np.complex64), slc, axes=1), np.ones_like(gains)
    numbers = np.ascontiguousarray(slc, dtype=np.complex64).view(np.float32)
    # The power of each sample over all channels; negative where one is not finite.
    sample_power = np.empty((rows, cols), np.float32)
    weights = np.abs(gains) ** 2
    # Another thread pays from 2^19 real and imaginary parts of samples.
    least = -(-(2**19) // (numbers.shape[0] * numbers.shape[2]))
    in_parallel(lambda part: sum_powers(numbers, weights, part.start, sample_power[part]), rows, least)
    by_row = axis_looks(down, rows, response.down if response else None)
    by_col = axis_looks(across, cols, response.across if response else None)
    count = np.multiply.outer(by_row.count, by_col.count)
    bad = sample_power < 0
    finite = (
        by_row.looks.down(by_col.looks.across(bad.astype(np.float64))) == 0
        if bad.any()
        else np.ones_like(count, np.bool_)
    )
    # Sums over the looks of each pixel, first along the columns, then along the rows.
    seen = np.maximum(sample_power, 0).astype(np.float64)
    along = by_col.looks.across(seen)
    summed = by_row.looks.down(along)
    power = summed * finite
    sums = np.multiply.outer(by_row.looks.sums, by_col.looks.sums)
    scale = count / sums * finite
    # The power-weighted centre; the middle of the looks where there is no power.
    row, col = np.empty((2, *count.shape))
    row[:], col[:] = by_row.middle[:, None], by_col.middle
    np.divide(by_row.moments.down(along), power, out=row, where=power > 0)
    np.divide(by_row.looks.down(by_col.moments.across(seen)), power, out=col, where=power > 0)
    floor = np.ones_like(count)
    if np.all(channels.noise_powers > 0):
        noise = float(channels.noise_powers.sum())
        deviation = noise / np.sqrt(len(slc) * count)
        floor += foreign_power(seen, summed / sums, noise, by_row, by_col, deviation) / channels.noise_powers.min()
    # Variances depend on the inverse of the looks' energy, whose median is less by 1/3 than its mean K.
    median = count / (count - 1 / 3)
    variance = by_row.between + by_row.within
    covariances = SlcCovariance(numbers, down, across, gains, scale.astype(np.float32), hermitian)
    return Looks(
        covariance=covariances[:, :] if math.prod(covariances.shape) <= NUMBERS_KEPT else covariances,
        squint=squint,
        noise_powers=channels.noise_powers,
        floor=floor,
        count=count,
        row_variance=np.multiply.outer(by_row.displaced, 1 / by_col.count) * median,
        col_variance=np.multiply.outer(1 / by_row.count, by_col.displaced) * median,
        row=row,
        col=col,
        power=power * scale,
        finite=finite,
        level_spread=level_turn * math.sqrt(variance),
        unplaced=by_row.within / variance,
    )


def look_grid(grid: Grid, down: Window, across: Window) -> Grid:
    """Pixel grid of the height image whose looks are windows of the SLC's `grid` in range and azimuth."""
    return Grid(
        origin=grid.points(down.middle, across.middle),
        row_direction=grid.row_direction,
        col_direction=grid.col_direction,
        row_spacing=grid.row_spacing * down.step,
        col_spacing=grid.col_spacing * across.step,
        rows=down.pixels(grid.rows),
        cols=across.pixels(grid.cols),
    )
