"""Tracked heights against linear algebra with the covariance of all cells, the spectrum of the relief, and chance."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from drawn_reliefs import SPACING, conditioned, draw, measure, of, rms, tracks, uneven, within
from helpers import refused

from sal_height.errors import UserError
from sal_height.relief.prior import PriorEstimate
from sal_height.relief.settings import TrackingSettings
from sal_height.relief.smoothing import (
    COLUMNS_AT_ONCE,
    ReliefPrior,
    filtered,
    smoothed,
    smoothed_columns,
    steady_sigmas,
)

PRIOR = ReliefPrior(20.0, 1.0, 3.0)
ALL = TrackingSettings(gate=1000.0)
"""A gate that no measurement is beyond."""

ALONG_RANGE = TrackingSettings(along_track=False)


def test_filter_and_smoother_are_what_conditioning_on_all_cells_gives() -> None:
    """With sigmas that vary, a fifth of the cells missing and two that no sigma or an infinite one makes so."""
    rng = np.random.default_rng(1)
    position = np.arange(60) * SPACING
    covariance = PRIOR.sigma**2 * PRIOR.correlation(position[:, None] - position)
    sigma = uneven(rng, (60, 3))
    measured = measure(rng, tracks(rng, PRIOR, sigma.shape), sigma, missing=0.2)
    sigma[7, 0], sigma[8, 0], sigma[9, 0], sigma[10, 0] = np.inf, np.nan, 0.0, -1.0
    known = np.where(np.isfinite(sigma) & (sigma > 0), measured, np.nan)
    both, causal = smoothed_columns(of(measured, sigma), PRIOR, ALL), filtered(of(measured, sigma), PRIOR, ALL)
    for c in range(3):
        height, spread = conditioned(known[:, c], sigma[:, c], covariance, PRIOR.mean)
        np.testing.assert_allclose(both.height[:, c], height, atol=1e-9)
        np.testing.assert_allclose(both.sigma[:, c], spread, atol=1e-9)
        for i in (0, 9, 30, 59):
            so_far = np.where(np.arange(60) <= i, known[:, c], np.nan)
            height, spread = conditioned(so_far, sigma[:, c], covariance, PRIOR.mean)
            assert causal.height[i, c] == pytest.approx(height[i], abs=1e-9)
            assert causal.sigma[i, c] == pytest.approx(spread[i], abs=1e-9)
    assert not both.outlier.any()


@pytest.mark.parametrize(("length", "measured"), [(20.0, 1.0), (5.0, 1.0), (20.0, 0.3), (1.0, 4.0)])
def test_steady_state_is_that_of_the_spectrum(length: float, measured: float) -> None:
    """Wiener: the smoother's error is the mean of S R / (S + R). Kolmogorov: ln (P + R) is that of ln (S + R)."""
    prior = ReliefPrior(length, 1.5)
    phi, r = np.exp(-SPACING / length), measured**2
    turns = np.exp(2j * np.pi * np.arange(4096) / 4096)
    spectrum = 1.5**2 * (1 - phi**2) / np.abs(1 - phi * turns) ** 2
    predicted = np.exp(np.mean(np.log(spectrum + r))) - r
    expected = np.sqrt([predicted * r / (predicted + r), np.mean(spectrum * r / (spectrum + r))])
    np.testing.assert_allclose(steady_sigmas(prior, SPACING, measured), expected, rtol=1e-9)


def test_errors_are_those_of_the_steady_state() -> None:
    """Length 20 m, sigma 1 m, noise 1 m, cells of 0.5 m: 2000 independent tracks, standard error 1.6 %."""
    rng = np.random.default_rng(2)
    height = tracks(rng, PRIOR, (241, 2000))
    sigma = np.ones_like(height)
    measured = measure(rng, height, sigma)
    middle = slice(80, 161)  # 40 m, twice the correlation length, make several independent errors of a track
    for track, expected in zip((filtered, smoothed_columns), steady_sigmas(PRIOR, SPACING, 1.0), strict=True):
        result = track(of(measured, sigma), PRIOR, ALL)
        assert rms((result.height - height)[middle]) == pytest.approx(expected, rel=0.02)
        np.testing.assert_allclose(result.sigma[middle], expected, rtol=1e-6)


