"""The reasons for no height: how often noise alone gives one, against the rate that is stated."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import BEAMWIDTH, circular, elevation_at, few, make_beams, multilook, target_slc
from scipy import stats

from sal_height.elevation.array.estimate import (
    Fit,
    Validity,
    detection_limit,
    explained_power,
    is_detected,
    is_explained,
    noise_limit,
)
from sal_height.elevation.array.height_settings import HeightSettings
from sal_height.elevation.estimators.maximum_likelihood import MlSettings, ml_elevation
from sal_height.elevation.looks.looks import Looks
from sal_height.elevation.monopulse.sum_difference import SumDifferenceSettings, sum_difference_elevation

CASES = pytest.mark.parametrize(
    ("channels", "looks", "trials"), few(1, [(16, 4, 60_000), (2, 1, 400_000), (3, 2, 300_000)])
)


def looks_of_pixels(slc: np.ndarray, hermitian: bool = False) -> Looks:
    """Looks of images (channels, pixels, looks)."""
    return multilook(slc.astype(np.complex64), 1, slc.shape[2], hermitian)


def assert_rate(happened: np.ndarray, rate: float) -> None:
    """Assert that a share of pixels is `rate` within 3.5 standard errors of a Poisson count."""
    expected = rate * happened.size
    assert np.count_nonzero(happened) == pytest.approx(expected, abs=3.5 * np.sqrt(expected))


@CASES
def test_single_scatterers_are_rejected_at_the_stated_rate(channels: int, looks: int, trials: int) -> None:
    """By maximum likelihood at 15 dB and more, where 6 to 40 of the pixels are expected."""
    beams, rng = make_beams("jinc", channels), np.random.default_rng([70, channels])
    offsets = rng.uniform(-0.4, 0.4, (trials, 1)) * (channels - 1) / 2
    seen = looks_of_pixels(target_slc(beams, offsets, trials, looks, 100.0 / looks, rng))
    result = ml_elevation(seen, beams, MlSettings(layover=False))
    usable = result.cnr > 10
    assert np.mean(usable) > 0.8
    assert_rate(result.validity[usable] == Validity.NOT_ONE_SCATTERER, HeightSettings().false_alarm_rate)


@pytest.mark.parametrize("looks", few(1, [16, 2]))
def test_sum_and_difference_reject_at_the_stated_rate(looks: int) -> None:
    """30 and 20 of the pixels are expected."""
    trials = 300_000 if looks == 2 else 200_000
    beams, rng = make_beams("gaussian", 2), np.random.default_rng([71, looks])
    slc = target_slc(beams, 0.1, trials, looks, 80.0 / looks, rng)
    seen = looks_of_pixels(np.stack([slc[1] + slc[0], slc[1] - slc[0]]) / np.sqrt(2), hermitian=True)
    result = sum_difference_elevation(seen, beams, SumDifferenceSettings(min_cnr_db=4.0))
    usable = result.cnr > 3
    assert np.mean(usable) > 0.9
    assert_rate(result.validity[usable] == Validity.NOT_ONE_SCATTERER, HeightSettings().false_alarm_rate)


@pytest.mark.parametrize("looks", few(1, [4, 1]))
def test_pixels_of_noise_pass_for_a_scatterer_no_more_often_than_stated(looks: int) -> None:
    """Without a least CNR, the limit for M independent directions is passed by others, too, but mostly outside."""
    trials, beams = 200_000, make_beams("sinc", 4)
    noise = looks_of_pixels(circular(np.random.default_rng([72, looks]), (4, trials, looks)))
    result = ml_elevation(noise, beams, MlSettings(min_cnr_db=-60.0, layover=False))
    assert np.count_nonzero(result.validity == Validity.OK) < 2 * HeightSettings().false_alarm_rate * trials
    assert np.count_nonzero(result.validity != Validity.NO_SIGNAL) < 8 * HeightSettings().false_alarm_rate * trials


def test_signal_without_another_around_must_stand_out_from_all_pixels_around() -> None:
    """In 7 x 7 pixels; above the limit of one pixel suffices where another one is, at the edge of the image, too."""
    looks, settings = Looks.of(np.zeros((12, 30, 3, 3), np.float32), 4.0), HeightSettings()
    alone, one = (float(detection_limit(looks, 3 * pixels, settings)[0, 0]) for pixels in (49, 1))
    explained = np.zeros((12, 30))
    for row, col, power in ((0, 0, one), (5, 5, one), (5, 9, one), (0, 14, alone), (5, 20, one), (8, 23, one)):
        explained[row, col] = power + 1e-6
    found = is_detected(looks, Fit(explained, explained, explained, directions=3), settings)
    assert np.argwhere(found).tolist() == [[0, 14], [5, 20], [8, 23]]


def test_image_of_noise_shows_fewer_scatterers_than_pixels_alone_would() -> None:
    """At a rate of 1e-2, where 400 pixels of noise pass the limit of one; 160 of them have another around."""
    rate, shape = 1e-2, (200, 200)
    noise = np.random.default_rng(75).gamma(4.0, size=shape)
    looks = Looks.of(np.zeros((*shape, 1, 1), np.float32), 4.0)
    settings = HeightSettings(false_alarm_rate=rate)
    found = is_detected(looks, Fit(noise, noise, noise, directions=1), settings)
    assert_rate(noise >= detection_limit(looks, 1, settings), rate)
    assert_rate(found, rate * (1 - (1 - rate) ** 48 * (1 - 1 / 49)))


@pytest.mark.parametrize("degrees", [0.5, 1.0, 7.5, 60.0, 1000.0])
@pytest.mark.parametrize("rate", [1e-2, 1e-4, 1e-8])
def test_limit_is_the_quantile_of_the_noise_power(degrees: float, rate: float) -> None:
    limit = float(noise_limit(np.array([degrees]), rate)[0])
    assert stats.gamma(degrees).sf(limit) == pytest.approx(rate, rel=1e-9)


def test_rules_of_validity_can_be_set() -> None:
    """1 % are rejected instead of 0.01 %; a share of 1 rejects none, and a ratio of 1 marks none."""
    beams, rng = make_beams("jinc", 3), np.random.default_rng(74)
    seen = looks_of_pixels(target_slc(beams, rng.uniform(-0.4, 0.4, (20_000, 1)), 20_000, 2, 50.0, rng))

    def share(reason: Validity, **rules: float) -> np.ndarray:
        result = ml_elevation(seen, beams, MlSettings(layover=False, **rules))
        return (result.validity == reason)[result.cnr > 10]

    assert_rate(share(Validity.NOT_ONE_SCATTERER, false_alarm_rate=1e-2, misfit_fraction=0.0), 1e-2)
    assert not share(Validity.NOT_ONE_SCATTERER, false_alarm_rate=1e-2, misfit_fraction=1.0).any()
    assert share(Validity.AMBIGUOUS, ambiguous_ratio=1e9).mean() > 2 * share(Validity.AMBIGUOUS).mean()
    assert not share(Validity.AMBIGUOUS, ambiguous_ratio=1.0).any()


def test_limit_of_no_dimensions_is_zero() -> None:
    np.testing.assert_array_equal(noise_limit(np.array([[0.0, -0.5]]), 1e-4), [[0, 0]])


def test_small_share_of_a_strong_scatterer_may_be_left() -> None:
    """Of 10 000 noise powers 3 % beyond the mean of the noise, whatever the noise alone allows."""
    left = np.array([7.5 + 299.0, 7.5 + 301.0])
    fit = Fit(np.full(2, 10_000.0), left, np.full(2, 7.5), directions=3)
    np.testing.assert_array_equal(is_explained(fit, HeightSettings()), [True, False])


def test_explained_power_is_the_quadratic_form_of_the_unit_response() -> None:
    rng, beams = np.random.default_rng(73), make_beams("jinc", 5)
    response = beams.response(elevation_at(rng.uniform(-1, 1, 7)), 0.3 * BEAMWIDTH) * np.exp(1j * rng.random((7, 5)))
    samples = circular(rng, (7, 4, 5))
    covariance = np.einsum("pkm,pkn->pmn", samples, samples.conj())
    matched = np.einsum("pm,pkm->pk", response.conj(), samples)
    expected = np.sum(np.abs(matched) ** 2, axis=1) / np.sum(np.abs(response) ** 2, axis=1)
    np.testing.assert_allclose(explained_power(covariance, response), expected, rtol=1e-12)
