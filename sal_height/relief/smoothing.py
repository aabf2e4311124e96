"""Smoothing of the relief: heights from noisy measurements of neighbouring cells, in range and along-track.

The relief paper estimates the angle of each range cell and leaves the tracking of the relief from cell to cell to
Bayesian filtering of a virtual target. Here the relief is a stationary Gauss-Markov (Ornstein-Uhlenbeck) process,

    h_(i+1) - m = phi (h_i - m) + w_i,    phi = exp(-d / l),    var w = s^2 (1 - phi^2),

with the mean m, the standard deviation s and the correlation length l of a `ReliefPrior`, and the ground spacing d
between cells. Each cell is measured with a standard deviation of its own, or not at all. The Kalman filter then gives
the posterior of each height given all cells up to it, the smoother of Rauch, Tung and Striebel (AIAA Journal 3, 1965)
the posterior given all cells of the swath. Every column is a track of its own.

A measurement farther from its prediction than `gate` standard deviations of their difference (the validation gate of
Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001) is an outlier and not
used. The variance of the prediction then keeps growing, up to s^2, and the gate with it: beyond a cliff the track is
acquired again after a fraction of l, unless the ground stays more than `gate` s away from the mean.

Smoothed along-track as well, the relief is a Gaussian field,

    cov(h, h') = s^2 exp(-|distance along range| / l) exp(-|distance along-track| / l),

about a mean that is itself Gaussian (`ReliefPrior.mean_sigma`). From row to row, a line of cells is a Gauss-Markov
process whose state is the whole line (`_tracking_kernels`). The Kalman filter with that state, whose measurements enter
one by one, and a smoother are exact, but their cost for each cell grows as the square of the line's length. Long lines
are therefore cut into overlapping windows of `window_columns` cells, and each cell takes its height from the window
that it is in the middle of. The result is the exact posterior given the measurements in the window's columns, with the
right standard deviation; columns farther away do not contribute.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sal_height.errors import UserError
from sal_height.numeric import F64, Bool, Index, ShortRepr, blocks, in_parallel
from sal_height.relief import _tracking_kernels as kernels
from sal_height.relief._tracking_kernels import LEAST_SIGMA, Heights
from sal_height.relief.settings import DEFAULT_TRACKING, TrackingSettings

COLUMNS_AT_ONCE = 64
"""Number of columns that are tracked at a time: 1000 rows of them fit into a processor's cache."""


@dataclass(frozen=True, eq=False)
class MeasuredHeights(ShortRepr):
    """Measured heights of the cells of an image, rows in the order of range.

    Attributes:
        height: height of each cell, m, float32 or float64, shape (rows, cols).
        sigma: standard deviation of height, m, same shape. A cell is not measured where either is not finite or sigma
            is not greater than 0.
        spacings: ground spacing between rows and between columns, m.

    Raises:
        UserError: the shapes differ or are not (rows, cols), or a spacing is not finite and greater than 0.
    """

    height: Heights
    sigma: Heights
    spacings: tuple[float, float]

    def __post_init__(self) -> None:
        """Refuse heights that cannot be tracked."""
        if self.height.ndim != 2 or self.height.shape != self.sigma.shape:
            raise UserError(
                f"Heights have the shape {self.height.shape}, their sigmas {self.sigma.shape}; both must have the same "
                "(rows, cols)."
            )
        if not all(np.isfinite(spacing) and spacing > 0 for spacing in self.spacings):
            raise UserError(
                f"The rows of the heights are {self.spacings[0]:g} m apart and the columns {self.spacings[1]:g} m; "
                "both must be finite and greater than 0."
            )

    def deviations(self, mean: float) -> tuple[F64, F64]:
        """Deviations of the heights from `mean` (m) and their precisions 1 / sigma^2 (1/m^2); 0 if not measured."""
        measured = np.isfinite(self.height) & np.isfinite(self.sigma) & (self.sigma > LEAST_SIGMA)
        height, sigma = self.height.astype(np.float64), self.sigma.astype(np.float64)
        return np.where(measured, height - mean, 0.0), 1 / np.where(measured, sigma, np.inf) ** 2


@dataclass(frozen=True)
class ReliefPrior:
    """Prior distribution of the relief.

    Attributes:
        length: correlation length on the ground, m: the correlation of heights falls to 1 / e.
        sigma: standard deviation of heights, m.
        mean: mean of heights, m.
        mean_sigma: standard deviation of the mean, m; 0: it is known. Tracks along range assume that it is known.

    Raises:
        UserError: length or sigma is not greater than 0, the mean's sigma is less than 0, or a value is not finite.
    """

    length: float
    sigma: float
    mean: float = 0.0
    mean_sigma: float = 0.0

    def __post_init__(self) -> None:
        """Refuse values that no relief has."""
        values = self.length, self.sigma, self.mean, self.mean_sigma
        if not (all(map(math.isfinite, values)) and self.length > 0 and self.sigma > 0 and self.mean_sigma >= 0):
            raise UserError(
                f"The prior of the relief has length {self.length:g} m, sigma {self.sigma:g} m and mean "
                f"{self.mean:g} +- {self.mean_sigma:g} m; all must be finite, the first two greater than 0."
            )

    def correlation(self, distance: npt.ArrayLike) -> F64:
        """Correlation of two heights `distance` (m) apart; broadcasts."""
        return np.exp(-np.abs(distance) / self.length)

    @property
    def variances(self) -> tuple[float, float]:
        """Variance of the relief and that of its mean, m^2."""
        return self.sigma**2, self.mean_sigma**2

    def step(self, spacing: float) -> tuple[float, float]:
        """Correlation phi of cells `spacing` (m) apart, and variance s^2 (1 - phi^2) of the process noise, m^2."""
        return float(self.correlation(spacing)), float(-(self.sigma**2) * np.expm1(-2 * spacing / self.length))


