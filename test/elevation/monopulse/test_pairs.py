"""Monopulse: the statistics of the discriminant in closed form, its inversion, and the choice of the pair."""

from __future__ import annotations

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
    standard_error_of_rms,
    target_slc,
    whitening,
)
from scipy import stats
from scipy.integrate import quad

from sal_height.beams.apertures import GAUSSIAN_WIDTH
from sal_height.beams.array import Beams
from sal_height.beams.pattern import PATTERNS
from sal_height.elevation.array.bounds import stochastic_crb
from sal_height.elevation.array.estimate import ElevationEstimate, Validity
from sal_height.elevation.looks.looks import Looks
from sal_height.elevation.monopulse.estimators import (
    DISCRIMINANTS,
    Products,
    noise_subtraction,
    products,
    ratio,
    total_least_squares,
)
from sal_height.elevation.monopulse.pairs import MonopulseSettings, monopulse_elevation, strongest_pairs

PATTERN_NAMES = pytest.mark.parametrize("pattern", sorted(PATTERNS))


def estimate(looks: Looks, beams: Beams, discriminant: str = "tls") -> ElevationEstimate:
    return monopulse_elevation(looks, beams, MonopulseSettings(discriminant=discriminant))


def powers(kappa: float, cnr: float, looks: int, trials: int, seed: int, steady: bool = False) -> Products:
    """Products of Sigma and Delta = kappa Sigma, both in unit noise."""
    rng = np.random.default_rng(seed)
    signal = np.sqrt(cnr) * (1.0 if steady else circular(rng, (trials, looks)))
    total = signal + circular(rng, (trials, looks))
    difference = kappa * signal + circular(rng, (trials, looks))
    return products(total, difference)


@pytest.mark.parametrize("looks", few(2, [1, 4, 2, 3]))
@pytest.mark.parametrize(("kappa", "cnr_db"), few(1, [(0.75, 5), (-0.5, 0), (0.3, 15)]))
def test_ratio_of_a_fluctuating_target_is_student_distributed(looks: int, kappa: float, cnr_db: int) -> None:
    """Around kappa C / (C + 1), however many looks, with sqrt((C + 1 + kappa^2 C) / (2 K)) / (C + 1) T_2K.

    Kolmogorov and Smirnov see 1.95 / sqrt(trials) = 1.2 % of probability. That holds for one look too, where no
    variance exists.
    """
    trials, cnr = 25_000, 10 ** (cnr_db / 10)
    estimates = ratio(powers(kappa, cnr, looks, trials, seed=21), 1.0)
    middle, scale = kappa * cnr / (cnr + 1), np.sqrt(cnr + 1 + kappa**2 * cnr) / (cnr + 1) / np.sqrt(2 * looks)
    assert stats.kstest((estimates - middle) / scale, "t", args=(2 * looks,)).pvalue > 0.001


@pytest.mark.parametrize("looks", few(1, [3, 4]))
def test_ratio_has_the_bias_and_spread_of_the_closed_form(looks: int) -> None:
    kappa, cnr, trials = 0.5, 10.0, 100_000
    estimates = ratio(powers(kappa, cnr, looks, trials, seed=22), 1.0)
    spread = np.sqrt((cnr + 1 + kappa**2 * cnr) / (2 * (looks - 1) * (cnr + 1) ** 2))
    assert np.mean(estimates) == pytest.approx(kappa * cnr / (cnr + 1), abs=3.5 * spread / np.sqrt(trials))
    kurtosis = stats.t.stats(2 * looks, moments="k") + 3
    assert np.std(estimates) == pytest.approx(spread, rel=3.5 * np.sqrt((kurtosis - 1) / (4 * trials)))  # 1 %
    # 0.1364 at K = 4 and 10 dB, where the leading term would be 0.1250
    if looks == 4:
        assert spread == pytest.approx(0.1364, abs=5e-5)


