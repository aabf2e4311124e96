"""Array maximum likelihood: exact without noise, at its bound with it, and honest about pixels it cannot use."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

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
    whitening,
)

from sal_height.beams.array import Beams
from sal_height.beams.pattern import PATTERNS
from sal_height.elevation.array import search as peak_search
from sal_height.elevation.array.bounds import stochastic_crb
from sal_height.elevation.array.estimate import ElevationEstimate, Validity, detection_limit
from sal_height.elevation.array.likelihood import OBJECTIVES, highest_peaks, highest_peaks_of, peak_elevation
from sal_height.elevation.estimators.maximum_likelihood import MlSettings, ml_elevation
from sal_height.elevation.looks.looks import Looks, live_detectors
from sal_height.elevation.monopulse.pairs import MonopulseSettings, monopulse_elevation
from sal_height.errors import UserError

PATTERN_NAMES = pytest.mark.parametrize("pattern", sorted(PATTERNS))


def estimate(looks: Looks, beams: Beams, **settings: Any) -> ElevationEstimate:
    """By default at 5 dB and above."""
    return ml_elevation(looks, beams, MlSettings(layover=False, **settings))


def offsets_of(result: ElevationEstimate) -> np.ndarray:
    return offset_of(result.elevation[:, 0])


@PATTERN_NAMES
@pytest.mark.parametrize("squint", [0.0, 0.4 * BEAMWIDTH, 0.9 * BEAMWIDTH])
def test_elevation_is_exact_without_noise(pattern: str, squint: float) -> None:
    beams, offsets = make_beams(pattern), np.linspace(-3.745, 3.745, 200)
    result = estimate(noise_free_looks(beams, offsets, squint), beams)
    np.testing.assert_allclose(offsets_of(result), offsets, atol=1e-5)
    assert np.all(result.validity == Validity.OK)
    np.testing.assert_allclose(result.cnr[:, 0], 1e6, rtol=1e-4)  # less one look's noise over the beams' power


def test_every_column_has_its_own_squint() -> None:
    beams, offsets, squints = make_beams("jinc"), np.linspace(-3.7, 3.7, 20), np.array([-0.9, 0.0, 0.3]) * BEAMWIDTH
    covariance = np.concatenate([noise_free_looks(beams, offsets, s).covariance for s in squints], axis=1)
    result = estimate(Looks.of(covariance, 1, squints), beams)
    np.testing.assert_allclose(offset_of(result.elevation), np.repeat(offsets[:, None], 3, axis=1), atol=1e-5)


def test_second_peaks_are_found_where_a_signal_can_be_detected() -> None:
    """In noise alone the highest peak is the same without a search for others."""
    beams, settings, shape = make_beams("jinc"), MlSettings(), (200, 10, 4)
    rng, power = np.random.default_rng(7), np.linspace(0, 30, 10)[:, None]
    noise, signal = (rng.standard_normal((2, *shape, n)).T.dot([1, 1j]).T for n in (beams.count, 1))
    samples = noise + np.sqrt(power)[..., None] * signal * beams.response(elevation_at(0.6), 0.0)
    looks = Looks.of(np.einsum("rckm,rckn->rcmn", samples, samples.conj()).real.astype(np.float32), 4, 0.0, 2.0)
    one = highest_peaks(looks, beams, settings)
    every = highest_peaks_of(OBJECTIVES["normalised"], looks, beams, settings)
    detected = every.explained >= detection_limit(looks, beams.count, settings)
    np.testing.assert_array_equal(one.elevation, every.elevation)
    np.testing.assert_array_equal(one.lead[detected], every.lead[detected])
    assert np.any(one.lead[~detected] > every.lead[~detected])
    assert np.any(one.lead[detected] < one.explained[detected])


@pytest.mark.parametrize(
    ("pattern", "offset", "bias", "precision"),
    [
        ("sinc", 1.75, -0.002, 1e-3),
        ("sinc", 3.0, 0.004, 6e-4),
        ("sinc", 3.5, -0.067, 6e-4),
        ("sinc", 3.75, -0.166, 6e-4),
        ("sinc", 4.0, -0.279, 6e-4),
        ("jinc", 3.25, -0.041, 6e-4),
        ("jinc", 3.75, -0.239, 6e-4),
        ("jinc", 4.0, -0.373, 6e-4),
    ],
)
def test_numerator_alone_is_biased_inwards_at_the_ends(
    pattern: str, offset: float, bias: float, precision: float
) -> None:
    """And for ever: the covariance here is the limit of infinite CNR. The normalised objective has no bias."""
    beams, ends = make_beams(pattern), np.array([offset, -offset])
    looks = noise_free_looks(beams, ends)
    error = offsets_of(estimate(looks, beams, objective="numerator")) - ends
    np.testing.assert_allclose(error, [bias, -bias], atol=precision)
    np.testing.assert_allclose(offsets_of(estimate(looks, beams)), ends, atol=1e-5)


def dense_peaks(covariance: np.ndarray, beams: Beams, objective: str, half: float) -> tuple[np.ndarray, np.ndarray]:
    """Offsets of the highest peaks within `half` beamwidths by search in steps of 0.004 and a parabola, in float64.

    Also where it is clear: the second peak is lower by 0.1 % or more.
    """
    step = 4e-3
    fine = np.arange(-half, half + step / 2, step)
    response = beams.response(elevation_at(fine), 0.0)
    forms = (response.conj()[:, :, None] * response[:, None, :]).reshape(len(fine), -1)
    value = (covariance.reshape(len(covariance), -1).astype(forms.dtype) @ forms.T).real
    if objective == "normalised":
        value /= np.sum(np.abs(response) ** 2, axis=1)
    pixel, top = np.arange(len(value)), value.argmax(axis=1)
    low, middle, high = (value[pixel, np.clip(top + shift, 0, len(fine) - 1)] for shift in (-1, 0, 1))
    inside = (top > 0) & (top < len(fine) - 1)
    vertex = (low - high) / (2 * np.where(inside, low - 2 * middle + high, 1))
    padded = np.pad(value, ((0, 0), (1, 1)), constant_values=-1)
    heights = np.where((value >= padded[:, :-2]) & (value > padded[:, 2:]), value, 0)
    second = np.partition(heights, -2, axis=1)[:, -2]
    return fine[top] + step * np.where(inside, vertex, 0), second < 0.999 * middle


@pytest.mark.parametrize("objective", sorted(OBJECTIVES))
@pytest.mark.parametrize("pattern", ["sinc", "jinc"])
@pytest.mark.parametrize("looks", few(1, [1, 16, 4]))
def test_estimate_is_the_highest_point_of_the_objective(pattern: str, looks: int, objective: str) -> None:
    """At 0 to 20 dB, in the array and its guard. One peak in a thousand is not clear.

    The parabola of the dense search is good to 3e-5, and to 4e-6 in the rms; a flat peak at 0 dB has fewer digits in
    float32.
    """
    beams, rng = make_beams(pattern), np.random.default_rng(12)
    slc = np.concatenate(
        [target_slc(beams, rng.uniform(-3.75, 3.75), 250, looks, 10**level, rng) for level in (0, 0.5, 1, 2)], axis=1
    )
    seen = multilook(slc, 1, looks)
    expected, clear = dense_peaks(seen.covariance[:, :][:, 0], beams, objective, 7.0)
    found = peak_elevation(seen, beams, OBJECTIVES[objective], 3 * BEAMWIDTH)
    error = (offset_of(found[:, 0]) - expected)[clear]
    assert np.mean(clear) > 0.99
    assert np.max(np.abs(error)) < 1e-3
    assert np.sqrt(np.mean(error**2)) < 5e-5


def test_blocks_and_threads_and_columns_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every pixel by itself gives what it gives among all others."""
    beams = make_beams("jinc")
    slc = target_slc(beams, 0.6, 12, 20, 3.0, np.random.default_rng(12))
    looks = multilook(slc, 1, 4, squint=0.2 * BEAMWIDTH)
    whole = peak_elevation(looks, beams, OBJECTIVES["normalised"], 0.0)
    monkeypatch.setattr(peak_search, "PIXELS_AT_ONCE", 7)
    monkeypatch.setattr(peak_search, "PIXELS_OF_THREAD", 3)
    blocks = peak_elevation(looks, beams, OBJECTIVES["normalised"], 0.0)
    np.testing.assert_array_equal(blocks, whole)
    looks = replace(looks, squint=np.array([0.2, 0.3, 0.2, 0.1, 0.2]) * BEAMWIDTH)
    columns = peak_elevation(looks, beams, OBJECTIVES["normalised"], 0.0)
    np.testing.assert_array_equal(columns[:, [0, 2, 4]], whole[:, [0, 2, 4]])


