"""Multi-looking: the channels' covariance in each height pixel."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, Self, TypeAlias

import numpy as np

from sal_height.errors import Rejected, UserError
from sal_height.geometry import Grid
from sal_height.numeric import C64, F32, F64, Bool, Complex, Index, compiled, in_parallel, inlined

Indices = slice | Index
Covariance: TypeAlias = F32 | C64

LOOK_WINDOWS: dict[str, Callable[[int], F64]] = {
    "boxcar": np.ones,
    "triangular": lambda count: np.bartlett(count + 2)[1:-1],
    "hamming": np.hamming,
}
"""Weights of the looks of a pixel, all greater than 0."""

LOOKS_AT_ONCE = 4
"""Whose outer products are added at a time: what stays in registers."""

EXPONENT = np.uint32(0x7F800000)
"""Of a float32: all set if it is infinite or not a number, which compiled loops do not tell otherwise."""


class Covariances(Protocol):
    """The covariance of every pixel, (rows, cols, channels, channels): an array, or made when it is asked for."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the whole."""

    def __getitem__(self, pixels: tuple[Indices, Indices], /) -> Covariance:
        """Of some pixels, indexed as an array's first two axes."""


@dataclass(frozen=True)
class Window:
    """Which samples along one axis of an image are the looks of a pixel, and how much they weigh.

    Pixel i has the samples from i step + (step - n) // 2 on, n the number of weights: consecutive blocks if the step is
    n, a window that slides by one sample if it is 1. What an edge of the image cuts off is left out.

    Attributes:
        weights: of the looks, greater than 0, shape (n,).
        step: samples from one pixel to the next.

    Raises:
        UserError: no weight, one that is not finite and greater than 0, or a step below 1.
    """

    weights: F64
    step: int

    def __post_init__(self) -> None:
        if not (self.weights.size and np.all(np.isfinite(self.weights) & (self.weights > 0)) and self.step >= 1):
            raise UserError(
                f"A window of looks has the weights {self.weights.tolist()} and the step {self.step}; it must have one "
                "weight or more, all finite and greater than 0, and a step of 1 or more."
            )

    @classmethod
    def named(cls, name: str, looks: int, step: int = 0) -> Self:
        """The window of that name (LOOK_WINDOWS) over `looks` samples; step 0: blocks without overlap."""
        return cls(LOOK_WINDOWS[name](looks) if looks > 0 else np.empty(0), step or max(looks, 1))

    def pixels(self, samples: int) -> int:
        """Number of pixels along an axis of `samples`: all samples are looks of one of them."""
        return -(-samples // self.step)

    @property
    def first(self) -> int:
        """First sample of pixel 0; negative where the edge cuts it off."""
        return (self.step - len(self.weights)) // 2

    @property
    def middle(self) -> float:
        """Sample, and fraction of one, in the middle of pixel 0."""
        return self.first + (len(self.weights) - 1) / 2

    def sums(self, samples: int) -> tuple[F64, F64]:
        """Sum of the weights, and of their squares, of the looks that each pixel has, (pixels,) each."""
        inside = np.arange(len(self.weights)) + self.first + np.arange(self.pixels(samples))[:, None] * self.step
        there = (inside >= 0) & (inside < samples)
        return there @ self.weights, there @ self.weights**2


@dataclass(frozen=True)
class Looks:
    """Sum over looks of the outer product of the channels; rows and cols are those of the height image.

    Attributes:
        covariance: sum_k w_k g_k g_k^H, shape (rows, cols, channels, channels): complex64, or its real part as float32.
            Real beams need no more (a^T R a = a^T Re(R) a for any real a).
        count: number of looks K, (rows, cols). Of weighted looks (sum w)^2 / sum w^2, and the weights are scaled to
            that sum: mean and variance of the noise are then those of K looks.
        row: power-weighted mean row of the looks, in SLC pixels, shape (rows, cols); the middle where there is none.
        col: power-weighted mean column.
        power: trace of the covariance, shape (rows, cols).
        finite: False where a sample was NaN or infinite (covariance is 0 there), shape (rows, cols).
    """

    covariance: Covariances
    count: F64
    row: F64
    col: F64
    power: F64
    finite: Bool


@dataclass(frozen=True)
class SlcCovariance:
    """The covariance of every pixel, summed up from the images when it is asked for, so that it is never held whole.

    In single precision: the error grows as 6e-8 times the number of looks. Runs in the calling thread alone.

    Attributes:
        numbers: real and imaginary parts of the images in turn, shape (channels, rows, 2 * cols), float32.
        down, across: looks in range and azimuth.
        gains: complex, by which each channel is multiplied, shape (channels,).
        scale: of the weights in each pixel; 0: leave it 0; shape (rows, cols).
        hermitian: complex covariances, or their real part only.
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
        """Of some pixels, indexed as an array's first two axes."""
        rows, cols = (np.arange(n)[index] for n, index in zip(self.shape, pixels, strict=False))
        if any(isinstance(index, slice) for index in pixels):
            rows = rows[:, None]
        shape, channels = np.broadcast_shapes(rows.shape, cols.shape), len(self.numbers)
        flat = np.broadcast_to(rows, shape).flatten(), np.broadcast_to(cols, shape).flatten()
        parts = np.empty((len(flat[0]), 1 + self.hermitian, channels, channels), np.float32)
        down, across = ((w.first, w.step, w.weights.astype(np.float32)) for w in (self.down, self.across))
        _covariances(self.numbers, self.gains, flat, down, across, self.scale, parts)
        return _together(parts).reshape(*shape, channels, channels)


def covariance(samples: C64, hermitian: bool) -> Covariance:
    """Sum over looks of g g^H; precision and threads as of `SlcCovariance`.

    Args:
        samples: g, shape (pixels, looks, channels), C-contiguous; finite.
        hermitian: all of it, as complex beams need (`Beams.is_complex`), or the real part only.

    Returns:
        Shape (pixels, channels, channels), complex64 if `hermitian`, otherwise float32.
    """
    pixels, _, channels = samples.shape
    parts = np.empty((pixels, 1 + hermitian, channels, channels), np.float32)
    _sums(samples.view(np.float32), parts)
    return _together(parts)


def _together(parts: F32) -> Covariance:
    """Complex matrices of their real and imaginary parts (pixels, 2, M, M), or real ones of (pixels, 1, M, M)."""
    return parts[:, 0] + np.complex64(1j) * parts[:, 1] if parts.shape[1] == 2 else parts[:, 0]


def live_detectors(slc: C64) -> Index:
    """Numbers of the channels of `slc` (channels, rows, cols) with a finite sample other than 0 anywhere.

    Raises:
        Rejected: there are fewer than two.
    """
    live = [m for m, image in enumerate(slc) if any(np.any(np.isfinite(row) & (row != 0)) for row in image)]
    if len(live) < 2:
        raise Rejected(
            "dead detectors",
            f"Of {len(slc)} detectors {len(live)} have a finite sample other than 0 in the images; elevation needs 2 "
            "or more.",
        )
    return np.array(live)


def blocks(range_looks: int, azimuth_looks: int) -> tuple[Window, Window]:
    """Windows in range and azimuth that make pixels of `range_looks` x `azimuth_looks` samples without overlap."""
    return Window.named("boxcar", range_looks), Window.named("boxcar", azimuth_looks)


def multilook(
    slc: C64,
    range_looks: int,
    azimuth_looks: int,
    hermitian: bool = False,
    transform: Complex | None = None,
) -> Looks:
    """Sum up blocks of `range_looks` x `azimuth_looks` pixels; those at the far edges have what is left.

    Other arguments and errors as of `windowed_looks`.
    """
    return windowed_looks(slc, *blocks(range_looks, azimuth_looks), hermitian, transform)


def windowed_looks(
    slc: C64,
    down: Window,
    across: Window,
    hermitian: bool = False,
    transform: Complex | None = None,
) -> Looks:
    """Looks of every pixel of the height image.

    On sloping ground the looks of a pixel come from different ranges and elevations; the power-weighted centre tells
    which range the angle estimate, itself weighted by power, belongs to. Pixels whose windows overlap share looks, and
    their errors.

    Args:
        slc: images of all channels, shape (channels, rows, cols); the covariances refer to them and are not copies.
        down: looks in range.
        across: looks in azimuth.
        hermitian: whether the covariance is complex, as complex beams need it (`Beams.is_complex`).
        transform: matrix that the channels are multiplied by (`channels.whitening`), shape (channels, channels); None:
            they stay as they are.

    Raises:
        UserError: more looks than the image has pixels.
    """
    channels, rows, cols = slc.shape
    high, wide = len(down.weights), len(across.weights)
    if high > rows or wide > cols:
        raise UserError(f"Looks are {high} x {wide} in an image of {rows} x {cols} pixels; they must fit in it.")
    gains = np.ones(channels, np.complex64) if transform is None else np.diag(transform).astype(np.complex64)
    if transform is not None and np.any(transform != np.diag(np.diag(transform))):
        slc, gains = np.tensordot(transform.astype(np.complex64), slc, axes=1), np.ones_like(gains)
    numbers = np.ascontiguousarray(slc, dtype=np.complex64).view(np.float32)
    sums, squares = (np.multiply.outer(*pair) for pair in zip(down.sums(rows), across.sums(cols), strict=True))
    shape = sums.shape
    sample_power, power, row, col = np.empty((rows, cols), np.float32), *np.empty((3, *shape))
    in_parallel(lambda part: _powers(numbers, np.abs(gains) ** 2, part.start, sample_power[part]), rows)
    axes = (down.first, down.step, down.weights), (across.first, across.step, across.weights)
    in_parallel(lambda part: _centres(sample_power, *axes, part.start, (power[part], row[part], col[part])), shape[0])
    finite = power >= 0
    scale = np.where(finite, sums / squares, 0.0)
    return Looks(
        covariance=SlcCovariance(numbers, down, across, gains, scale.astype(np.float32), hermitian),
        count=sums**2 / squares,
        row=row,
        col=col,
        power=power * scale,
        finite=finite,
    )


# The loops below are compiled. Of an axis they know the first sample of pixel 0, the step and the weights.


@compiled
def _powers(numbers: F32, weights: F32, first: int, power: F32) -> None:
    """Weighted sum over channels of |g|^2 of samples from row `first` on; -1 where it is infinite or not a number."""
    bits = power.view(np.uint32)
    for r in range(len(power)):
        line = power[r]
        line[:] = 0
        for m in range(len(numbers)):
            here, weight = numbers[m, first + r], weights[m]
            for c in range(line.size):
                line[c] += weight * (here[2 * c] * here[2 * c] + here[2 * c + 1] * here[2 * c + 1])
        for c in range(line.size):
            if (bits[r, c] & EXPONENT) == EXPONENT:
                line[c] = -1


@compiled
def _centres(
    sample_power: F32,
    down: tuple[int, int, F64],
    across: tuple[int, int, F64],
    first: int,
    result: tuple[F64, F64, F64],
) -> None:
    """Power, mean row and mean column of the looks of pixels from row `first` on; power -1 where one is bad."""
    (top, row_step, row_weights), (left, col_step, col_weights) = down, across
    rows, cols = sample_power.shape
    power, row, col = result
    for i in range(power.shape[0]):
        for j in range(power.shape[1]):
            start, side = top + (first + i) * row_step, left + j * col_step
            total, by_row, by_col, count, mean_row, mean_col, bad = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, False
            for r in range(max(start, 0), min(start + row_weights.size, rows)):
                for c in range(max(side, 0), min(side + col_weights.size, cols)):
                    looked = row_weights[r - start] * col_weights[c - side]
                    weight = looked * sample_power[r, c]
                    bad |= weight < 0
                    total += weight
                    by_row += weight * r
                    by_col += weight * c
                    count += looked
                    mean_row += looked * r
                    mean_col += looked * c
            empty = bad or total == 0
            power[i, j] = -1.0 if bad else total
            row[i, j] = mean_row / count if empty else by_row / total
            col[i, j] = mean_col / count if empty else by_col / total


@compiled
def _covariances(
    numbers: F32,
    gains: C64,
    pixels: tuple[Index, Index],
    down: tuple[int, int, F32],
    across: tuple[int, int, F32],
    scale: F32,
    parts: F32,
) -> None:
    """See `SlcCovariance`; `parts` are the real part, and the imaginary one if wanted: (pixels, 1 or 2, M, M)."""
    (top, row_step, row_weights), (left, col_step, col_weights) = down, across
    channels, rows, twice = numbers.shape
    most = row_weights.size * col_weights.size + LOOKS_AT_ONCE
    x, y = np.empty((most, channels), np.float32), np.empty((most, channels), np.float32)
    for i in range(len(parts)):
        row, col = pixels[0][i], pixels[1][i]
        start, side, count = top + row * row_step, left + col * col_step, 0
        if scale[row, col] > 0:
            for r in range(max(start, 0), min(start + row_weights.size, rows)):
                for c in range(max(side, 0), min(side + col_weights.size, twice // 2)):
                    weight = np.sqrt(scale[row, col] * row_weights[r - start] * col_weights[c - side])
                    for m in range(channels):
                        real, imaginary = weight * numbers[m, r, 2 * c], weight * numbers[m, r, 2 * c + 1]
                        x[count, m] = gains[m].real * real - gains[m].imag * imaginary
                        y[count, m] = gains[m].real * imaginary + gains[m].imag * real
                    count += 1
        _sum_outer_products(x, y, count, parts[i])


@compiled
def _sums(numbers: F32, parts: F32) -> None:
    """See `covariance`; numbers of shape (pixels, looks, 2 M), parts as of `_covariances`."""
    looks, channels = numbers.shape[1], numbers.shape[2] // 2
    x = np.empty((looks + LOOKS_AT_ONCE, channels), np.float32)
    y = np.empty_like(x)
    for i in range(len(numbers)):
        for k in range(looks):
            for m in range(channels):
                x[k, m] = numbers[i, k, 2 * m]
                y[k, m] = numbers[i, k, 2 * m + 1]
        _sum_outer_products(x, y, looks, parts[i])


@inlined
def _sum_outer_products(x: F32, y: F32, count: int, parts: F32) -> None:
    """Sum of g g^H over `count` samples g = x + j y, as parts (1 or 2, M, M); spare rows of x and y are overwritten."""
    padded = max(1, -(-count // LOOKS_AT_ONCE)) * LOOKS_AT_ONCE
    for k in range(count, padded):
        for m in range(x.shape[1]):
            x[k, m] = 0
            y[k, m] = 0
    for k in range(0, padded, LOOKS_AT_ONCE):
        _add_four(x, y, np.float32(1), x, y, k, parts[0])
        if len(parts) == 2:
            _add_four(y, x, np.float32(-1), x, y, k, parts[1])


@inlined
def _add_four(p: F32, q: F32, sign: np.float32, x: F32, y: F32, k: int, result: F32) -> None:
    """Add p x^T + sign q y^T of four samples from number `k` on to `result` (M, M), which the first ones overwrite."""
    x0, x1, x2, x3, y0, y1, y2, y3 = x[k], x[k + 1], x[k + 2], x[k + 3], y[k], y[k + 1], y[k + 2], y[k + 3]
    for m in range(len(result)):
        row = result[m]
        p0, p1, p2, p3 = p[k, m], p[k + 1, m], p[k + 2, m], p[k + 3, m]
        q0, q1, q2, q3 = sign * q[k, m], sign * q[k + 1, m], sign * q[k + 2, m], sign * q[k + 3, m]
        for n in range(row.size):
            before = row[n] if k > 0 else np.float32(0)
            first = p0 * x0[n] + p1 * x1[n] + p2 * x2[n] + p3 * x3[n]
            row[n] = before + first + q0 * y0[n] + q1 * y1[n] + q2 * y2[n] + q3 * y3[n]


def look_grid(grid: Grid, down: Window, across: Window) -> Grid:
    """Grid of the pixels whose looks are those windows of `grid`, in range and azimuth."""
    return Grid(
        origin=grid.points(down.middle, across.middle),
        row_direction=grid.row_direction,
        col_direction=grid.col_direction,
        row_spacing=grid.row_spacing * down.step,
        col_spacing=grid.col_spacing * across.step,
        rows=down.pixels(grid.rows),
        cols=across.pixels(grid.cols),
    )