@dataclass(frozen=True, eq=False)
class TrackedRelief(ShortRepr):
    """Tracked heights of all cells; arrays of shape (rows, cols).

    Attributes:
        height: posterior mean, m, in the precision of the measured heights.
        sigma: posterior standard deviation, m.
        outlier: True where a measurement was rejected by the gate.
    """

    height: Heights
    sigma: Heights
    outlier: Bool


def filtered(
    measured: MeasuredHeights, prior: ReliefPrior, settings: TrackingSettings = DEFAULT_TRACKING
) -> TrackedRelief:
    """Estimate each height from the cells up to it, in the order of rows, by the Kalman filter."""
    return _tracked(measured, prior, settings.gate, both_ways=False)


def smoothed(
    measured: MeasuredHeights, prior: ReliefPrior, settings: TrackingSettings = DEFAULT_TRACKING
) -> TrackedRelief:
    """Estimate each height from all cells around it: of its window, or of its column if `along_track` is not set."""
    return (_smoothed_windows if settings.along_track else smoothed_columns)(measured, prior, settings)


def smoothed_columns(
    measured: MeasuredHeights, prior: ReliefPrior, settings: TrackingSettings = DEFAULT_TRACKING
) -> TrackedRelief:
    """Estimate each height from all cells of its column, by the filter and the smoother of Rauch, Tung and Striebel.

    The filter decides what is an outlier.
    """
    return _tracked(measured, prior, settings.gate, both_ways=True)


def _tracked(measured: MeasuredHeights, prior: ReliefPrior, gate: float, both_ways: bool) -> TrackedRelief:
    """Filter the columns, a block of them at a time, and smooth them if they are tracked `both_ways`."""
    height, sigma, step = measured.height, measured.sigma, prior.step(measured.spacings[0])
    moments = float(prior.mean), float(prior.sigma**2)
    result = TrackedRelief(np.empty_like(height), np.empty_like(height), np.empty(height.shape, np.bool_))
    columns = blocks(height.shape[1], COLUMNS_AT_ONCE)

    def work(part: slice) -> None:
        scratch = np.empty((2, len(height), COLUMNS_AT_ONCE))
        for block in columns[part]:
            here = np.s_[:, block]
            state, variance = scratch[..., : block.stop - block.start]
            kernels.filter_columns(
                height[here], sigma[here], moments, step, float(gate), state, variance, result.outlier[here]
            )
            if both_ways:
                kernels.smooth_columns(step, state, variance)
            np.add(state, prior.mean, out=result.height[here], casting="same_kind")
            np.sqrt(variance, out=result.sigma[here], casting="same_kind")

    in_parallel(work, len(columns))
    return result


def _smoothed_windows(measured: MeasuredHeights, prior: ReliefPrior, settings: TrackingSettings) -> TrackedRelief:
    """Estimate heights from all rows of `window_columns` columns around each cell; exact if there are no more columns.

    The prior is the same in both directions. The filter along range decides what is an outlier.
    """
    outlier = filtered(measured, prior, settings).outlier
    deviation, precision = measured.deviations(prior.mean)
    precision[outlier] = 0.0
    rows, cols = deviation.shape
    starts, size = _windows(cols, settings.window_columns)
    edges = [0, *((starts[1:] + starts[:-1] + size) // 2).tolist(), cols]  # in the middle of what two windows share
    steps = float(prior.correlation(measured.spacings[0])), float(prior.correlation(measured.spacings[1]))
    result = TrackedRelief(np.empty_like(measured.height), np.empty_like(measured.height), outlier)

    def work(part: slice) -> None:
        columns, (state, variance) = np.empty((rows, size, size + 1)), np.empty((2, rows, size))
        for number, start in enumerate(starts[part].tolist(), part.start):
            window = deviation[:, start : start + size], precision[:, start : start + size]
            kernels.filter_rows(*window, prior.variances, steps, columns, state, variance)
            kernels.smooth_rows(*window, steps[0], columns, state, variance)
            there = slice(edges[number], edges[number + 1])
            inner = np.s_[:, there.start - start : there.stop - start]
            result.height[:, there] = state[inner] + prior.mean
            result.sigma[:, there] = np.sqrt(variance[inner])

    worth_a_thread = 2**14  # cells of windows
    in_parallel(work, len(starts), -(-worth_a_thread // (rows * size)))
    return result


def _windows(cols: int, window: int) -> tuple[Index, int]:
    """First columns of the windows, which overlap by half or, to end with the image, by more; and their size."""
    size, half = min(window, cols), window // 2
    return np.minimum(np.arange(0, max(1, cols - half), half), cols - size), size


def steady_sigmas(prior: ReliefPrior, spacing: float, measured_sigma: float) -> tuple[float, float]:
    """Standard deviations (m) of `filtered` and `smoothed` heights far from the edges of the swath.

    All cells are measured with `measured_sigma` (m) and none is an outlier. The filter's predicted variance is
    the positive root of P^2 + P (R (1 - phi^2) - q) - q R = 0, what follows the measurement P R / (P + R); the
    smoother's is the fixed point of its recursion.
    """
    (phi, q), r = prior.step(spacing), measured_sigma**2
    off = q - r * q / prior.sigma**2
    predicted = (off + np.sqrt(off**2 + 4 * q * r)) / 2
    updated = predicted * r / (predicted + r)
    back = phi * updated / predicted
    return float(np.sqrt(updated)), float(np.sqrt((updated - back**2 * predicted) / (1 - back**2)))
