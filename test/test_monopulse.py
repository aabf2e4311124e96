"""Monopulse: the statistics of the discriminant in closed form, its inversion, and the choice of the pair."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import (
    BEAMWIDTH,
    assert_one_sentence,
    circular,
    elevation_at,
    make_beams,
    noise_free_looks,
    offset_of,
    target_slc,
)
from scipy import stats
from scipy.integrate import quad

from sal_height.array_ml import elevation_bound
from sal_height.beams import Beams
from sal_height.errors import UserError
from sal_height.estimate import ElevationEstimate, Validity
from sal_height.looks import Looks, multilook
from sal_height.monopulse import (
    DISCRIMINANTS,
    monopulse_elevation,
    pair_discriminant,
    ratio,
    total_least_squares,
)
from sal_height.optics import GAUSSIAN_WIDTH, PATTERNS

PATTERN_NAMES = pytest.mark.parametrize("pattern", sorted(PATTERNS))


def estimate(looks: Looks, beams: Beams, squint: float = 0.0, discriminant: str = "tls") -> ElevationEstimate:
    return monopulse_elevation(looks, beams, np.array([squint]), 1.0, DISCRIMINANTS[discriminant], 10**0.5)


def powers(
    kappa: float, cnr: float, looks: int, trials: int, seed: int, steady: bool = False
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sums over looks of |Sigma|^2, |Delta|^2 and Re Delta Sigma* with Delta = kappa Sigma, both in unit noise."""
    rng = np.random.default_rng(seed)
    signal = np.sqrt(cnr) * (1.0 if steady else circular(rng, (trials, looks)))
    total = signal + circular(rng, (trials, looks))
    difference = kappa * signal + circular(rng, (trials, looks))
    return (
        np.sum(np.abs(total) ** 2, axis=1),
        np.sum(np.abs(difference) ** 2, axis=1),
        np.sum((difference * total.conj()).real, axis=1),
    )


@pytest.mark.parametrize("looks", [1, 2, 3, 4])
@pytest.mark.parametrize(("kappa", "cnr_db"), [(0.75, 5), (-0.5, 0), (0.3, 15)])
def test_ratio_of_a_fluctuating_target_is_student_distributed(looks: int, kappa: float, cnr_db: int) -> None:
    """Around kappa C / (C + 1), however many looks, with sqrt((C + 1 + kappa^2 C) / (2 K)) / (C + 1) T_2K.

    Kolmogorov and Smirnov see 1.95 / sqrt(trials) = 1.2 % of probability. That holds for one look too, where no
    variance exists.
    """
    trials, cnr = 25_000, 10 ** (cnr_db / 10)
    estimates = ratio(*powers(kappa, cnr, looks, trials, seed=21))
    middle, scale = kappa * cnr / (cnr + 1), np.sqrt(cnr + 1 + kappa**2 * cnr) / (cnr + 1) / np.sqrt(2 * looks)
    assert stats.kstest((estimates - middle) / scale, "t", args=(2 * looks,)).pvalue > 0.001


@pytest.mark.parametrize("looks", [3, 4])
def test_ratio_has_the_bias_and_spread_of_the_closed_form(looks: int) -> None:
    kappa, cnr, trials = 0.5, 10.0, 100_000
    estimates = ratio(*powers(kappa, cnr, looks, trials, seed=22))
    spread = np.sqrt((cnr + 1 + kappa**2 * cnr) / (2 * (looks - 1) * (cnr + 1) ** 2))
    assert np.mean(estimates) == pytest.approx(kappa * cnr / (cnr + 1), abs=3.5 * spread / np.sqrt(trials))
    kurtosis = stats.t.stats(2 * looks, moments="k") + 3
    assert np.std(estimates) == pytest.approx(spread, rel=3.5 * np.sqrt((kurtosis - 1) / (4 * trials)))  # 1 %
    # 0.1364 at K = 4 and 10 dB, where the leading term would be 0.1250
    if looks == 4:
        assert spread == pytest.approx(0.1364, abs=5e-5)


@pytest.mark.parametrize(("looks", "mean"), [(1, 0.7183), (2, 0.6316), (4, 0.5980), (16, 0.5764)])
def test_more_looks_make_the_bias_of_a_steady_target_worse(looks: int, mean: float) -> None:
    """E = kappa K C integral_0^1 t^(K-1) exp(K C (t - 1)) dt, for kappa 0.75 and 5 dB."""
    cnr, trials = 10**0.5, 40_000
    integral = quad(lambda t: t ** (looks - 1) * np.exp(looks * cnr * (t - 1)), 0, 1)[0]
    assert 0.75 * looks * cnr * integral == pytest.approx(mean, abs=6e-5)
    estimates = ratio(*powers(0.75, cnr, looks, trials, seed=23, steady=True))
    assert np.mean(estimates) == pytest.approx(mean, abs=3.5 * np.std(estimates) / np.sqrt(trials))


