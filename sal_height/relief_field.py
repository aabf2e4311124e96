"""Relief tracked in both directions: every cell told by its neighbours along range and along the flight.

The relief is the Gaussian field whose correlation falls exponentially along range and along the flight,

    cov(h, h') = s^2 exp(-|distance along range| / l) exp(-|distance along the flight| / l):

along range a line of cells is a Gauss-Markov process whose state is the whole line. The Kalman filter and the smoother
of Rauch, Tung and Striebel with that state are exact, but cost the cube of the line's length. Therefore long lines are
cut into windows of WINDOW cells that overlap, and each cell takes its height from the window in whose middle it lies.
Within a window all is exact: what comes out is the posterior from the measurements of the window's columns, and its
standard deviation is right; what is lost is only what columns farther away would have added.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sal_height.compiled import in_parallel
from sal_height.relief_tracking import GATE, Heights, ReliefPrior, TrackedRelief, measurements, smoothed

Array = npt.NDArray[np.float64]

WINDOW = 32
"""Columns that are tracked together."""

MARGIN = 8
"""Columns on both sides of those that take their heights from a window."""

NUMBERS_HELD = 2**23
"""Of the covariances that the smoother comes back to."""


def smoothed_field(
    height: Heights, sigma: Heights, spacings: tuple[float, float], prior: ReliefPrior, gate: float = GATE
) -> TrackedRelief:
    """Heights from all cells along range of up to WINDOW columns around; exact where there are no more than those.

    Args:
        height: measured, m, shape (rows, cols), as of `relief_tracking.filtered`.
        sigma: its standard deviation, m.
        spacings: way on the ground from row to row, and from column to column, m.
        prior: of the relief, the same along both.
        gate: `relief_tracking.smoothed` along range says what is an outlier, standard deviations.

    Raises:
        UserError: as `relief_tracking.filtered`.
    """
    along_range = smoothed(height, sigma, spacings[0], prior, gate)
    deviation, precision = measurements(height, sigma, prior.mean)
    precision[along_range.outlier] = 0.0
    rows, cols = height.shape
    size = min(WINDOW, cols)
    steps = np.arange(size) * spacings[1]
    beside = prior.correlation(steps[:, None] - steps)
    phi, q = float(prior.correlation(spacings[0])), prior.noise(spacings[0])
    result = TrackedRelief(np.empty_like(height), np.empty_like(height), along_range.outlier)
    starts = _window_starts(cols)

    def work(part: slice) -> None:
        at_once = max(1, NUMBERS_HELD // (rows * size**2))
        for first in range(part.start, part.stop, at_once):
            some = starts[first : min(first + at_once, part.stop)]
            columns = some[:, None] + np.arange(size)
            state, variance = _smoothed_lines(
                deviation[:, columns], precision[:, columns], phi, q * beside, prior.sigma**2 * beside
            )
            for index, start in enumerate(some.tolist()):
                inner = slice(MARGIN if start else 0, size - MARGIN if start + size < cols else size)
                there = np.s_[:, start + inner.start : start + inner.stop]
                result.height[there] = state[:, index, inner] + prior.mean
                result.sigma[there] = np.sqrt(variance[:, index, inner])

    in_parallel(work, len(starts))
    return result


def _window_starts(cols: int) -> npt.NDArray[np.intp]:
    """First columns of the windows: all but their margins join, and the last ends with the image."""
    if cols <= WINDOW:
        return np.zeros(1, np.intp)
    return np.minimum(np.arange(0, cols - 2 * MARGIN, WINDOW - 2 * MARGIN), cols - WINDOW)


def _smoothed_lines(
    deviation: Array, precision: Array, phi: float, noise: Array, covariance: Array
) -> tuple[Array, Array]:
    """Smoothed states and variances, shape (rows, windows, size), of as many measured deviations and precisions.

    Args:
        deviation: from the mean, m.
        precision: 1 / m^2; 0: not measured.
        phi: correlation from row to row.
        noise: covariance of what a step adds to a line, m^2, shape (size, size).
        covariance: of a line before it is measured, m^2, shape (size, size).
    """
    rows, windows, size = deviation.shape
    states, covariances = np.empty_like(deviation), np.empty((rows, windows, size, size))
    state, spread = np.zeros((windows, size)), np.broadcast_to(covariance, (windows, size, size))
    for i in range(rows):
        root = np.sqrt(precision[i])
        scaled = root[:, :, None] * spread
        whitened = np.eye(size) + scaled * root[:, None, :]
        covariances[i] = spread - (spread * root[:, None, :]) @ np.linalg.solve(whitened, scaled)
        states[i] = state + _times(covariances[i], precision[i] * (deviation[i] - state))
        state, spread = phi * states[i], phi**2 * covariances[i] + noise
    variances = np.empty_like(deviation)
    state, spread = states[-1], covariances[-1]
    variances[-1] = np.diagonal(spread, axis1=-2, axis2=-1)
    for i in range(rows - 2, -1, -1):
        predicted = phi**2 * covariances[i] + noise
        back = np.swapaxes(np.linalg.solve(predicted, phi * covariances[i]), -1, -2)
        state = states[i] + _times(back, state - phi * states[i])
        spread = covariances[i] + back @ (spread - predicted) @ np.swapaxes(back, -1, -2)
        states[i], variances[i] = state, np.diagonal(spread, axis1=-2, axis2=-1)
    return states, variances


def _times(matrices: Array, vectors: Array) -> Array:
    """Each matrix times its vector."""
    return np.asarray((matrices @ vectors[..., None])[..., 0])
