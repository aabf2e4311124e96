"""Tracking of the relief in both directions: the height of every cell from its neighbours in range and along-track.

The relief is a Gaussian field whose correlation falls exponentially in range and along-track,

    cov(h, h') = s^2 exp(-|distance along range| / l) exp(-|distance along-track| / l):

from row to row, a line of cells is a Gauss-Markov process whose state is the whole line. The Kalman filter and the
smoother of Rauch, Tung and Striebel with that state are exact, but their cost grows as the cube of the line's length.
Long lines are therefore cut into overlapping windows of `window_columns` cells, and each cell takes its height from the
window that it is in the middle of. The result is the exact posterior given the measurements in the window's columns,
with the right standard deviation; columns farther away do not contribute.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sal_height.numeric import F64, Bool, Index, in_parallel
from sal_height.relief.range_tracking import (
    MeasuredHeights,
    ReliefPrior,
    TrackedRelief,
    estimated_prior,
    evenly,
    flattest,
    least_misfit,
    smoothed,
)
from sal_height.relief.settings import DEFAULT_TRACKING, TrackingSettings

ROWS_OF_PRIOR = 256
"""Number of rows in the middle of the image from which a prior is estimated."""

NUMBERS_HELD = 2**23
"""Numbers of filtered covariances that are held for the smoother: 64 MB."""


class _LineProcess:
    """A row of `size` cells as the state of a Gauss-Markov process along range."""

    def __init__(self, prior: ReliefPrior, spacings: tuple[float, float], size: int) -> None:
        steps = np.arange(size) * spacings[1]
        beside = prior.correlation(steps[:, None] - steps)
        self.phi, noise_variance = prior.step(spacings[0])
        self.covariance = prior.sigma**2 * beside
        self.noise = noise_variance * beside

    def filtered(self, deviation: F64, precision: F64) -> Iterator[tuple[F64, F64, float]]:
        """Kalman filter over the rows of windows, measured as in `MeasuredHeights.deviations`.

        Args:
            deviation: m, shape (rows, windows, size).
            precision: 1/m^2, same shape.

        Yields:
            State (m, shape (windows, size)) and covariance (m^2, shape (windows, size, size)) of a row after its
            measurements, and the log-likelihood of these without terms that do not depend on the prior.
        """
        _, windows, size = deviation.shape
        state, spread = np.zeros((windows, size)), np.broadcast_to(self.covariance, (windows, size, size))
        for measured, weight in zip(deviation, precision, strict=True):
            root = np.sqrt(weight)
            scaled = root[:, :, None] * spread
            factor = np.linalg.cholesky(np.eye(size) + scaled * root[:, None, :])
            unknown = np.concatenate([scaled, (root * (measured - state))[..., None]], axis=-1)
            whitened = np.linalg.solve(factor, unknown)
            gain, innovation = np.swapaxes(whitened[..., :-1], -1, -2), whitened[..., -1]
            log_volume = float(np.sum(np.log(np.diagonal(factor, axis1=-2, axis2=-1))))
            covariance = spread - gain @ whitened[..., :-1]
            state = state + (gain @ innovation[..., None])[..., 0]
            yield state, covariance, -float(np.sum(innovation**2)) / 2 - log_volume
            state, spread = self.phi * state, self.phi**2 * covariance + self.noise

    def smoothed(self, deviation: F64, precision: F64) -> tuple[F64, F64]:
        """Smoothed states (m) and variances (m^2) of all rows; arguments and shapes as in `filtered`."""
        rows, windows, size = deviation.shape
        states, covariances = np.empty_like(deviation), np.empty((rows, windows, size, size))
        for i, (state, covariance, _) in enumerate(self.filtered(deviation, precision)):
            states[i], covariances[i] = state, covariance
        variances = np.empty_like(deviation)
        state, spread = states[-1], covariances[-1]
        variances[-1] = np.diagonal(spread, axis1=-2, axis2=-1)
        for i in range(rows - 2, -1, -1):
            predicted = self.phi**2 * covariances[i] + self.noise
            back = np.swapaxes(np.linalg.solve(predicted, self.phi * covariances[i]), -1, -2)
            state = states[i] + (back @ (state - self.phi * states[i])[..., None])[..., 0]
            spread = covariances[i] + back @ (spread - predicted) @ np.swapaxes(back, -1, -2)
            states[i], variances[i] = state, np.diagonal(spread, axis1=-2, axis2=-1)
        return states, variances


def estimated_field_prior(measured: MeasuredHeights, settings: TrackingSettings = DEFAULT_TRACKING) -> ReliefPrior:
    """Estimate the prior under which the heights in windows of up to `prior_columns` in all are most likely.

    Its mean and the outliers are those of `range_tracking.estimated_prior`, whose errors are raised. Length and sigma
    are estimated anew unless they are given: those that fit single columns would state too small a sigma for a field,
    because the product of two exponentials also fixes the correlation between columns, of which single columns contain
    no information.
    """
    alone = estimated_prior(measured, settings)
    length, relief_sigma = settings.correlation_length_m, settings.relief_sigma_m
    if length and relief_sigma:
        return alone
    deviation, precision, _ = _inliers(measured, alone, settings)
    rows, cols = deviation.shape
    starts, size = _windows(cols, settings.window_columns)
    chosen = evenly(starts, max(1, settings.prior_columns // settings.window_columns))
    first = max(0, (rows - ROWS_OF_PRIOR) // 2)
    part = np.s_[first : first + ROWS_OF_PRIOR, chosen[:, None] + np.arange(size)]

    def misfit(values: F64) -> float:
        process = _LineProcess(ReliefPrior(*np.exp(values).tolist()), measured.spacings, size)
        return -sum(likelihood for _, _, likelihood in process.filtered(deviation[part], precision[part]))

    lowest = np.log([length or alone.length / 100, relief_sigma or flattest(precision)])
    highest = np.log([length or alone.length * 100, relief_sigma or alone.sigma * 100])
    found = least_misfit(misfit, np.log([[alone.length, alone.sigma]]), lowest, highest)
    return replace(alone, length=float(np.exp(found[0])), sigma=float(np.exp(found[1])))


def smoothed_field(
    measured: MeasuredHeights, prior: ReliefPrior, settings: TrackingSettings = DEFAULT_TRACKING
) -> TrackedRelief:
    """Estimate heights from all rows of `window_columns` columns around each cell; exact if there are no more columns.

    The prior is the same in both directions. `range_tracking.smoothed` decides what is an outlier.
    """
    deviation, precision, outlier = _inliers(measured, prior, settings)
    rows, cols = deviation.shape
    starts, size = _windows(cols, settings.window_columns)
    edges = [0, *((starts[1:] + starts[:-1] + size) // 2).tolist(), cols]  # in the middle of what two windows share
    process = _LineProcess(prior, measured.spacings, size)
    result = TrackedRelief(np.empty_like(measured.height), np.empty_like(measured.height), outlier)

    def work(part: slice) -> None:
        at_once = max(1, NUMBERS_HELD // (rows * size**2))
        for first in range(part.start, part.stop, at_once):
            some = starts[first : min(first + at_once, part.stop)]
            columns = some[:, None] + np.arange(size)
            state, variance = process.smoothed(deviation[:, columns], precision[:, columns])
            for index, start in enumerate(some.tolist()):
                there = slice(*edges[first + index : first + index + 2])
                inner = slice(there.start - start, there.stop - start)
                result.height[:, there] = state[:, index, inner] + prior.mean
                result.sigma[:, there] = np.sqrt(variance[:, index, inner])

    in_parallel(work, len(starts))
    return result


def _inliers(measured: MeasuredHeights, prior: ReliefPrior, settings: TrackingSettings) -> tuple[F64, F64, Bool]:
    """Deviations from the prior's mean and precisions without the outliers of the tracks in range; and the outliers."""
    outlier = smoothed(measured, prior, settings).outlier
    deviation, precision = measured.deviations(prior.mean)
    precision[outlier] = 0.0
    return deviation, precision, outlier


def _windows(cols: int, window: int) -> tuple[Index, int]:
    """First columns of the windows, which overlap by half or, to end with the image, by more; and their size."""
    size, half = min(window, cols), window // 2
    return np.minimum(np.arange(0, max(1, cols - half), half), cols - size), size