@pytest.mark.parametrize(("looks", "mean"), few(2, [(1, 0.7183), (16, 0.5764), (2, 0.6316), (4, 0.5980)]))
def test_more_looks_make_the_bias_of_a_steady_target_worse(looks: int, mean: float) -> None:
    """E = kappa K C integral_0^1 t^(K-1) exp(K C (t - 1)) dt, for kappa 0.75 and 5 dB."""
    cnr, trials = 10**0.5, 40_000
    integral = quad(lambda t: t ** (looks - 1) * np.exp(looks * cnr * (t - 1)), 0, 1)[0]
    assert 0.75 * looks * cnr * integral == pytest.approx(mean, abs=6e-5)
    estimates = ratio(powers(0.75, cnr, looks, trials, seed=23, steady=True), 1.0)
    assert np.mean(estimates) == pytest.approx(mean, abs=3.5 * np.std(estimates) / np.sqrt(trials))


def test_total_least_squares_removes_the_bias() -> None:
    """kappa 0.75, 5 dB, K = 4: its median is 0.7472 where the ratio's mean is 0.5701; its mean does not exist."""
    trials = 100_000
    sums = powers(0.75, 10**0.5, 4, trials, seed=24)
    estimates = total_least_squares(sums, 1.0)
    low, middle, high = np.percentile(estimates, [16, 50, 84])
    assert (high - low) / 2 == pytest.approx(0.305, abs=0.01)
    density = 1 / (np.sqrt(2 * np.pi) * 0.305)  # of a normal distribution of that width, at its middle
    assert middle == pytest.approx(0.7472, abs=3.5 / (2 * density * np.sqrt(trials)))  # 0.0042
    biased = ratio(sums, 1.0)
    assert np.mean(biased) == pytest.approx(0.5701, abs=3.5 * np.std(biased) / np.sqrt(trials) + 5e-5)


@pytest.mark.parametrize("cnr_db", few(1, [0, 5, 10, 20]))
def test_noise_subtraction_removes_the_bias(cnr_db: int) -> None:
    """Of a fluctuating target; with K looks (C + 1) / (C^2 K) of kappa is left, 5e-4 at 0 dB with 4096."""
    kappa, cnr, looks, trials = 0.75, 10 ** (cnr_db / 10), 4096, 300
    sums = powers(kappa, cnr, looks, trials, seed=28)
    estimates = noise_subtraction(sums, 1.0)
    standard_error = np.std(estimates) / np.sqrt(trials)  # 0.0016 at 0 dB, where the bias of the ratio is 0.375
    left = kappa * (cnr + 1) / (cnr**2 * looks)
    assert np.mean(estimates) == pytest.approx(kappa + left, abs=3.5 * standard_error)
    assert standard_error < 0.1 * kappa / (cnr + 1)
    biased = ratio(sums, 1.0)
    expected = kappa * cnr / (cnr + 1)
    assert np.mean(biased) == pytest.approx(expected, abs=3.5 * np.std(biased) / np.sqrt(trials))


def test_noise_subtraction_has_no_value_without_power_above_the_noise() -> None:
    """Neither one of the wrong sign nor infinity."""
    sums = Products(np.array([3.0, 4.0, 5.0]), np.ones(3), np.array([0.5, 0.5, 0.5 + 1j]), 4)
    estimates = noise_subtraction(sums, 1.0)
    np.testing.assert_array_equal(estimates, [np.nan, np.nan, 0.5])


@pytest.mark.parametrize("discriminant", sorted(DISCRIMINANTS))
def test_discriminant_is_the_real_part_of_a_complex_ratio(discriminant: str) -> None:
    """Beams with phases: without noise each estimate is Re(Delta / Sigma), exactly."""
    kappa = (np.linspace(-1, 1, 21) + 1j * np.linspace(-0.3, 0.5, 5)[:, None]).ravel()
    estimates = DISCRIMINANTS[discriminant](Products(np.ones(kappa.shape), np.abs(kappa) ** 2, kappa, 1), 0.0)
    np.testing.assert_allclose(estimates, kappa.real, atol=1e-14)