@pytest.mark.parametrize(
    ("length", "noise", "missing"), [(20.0, 1.0, 0.0), (5.0, 0.3, 0.3), (40.0, 3.0, 0.1), (1.0, 1.0, 0.5)]
)
def test_sigma_is_the_spread_of_the_errors(length: float, noise: float, missing: float) -> None:
    """68 % within 3 points, of noise that varies and cells that miss, with the true prior and with the estimated one.

    200 swaths of 150 m hold 750 independent errors or more: standard error 1.7 points at most.
    """
    rng = np.random.default_rng(3)
    prior = ReliefPrior(length, 1.0, -100.0)
    height = tracks(rng, prior, (300, 200))
    sigma = noise * uneven(rng, height.shape)
    measured = measure(rng, height, sigma, missing)
    estimated, _ = PriorEstimate().after(of(measured, sigma), ALONG_RANGE)
    for known, track in itertools.product((prior, estimated), (filtered, smoothed_columns)):
        result = track(of(measured, sigma), known)
        assert within(result, height) == pytest.approx(0.683, abs=0.03)
        assert rms((result.height - height) / result.sigma) == pytest.approx(1, abs=0.06)


def test_an_outlier_is_marked_and_does_no_harm() -> None:
    rng = np.random.default_rng(8)
    height = tracks(rng, PRIOR, (100, 1))
    sigma = np.full(height.shape, 0.3)
    measured = measure(rng, height, sigma)
    spoilt, missing = measured.copy(), measured.copy()
    spoilt[50], missing[50] = 20.0, np.nan
    result, expected = (smoothed_columns(of(values, sigma), PRIOR) for values in (spoilt, missing))
    np.testing.assert_array_equal(np.flatnonzero(result.outlier), [50])
    np.testing.assert_allclose(result.height, expected.height, rtol=1e-12)
    np.testing.assert_allclose(result.sigma, expected.sigma, rtol=1e-12)


@pytest.mark.parametrize("step", [2.0, 3.0])
def test_the_track_is_found_again_behind_a_cliff(step: float) -> None:
    """The gate lets a step of b in once b phi^n < gate sqrt(P + R): P is the prior's less what n cells leave of it."""
    measured = np.where(np.arange(200)[:, None] < 100, 0.0, step)
    sigma = np.full(measured.shape, 0.1)
    prior = ReliefPrior(20.0, 1.0)
    result = filtered(of(measured, sigma), prior)
    lost = np.flatnonzero(result.outlier)
    n = np.arange(1, 101)
    left = prior.correlation(n * SPACING) ** 2 * (1 - result.sigma[99] ** 2)
    departure = step - prior.correlation(n * SPACING) * result.height[99]
    let_in = departure**2 <= TrackingSettings().gate ** 2 * (1 - left + 0.1**2)
    count = int(np.argmax(let_in))
    assert 0 < count < 30
    np.testing.assert_array_equal(lost, np.arange(100, 100 + count))
    assert result.height[100 + count + 2, 0] == pytest.approx(step, abs=0.3)