@pytest.mark.parametrize("pattern", ["sinc", "jinc"])
def test_many_squints_are_as_good_as_one(pattern: str) -> None:
    """Of 40 columns the beams are interpolated between a few squints."""
    beams, squints = make_beams(pattern), np.linspace(-0.4, 0.6, 40) * BEAMWIDTH
    offsets = np.linspace(-3.7, 3.7, 40)
    covariance = np.stack(
        [noise_free_looks(beams, offsets[i : i + 1], squint).covariance[0] for i, squint in enumerate(squints)], axis=1
    )
    elevation = peak_elevation(Looks.of(covariance, 1, squints), beams, OBJECTIVES["normalised"], 0.0)
    np.testing.assert_allclose(offset_of(elevation[0]), offsets, atol=1e-5)


def complex_beams() -> Beams:
    """Five detectors with complex patterns, each with its own phase."""
    jinc = PATTERNS["jinc"]
    return replace(make_beams(count=5), patterns=tuple(phased(jinc, tilt=rate) for rate in (0.5, -1.0, 0.2, 0.0, 1.5)))


def test_complex_beams_are_estimated_from_the_complex_covariance() -> None:
    beams, rng = complex_beams(), np.random.default_rng(33)
    assert beams.is_complex
    assert not make_beams().is_complex
    offsets = np.linspace(-1, 1, 41)
    response = beams.response(elevation_at(offsets), 0.0)
    covariance = (response[:, :, None] * response[:, None, :].conj())[:, None]
    found = peak_elevation(Looks.of(covariance, 1), beams, OBJECTIVES["normalised"], 0.0)
    np.testing.assert_allclose(offset_of(found[:, 0]), offsets, atol=1e-5)

    looks = multilook(target_slc(beams, 0.3, 400, 4, 5.0, rng), 1, 4, hermitian=True)
    expected, clear = dense_peaks(looks.covariance[:, :][:, 0], beams, "normalised", 2.0)
    found = peak_elevation(looks, beams, OBJECTIVES["normalised"], 0.75 * BEAMWIDTH)
    np.testing.assert_allclose(offset_of(found[clear, 0]), expected[clear], atol=1e-4)
    assert np.mean(clear) > 0.99


