"""Beams that are not exactly known: sigma and the test of fit against perturbed beams, drawn anew for every pixel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import BEAMWIDTH, circular, elevation_at, few, make_beams, multilook
from scipy import stats

from sal_height.beams.array import Beams
from sal_height.elevation.array.beam_error import PowerLaw, beam_deviation, common_deviation
from sal_height.elevation.array.bounds import information
from sal_height.elevation.array.estimate import ElevationEstimate, Validity
from sal_height.elevation.estimators.maximum_likelihood import MlSettings, ml_elevation
from sal_height.elevation.looks.looks import Looks
from sal_height.elevation.monopulse.pairs import MonopulseSettings, monopulse_elevation
from sal_height.elevation.monopulse.sum_difference import SumDifferenceSettings, sum_difference_elevation

TRIALS = 2500
"""Pixels of a case: a share of 68.3 % has a standard error of 0.9 %."""


def perturbed(beams: Beams, elevation: np.ndarray, error: np.ndarray, cnr_db: float, looks: int, seed: int) -> Looks:
    """Pixels of one scatterer each, whose responses are those of `beams` and `error` (pixels, channels)."""
    rng = np.random.default_rng([80, seed])
    response = (beams.response(elevation, 0.0) + error) * 10 ** (cnr_db / 20)
    amplitude = circular(rng, (looks, len(elevation)))
    slc = np.einsum("pm,kp->mpk", response, amplitude) + circular(rng, (beams.count, len(elevation), looks))
    return multilook(slc.astype(np.complex64), 1, looks)


def case(uncertainty_db: float, cnr_db: float, looks: int, count: int = 8) -> tuple[np.ndarray, Looks, Beams]:
    """Elevations, looks and beams of pixels whose beams are wrong by `uncertainty_db`, and stated to be."""
    seed = [81, int(-uncertainty_db), int(cnr_db), looks]
    rng, beams = np.random.default_rng(seed), make_beams("jinc", count)
    uncertainty = 10 ** (uncertainty_db / 20)
    elevation = elevation_at(rng.uniform(-0.4, 0.4, TRIALS) * (count - 1) / 2)
    error = uncertainty * circular(rng, (TRIALS, count))
    return elevation, perturbed(beams, elevation, error, cnr_db, looks, looks), replace(beams, uncertainty=uncertainty)


def share_within_sigma(result: ElevationEstimate, elevation: np.ndarray) -> float:
    """Share of the valid pixels whose elevation is right within its stated standard deviation."""
    valid = result.validity[:, 0] == Validity.OK
    assert valid.mean() > 0.9
    return float(np.mean(np.abs(result.elevation[:, 0] - elevation)[valid] < result.sigma[valid, 0]))


@pytest.mark.parametrize("looks", few(2, [1, 48, 4]))
@pytest.mark.parametrize("cnr_db", few(2, [20.0, 60.0, 40.0]))
@pytest.mark.parametrize("uncertainty_db", few(1, [-30.0, -40.0, -20.0]))
def test_sigma_is_right_with_perturbed_beams(uncertainty_db: float, cnr_db: float, looks: int) -> None:
    """Also where the beams leave a thousand times as much as the noise."""
    elevation, seen, beams = case(uncertainty_db, cnr_db, looks)
    result = ml_elevation(seen, beams, MlSettings(layover=False, misfit_fraction=0.0))
    assert share_within_sigma(result, elevation) == pytest.approx(0.683, abs=0.04)


def test_sigma_without_the_uncertainty_is_far_too_small() -> None:
    elevation, seen, beams = case(-25.0, 50.0, 4)
    result = ml_elevation(seen, replace(beams, uncertainty=0.0), MlSettings(layover=False, misfit_fraction=1.0))
    assert share_within_sigma(result, elevation) < 0.1


@pytest.mark.parametrize("looks", few(1, [1, 16]))
def test_sigma_of_pairs_is_right_with_perturbed_beams(looks: int) -> None:
    elevation, seen, beams = case(-30.0, 45.0, looks)
    result = monopulse_elevation(seen, beams, MonopulseSettings(misfit_fraction=0.0))
    assert share_within_sigma(result, elevation) == pytest.approx(0.683, abs=0.04)


@pytest.mark.parametrize("looks", few(1, [1, 16]))
def test_sigma_of_sum_and_difference_is_right_with_perturbed_beams(looks: int) -> None:
    rng, beams = np.random.default_rng([84, looks]), replace(make_beams("gaussian", 2), uncertainty=10 ** (-30 / 20))
    elevation = elevation_at(rng.uniform(-0.2, 0.2, TRIALS))
    response = beams.response(elevation, 0.0) + beams.uncertainty * circular(rng, (TRIALS, 2))
    lower, upper = np.einsum("pm,pk->mpk", response * 10 ** (45 / 20), circular(rng, (TRIALS, looks)))
    slc = np.stack([upper + lower, upper - lower]) + circular(rng, (2, TRIALS, looks))
    seen = multilook(slc.astype(np.complex64), 1, looks, hermitian=True)
    result = sum_difference_elevation(seen, beams, SumDifferenceSettings())
    assert share_within_sigma(result, elevation) == pytest.approx(0.683, abs=0.04)


@pytest.mark.parametrize("looks", few(1, [4, 1, 48]))
def test_pixels_are_rejected_at_the_stated_rate(looks: int) -> None:
    """1 % of single scatterers, 25 of them with a standard error of 5, for beams good to -25 dB at 50 dB."""
    _, seen, beams = case(-25.0, 50.0, looks, count=12)
    rules = {"layover": False, "misfit_fraction": 0.0, "false_alarm_rate": 0.01}
    stated = ml_elevation(seen, beams, MlSettings(**rules)).validity == Validity.NOT_ONE_SCATTERER
    assert np.mean(stated) == pytest.approx(0.01, abs=0.006)
    perfect = ml_elevation(seen, replace(beams, uncertainty=0.0), MlSettings(**rules)).validity
    assert np.mean(perfect == Validity.NOT_ONE_SCATTERER) > 0.99


def test_the_deviation_that_pixels_of_one_elevation_share_is_that_of_the_closed_form() -> None:
    """Twelve channels, good to -25 dB: rms over 400 sensors of the shift of a noise-free scatterer, +- 3.5 %."""
    rng, beams = np.random.default_rng(82), replace(make_beams("jinc", 12), uncertainty=10 ** (-25 / 20))
    elevation = np.full(400, elevation_at(0.7))
    seen = perturbed(beams, elevation, beams.uncertainty * circular(rng, (400, 12)), 120.0, 1, 0)
    shift = ml_elevation(seen, beams, MlSettings(layover=False)).elevation[:, 0] - elevation
    expected = common_deviation(beams, elevation[0], 0.0)
    assert np.sqrt(np.mean(shift**2)) == pytest.approx(expected, rel=0.12)
    assert expected == pytest.approx(beams.uncertainty / np.sqrt(2 * information(beams, elevation[0], 0.0)), rel=1e-12)
    assert 0.01 < expected / BEAMWIDTH < 0.03


def test_nothing_is_determined_without_information_and_all_with_known_beams() -> None:
    np.testing.assert_array_equal(beam_deviation(np.array([0.0, -1.0, np.nan]), 0.1), np.inf)
    np.testing.assert_array_equal(beam_deviation(np.array([0.0, 1.0]), 0.0), 0.0)
    assert np.isnan(common_deviation(make_beams(), np.nan, 0.0))


@pytest.mark.parametrize("error", [0.0, 0.5, 2.0, 9.0, 1e4])
@pytest.mark.parametrize(("order", "coherent"), [(6.5, 6.5), (27.5, 6.5), (335.5, 6.5), (16.0, 1.0)])
def test_power_law_has_the_quantiles_of_the_sum(order: float, coherent: float, error: float) -> None:
    """A share of 1 % within a factor of 1.2, over 400 000 draws of the two gamma distributions."""
    rng, law = np.random.default_rng(83), PowerLaw.of(order, coherent, error)
    drawn = (1 + error) * rng.gamma(coherent, size=400_000) + rng.gamma(max(order - coherent, 1e-12), size=400_000)
    rare = law.exceeded(drawn) < 0.01
    assert 0.0095 < np.mean(rare) < 0.012
    assert drawn[rare].min() > drawn[~rare].max()


def test_power_law_without_error_is_the_gamma_distribution() -> None:
    order = np.array([0.0, 0.5, 27.5])
    law = PowerLaw.of(order, np.minimum(order, 0.5), 0.0)
    np.testing.assert_allclose(law, (order, np.ones(3), np.zeros(3)), atol=1e-14)
    np.testing.assert_allclose(law.exceeded(np.array([0.1, 1.0, 30.0]))[1:], stats.gamma(order[1:]).sf([1.0, 30.0]))
    np.testing.assert_array_equal(law.exceeded(np.array([0.1, 0.0, -1.0])), [0.0, 1.0, 1.0])
