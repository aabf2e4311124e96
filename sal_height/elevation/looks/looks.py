"""Multi-looking: the channels' covariance in each height pixel, summed over the SLC pixels that are its looks."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol, Self, TypeAlias

import numpy as np
import numpy.typing as npt

from sal_height.elevation.looks._look_kernels import sum_covariances, sum_powers, sum_samples
from sal_height.elevation.looks.cell_response import CellResponse
from sal_height.elevation.looks.dwell_columns import DwellColumns
from sal_height.elevation.looks.look_windows import EVEN_VARIANCE, Window, axis_looks
from sal_height.elevation.looks.noise_floor import foreign_power
from sal_height.errors import Rejected, UserError
from sal_height.geometry import Grid
from sal_height.numeric import C64, F32, F64, Bool, Index, in_parallel
from sal_height.sensor import Channels

Indices = slice | Index
Covariance: TypeAlias = F32 | C64

NUMBERS_KEPT = 2**20
"""Greatest number of elements of all covariances that are kept: 4 or 8 MB, 4096 pixels of 16 detectors."""


class Covariances(Protocol):
    """The covariance of every pixel, shape (rows, cols, channels, channels): an array, or computed when indexed."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the whole."""

    def __getitem__(self, pixels: tuple[Indices, Indices], /) -> Covariance:
        """The covariance of some pixels, indexed as the first two axes of an array."""


@dataclass(frozen=True, eq=False)
class Looks:
    """Covariance of the channels in each pixel of the height image: with the beams, the input of an estimator.

    Attributes:
        covariance: sum_k w_k g_k g_k^H, shape (rows, cols, channels, channels): complex64, or its real part as float32.
            Real beams need no more (a^T R a = a^T Re(R) a for any real a).
        squint: squint of each column, shape (cols,), rad.
        noise_powers: E|n|^2 of the receivers' noise of one look in each channel, shape (channels,).
        floor: factor by which scatterers in other pixels raise the noise power of a pixel by their sidelobes, and at
            the edge of a shadow by their main lobes; 1 or more, shape (rows, cols). All their power counts, as it may
            be at one elevation.
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
        dwells: number of dwells side by side (`dwells.estimate_dwells`); with several, `level_spread` and `unplaced`
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