def test_real_covariance_of_complex_beams_is_refused() -> None:
    looks = multilook(target_slc(complex_beams(), 0.3, 3, 4, 5.0, np.random.default_rng(33)), 1, 4)
    with refused(UserError, "complex beams", "must be complex"):
        estimate(looks, complex_beams())


def test_sigma_of_complex_beams_predicts_the_spread() -> None:
    beams, trials = complex_beams(), 4000
    slc = target_slc(beams, 0.3, trials, 16, 30.0, np.random.default_rng(34))
    result = estimate(multilook(slc, 1, 16, hermitian=True), beams)
    normal = (offsets_of(result) - 0.3) * BEAMWIDTH / result.sigma[:, 0]
    assert np.sqrt(np.mean(normal**2)) == pytest.approx(1, abs=3.5 * standard_error_of_rms(normal) + 0.02)
    assert np.mean(result.cnr) == pytest.approx(30, rel=3.5 / np.sqrt(trials * 16) + 0.005)
    assert np.mean(result.validity == Validity.OK) > 0.99


def test_rotation_and_aspects_and_own_patterns_of_detectors_come_through() -> None:
    beams = replace(make_beams(count=5), patterns=tuple(PATTERNS[name] for name in ("jinc", "sinc") * 2 + ("jinc",)))
    beams = replace(beams, rotation=0.26).averaged(np.array([-0.3, 0.0, 0.4]) * BEAMWIDTH, np.array([1.0, 2.0, 1.5]))
    offsets, squint = np.linspace(-1, 1, 41), 0.3 * BEAMWIDTH
    result = estimate(noise_free_looks(beams, offsets, squint), beams)
    np.testing.assert_allclose(offsets_of(result), offsets, atol=1e-5)