@pytest.mark.parametrize(("pattern", "null"), [("sinc", 1.0), ("jinc", np.sqrt(1.219670**2 - 0.4**2))])
@pytest.mark.parametrize("pitch", [0.5, 1.0])
def test_targets_beyond_the_null_of_the_farther_beam_are_outside_their_pair(
    pattern: str, null: float, pitch: float
) -> None:
    beams, squint, reach = make_beams(pattern, count=2, pitch=pitch), 0.4 * BEAMWIDTH, null - pitch / 2
    inside = np.linspace(-0.999, 0.999, 67) * reach
    result = estimate(noise_free_looks(beams, inside, squint), beams)
    np.testing.assert_allclose(offset_of(result.elevation[:, 0]), inside, atol=1e-6)
    np.testing.assert_allclose(result.cnr[:, 0], 1e6, rtol=2e-5)  # one look's noise is taken off
    assert not np.any(result.validity == Validity.OUTSIDE_PAIR)

    outside = np.array([-1.15, -1.001, 1.001, 1.15]) * reach
    result = estimate(noise_free_looks(beams, outside, squint), beams)
    assert np.isnan(result.elevation).all()
    assert np.all(result.validity == Validity.OUTSIDE_PAIR)


@PATTERN_NAMES
def test_strongest_pair_gives_the_exact_elevation_everywhere_in_the_array(pattern: str) -> None:
    beams, offsets = make_beams(pattern), np.linspace(-3.745, 3.745, 199)
    result = estimate(noise_free_looks(beams, offsets), beams)
    np.testing.assert_allclose(offset_of(result.elevation[:, 0]), offsets, atol=1e-6)
    assert np.all(result.validity == Validity.OK)


def test_the_pair_with_the_most_power_in_sigma_is_taken() -> None:
    """A covariance made up so that every pair tells another elevation."""
    beams = make_beams("sinc", count=4)
    looks = noise_free_looks(beams, np.zeros(1))
    for strong in range(3):
        covariance = np.diag([10.0] * 4)  # incoherent, and therefore weaker in Sigma than in each channel by itself
        covariance[strong : strong + 2, strong : strong + 2] = 9.0  # equal channels: the target is in the middle
        result = estimate(replace(looks, covariance=covariance[None, None]), beams)
        assert offset_of(result.elevation[0, 0]) == pytest.approx((strong - 1) * 0.5, abs=1e-6)


@pytest.mark.parametrize("discriminant", sorted(DISCRIMINANTS))
def test_only_the_ratio_pulls_the_elevation_to_the_middle_of_the_pair(discriminant: str) -> None:
    beams, cnr = make_beams("gaussian", count=2), 5.0
    looks = multilook(target_slc(beams, 0.2, 4000, 64, cnr, np.random.default_rng(25)), 1, 64)
    offsets = offset_of(estimate(looks, beams, discriminant=discriminant).elevation[:, 0])
    # At the target: CNR of Sigma (l + u)^2 C / 2; of the discriminant C / (C + 1) is left.
    lower, upper = beams.response(elevation_at(0.2), 0.0)
    in_sigma = (lower + upper) ** 2 * cnr / 2
    left = in_sigma / (in_sigma + 1) if discriminant == "ratio" else 1.0
    expected = np.arctanh(left * np.tanh(0.25 * 0.2 / GAUSSIAN_WIDTH**2)) * GAUSSIAN_WIDTH**2 / 0.25
    standard_error = 1.2533 * np.std(offsets) / np.sqrt(len(offsets))
    assert np.median(offsets) == pytest.approx(expected, abs=3.5 * standard_error)  # 0.003; the bias is 0.02