def test_columns_and_precision_of_single_numbers_make_no_difference() -> None:
    """One column more than are followed at a time, and again each for itself."""
    rng = np.random.default_rng(9)
    sigma = uneven(rng, (50, 2 * COLUMNS_AT_ONCE + 1))
    measured = measure(rng, tracks(rng, PRIOR, sigma.shape), sigma, 0.1)
    result = smoothed_columns(of(measured, sigma), PRIOR)
    for c in (0, COLUMNS_AT_ONCE - 1, COLUMNS_AT_ONCE, 2 * COLUMNS_AT_ONCE):
        alone = smoothed_columns(of(measured[:, [c]], sigma[:, [c]]), PRIOR)
        np.testing.assert_allclose(result.height[:, [c]], alone.height, rtol=1e-12)
        np.testing.assert_allclose(result.sigma[:, [c]], alone.sigma, rtol=1e-12)
    single = smoothed_columns(of(measured.astype(np.float32), sigma.astype(np.float32)), PRIOR)
    assert single.height.dtype == single.sigma.dtype == np.float32
    np.testing.assert_allclose(single.height, result.height, atol=2e-6)
    np.testing.assert_allclose(single.sigma, result.sigma, atol=1e-6)


def test_a_field_of_one_window_is_what_conditioning_on_all_cells_gives() -> None:
    rng = np.random.default_rng(10)
    shape, spacings = (9, TrackingSettings().window_columns), (SPACING, 2.0)
    rows, cols = (
        PRIOR.correlation(np.subtract.outer(np.arange(n), np.arange(n)) * d)
        for n, d in zip(shape, spacings, strict=True)
    )
    sigma = uneven(rng, shape)
    measured = measure(rng, draw(rng, PRIOR, shape, spacings), sigma, 0.2)
    result = smoothed(of(measured, sigma, spacings), PRIOR, ALL)
    height, spread = conditioned(measured.ravel(), sigma.ravel(), PRIOR.sigma**2 * np.kron(rows, cols), PRIOR.mean)
    np.testing.assert_allclose(result.height.ravel(), height, atol=1e-9)
    np.testing.assert_allclose(result.sigma.ravel(), spread, atol=1e-9)


def test_the_mean_is_estimated_with_the_heights_if_it_is_not_known() -> None:
    """As conditioning does whose covariance has the variance of the mean everywhere."""
    rng = np.random.default_rng(13)
    shape, prior = (12, 5), ReliefPrior(2.0, 0.5, 3.0, 4.0)
    rows, cols = (prior.correlation(np.subtract.outer(np.arange(n), np.arange(n)) * SPACING) for n in shape)
    sigma = uneven(rng, shape)
    measured = measure(rng, 7 + draw(rng, prior, shape, (SPACING, SPACING)), sigma, 0.3)
    covariance = prior.sigma**2 * np.kron(rows, cols) + prior.mean_sigma**2
    height, spread = conditioned(measured.ravel(), sigma.ravel(), covariance, prior.mean)
    result = smoothed(of(measured, sigma), prior, ALL)
    np.testing.assert_allclose(result.height.ravel(), height, atol=1e-9)
    np.testing.assert_allclose(result.sigma.ravel(), spread, atol=1e-9)


@pytest.mark.parametrize("prior", [ReliefPrior(1e6, 1e-6), ReliefPrior(1e6, 1e5), ReliefPrior(1e-3, 1.0)])
def test_nothing_breaks_the_smoother(prior: ReliefPrior) -> None:
    """Hardly any variance, no end of correlation, or none at all; and cells that are all but exactly known."""
    rng = np.random.default_rng(14)
    sigma = uneven(rng, (40, 6))
    sigma[20:22] = 1e-40
    result = smoothed(of(5 + sigma * rng.standard_normal(sigma.shape), sigma), prior, ALL)
    assert np.all(np.isfinite(result.height))
    assert np.all(result.sigma > 0)
    assert np.all(result.sigma <= prior.sigma * (1 + 1e-9))


