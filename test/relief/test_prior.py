"""The prior of tracked heights: of one dwell, of many against all of them at once, and of ground that changes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from drawn_reliefs import SPACING, Array, draw, measure, of, rms, tracks, uneven, within
from scipy.optimize import minimize

from sal_height.relief.prior import LEAST_STEPS, PriorEstimate, _Heights
from sal_height.relief.settings import TrackingSettings
from sal_height.relief.smoothing import MeasuredHeights, ReliefPrior, smoothed, smoothed_columns

PRIOR = ReliefPrior(20.0, 1.0, 3.0)
ALONG_RANGE = TrackingSettings(along_track=False)
SPACINGS = (SPACING, SPACING)
DWELL = (60, 6)


def dwells(
    rng: np.random.Generator, prior: ReliefPrior, count: int, noise: float, shape: tuple[int, int] = DWELL
) -> Iterator[tuple[Array, MeasuredHeights]]:
    """Heights of independent dwells, m, and their measurements, one in ten of which is missing."""
    for _ in range(count):
        height = draw(rng, prior, shape, SPACINGS)
        sigma = noise * np.exp(0.4 * rng.standard_normal(shape))
        yield height, of(measure(rng, height, sigma, 0.1), sigma)


def logs(prior: ReliefPrior) -> Array:
    return np.log([prior.length, prior.sigma])


def test_prior_of_a_dwell_is_estimated() -> None:
    """From 64 swaths of 6 lengths: the scatter of 9 estimates is their standard error, and none is biased."""
    rng = np.random.default_rng(4)
    found = []
    for _ in range(9):
        height = tracks(rng, PRIOR, (256, 64))
        sigma = uneven(rng, height.shape)
        prior, _ = PriorEstimate().after(of(measure(rng, height, sigma, 0.1), sigma), ALONG_RANGE)
        found.append([*(logs(prior) - logs(PRIOR)), prior.mean - 3.0])
    error = np.std(found, axis=0, ddof=1)
    assert np.all(error < [0.12, 0.05, 0.1])
    assert np.all(np.abs(np.mean(found, axis=0)) < 3.5 * error / np.sqrt(9))


def test_prior_is_estimated_in_spite_of_outliers() -> None:
    """One in eight cells is anywhere within 10 sigmas; tracks then lose a tenth of their precision, and no more."""
    rng = np.random.default_rng(5)
    height = tracks(rng, PRIOR, (400, 200))
    sigma = np.full(height.shape, 0.5)
    clean = measure(rng, height, sigma)
    wrong = rng.random(height.shape) < 0.125
    measured = np.where(wrong, rng.uniform(-7, 13, height.shape), clean)
    prior, _ = PriorEstimate().after(of(measured, sigma), ALONG_RANGE)
    assert prior.length == pytest.approx(20, rel=0.3)
    assert prior.sigma == pytest.approx(1, rel=0.15)
    result = smoothed_columns(of(measured, sigma), prior)
    without = smoothed_columns(of(np.where(wrong, np.nan, clean), sigma), PRIOR)
    far = wrong & (np.abs(measured - height) > 5)
    assert np.mean(result.outlier[far]) > 0.99
    assert np.mean(result.outlier[~wrong]) < 0.001
    assert rms(result.height - height) < 1.1 * rms(without.height - height)
    assert within(result, height) == pytest.approx(0.683, abs=0.03)


@pytest.mark.parametrize("along_track", [True, False])
def test_what_is_known_of_the_prior_is_kept(along_track: bool) -> None:
    rng = np.random.default_rng(6)
    ((_, measured),) = dwells(rng, PRIOR, 1, 1.0)
    settings = TrackingSettings(along_track=along_track)
    found = [
        PriorEstimate().after(measured, settings.changed(correlation_length_m=length, relief_sigma_m=sigma))[0]
        for length, sigma in ((7.0, 0.0), (0.0, 2.0), (7.0, 2.0))
    ]
    assert found[0].length == pytest.approx(7.0)
    assert found[1].sigma == pytest.approx(2.0)
    assert logs(found[2]) == pytest.approx(np.log([7.0, 2.0]))
    assert found[0].sigma != pytest.approx(2.0, rel=0.01)
    assert found[1].length != pytest.approx(7.0, rel=0.01)


def test_level_ground_is_averaged_and_no_surer_than_its_level() -> None:
    """Planes in noise of 1 m, in 1200 cells: 29 mm. Of 30 heights all but one or two are within two sigmas."""
    rng = np.random.default_rng(7)
    off = []
    for _ in range(15):
        measured = of(5 + rng.standard_normal((60, 20)), np.ones((60, 20)))
        (alone, _), (field, _) = (PriorEstimate().after(measured, one) for one in (ALONG_RANGE, TrackingSettings()))
        assert min(alone.sigma, field.sigma) > 1.99 / np.sqrt(1200)
        assert (alone.mean_sigma, field.mean_sigma) == (0.0, pytest.approx(1.0, rel=0.1))
        for result in (smoothed_columns(measured, alone), smoothed(measured, field)):
            assert rms(result.height - 5) < 0.2
            off.append(rms((result.height - 5) / result.sigma))
    assert np.count_nonzero(np.array(off) > 2) <= 2


def test_dwells_one_by_one_say_what_all_say_at_once() -> None:
    """Against the greatest likelihood of all 60 dwells, whose terms `test_kernels` compares with dense matrices.

    Where nothing is forgotten the two are a third of their standard deviation apart, which falls as dwells come in. The
    information is the curvature of the likelihood within a fifth: outliers are expected, and there are none.
    """
    rng = np.random.default_rng(1)
    truth = ReliefPrior(3.0, 0.5, 10.0)
    heights = [measured for _, measured in dwells(rng, truth, 60, 0.2, (30, 6))]
    settings, estimate = TrackingSettings(prior_dwells=1_000_000), PriorEstimate()
    for measured in heights:
        prior, estimate = estimate.after(measured, settings)
    every = [_Heights.of(measured, settings, 1) for measured in heights]

    def misfit(values: Array) -> float:
        return -sum(one.log_likelihood(values) for one in every)

    best = minimize(misfit, logs(truth), method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-3}).x
    deviation = np.sqrt(np.diag(np.linalg.inv(estimate.information)))
    assert np.all(np.abs(logs(prior) - best) < deviation / 3)
    assert np.all(np.abs(logs(prior) - logs(truth)) < 3 * deviation)
    for step, stated in zip(0.1 * np.eye(2), np.diag(estimate.information), strict=True):
        curvature = (misfit(best + step) - 2 * misfit(best) + misfit(best - step)) / 0.1**2
        assert stated == pytest.approx(curvature, rel=0.2)


def test_the_stated_uncertainty_is_the_scatter_of_the_estimate() -> None:
    """(x - truth) information (x - truth) has the mean 2: 60 sequences of 6 dwells, standard error 0.26."""
    rng = np.random.default_rng(2)
    truth, distances = ReliefPrior(3.0, 0.5), []
    settings = TrackingSettings(prior_dwells=1_000_000)
    for _ in range(60):
        estimate = PriorEstimate()
        for _, measured in dwells(rng, truth, 6, 0.2, (40, 6)):
            prior, estimate = estimate.after(measured, settings)
        off = logs(prior) - logs(truth)
        distances.append(off @ estimate.information @ off)
    assert np.mean(distances) == pytest.approx(2, abs=0.8)


@pytest.mark.parametrize(("length", "sigma", "noise"), [(5.0, 1.0, 0.3), (2.0, 0.3, 0.4), (0.5, 0.5, 0.3)])
def test_sigma_of_tracked_heights_is_the_spread_of_their_errors(length: float, sigma: float, noise: float) -> None:
    """From the tenth dwell on, of rough and smooth relief: 80 dwells of 20 independent errors or more, 1.2 points."""
    rng = np.random.default_rng(3)
    estimate, shares = PriorEstimate(), []
    for height, measured in dwells(rng, ReliefPrior(length, sigma), 90, noise):
        prior, estimate = estimate.after(measured)
        shares.append(within(smoothed(measured, prior), height))
    assert np.mean(shares[10:]) == pytest.approx(0.683, abs=0.02)
    assert np.mean(shares[:10]) == pytest.approx(0.683, abs=0.06)


@pytest.mark.parametrize(
    ("before", "after"),
    [((5.0, 1e-9), (5.0, 2.0)), ((5.0, 0.1), (1.0, 2.0)), ((5.0, 2.0), (5.0, 0.1)), ((1.0, 1.0), (20.0, 1.0))],
    ids=["level to rough", "smooth to rough", "rough to smooth", "short to long"],
)
def test_ground_that_is_quite_another_is_followed_at_once(
    before: tuple[float, float], after: tuple[float, float]
) -> None:
    """In its first dwell heights keep their sigma and hardly any is an outlier; 16 dwells later the prior is right."""
    rng = np.random.default_rng(4)
    estimate = PriorEstimate()
    for _, measured in dwells(rng, ReliefPrior(*before), 20, 0.05):
        _, estimate = estimate.after(measured)
    for number, (height, measured) in enumerate(dwells(rng, ReliefPrior(*after), 16, 0.05)):
        prior, estimate = estimate.after(measured)
        result = smoothed(measured, prior)
        if number == 0:
            assert within(result, height) > 0.6
            assert np.mean(result.outlier) < 0.01
    assert np.all(np.abs(logs(prior) - np.log(after)) < 0.35)


def test_ground_that_changes_a_little_is_followed_in_twice_the_dwells_of_the_prior() -> None:
    """A third rougher: of the change an eighth is left, and 3.5 standard errors of an estimate from 16 dwells."""
    rng = np.random.default_rng(5)
    old, new, estimate = ReliefPrior(2.0, 0.3), ReliefPrior(2.0, 0.4), PriorEstimate()
    for prior_now, count in ((old, 20), (new, 2 * TrackingSettings().prior_dwells)):
        for _, measured in dwells(rng, prior_now, count, 0.1):
            prior, estimate = estimate.after(measured)
    deviation = np.sqrt(np.linalg.inv(estimate.information)[1, 1])
    assert deviation < 0.05
    assert abs(np.log(prior.sigma / new.sigma)) < np.log(4 / 3) / 8 + 3.5 * deviation


def test_the_same_dwells_give_the_same_prior_and_nothing_is_kept_of_old_ones() -> None:
    """Value for value; with `prior_dwells` 1 each dwell is estimated alone, and information does not grow for ever."""
    heights = [measured for _, measured in dwells(np.random.default_rng(6), PRIOR, 12, 0.3)]

    def priors(dwells_kept: int) -> tuple[list[ReliefPrior], list[Array]]:
        estimate, found, information = PriorEstimate(), [], []
        for measured in heights:
            prior, estimate = estimate.after(measured, TrackingSettings(prior_dwells=dwells_kept))
            found.append(prior)
            information.append(estimate.information)
        return found, information

    found, four = priors(4)
    assert found == priors(4)[0]
    alone, single = priors(1)
    assert alone == [PriorEstimate().after(measured)[0] for measured in heights]
    assert four[-1][1, 1] < 4.5 * max(one[1, 1] for one in single)


@pytest.mark.parametrize("cells", [0, 1, LEAST_STEPS // 2])
def test_the_first_prior_needs_measurements(cells: int) -> None:
    """As many in each of two columns; the others are empty."""
    measured = np.full((50, 5), np.nan)
    measured[:cells, 1] = measured[:cells, 3] = 1.0
    assert PriorEstimate().after(of(measured, np.ones_like(measured))) is None


def test_a_later_prior_needs_a_pair() -> None:
    """Two cells hardly change what a dwell has said; single ones are no relief."""
    ((_, full),) = dwells(np.random.default_rng(7), ReliefPrior(3.0, 0.5, 3.0), 1, 0.3)
    before, estimate = PriorEstimate().after(full)
    few = np.full(DWELL, np.nan)
    few[10:12, 2] = 3.0
    prior, _ = estimate.after(of(few, np.full(DWELL, 0.3)))
    assert np.all(np.abs(logs(prior) - logs(before)) < 0.3)
    few[11] = np.nan
    assert estimate.after(of(few, np.full(DWELL, 0.3))) is None