@pytest.mark.parametrize("beamwidth", [1.55e-4, 3e-5])
def test_narrow_beams_at_45_degrees_lose_no_digits(beamwidth: float) -> None:
    wide = make_beams("jinc")
    boresights = np.pi / 4 + (wide.boresights - np.pi / 4) / BEAMWIDTH * beamwidth
    beams, offsets = replace(wide, boresights=boresights, beamwidth=beamwidth), np.linspace(-3.7, 3.7, 101)
    response = beams.response(np.pi / 4 + offsets * beamwidth, 0.0)
    covariance = (response[:, :, None] * response[:, None, :])[:, None]
    found = peak_elevation(Looks.of(covariance, 1), beams, OBJECTIVES["normalised"], 0.0)
    np.testing.assert_allclose((found[:, 0] - np.pi / 4) / beamwidth, offsets, atol=1e-5)


def test_climb_that_starts_on_the_peak_stays_there() -> None:
    """One detector with w = 1 - x^2 / 144 from step to step of the table: the slope at the start is 0 exactly."""
    steps = np.arange(-peak_search.TABLE_STEPS, peak_search.TABLE_STEPS + 1.0)
    nodes, response, slope = np.pi / 4 + 1e-5 * steps, 1 - steps[:, None] ** 2 / 144, -steps[:, None] / 72e-5
    tables = peak_search.SearchTables.of(nodes, response[None], slope[None], OBJECTIVES["numerator"])
    search = peak_search.PeakSearch(tables, np.zeros(1, np.intp))
    assert (search.peaks(np.ones((1, 1, 1))).elevation[0] - np.pi / 4) / 1e-5 == pytest.approx(0, abs=1e-6)


def test_search_ends_where_a_pattern_is_no_longer_known() -> None:
    """Patterns known 5 beamwidths to each side leave 1.25 around the middle of 16 detectors."""
    beams = replace(make_beams(), patterns=(replace(PATTERNS["sinc"], domain=(-5.0, 5.0)),))
    offsets = np.array([-2.0, -1.2, 0.3, 1.2, 2.0])
    found = peak_elevation(noise_free_looks(make_beams(), offsets), beams, OBJECTIVES["normalised"], 3 * BEAMWIDTH)
    np.testing.assert_allclose(offset_of(found[1:4, 0]), offsets[1:4], atol=1e-5)
    assert np.max(np.abs(offset_of(found))) <= 1.25 + 1e-9


def test_pixel_without_any_power_has_an_elevation_in_the_domain() -> None:
    beams = make_beams()
    found = peak_elevation(Looks.of(np.zeros((1, 1, 16, 16)), 1), beams, OBJECTIVES["normalised"], 0.0)
    assert abs(offset_of(found[0, 0])) <= 4


def test_objective_that_flattens_out_does_not_carry_the_estimate_away() -> None:
    """Towards a target far outside two Gaussian beams it rises for ever, ever less: half a beamwidth is searched."""
    beams = make_beams("gaussian", count=2)
    offsets = offsets_of(estimate(noise_free_looks(beams, np.array([-6.0, 6.0])), beams))
    np.testing.assert_allclose(offsets, [-0.5, 0.5], atol=1e-9)


