"""Heights tracked along range (the relief paper leaves this to Bayesian filtering), with their closed forms.

A Gauss-Markov relief is drawn, measured in every cell, and tracked as by the node; the error is that in the middle of
the swath, far from its ends.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from sal_height.elevation import discriminator_variance
from sal_height.figures.curve import Curve
from sal_height.figures.sample_statistics import Measured
from sal_height.numeric import F64
from sal_height.relief import (
    MeasuredHeights,
    ReliefPrior,
    TrackedRelief,
    TrackingSettings,
    filtered,
    smoothed_columns,
    steady_sigmas,
)

Track = Callable[[MeasuredHeights, ReliefPrior, TrackingSettings], TrackedRelief]

LENGTHS = np.array([1.0, 2.0, 5.0, 10.0, 20.0, 40.0])
"""Correlation lengths of the relief, m."""

SPACING = 0.5
"""Ground spacing between cells, m."""

RELIEF_SIGMA = 1.0
MEASURED_SIGMA = 1.0
"""Standard deviations of the relief and of its measurements, m."""

ROWS = 301
"""Cells of a swath; cells 150 away from the middle do not affect it."""

SNR_DB = np.arange(0.0, 31.0, 5.0)
"""SNR of the sum channel in a cell, for the RMSE over it."""

BLOCK = 4096
"""Number of tracks that are drawn at a time."""

STREAM = 17
"""Number that gives this figure other random numbers than other figures with the same seed."""

ALL = TrackingSettings(gate=1000.0)
"""A gate that no Gaussian error reaches: no measurement is an outlier."""


def relief_tracking(trials: int, seed: int) -> Iterator[Curve]:
    """RMSE and gain of filter and smoother over the correlation length; RMSE over SNR, and with noise that varies.

    The closed forms are those of the steady state (`steady_sigmas`). Where noise varies (variances as 1 / power of
    four looks of speckle), the smoother with each cell's variance is compared with one with their mean; there the
    closed form is linear algebra with the covariance of the whole swath.
    """
    yield from _over_snr(trials, seed)
    varying = MEASURED_SIGMA / np.sqrt(np.random.default_rng((seed, STREAM)).gamma(4, 1 / 4, ROWS))
    level = np.full(ROWS, float(np.sqrt(np.mean(varying**2))))
    priors = [ReliefPrior(length, RELIEF_SIGMA) for length in LENGTHS.tolist()]
    constant = np.full(ROWS, MEASURED_SIGMA)
    steady = np.array([steady_sigmas(prior, SPACING, MEASURED_SIGMA) for prior in priors])
    for index, (name, track) in enumerate((("filter", filtered), ("smoother", smoothed_columns))):
        rmse = [_rmse(seed, trials, prior, constant, constant, track) for prior in priors]
        yield _curve("RMSE", name, index, rmse, steady[:, index], LENGTHS)
        gain = [Measured(_decibels(m.value), 20 / np.log(10) * m.standard_error / m.value) for m in rmse]
        expected = np.array([_decibels(sigma) for sigma in steady[:, index]])
        yield _curve("gain", name, index, gain, expected, LENGTHS)
    for index, (name, taken) in enumerate((("each cell's own", varying), ("their mean", level))):
        rmse = [_rmse(seed, trials, prior, varying, taken, smoothed_columns) for prior in priors]
        expected = np.array([_expected_rmse(prior, varying, taken) for prior in priors])
        yield _curve("RMSE with noise that varies", f"variance taken: {name}", index, rmse, expected, LENGTHS)


def _over_snr(trials: int, seed: int) -> Iterator[Curve]:
    """Single cells, filter and smoother where the variance of a height is as 1 / SNR (`discriminator_variance`)."""
    prior, snr = ReliefPrior(20.0, RELIEF_SIGMA), 10 ** (SNR_DB / 10)
    first_order = np.sqrt(discriminator_variance(0.0, snr, (1.0, 1.0)))
    # Range and slope of the discriminator give MEASURED_SIGMA at 10 dB in the equisignal direction.
    unit = np.sqrt(discriminator_variance(0.0, 10 ** (10.0 / 10), (1.0, 1.0)))
    sigmas = MEASURED_SIGMA * first_order / unit
    steady = np.array([steady_sigmas(prior, SPACING, sigma) for sigma in sigmas.tolist()])
    cases: list[tuple[str, Track, F64]] = [
        ("single cells", _untracked, sigmas),
        ("filter", filtered, steady[:, 0]),
        ("smoother", smoothed_columns, steady[:, 1]),
    ]
    for index, (name, track, closed_form) in enumerate(cases):
        noise = [np.full(ROWS, sigma) for sigma in sigmas.tolist()]
        rmse = [_rmse(seed, trials, prior, sigma, sigma, track) for sigma in noise]
        yield _curve("RMSE over SNR", name, index, rmse, closed_form, SNR_DB)


def _untracked(measured: MeasuredHeights, _prior: ReliefPrior, _settings: TrackingSettings) -> TrackedRelief:
    return TrackedRelief(measured.height, measured.sigma, np.zeros(measured.height.shape, dtype=np.bool_))


def draw_relief(rng: np.random.Generator, prior: ReliefPrior, spacing: float, rows: int, cols: int) -> F64:
    """Tracks of a Gauss-Markov relief, m, shape (rows, cols), one in each column."""
    height = rng.standard_normal((rows, cols))
    height[0] *= prior.sigma
    phi, noise = prior.step(spacing)
    for i in range(1, rows):
        height[i] = phi * height[i - 1] + np.sqrt(noise) * height[i]
    return height + prior.mean


def _rmse(seed: int, trials: int, prior: ReliefPrior, sigma: F64, taken: F64, track: Track) -> Measured:
    """Error of tracked heights in the middle: measured with `sigma`, tracked as if with `taken` (m, shape (ROWS,))."""
    errors = []
    for first in range(0, trials, BLOCK):
        cols = min(BLOCK, trials - first)
        rng = np.random.default_rng((seed, STREAM, first))
        height = draw_relief(rng, prior, SPACING, ROWS, cols)
        measured = height + sigma[:, None] * rng.standard_normal(height.shape)
        heights = MeasuredHeights(measured, np.repeat(taken[:, None], cols, axis=1), (SPACING, SPACING))
        result = track(heights, prior, ALL)
        errors.append((result.height - height)[ROWS // 2])
    square = np.concatenate(errors) ** 2
    rmse = float(np.sqrt(np.mean(square)))
    return Measured(rmse, float(np.std(square) / np.sqrt(square.size) / (2 * rmse)))


def _expected_rmse(prior: ReliefPrior, sigma: F64, taken: F64) -> float:
    """Root of the mean square error in the middle by the covariance of all cells: (I - W) K (I - W)^T + W R W^T."""
    position = np.arange(ROWS) * SPACING
    relief = prior.sigma**2 * prior.correlation(position[:, None] - position)
    weight = np.linalg.solve(relief + np.diag(taken**2), relief[:, ROWS // 2])
    own = np.eye(ROWS)[ROWS // 2] - weight
    return float(np.sqrt(own @ relief @ own + np.sum((weight * sigma) ** 2)))


def _decibels(rmse: float) -> float:
    """Gain of an RMSE over that of single cells, dB."""
    return float(20 * np.log10(MEASURED_SIGMA / rmse))


def _curve(quantity: str, case: str, colour: int, measured: list[Measured], closed_form: F64, x: F64) -> Curve:
    values, errors = np.array(measured).T
    return Curve(quantity, case, x, values, errors, closed_form, colour=colour)
