"""Capon and MUSIC against the Cramer-Rao bound, their own sigma, and two scatterers in a pixel."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from helpers import (
    BEAMWIDTH,
    circular,
    elevation_at,
    few,
    make_beams,
    multilook,
    noise_free_looks,
    offset_of,
    phased,
    refused,
    standard_error_of_rms,
    target_slc,
)

from sal_height.beams.array import Beams
from sal_height.beams.pattern import PATTERNS
from sal_height.elevation.array.bounds import speckle_crb
from sal_height.elevation.array.estimate import ElevationEstimate, Validity
from sal_height.elevation.estimators.maximum_likelihood import MlSettings, ml_elevation
from sal_height.elevation.estimators.spectra import (
    CaponSettings,
    MusicSettings,
    capon_elevation,
    deviation_factor,
    music_elevation,
)
from sal_height.elevation.looks.looks import Looks
from sal_height.errors import UserError

Estimate = Callable[[Looks, Beams], ElevationEstimate]

ESTIMATORS: dict[str, Estimate] = {
    "capon": lambda looks, beams: capon_elevation(looks, beams, CaponSettings()),
    "capon, little loading": lambda looks, beams: capon_elevation(looks, beams, CaponSettings(loading=0.1)),
    "music": lambda looks, beams: music_elevation(looks, beams, MusicSettings()),
    "music of order 2": lambda looks, beams: music_elevation(looks, beams, MusicSettings(order=2)),
}

BOTH = pytest.mark.parametrize("name", ["capon", "music"])


def estimate(name: str, slc: np.ndarray, beams: Beams) -> ElevationEstimate:
    """Of images (channels, pixels, looks) in unit noise."""
    return ESTIMATORS[name](multilook(slc, 1, slc.shape[2], beams.is_complex), beams)


def offsets_of(result: ElevationEstimate) -> np.ndarray:
    return offset_of(result.elevation[:, 0])


@BOTH
@pytest.mark.parametrize("pattern", sorted(PATTERNS))
def test_elevation_is_exact_without_noise(pattern: str, name: str) -> None:
    beams, offsets, squint = make_beams(pattern), np.linspace(-3.745, 3.745, 50), 0.4 * BEAMWIDTH
    looks = noise_free_looks(beams, offsets, squint)
    np.testing.assert_allclose(offsets_of(ESTIMATORS[name](looks, beams)), offsets, atol=1e-5)
    # The tests of maximum likelihood expect noise.
    if name == "capon":
        result = capon_elevation(looks, beams, CaponSettings(layover=False))
    else:
        result = music_elevation(looks, beams, MusicSettings(layover=False))
    np.testing.assert_allclose(offsets_of(result), offsets, atol=1e-5)
    assert np.all(result.validity == Validity.OK)


def expected_factor(name: str, looks: int, beams: Beams) -> float:
    """Standard deviation over that of maximum likelihood."""
    loading = {"capon": 1.0, "capon, little loading": 0.1}
    if name in loading:
        return float(deviation_factor(np.array(float(looks)), beams, loading[name]))
    return float(np.sqrt(15 / 14)) if "order 2" in name else 1.0


@pytest.mark.parametrize("name", sorted(ESTIMATORS))
@pytest.mark.parametrize(("looks", "cnr_db"), few(2, [(64, 10), (4, 20), (16, 10)]))
def test_error_is_the_speckle_bound_times_the_stated_factor(looks: int, cnr_db: int, name: str) -> None:
    """With 16 detectors and with fewer looks than that, too. One SE of the rms is 1.3 to 1.9 % (`test_likelihood`)."""
    beams, cnr, trials = make_beams("sinc"), 10 ** (cnr_db / 10), 3000
    slc = target_slc(beams, 1.75, trials, looks, cnr, np.random.default_rng([60, looks]))
    error = offsets_of(estimate(name, slc, beams)) - 1.75
    assert np.mean(np.abs(error) < 0.5) > 0.999
    error = error[np.abs(error) < 0.5]
    bound = speckle_crb(beams, elevation_at(1.75), 0.0, cnr, looks) / BEAMWIDTH
    ratio = np.sqrt(np.mean(error**2)) / (bound * expected_factor(name, looks, beams))
    assert ratio == pytest.approx(1, abs=3.5 * np.sqrt((3 * (looks - 1) / (looks - 2) - 1) / (4 * trials)) + 0.02)


@pytest.mark.parametrize("name", sorted(ESTIMATORS))
@pytest.mark.parametrize(("cnr_db", "looks"), few(2, [(20, 2), (10, 16), (10, 4), (20, 4), (10, 9), (5, 32)]))
def test_sigma_holds_as_many_errors_as_it_says(cnr_db: int, looks: int, name: str) -> None:
    """Of the valid pixels 68.3 % and 95.4 % lie within one and two sigma: to 3 points, or 5 for two looks.

    An image of 64 x 64 pixels, as sigma contains the spread of a square of pixels around each: in a line of pixels the
    noise of that is 1 % of sigma more. One SE of the shares is 0.75 and 0.34 points for 3900 pixels; two are added.
    """
    beams, side, rng = make_beams("jinc"), 64, np.random.default_rng([61, looks, cnr_db])
    offsets = rng.uniform(-3, 3, (side**2, 1))
    slc = target_slc(beams, offsets, side**2, looks, 10 ** (cnr_db / 10), rng)
    result = ESTIMATORS[name](multilook(slc.reshape(beams.count, side, side * looks), 1, looks), beams)
    valid = result.validity == Validity.OK
    normal = ((offset_of(result.elevation) - offsets.reshape(side, side)) * BEAMWIDTH / result.sigma)[valid]
    for sigmas, share in ((1, 0.6827), (2, 0.9545)):
        error = 2 * np.sqrt(share * (1 - share) / len(normal))
        assert np.mean(np.abs(normal) < sigmas) == pytest.approx(share, abs=(0.05 if looks == 2 else 0.03) + error)


@BOTH
@pytest.mark.parametrize(("spread", "cnr_db", "looks"), few(1, [(0.3, 30, 16), (0.15, 20, 4)]))
def test_sigma_of_a_surface_contains_the_distance_of_the_peak_from_its_middle(
    spread: float, cnr_db: int, looks: int, name: str
) -> None:
    """Surfaces that are evenly spread, 1000 pixels: one SE of the shares is 1.6 points.

    Where the peak is far from the middle of the fitted surface, sigma is that distance, which half of the errors are
    less than. With the sigma of the middle alone 13 % of MUSIC's heights were beyond five.
    """
    beams, rng, count, pieces = make_beams("jinc"), np.random.default_rng([67, looks]), 1000, 24
    middle = rng.uniform(-3, 3, (count, 1))
    offsets = middle + spread * np.sqrt(12) * ((np.arange(pieces) + 0.5) / pieces - 0.5)
    waves = np.sqrt(10 ** (cnr_db / 10) / pieces) * circular(rng, (count, looks, pieces))
    slc = np.einsum("pks,psm->mpk", waves, beams.response(elevation_at(offsets), 0.0))
    result = estimate(name, slc + circular(rng, slc.shape), beams)
    surface = result.validity[:, 0] == Validity.EXTENDED
    normal = ((offsets_of(result) - middle[:, 0]) * BEAMWIDTH / result.sigma[:, 0])[surface]
    assert np.mean(surface) > 0.9
    assert 0.48 < np.mean(np.abs(normal) < 1) < 0.75
    assert np.mean(np.abs(normal) > 5) < 0.002 + 2 * np.sqrt(0.002 / count)


@pytest.mark.parametrize("loading", [0.1, 1.0, 10.0])
@pytest.mark.parametrize("looks", few(2, [2, 16, 8, 64]))
def test_factor_is_that_of_simulated_noise(looks: int, loading: float) -> None:
    """Least squares weighted with the inverse of a measured noise covariance, in 15 dimensions of real beams.

    The law is that of many dimensions; 15 leave 0.3 %, or 1.6 % where there is little loading and K is below M / 2.
    """
    rng, samples = np.random.default_rng([62, looks]), 2 * (looks - 1)
    noise = rng.standard_normal((4000, samples, 15))
    covariance = np.einsum("tki,tkj->tij", noise, noise) / samples
    inverse = np.linalg.inv(covariance + loading * np.eye(15))
    weight = inverse[:, 0, :]
    variance = np.sum(weight**2, axis=1) / weight[:, 0] ** 2
    found = float(deviation_factor(np.array(float(looks)), make_beams(), loading))
    assert found == pytest.approx(np.sqrt(np.mean(variance)), rel=0.025 if loading < 1 else 0.01)


def test_factor_is_1_for_one_look_and_for_much_loading() -> None:
    beams = make_beams()
    np.testing.assert_allclose(deviation_factor(np.array([1.0, 1.0]), beams, 0.1), 1)
    np.testing.assert_allclose(deviation_factor(np.array([4.0, 64.0]), beams, 1e4), 1, atol=1e-4)


def displacement(found: np.ndarray) -> float:
    """Median distance in beamwidths from the stronger scatterer, at 0."""
    return float(np.median(np.abs(found)))


def test_second_scatterer_displaces_capon_and_order_2_less_than_maximum_likelihood() -> None:
    """Half a beamwidth away, 3 dB weaker, 16 looks at 20 dB. One SE of each median is 0.003 or less."""
    beams, rng = make_beams("sinc"), np.random.default_rng(63)
    slc = target_slc(beams, 0.0, 2000, 16, 100.0, rng)
    slc += np.sqrt(0.5) * (target_slc(beams, 0.5, 2000, 16, 100.0, rng) - circular(rng, slc.shape))
    likely = ml_elevation(multilook(slc, 1, 16), beams, MlSettings(layover=False))
    assert displacement(offsets_of(likely)) == pytest.approx(0.135, abs=0.012)
    assert displacement(offsets_of(estimate("music", slc, beams))) == pytest.approx(0.137, abs=0.012)
    assert displacement(offsets_of(estimate("capon", slc, beams))) == pytest.approx(0.044, abs=0.012)
    assert displacement(offsets_of(estimate("music of order 2", slc, beams))) == pytest.approx(0.022, abs=0.012)


@BOTH
def test_detectors_far_apart_are_ambiguous_in_their_sidelobes(name: str) -> None:
    beams = replace(make_beams("sinc", 4), boresights=elevation_at(2.5 * (np.arange(4) - 1.5)))
    result = estimate(name, target_slc(beams, 0.625, 2000, 4, 30.0, np.random.default_rng(64)), beams)
    validity = result.validity[:, 0]
    assert np.mean(validity == Validity.OK) < 0.02
    assert np.mean(validity == Validity.AMBIGUOUS) > 0.8


@BOTH
def test_layover_has_no_heights_far_from_both_surfaces(name: str) -> None:
    """Half a beamwidth apart, where a single peak lies between them: before the tests of likelihood, 1 % of 4 looks."""
    beams, rng, pixels, looks = make_beams(), np.random.default_rng(6), 4000, 4
    ends = np.array([-0.25, 0.25])
    response = beams.response(elevation_at(ends), 0.0)
    waves = np.sqrt(50.0) * rng.standard_normal((pixels, looks, 2, 2)).view(np.complex128)[..., 0]
    slc = np.einsum("pks,sm->mpk", waves, response)
    slc = slc + np.sqrt(0.5) * rng.standard_normal((*slc.shape, 2)).view(np.complex128)[..., 0]
    result = estimate(name, slc, beams)
    off = np.abs(offsets_of(result)[:, None] - ends).min(axis=1) * BEAMWIDTH
    published = np.isin(result.validity, (Validity.OK, Validity.EXTENDED))[:, 0]
    beyond = np.mean(off[published] > 5 * result.sigma[published, 0])
    assert published.sum() > 200
    assert beyond < 0.002 + 4 * np.sqrt(0.002 / published.sum())


@BOTH
def test_noise_alone_and_missing_samples_are_not_valid(name: str) -> None:
    """One pixel in 10 000 passes for a signal in one of 16 independent directions; none of these 2000 does."""
    slc = circular(np.random.default_rng(65), (16, 2000, 4))
    slc[3, 7, 2] = np.nan
    validity = estimate(name, slc, make_beams("jinc")).validity[:, 0]
    assert validity[7] == Validity.MISSING_DATA
    assert np.all(np.delete(validity, 7) == Validity.NO_SIGNAL)


@BOTH
@pytest.mark.parametrize("count", [2, 5])
def test_complex_beams_and_pairs_are_estimated(name: str, count: int) -> None:
    """The beams' phases turn with elevation; a pair is searched between its ends."""
    beams = make_beams("gaussian", count)
    for some in (beams, replace(beams, patterns=(phased(beams.patterns[0], tilt=0.5),))):
        result = estimate(name, target_slc(some, 0.1, 1000, 16, 30.0, np.random.default_rng(66)), some)
        valid = result.validity[:, 0] == Validity.OK
        normal = ((offsets_of(result) - 0.1) * BEAMWIDTH / result.sigma[:, 0])[valid]
        assert np.mean(valid) > 0.9
        assert np.sqrt(np.mean(normal**2)) == pytest.approx(1, abs=3.5 * standard_error_of_rms(normal) + 0.06)


def test_order_without_a_noise_subspace_is_refused() -> None:
    beams = make_beams()
    with refused(UserError, "order of MUSIC is 16", "16 detectors"):
        music_elevation(noise_free_looks(beams, np.zeros(1)), beams, MusicSettings(order=16))