@pytest.mark.parametrize(
    ("looks", "cnr_db", "rms", "bound"),
    few(1, [(16, 10, 0.0244, 0.0234), (4, 20, 0.0170, 0.0145)]),
)
def test_error_of_a_fluctuating_target_is_as_published(looks: int, cnr_db: int, rms: float, bound: float) -> None:
    """SAL paper, figure 10, recomputed (physics, section 6): sinc, 16 channels, target at 1.75 beamwidths.

    Given the energy x of K looks, errors are normal with variance 1 / x; over speckle x has a gamma distribution.
    Hence the kurtosis 3 (K - 1) / (K - 2) of the error, and a SE of its rms of 0.8 % (16 looks) and 1.0 % (4 looks),
    with 1.1 times that for the published value's own. Outliers, when all looks fade, are no part of it.
    """
    beams, cnr, trials = make_beams("sinc"), 10 ** (cnr_db / 10), 8000
    slc = target_slc(beams, 1.75, trials, looks, cnr, np.random.default_rng(13))
    error = offsets_of(estimate(multilook(slc, 1, looks), beams)) - 1.75
    inlying = np.abs(error) < 0.5
    assert np.mean(inlying) > 0.999
    observed = np.sqrt(np.mean(error[inlying] ** 2))
    tolerance = 3.5 * 1.1 * np.sqrt((3 * (looks - 1) / (looks - 2) - 1) / (4 * trials))
    assert observed == pytest.approx(rms, rel=tolerance)
    assert abs(np.mean(error[inlying])) < 3.5 * rms / np.sqrt(trials)
    crb = stochastic_crb(beams, elevation_at(1.75), 0.0, cnr, looks) / BEAMWIDTH
    assert crb == pytest.approx(bound, abs=5e-5)
    assert observed == pytest.approx(crb * np.sqrt(looks / (looks - 1)), rel=tolerance)


@pytest.mark.parametrize(("looks", "cnr"), few(1, [(16, 10.0), (4, 100.0)]))
def test_sigma_predicts_the_spread(looks: int, cnr: float) -> None:
    """Each pixel's error over its own sigma has variance 1."""
    beams = make_beams("jinc")
    slc = target_slc(beams, 0.6, 6000, looks, cnr, np.random.default_rng(14))
    result = estimate(multilook(slc, 1, looks), beams)
    normal = (offsets_of(result) - 0.6) * BEAMWIDTH / result.sigma[:, 0]
    # SE of the rms 0.9 %; sigma takes the energy from the same samples, good to 1 / sqrt(2 K C |a|^2), 4 % at most.
    assert np.sqrt(np.mean(normal**2)) == pytest.approx(1, abs=3.5 * standard_error_of_rms(normal) + 0.02)
    assert np.mean(result.cnr) == pytest.approx(cnr, rel=3.5 / np.sqrt(6000 * looks) + 0.005)


LEVELS = [(0, 2), (0, 4), *((level, count) for level in (5, 10, 15, 20, 25) for count in (2, 4, 9, 16))]
FEW_LEVELS = [(0, 4), (5, 2), (10, 4), (25, 16)]


@pytest.mark.parametrize("pattern", ["sinc", "jinc"])
@pytest.mark.parametrize(
    ("cnr_db", "looks"), few(len(FEW_LEVELS), [*FEW_LEVELS, *(one for one in LEVELS if one not in FEW_LEVELS)])
)
def test_sigma_holds_as_many_errors_as_it_says(cnr_db: int, looks: int, pattern: str) -> None:
    """Of the valid pixels 68.3 % and 95.4 % lie within one and two sigma: to 3 points, or 5 for two looks.

    Targets anywhere in the inner array. One SE of the shares is 0.75 and 0.34 points for 3900 valid pixels, which is
    the number but at 5 dB (half of it) and at 0 dB, where noise must raise a pixel to the least CNR: 5 % of 40 000 are
    in 2 looks, 1.5 % in 4, and none to speak of in more. Two SE are added to the points.
    """
    beams, trials = make_beams(pattern), 40000 if cnr_db == 0 else 4000
    rng = np.random.default_rng([22, looks, cnr_db])
    offsets = rng.uniform(-3, 3, (trials, 1))
    result = estimate(multilook(target_slc(beams, offsets, trials, looks, 10 ** (cnr_db / 10), rng), 1, looks), beams)
    valid = result.validity == Validity.OK
    normal = ((offset_of(result.elevation) - offsets) * BEAMWIDTH / result.sigma)[valid]
    for sigmas, share in ((1, 0.6827), (2, 0.9545)):
        error = 2 * np.sqrt(share * (1 - share) / len(normal))
        assert np.mean(np.abs(normal) < sigmas) == pytest.approx(share, abs=(0.05 if looks == 2 else 0.03) + error)