def test_total_least_squares_removes_the_bias() -> None:
    """kappa 0.75, 5 dB, K = 4: its median is 0.7472 where the ratio's mean is 0.5701; its mean does not exist."""
    trials = 100_000
    sums = powers(0.75, 10**0.5, 4, trials, seed=24)
    estimates = total_least_squares(*sums)
    low, middle, high = np.percentile(estimates, [16, 50, 84])
    assert (high - low) / 2 == pytest.approx(0.305, abs=0.01)
    density = 1 / (np.sqrt(2 * np.pi) * 0.305)  # of a normal distribution of that width, at its middle
    assert middle == pytest.approx(0.7472, abs=3.5 / (2 * density * np.sqrt(trials)))  # 0.0042
    biased = ratio(*sums)
    assert np.mean(biased) == pytest.approx(0.5701, abs=3.5 * np.std(biased) / np.sqrt(trials) + 5e-5)


def test_total_least_squares_is_exact_without_noise() -> None:
    kappa = np.linspace(-1, 1, 21)
    np.testing.assert_allclose(total_least_squares(np.ones(21), kappa**2, kappa), kappa, atol=1e-14)


def test_sinc_pair_half_a_beamwidth_apart_in_closed_form() -> None:
    beams = make_beams("sinc")
    t = np.array([-0.45, -0.1, 0.0, 0.1, 0.24, 0.35])
    closed = (4 * t - np.tan(np.pi * t)) / (1 - 4 * t * np.tan(np.pi * t))
    mu = pair_discriminant(t * BEAMWIDTH, 0.0, 0.5 * BEAMWIDTH, beams)
    np.testing.assert_allclose(mu, closed, atol=1e-12)
    half = pair_discriminant(np.array([-0.5, 0.5]) * BEAMWIDTH, 0.0, 0.5 * BEAMWIDTH, beams)
    np.testing.assert_allclose(half, [-0.5, 0.5], atol=1e-12)
    quarter = pair_discriminant(0.25 * BEAMWIDTH, 0.0, 0.5 * BEAMWIDTH, beams)
    assert quarter == pytest.approx(0.22203, abs=5e-6)


def test_gaussian_pair_is_a_hyperbolic_tangent() -> None:
    t = np.linspace(-2, 2, 41)
    mu = pair_discriminant(t * BEAMWIDTH, 0.3 * BEAMWIDTH, 0.5 * BEAMWIDTH, make_beams("gaussian"))
    np.testing.assert_allclose(mu, np.tanh(0.25 * t / GAUSSIAN_WIDTH**2), atol=1e-12)


@pytest.mark.parametrize(
    ("pattern", "pitch", "slope"),
    [("gaussian", 0.5, 0.65464), ("sinc", 0.5, 4 - np.pi), ("jinc", 0.5, 0.633342), ("jinc", 0.6, 0.769233)],
)
def test_slope_of_the_discriminant_at_boresight(pattern: str, pitch: float, slope: float) -> None:
    """By central difference: error 1e-6 / 6 of the third derivative."""
    step = 1e-3
    mu = pair_discriminant(np.array([-step, step]) * BEAMWIDTH, 0.0, pitch * BEAMWIDTH, make_beams(pattern))
    assert (mu[1] - mu[0]) / (2 * step) == pytest.approx(slope, abs=6e-6)


@PATTERN_NAMES
@pytest.mark.parametrize("pitch", [0.5, 1.0])
@pytest.mark.parametrize("squint", [0.0, 0.4 * BEAMWIDTH])
def test_inversion_undoes_the_pattern_inside_its_domain_and_is_nan_outside(
    pattern: str, pitch: float, squint: float
) -> None:
    """The domain ends a pitch from the middle, or where |mu| = 1: with the far detector in its first null."""
    beams = make_beams(pattern, count=2, pitch=pitch)
    null = {"gaussian": np.inf, "sinc": 1.0, "jinc": np.sqrt(1.219670**2 - (squint / BEAMWIDTH) ** 2)}[pattern]
    reach = min(pitch, null - pitch / 2)
    inside = np.linspace(-0.99, 0.99, 67) * reach
    result = estimate(noise_free_looks(beams, inside, squint), beams, squint)
    np.testing.assert_allclose(offset_of(result.elevation[:, 0]), inside, atol=1e-9)
    np.testing.assert_allclose(result.cnr[:, 0], 1e6, rtol=1e-5)

    outside = np.array([-1.15, -1.01, 1.01, 1.15]) * reach
    result = estimate(noise_free_looks(beams, outside, squint), beams, squint)
    assert np.isnan(result.elevation).all()
    assert np.all(result.validity == Validity.OUTSIDE_PAIR)