@pytest.mark.parametrize(("looks", "cnr"), few(1, [(16, 30.0), (4, 300.0)]))
@pytest.mark.parametrize("offset", [-0.4, 0.2, 0.6])
@pytest.mark.parametrize("turn", [0.0, 15.0], ids="{:g} deg".format)
def test_sigma_predicts_the_spread(looks: int, cnr: float, offset: float, turn: float) -> None:
    beams, trials, squint = replace(make_beams("jinc", count=2), rotation=np.deg2rad(turn)), 6000, 0.3 * BEAMWIDTH
    slc = target_slc(beams, offset, trials, looks, cnr, np.random.default_rng(26), squint)
    result = estimate(multilook(slc, 1, looks, squint=squint), beams)
    normal = (offset_of(result.elevation[:, 0]) - offset) * BEAMWIDTH / result.sigma[:, 0]
    # SE of the rms 0.9 %; sigma takes energy and discriminant from the same samples.
    assert np.sqrt(np.mean(normal**2)) == pytest.approx(1, abs=3.5 / np.sqrt(2 * trials) + 0.02)
    assert np.mean(result.cnr) == pytest.approx(cnr, rel=3.5 / np.sqrt(trials * looks) + 0.01)


@pytest.mark.parametrize("discriminant", sorted(DISCRIMINANTS))
def test_pixels_it_cannot_use_are_marked(discriminant: str) -> None:
    beams, rng = make_beams("jinc"), np.random.default_rng(27)
    slc = np.concatenate(
        [
            target_slc(beams, 1.2, 100, 16, 100.0, rng),
            target_slc(beams, 0.0, 100, 16, 0.0, rng),
            target_slc(beams, -1.0, 100, 16, 100.0, rng) + target_slc(beams, 1.0, 100, 16, 100.0, rng),
            target_slc(beams, 1.2, 1, 16, 100.0, rng) * np.nan,
        ],
        axis=1,
    )
    result = estimate(multilook(slc, 1, 16), beams, discriminant=discriminant)
    validity = result.validity[:, 0]
    assert np.all(validity[:100] == Validity.OK)
    assert np.all(np.isin(validity[100:200], [Validity.NO_SIGNAL, Validity.OUTSIDE_PAIR]))
    assert np.mean(validity[200:300] == Validity.NOT_ONE_SCATTERER) > 0.95
    assert validity[300] == Validity.MISSING_DATA


@pytest.mark.parametrize("turn", [0.0, 15.0, -40.0], ids="{:g} deg".format)
def test_every_pair_is_inverted_with_its_own_beams(turn: float) -> None:
    """Detectors of unequal spacing and pattern, on a turned axis."""
    patterns = tuple(PATTERNS[name] for name in ("jinc", "gaussian", "sinc", "jinc"))
    boresights = elevation_at(np.array([-0.8, -0.2, 0.2, 0.7]))
    beams = replace(make_beams(), patterns=patterns, boresights=boresights, rotation=np.deg2rad(turn))
    offsets = np.linspace(-0.7, 0.6, 53)
    result = estimate(noise_free_looks(beams, offsets, 0.2 * BEAMWIDTH), beams)
    np.testing.assert_allclose(offset_of(result.elevation[:, 0]), offsets, atol=1e-5)
    assert np.all(result.validity == Validity.OK)


def test_covariance_of_single_precision_will_do() -> None:
    beams, offsets = make_beams("jinc"), np.linspace(-3.7, 3.7, 99)
    looks = noise_free_looks(beams, offsets)
    result = estimate(replace(looks, covariance=looks.covariance.astype(np.float32)), beams)
    assert result.elevation.dtype == np.float64
    np.testing.assert_allclose(offset_of(result.elevation[:, 0]), offsets, atol=1e-6)


def test_hermitian_covariance_gives_the_complex_ratio() -> None:
    """Of the pair with the most power in Sigma, Delta Sigma* has the sign of upper minus lower."""
    response = np.array([0.1, 0.9 * np.exp(0.3j), 1.1 * np.exp(-0.2j), 0.2j])
    covariance = np.multiply.outer(response, response.conj()).astype(np.complex64)[None, None]
    pair, sums = strongest_pairs(Looks.of(covariance, 1))
    sigma, delta = response[2] + response[1], response[2] - response[1]
    assert pair.item() == 1
    assert sums.sum_power.item() == pytest.approx(np.abs(sigma) ** 2, rel=1e-6)
    assert sums.difference_power.item() == pytest.approx(np.abs(delta) ** 2, rel=1e-6)
    assert sums.cross_power.item() == pytest.approx(delta * np.conj(sigma), rel=1e-6)