def test_bound_is_infinite_without_energy() -> None:
    beams = make_beams()
    bound = stochastic_crb(beams, elevation_at(np.zeros(3)), 0.0, np.array([0.0, -1.0, 1.0]) / 4, 4)
    np.testing.assert_array_equal(np.isinf(bound), [True, True, False])


def test_two_channels_give_the_total_least_squares_of_monopulse() -> None:
    """Gaussian beams: with any others a second direction, in the sidelobes, has the same discriminant."""
    beams = make_beams("gaussian", count=2)
    looks = multilook(target_slc(beams, 0.1, 500, 4, 30.0, np.random.default_rng(15)), 1, 4)
    monopulse = monopulse_elevation(looks, beams, MonopulseSettings())
    inside = np.isfinite(monopulse.elevation)
    assert np.mean(inside) > 0.9
    result = estimate(looks, beams)
    np.testing.assert_allclose(offset_of(result.elevation[inside]), offset_of(monopulse.elevation[inside]), atol=1e-4)


def validity_counts(beams: Beams, slc: np.ndarray) -> np.ndarray:
    """Share of the pixels (one row each) with every `Validity`."""
    result = estimate(multilook(slc, 1, slc.shape[2]), beams)
    return np.bincount(result.validity.ravel(), minlength=len(Validity)) / result.validity.size


@PATTERN_NAMES
def test_target_in_the_array_is_ok(pattern: str) -> None:
    beams = make_beams(pattern)
    shares = validity_counts(beams, target_slc(beams, 1.2, 500, 4, 100.0, np.random.default_rng(16)))
    assert shares[Validity.OK] > 0.99


@pytest.mark.parametrize("offset", [4.75, -4.75])
def test_target_a_beamwidth_beyond_the_array_is_outside(offset: float) -> None:
    beams = make_beams("jinc")
    shares = validity_counts(beams, target_slc(beams, offset, 500, 16, 100.0, np.random.default_rng(17)))
    assert shares[Validity.OUTSIDE_ARRAY] > 0.99
    assert shares[Validity.OK] == 0


@pytest.mark.parametrize(("min_cnr", "expected"), [(19.0, Validity.OK), (21.0, Validity.LOW_CNR)])
def test_least_cnr_is_asked_of_every_look(min_cnr: float, expected: Validity) -> None:
    """A target of CNR 20 in four looks."""
    beams = make_beams("jinc")
    exact = noise_free_looks(beams, np.array([0.6]), count=4, energy=4 * 20.0)
    noisy = Looks.of(exact.covariance + 4 * np.eye(16), 4)
    result = estimate(noisy, beams, min_cnr_db=10 * math.log10(min_cnr))
    assert result.cnr[0, 0] == pytest.approx(20.0, rel=1e-6)
    assert result.validity[0, 0] == expected


@pytest.mark.parametrize("looks", [1, 4, 16])
def test_noise_alone_has_low_cnr(looks: int) -> None:
    """Even if no CNR is asked for, and wherever it peaks: beyond the array, little power makes a great CNR."""
    beams = make_beams("jinc")
    noise = target_slc(beams, 0.0, 3000, looks, 0.0, np.random.default_rng(18))
    result = estimate(multilook(noise, 1, looks), beams, min_cnr_db=-60.0)
    missed = np.count_nonzero(result.validity != Validity.NO_SIGNAL)
    # One in 10 000 passes for a signal if the objective has 16 independent directions; searched are about 30.
    assert missed <= 3


def test_two_scatterers_two_beamwidths_apart_are_not_one() -> None:
    beams, rng = make_beams("jinc"), np.random.default_rng(19)
    slc = target_slc(beams, -1.0, 500, 16, 100.0, rng) + target_slc(beams, 1.0, 500, 16, 100.0, rng)
    assert validity_counts(beams, slc)[Validity.NOT_ONE_SCATTERER] > 0.99