@PATTERN_NAMES
def test_strongest_pair_gives_the_exact_elevation_everywhere_in_the_array(pattern: str) -> None:
    beams, offsets = make_beams(pattern), np.linspace(-3.745, 3.745, 199)
    result = estimate(noise_free_looks(beams, offsets), beams)
    np.testing.assert_allclose(offset_of(result.elevation[:, 0]), offsets, atol=1e-9)
    assert np.all(result.validity == Validity.OK)


def test_the_pair_with_the_most_power_in_sigma_is_taken() -> None:
    """A covariance made up so that every pair tells another elevation."""
    beams = make_beams("sinc", count=4)
    looks = noise_free_looks(beams, np.zeros(1))
    for strong in range(3):
        covariance = np.diag([10.0] * 4)  # incoherent, and therefore weaker in Sigma than in each channel by itself
        covariance[strong : strong + 2, strong : strong + 2] = 9.0  # equal channels: the target is in the middle
        result = estimate(replace(looks, covariance=covariance[None, None]), beams)
        assert offset_of(result.elevation[0, 0]) == pytest.approx((strong - 1) * 0.5, abs=1e-9)


@pytest.mark.parametrize("discriminant", ["ratio", "tls"])
def test_ratio_pulls_the_elevation_to_the_middle_of_the_pair_and_tls_does_not(discriminant: str) -> None:
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


@pytest.mark.parametrize(("looks", "cnr"), [(16, 30.0), (4, 300.0)])
def test_sigma_predicts_the_spread(looks: int, cnr: float) -> None:
    beams, trials = make_beams("jinc", count=2), 6000
    slc = target_slc(beams, 0.2, trials, looks, cnr, np.random.default_rng(26))
    result = estimate(multilook(slc, 1, looks), beams)
    normal = (offset_of(result.elevation[:, 0]) - 0.2) * BEAMWIDTH / result.sigma[:, 0]
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
    assert np.all(np.isin(validity[100:200], [Validity.LOW_CNR, Validity.OUTSIDE_PAIR]))
    assert np.mean(validity[200:300] == Validity.NOT_ONE_SCATTERER) > 0.95
    assert validity[300] == Validity.MISSING_DATA


def test_unequal_pitch_is_refused() -> None:
    beams = make_beams(count=3)
    uneven = replace(beams, boresights=beams.boresights + np.array([0, 0, 0.01]) * BEAMWIDTH)
    with pytest.raises(UserError) as refusal:
        estimate(noise_free_looks(uneven, np.zeros(1)), uneven)
    assert_one_sentence(str(refusal.value), "7.75e-05 to 7.905e-05 rad", "equal spacing")


@pytest.mark.parametrize("offset", [5.0, -5.0])
def test_weak_sidelobes_of_a_target_outside_are_not_taken_for_one_inside(offset: float) -> None:
    """The ratio of the strongest pair alone looks like any other, in a fourth of these pixels."""
    beams = make_beams("sinc")
    slc = target_slc(beams, offset, 300, 4, 100.0, np.random.default_rng(32))
    validity = estimate(multilook(slc, 1, 4), beams).validity
    assert np.count_nonzero(validity == Validity.OK) <= 1
    assert np.mean(validity == Validity.OUTSIDE_ARRAY) > 0.3


@pytest.mark.parametrize("offset", [0.0, 0.2, -0.45])
def test_sigma_is_the_bound_for_two_channels(offset: float) -> None:
    """For the mean covariance of K looks; with two channels the information of the array is that of the pair."""
    beams, looks, energy, squint = make_beams("jinc", count=2), 4, 40.0, 0.3 * BEAMWIDTH
    exact = noise_free_looks(beams, np.array([offset]), squint, looks, energy)
    noisy = replace(exact, covariance=exact.covariance + looks * np.eye(2))
    result = estimate(noisy, beams, squint)
    assert offset_of(result.elevation[0, 0]) == pytest.approx(offset, abs=1e-9)
    assert result.cnr[0, 0] == pytest.approx(energy / looks, rel=1e-9)
    bound = elevation_bound(np.array(energy), looks, beams, elevation_at(offset), np.array(squint))
    assert result.sigma[0, 0] == pytest.approx(bound, rel=1e-6)


def test_one_detector_is_refused() -> None:
    beams = make_beams(count=1)
    with pytest.raises(UserError) as refusal:
        estimate(noise_free_looks(beams, np.zeros(1)), beams)
    assert_one_sentence(str(refusal.value), "1 detector", "2 or more")
