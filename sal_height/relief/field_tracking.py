"""Tracking of the relief in both directions: the height of every cell from its neighbours in range and along-track.

The relief is a Gaussian field whose correlation falls exponentially in range and along-track,

    cov(h, h') = s^2 exp(-|distance along range| / l) exp(-|distance along-track| / l):

from row to row, a line of cells is a Gauss-Markov process whose state is the whole line. The Kalman filter and the
smoother of Rauch, Tung and Striebel with that state are exact, but their cost grows as the cube of the line's length.
Long lines are therefore cut into overlapping windows of WINDOW cells, and each cell takes its height from the window
that it is in the middle of. The result is the exact posterior given the measurements in the window's columns, with the
right standard deviation; columns farther away do not contribute.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sal_height.numeric import F64, Bool, Index, in_parallel
from sal_height.relief.range_tracking import (
    GATE,
    Heights,
    ReliefPrior,
    TrackedRelief,
    estimated_prior,
    flattest,
    measurements,
    minimised,
    smoothed,
)

WINDOW = 32
"""Number of columns that are tracked together."""

MARGIN = 8
"""Number of columns at both sides of a window that take their heights from its neighbours."""

WINDOWS_OF_PRIOR = 2
"""Number of windows from which a prior is estimated."""

ROWS_OF_PRIOR = 256
"""Number of rows in the middle of the image from which a prior is estimated."""

NUMBERS_HELD = 2**23
"""Numbers of filtered covariances that are held for the smoother: 64 MB."""


@dataclass(frozen=True)
class _Line:
    """A row of a window as the state of a Gauss-Markov process along range.

    Attributes:
        phi: correlation from row to row.
        covariance: prior covariance of a line, m^2, shape (size, size).
        noise: covariance of the process noise that a step adds to a line, m^2, shape (size, size).
    """

    phi: float
    covariance: F64
    noise: F64

    @classmethod
    def of(cls, prior: ReliefPrior, spacings: tuple[float, float], size: int) -> _Line:
        """A line of `size` cells of the relief; `spacings` as in `smoothed_field`."""
        steps = np.arange(size) * spacings[1]
        beside = prior.correlation(steps[:, None] - steps)
        return cls(float(prior.correlation(spacings[0])), prior.sigma**2 * beside, prior.noise(spacings[0]) * beside)


def estimated_field_prior(
    height: Heights,
    sigma: Heights,
    spacings: tuple[float, float],
    length: float | None = None,
    relief_sigma: float | None = None,
) -> ReliefPrior:
    """Estimate the prior under which the heights in up to WINDOWS_OF_PRIOR windows are most likely.

    Its mean and the outliers are those of `range_tracking.estimated_prior`. Length and sigma are estimated anew: those
    that fit single columns would state too small a sigma for a field, because the product of two exponentials also
    fixes the correlation between columns, of which single columns contain no information.

    Args:
        height: measured, m, shape (rows, cols), as in `range_tracking.filtered`.
        sigma: its standard deviation, m.
        spacings: ground spacing between rows and between columns, m.
        length: correlation length, m; None: estimated.
        relief_sigma: standard deviation of the relief, m; None: estimated.

    Raises:
        UserError: as in `range_tracking.estimated_prior`.
    """
    alone = estimated_prior(height, sigma, spacings[0], length, relief_sigma)
    deviation, precision, _ = _inliers(height, sigma, spacings[0], alone, GATE)
    rows, cols = height.shape
    size = min(WINDOW, cols)
    starts = _window_starts(cols)
    chosen = starts[np.linspace(0, len(starts) - 1, min(len(starts), WINDOWS_OF_PRIOR)).astype(np.intp)]
    first = max(0, (rows - ROWS_OF_PRIOR) // 2)
    part = np.s_[first : first + ROWS_OF_PRIOR, chosen[:, None] + np.arange(size)]

    def misfit(values: F64) -> float:
        line = _Line.of(ReliefPrior(*np.exp(values).tolist()), spacings, size)
        return -sum(step.log_likelihood for step in _filtered_lines(deviation[part], precision[part], line))

    free = np.array([length is None, relief_sigma is None])
    start = np.log([alone.length, alone.sigma])
    if np.any(free):
        lowest = np.array([start[0] - np.log(100), np.log(flattest(precision))])
        start = minimised(misfit, start, free, lowest, start + np.log(100))
    return ReliefPrior(float(np.exp(start[0])), float(np.exp(start[1])), alone.mean)


def smoothed_field(
    height: Heights, sigma: Heights, spacings: tuple[float, float], prior: ReliefPrior, gate: float = GATE
) -> TrackedRelief:
    """Estimate heights from all rows of up to WINDOW columns around each cell; exact if there are no more columns.

    Args:
        height: measured, m, shape (rows, cols), as in `range_tracking.filtered`.
        sigma: its standard deviation, m.
        spacings: ground spacing between rows and between columns, m.
        prior: of the relief, the same in both directions.
        gate: of `range_tracking.smoothed`, which decides what is an outlier, standard deviations.

    Raises:
        UserError: as in `range_tracking.filtered`.
    """
    deviation, precision, outlier = _inliers(height, sigma, spacings[0], prior, gate)
    rows, cols = height.shape
    size = min(WINDOW, cols)
    line = _Line.of(prior, spacings, size)
    result = TrackedRelief(np.empty_like(height), np.empty_like(height), outlier)
    starts = _window_starts(cols)

    def work(part: slice) -> None:
        at_once = max(1, NUMBERS_HELD // (rows * size**2))
        for first in range(part.start, part.stop, at_once):
            some = starts[first : min(first + at_once, part.stop)]
            columns = some[:, None] + np.arange(size)
            state, variance = _smoothed_lines(deviation[:, columns], precision[:, columns], line)
            for index, start in enumerate(some.tolist()):
                inner = slice(MARGIN if start else 0, size - MARGIN if start + size < cols else size)
                there = np.s_[:, start + inner.start : start + inner.stop]
                result.height[there] = state[:, index, inner] + prior.mean
                result.sigma[there] = np.sqrt(variance[:, index, inner])

    in_parallel(work, len(starts))
    return result


def _inliers(height: Heights, sigma: Heights, spacing: float, prior: ReliefPrior, gate: float) -> tuple[F64, F64, Bool]:
    """`measurements` without the outliers of the tracks in range, and where these are."""
    outlier = smoothed(height, sigma, spacing, prior, gate).outlier
    deviation, precision = measurements(height, sigma, prior.mean)
    precision[outlier] = 0.0
    return deviation, precision, outlier


def _window_starts(cols: int) -> Index:
    """First columns of the windows, whose inner parts adjoin; the last window ends with the image."""
    if cols <= WINDOW:
        return np.zeros(1, np.intp)
    return np.minimum(np.arange(0, cols - 2 * MARGIN, WINDOW - 2 * MARGIN), cols - WINDOW)


class _Step(NamedTuple):
    """A row of windows after its measurements.

    Attributes:
        state: m, shape (windows, size).
        covariance: m^2, shape (windows, size, size).
        log_likelihood: of its measurements, without terms that do not depend on the prior.
    """

    state: F64
    covariance: F64
    log_likelihood: float


def _filtered_lines(deviation: F64, precision: F64, line: _Line) -> Iterator[_Step]:
    """Kalman filter over the rows of measured deviations (m) and precisions (1 / m^2), shape (rows, windows, size)."""
    _, windows, size = deviation.shape
    state, spread = np.zeros((windows, size)), np.broadcast_to(line.covariance, (windows, size, size))
    for measured, weight in zip(deviation, precision, strict=True):
        root = np.sqrt(weight)
        scaled = root[:, :, None] * spread
        factor = np.linalg.cholesky(np.eye(size) + scaled * root[:, None, :])
        unknown = np.concatenate([scaled, (root * (measured - state))[..., None]], axis=-1)
        whitened = np.linalg.solve(factor, unknown)
        gain, innovation = np.swapaxes(whitened[..., :-1], -1, -2), whitened[..., -1]
        log_volume = float(np.sum(np.log(np.diagonal(factor, axis1=-2, axis2=-1))))
        log_likelihood = -float(np.sum(innovation**2)) / 2 - log_volume
        covariance = spread - gain @ whitened[..., :-1]
        state = state + _times(gain, innovation)
        yield _Step(state, covariance, log_likelihood)
        state, spread = line.phi * state, line.phi**2 * covariance + line.noise


def _smoothed_lines(deviation: F64, precision: F64, line: _Line) -> tuple[F64, F64]:
    """Smoothed states (m) and variances (m^2) of all rows; arguments and shapes as in `_filtered_lines`."""
    rows, windows, size = deviation.shape
    states, covariances = np.empty_like(deviation), np.empty((rows, windows, size, size))
    for i, step in enumerate(_filtered_lines(deviation, precision, line)):
        states[i], covariances[i] = step.state, step.covariance
    variances = np.empty_like(deviation)
    state, spread = states[-1], covariances[-1]
    variances[-1] = np.diagonal(spread, axis1=-2, axis2=-1)
    for i in range(rows - 2, -1, -1):
        predicted = line.phi**2 * covariances[i] + line.noise
        back = np.swapaxes(np.linalg.solve(predicted, line.phi * covariances[i]), -1, -2)
        state = states[i] + _times(back, state - line.phi * states[i])
        spread = covariances[i] + back @ (spread - predicted) @ np.swapaxes(back, -1, -2)
        states[i], variances[i] = state, np.diagonal(spread, axis1=-2, axis2=-1)
    return states, variances


def _times(matrices: F64, vectors: F64) -> F64:
    """Product of each matrix with its vector."""
    return (matrices @ vectors[..., None])[..., 0]