@pytest.mark.parametrize(
    ("share", "expected"), [(0.02, Validity.OK), (0.04, Validity.NOT_ONE_SCATTERER)], ids=["2 %", "4 %"]
)
def test_rest_counts_as_another_scatterer_from_3_percent_of_the_power_on(share: float, expected: Validity) -> None:
    """Beside the noise: 240 times its power is the mean of what 16 looks leave in 15 channels, with a spread of 15."""
    beams, looks, energy = make_beams("sinc"), 16, 5000.0
    a = beams.response(elevation_at(0.6), 0.0)
    b = beams.response(elevation_at(3.0), 0.0)
    b -= a * (a @ b) / (a @ a)
    covariance = energy * (np.outer(a, a) / (a @ a) + share * np.outer(b, b) / (b @ b)) + looks * np.eye(16)
    result = estimate(Looks.of(covariance[None, None], looks), beams)
    assert offsets_of(result)[0] == pytest.approx(0.6, abs=0.01)
    assert result.validity[0, 0] == expected


def test_missing_sample_is_missing_data_and_spares_the_neighbours() -> None:
    beams = make_beams("jinc")
    slc = target_slc(beams, 0.5, 20, 4, 1000.0, np.random.default_rng(20))
    slc[3, 7, 2] = np.nan
    validity = estimate(multilook(slc, 1, 4), beams).validity[:, 0]
    assert validity[7] == Validity.MISSING_DATA
    assert np.all(np.delete(validity, 7) == Validity.OK)


UNEQUAL = np.array([1.0, 100.0, 0.2, 5.0] * 4)
"""Noise powers of 16 detectors."""


def whitened_looks(slc: np.ndarray, noise_powers: np.ndarray, looks: int, beams: Beams) -> tuple[Looks, Beams]:
    """Looks (along columns) and beams of channels whose noise is made equal."""
    power, transform = whitening(np.diag(noise_powers), np.eye(len(noise_powers)))
    return multilook(slc, 1, looks, transform=transform, noise_power=power), beams.combined(transform)


def test_unequal_noise_is_estimated_at_its_bound() -> None:
    """The bound of the whitened array, a sixth of that for the mean of the noise powers. Outliers are left out."""
    beams, cnr, looks, trials = make_beams("sinc"), 100.0, 16, 4000
    rng = np.random.default_rng(23)
    noise = np.sqrt(UNEQUAL)[:, None, None] * circular(rng, (16, trials, looks))
    target = beams.response(elevation_at(0.6), 0.0)[:, None, None] * circular(rng, (trials, looks))
    seen, white = whitened_looks(np.sqrt(cnr) * target + noise, UNEQUAL, looks, beams)
    result = estimate(seen, white)
    error = offsets_of(result) - 0.6
    normal = error * BEAMWIDTH / result.sigma[:, 0]
    # Fisher's information with a noise power of its own for each detector, by hand.
    a, slope = (f(elevation_at(0.6), 0.0) / np.sqrt(UNEQUAL) for f in (beams.response, beams.slope))
    information = slope @ slope - (a @ slope) ** 2 / (a @ a)
    bound = 1 / np.sqrt(2 * (looks - 1) * cnr * information) / BEAMWIDTH
    assert np.sqrt(np.mean(error**2)) == pytest.approx(bound, rel=3.5 * standard_error_of_rms(error / bound) + 0.02)
    assert np.sqrt(np.mean(normal**2)) == pytest.approx(1, abs=3.5 * standard_error_of_rms(normal) + 0.02)
    assert np.mean(result.validity == Validity.OK) > 0.99
    assert np.mean(result.cnr) == pytest.approx(cnr / seen.noise_power, rel=3.5 / np.sqrt(trials * looks) + 0.005)


def test_dead_detectors_are_left_out() -> None:
    """Of 16, the first and two in the middle are silent: the others find the target as if alone."""
    beams, rng = make_beams("jinc"), np.random.default_rng(24)
    slc = target_slc(beams, 0.6, 500, 16, 100.0, rng).astype(np.complex64)
    slc[[0, 7]] = 0
    slc[9] = np.nan
    live = live_detectors(slc)
    assert live.tolist() == [m for m in range(16) if m not in (0, 7, 9)]
    result = estimate(multilook(slc[live], 1, 16), beams.detectors(live))
    normal = (offsets_of(result) - 0.6) * BEAMWIDTH / result.sigma[:, 0]
    assert np.sqrt(np.mean(normal**2)) == pytest.approx(1, abs=3.5 * standard_error_of_rms(normal) + 0.02)
    assert np.mean(result.validity == Validity.OK) > 0.99