@pytest.mark.parametrize("cols", [1, 33, 48, 49, 80])
def test_windows_lose_little_of_a_wide_field(cols: int) -> None:
    """Against one window as wide as the image: every sigma is 4 % greater at most, 2 % in the mean."""
    rng = np.random.default_rng(11)
    spacings = (SPACING, SPACING)
    sigma = np.ones((40, cols))
    measured = measure(rng, draw(rng, PRIOR, sigma.shape, spacings), sigma)
    windows = smoothed(of(measured, sigma), PRIOR, ALL)
    whole = smoothed(of(measured, sigma), PRIOR, ALL.changed(window_columns=max(cols, 4)))
    ratio = windows.sigma / whole.sigma
    assert np.all(ratio > 1 - 1e-9)
    assert np.max(ratio) < 1.04
    assert np.mean(ratio) < 1.02


def test_a_mirrored_field_has_mirrored_heights() -> None:
    """Two windows overlap in all columns but four; each column has one of them, whichever thread ends first."""
    rng = np.random.default_rng(15)
    sigma = uneven(rng, (20, TrackingSettings().window_columns + 2))
    measured = measure(rng, draw(rng, PRIOR, sigma.shape, (SPACING, SPACING)), sigma)
    result = smoothed(of(measured, sigma), PRIOR)
    mirrored = smoothed(of(measured[:, ::-1], sigma[:, ::-1]), PRIOR)
    np.testing.assert_allclose(mirrored.height[:, ::-1], result.height, rtol=1e-9)
    np.testing.assert_allclose(mirrored.sigma[:, ::-1], result.sigma, rtol=1e-9)


def test_a_field_is_calibrated_and_better_than_tracks_along_range() -> None:
    """6 fields of 60 x 80 m, of 200 independent errors each or more: standard error of the share 1.3 points.

    With outliers, noise that varies and missing cells, and with the estimated prior, too.
    """
    rng = np.random.default_rng(12)
    spacings = (SPACING, 0.8)
    prior = ReliefPrior(10.0, 2.0, 50.0)
    shares, errors = [], []
    for _ in range(6):
        height = draw(rng, prior, (120, 100), spacings)
        sigma = 2 * uneven(rng, height.shape)
        measured = measure(rng, height, sigma, 0.1)
        wrong = rng.random(height.shape) < 0.02
        measured[wrong] = rng.uniform(0, 100, np.count_nonzero(wrong))
        known, _ = PriorEstimate().after(of(measured, sigma, spacings))
        results = [
            smoothed(of(measured, sigma, spacings), prior),
            smoothed(of(measured, sigma, spacings), known),
            smoothed_columns(of(measured, sigma, spacings), prior),
        ]
        shares.append([within(result, height) for result in results])
        errors.append([rms(result.height - height) for result in results])
    np.testing.assert_allclose(np.mean(shares, axis=0), 0.683, atol=0.03)
    field, estimated, tracks = np.mean(errors, axis=0)
    assert field < 0.8 * tracks
    assert estimated < 1.03 * field


@pytest.mark.parametrize(
    ("height", "sigma", "spacings", "words"),
    [
        ((5, 4), (5, 3), (1.0, 1.0), ("(5, 4)", "(5, 3)", "same (rows, cols)")),
        ((5,), (5,), (1.0, 1.0), ("(5,)",)),
        ((5, 4), (5, 4), (0.0, 1.0), ("0 m apart",)),
        ((5, 4), (5, 4), (np.nan, 1.0), ("nan m apart",)),
        ((5, 4), (5, 4), (1.0, np.inf), ("columns inf m",)),
    ],
)
def test_what_cannot_be_tracked_is_refused(
    height: tuple[int, ...], sigma: tuple[int, ...], spacings: tuple[float, float], words: tuple[str, ...]
) -> None:
    with refused(UserError, *words):
        of(np.ones(height), np.ones(sigma), spacings)


@pytest.mark.parametrize("values", [(0.0, 1.0, 0.0), (1.0, -1.0, 0.0), (np.inf, 1.0, 0.0), (1.0, 1.0, np.nan)])
def test_a_prior_that_is_none_is_refused(values: tuple[float, float, float]) -> None:
    with refused(UserError, "greater than 0"):
        ReliefPrior(*values)