@pytest.mark.parametrize("offset", [5.0, -5.0])
def test_weak_sidelobes_of_a_target_outside_are_not_taken_for_one_inside(offset: float) -> None:
    """The ratio of the strongest pair alone looks like any other, in a fourth of these pixels."""
    beams = make_beams("sinc")
    slc = target_slc(beams, offset, 300, 4, 100.0, np.random.default_rng(32))
    validity = estimate(multilook(slc, 1, 4), beams).validity
    assert np.count_nonzero(validity == Validity.OK) <= 3
    assert np.mean(validity == Validity.OUTSIDE_ARRAY) > 0.3


@pytest.mark.parametrize("offset", [0.0, 0.2, -0.45])
def test_sigma_is_the_bound_for_two_channels(offset: float) -> None:
    """For the mean covariance of K looks; with two channels the information of the array is that of the pair."""
    beams, looks, energy, squint = make_beams("jinc", count=2), 4, 40.0, 0.3 * BEAMWIDTH
    exact = noise_free_looks(beams, np.array([offset]), squint, looks, energy)
    noisy = Looks.of(exact.covariance + looks * np.eye(2), looks, squint)
    result = estimate(noisy, beams)
    assert offset_of(result.elevation[0, 0]) == pytest.approx(offset, abs=1e-5)
    assert result.cnr[0, 0] == pytest.approx(energy / looks, rel=1e-5)
    bound = stochastic_crb(beams, elevation_at(offset), squint, energy / looks, looks)
    assert result.sigma[0, 0] == pytest.approx(bound, rel=1e-4)


@pytest.mark.parametrize("discriminant", sorted(DISCRIMINANTS))
@pytest.mark.parametrize("pattern", ["jinc", "gaussian"])
def test_pairs_of_unequal_noise_are_exact_without_it(pattern: str, discriminant: str) -> None:
    beams, offsets = make_beams(pattern, 4).scaled(np.array([1.0, 10.0, 0.1, 2.0])), np.linspace(-0.7, 0.7, 29)
    result = estimate(noise_free_looks(beams, offsets), beams, discriminant=discriminant)
    inside = result.validity[:, 0] == Validity.OK
    np.testing.assert_allclose(offset_of(result.elevation[inside, 0]), offsets[inside], atol=1e-5)
    assert np.count_nonzero(inside) > 20


def test_pair_of_unequal_noise_has_the_sigma_that_it_says() -> None:
    """Noise of powers 1 and 9, whitened: no bias, and errors of the spread that each pixel's sigma gives."""
    beams, noise_powers, looks, trials = make_beams("jinc", 2), np.array([1.0, 9.0]), 16, 6000
    rng, (power, transform) = np.random.default_rng(35), whitening(np.diag(noise_powers), np.eye(2))
    noise = np.sqrt(noise_powers)[:, None, None] * circular(rng, (2, trials, looks))
    target = beams.response(elevation_at(0.1), 0.0)[:, None, None] * circular(rng, (trials, looks))
    seen = multilook(np.sqrt(300.0) * target + noise, 1, looks, transform=transform, noise_power=power)
    result = monopulse_elevation(seen, beams.combined(transform), MonopulseSettings(min_cnr_db=0.0))
    normal = (offset_of(result.elevation[:, 0]) - 0.1) * BEAMWIDTH / result.sigma[:, 0]
    assert np.mean(normal) == pytest.approx(0, abs=3.5 / np.sqrt(trials) + 0.02)
    assert np.sqrt(np.mean(normal**2)) == pytest.approx(1, abs=3.5 * standard_error_of_rms(normal) + 0.02)