@pytest.mark.parametrize(("difference", "expected"), [(4.2, Validity.AMBIGUOUS), (5.0, Validity.OK)])
def test_another_peak_nearly_as_likely_is_ambiguous(difference: float, expected: Validity) -> None:
    """Likelihoods differ by exp of the difference of the powers over that of the noise: ln 100 is 4.6."""
    beams, looks = make_beams("sinc"), 4
    a, b = (beams.response(elevation_at(offset), 0.0) for offset in (-1.5, 1.5))
    units = [a / np.linalg.norm(a), b / np.linalg.norm(b)]
    assert abs(units[0] @ units[1]) < 0.03
    energies = (34.0, 34.0 - difference)
    covariance = sum(energy * np.outer(unit, unit) for energy, unit in zip(energies, units, strict=True))
    result = estimate(Looks.of(covariance[None, None] + looks * np.eye(16), looks), beams)
    assert offsets_of(result)[0] == pytest.approx(-1.5, abs=0.01)
    assert result.validity[0, 0] == expected


def test_detectors_far_apart_are_ambiguous_in_their_sidelobes() -> None:
    """2.5 beamwidths apart, they see this target as they see others: a third of the highest peaks are those."""
    beams = replace(make_beams("sinc", 4), boresights=elevation_at(2.5 * (np.arange(4) - 1.5)))
    result = estimate(multilook(target_slc(beams, 0.625, 2000, 4, 30.0, np.random.default_rng(40)), 1, 4), beams)
    valid, ambiguous = (result.validity[:, 0] == reason for reason in (Validity.OK, Validity.AMBIGUOUS))
    assert np.mean(valid) < 0.01
    assert np.mean(ambiguous) > 0.8
    wrong = np.abs(offsets_of(result) - 0.625) > 0.5
    assert np.mean(wrong[ambiguous]) == pytest.approx(0.35, abs=0.05)


def test_sigma_of_the_numerator_contains_its_bias() -> None:
    """At the end of the array it is off by 0.17 beamwidths, however little noise there is."""
    beams, offset = make_beams("sinc"), 3.75
    looks = noise_free_looks(beams, np.array([offset, -offset, 0.0]))
    found, exact = estimate(looks, beams, objective="numerator"), estimate(looks, beams)
    assert np.all(offset - np.abs(offsets_of(found)[:2]) > 0.15)
    off = np.abs(found.elevation - exact.elevation)
    np.testing.assert_allclose(found.sigma, np.hypot(off, exact.sigma))
    assert np.all(off.ravel()[:2] > 100 * exact.sigma.ravel()[:2])
    assert off.ravel()[2] < exact.sigma.ravel()[2]


def test_the_numerator_has_no_height_in_layover() -> None:
    """Of two strong scatterers a beamwidth and a half apart; one that stands alone beside them stays."""
    beams, rng, looks = make_beams("sinc"), np.random.default_rng(11), 16
    offsets, power = np.array([[-0.75, 0.75], [0.5, 0.5]]), 100.0
    response = beams.response(elevation_at(offsets), 0.0)  # (pixels, scatterers, detectors)
    waves = np.sqrt(power / 2) * rng.standard_normal((2, looks, 2, 2)).view(np.complex128)[..., 0]
    samples = np.einsum("pks,psm->mpk", waves, response)
    samples = samples + np.sqrt(0.5) * rng.standard_normal((*samples.shape, 2)).view(np.complex128)[..., 0]
    found = [
        ml_elevation(multilook(samples, 1, looks), beams, MlSettings(objective=objective))
        for objective in ("normalised", "numerator")
    ]
    assert found[0].validity.ravel().tolist() == [Validity.TWO_SCATTERERS, Validity.OK]
    assert found[1].validity.ravel().tolist() == [Validity.NOT_ONE_SCATTERER, Validity.OK]
    assert len(found[1].scatterers) == 1
