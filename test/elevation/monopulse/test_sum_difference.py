"""The sum-difference discriminator: estimates of gamma, orders of accumulation, inversions, elevations of images."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import (
    BEAMWIDTH,
    circular,
    elevation_at,
    few,
    make_beams,
    multilook,
    offset_of,
    refused,
    standard_error_of_rms,
)
from scipy import stats
from scipy.optimize import minimize_scalar
from scipy.special import j1, jv

from sal_height.beams.apertures import GAUSSIAN_WIDTH
from sal_height.beams.array import Beams
from sal_height.beams.pattern import PATTERNS, pattern_named
from sal_height.elevation.array.bounds import beam_power, information_of, stochastic_crb, stochastic_deviation
from sal_height.elevation.array.estimate import ElevationEstimate, Validity
from sal_height.elevation.looks.looks import Looks
from sal_height.elevation.monopulse.discriminant import discriminant, discriminant_domain, discriminant_slope
from sal_height.elevation.monopulse.estimators import (
    DISCRIMINANTS,
    NoisePowers,
    Products,
    discriminate,
    products,
    ratio,
    total_least_squares,
)
from sal_height.elevation.monopulse.inversion import Reason, invert, invert_linear
from sal_height.elevation.monopulse.pairs import MonopulseSettings, monopulse_elevation
from sal_height.elevation.monopulse.sum_difference import SlopeTable, SumDifferenceSettings, sum_difference_elevation
from sal_height.errors import UserError
from sal_height.sensor.channels import separated_gains, sum_difference_channels
from sal_height.theory.discriminator_noise import steady_looks_mean, steady_mean
from sal_height.theory.link_budget import crossover_slope, synthesise

Array = np.ndarray
EQUAL: NoisePowers = (1.0, 1.0)
SUM_DIFFERENCE = np.array([[1.0, 1.0], [-1.0, 1.0]])
HYBRID = SUM_DIFFERENCE / np.sqrt(2)
ESTIMATORS = pytest.mark.parametrize("name", sorted(DISCRIMINANTS))


def images_of(total: Array, difference: Array, looks: int) -> Looks:
    """Multi-looked images of shape (pixels, looks) each."""
    return multilook(np.stack([total, difference]), 1, looks)


def target(pair: Beams, offset: float, shape: tuple[int, int], cnr: float, noise: NoisePowers, seed: int) -> Looks:
    """A fluctuating target; `cnr` is its power over 1, and `noise` the powers in Sigma and Delta."""
    rng = np.random.default_rng(seed)
    lower, upper = pair.response(elevation_at(offset), 0.0)
    amplitude = np.sqrt(cnr) * circular(rng, shape)
    total = (upper + lower) * amplitude + np.sqrt(noise[0]) * circular(rng, shape)
    difference = (upper - lower) * amplitude + np.sqrt(noise[1]) * circular(rng, shape)
    return images_of(total, difference, shape[1])


def estimate(looks: Looks, pair: Beams, noise: NoisePowers = EQUAL, **settings: str) -> ElevationEstimate:
    return sum_difference_elevation(
        replace(looks, noise_powers=np.array(noise)), pair, SumDifferenceSettings(**settings)
    )


@pytest.mark.parametrize("noise", [(1.0, 1.0), (1.0, 9.0), (4.0, 0.5)])
@pytest.mark.parametrize("pulses", [1, 4])
def test_total_least_squares_maximises_the_likelihood_over_real_gamma(noise: NoisePowers, pulses: int) -> None:
    """Amplitudes maximised away, what remains of the likelihood is the power along (1, gamma) of whitened channels."""
    rng = np.random.default_rng(41)
    for _ in range(20):
        total, difference = circular(rng, (2, pulses))
        found = float(discriminate(products(total, difference), total_least_squares, noise))

        def unexplained(angle: float, total: Array = total, difference: Array = difference) -> float:
            gamma = np.tan(angle)
            along = np.sum(np.abs(total / noise[0] + gamma * difference / noise[1]) ** 2)
            return float(-along / (1 / noise[0] + gamma**2 / noise[1]))

        start = np.linspace(-np.pi / 2, np.pi / 2, 401)
        near = start[np.argmin([unexplained(angle) for angle in start])]
        best = minimize_scalar(
            unexplained, bounds=(near - 0.01, near + 0.01), method="bounded", options={"xatol": 1e-9}
        )
        apart = np.arctan(found) - best.x
        assert abs(apart - np.pi * np.round(apart / np.pi)) < 1e-6


def test_ratio_is_the_real_part_of_the_quotient_of_one_look() -> None:
    total, difference = circular(np.random.default_rng(42), (2, 30, 1))
    found = discriminate(products(total, difference), ratio, (1.0, 5.0))
    np.testing.assert_allclose(found, (difference / total).real[:, 0], rtol=1e-12)


@ESTIMATORS
def test_every_estimate_is_exact_without_noise(name: str) -> None:
    gamma = np.linspace(-1.5, 1.5, 31)
    sums = Products(np.ones(31), gamma**2, gamma, 1)
    np.testing.assert_allclose(discriminate(sums, DISCRIMINANTS[name], (1e-9, 7e-9)), gamma, atol=1e-8)


def test_whitening_removes_a_bias_of_many_looks() -> None:
    """16 looks at 3 dB, Delta with a fourth of the noise of Sigma: 0.5 with whitening, 0.38 without."""
    rng, gamma, noise = np.random.default_rng(45), 0.5, (1.0, 0.25)
    signal = np.sqrt(2.0) * circular(rng, (20_000, 64))
    total, difference = signal + circular(rng, signal.shape), gamma * signal + 0.5 * circular(rng, signal.shape)
    sums = products(total, difference)
    medians = [np.median(discriminate(sums, total_least_squares, powers)) for powers in (noise, EQUAL)]
    spread = stats.median_abs_deviation(discriminate(sums, total_least_squares, noise), scale="normal")
    assert medians[0] == pytest.approx(gamma, abs=3.5 * 1.2533 * spread / np.sqrt(20_000) + 1e-3)
    assert medians[1] < gamma - 0.05


def test_forming_sums_and_synthesising_commute_and_unequal_filters_do_not() -> None:
    rng = np.random.default_rng(47)
    lower_upper, phase = circular(rng, (2, 5, 32)), rng.uniform(-9, 9, 32)
    first = synthesise(np.tensordot(HYBRID, lower_upper, 1), phase)
    np.testing.assert_allclose(first, np.tensordot(HYBRID, synthesise(lower_upper, phase), 1), atol=1e-13)
    unlike = np.stack([synthesise(pulses, phase * (1 + 1e-3 * m)) for m, pulses in enumerate(lower_upper)])
    assert np.max(np.abs(first - np.tensordot(HYBRID, unlike, 1))) > 1e-4


def test_synthesising_brings_pulses_of_known_phase_together() -> None:
    phase = np.random.default_rng(58).uniform(-9, 9, (3, 32))
    np.testing.assert_allclose(synthesise(2j * np.exp(1j * phase), phase), np.full(3, 64j), atol=1e-12)


def test_products_of_pulses_need_no_phase_compensation_and_are_no_coherent_sum() -> None:
    rng = np.random.default_rng(48)
    total, difference = circular(rng, (2, 7, 16))
    turn = np.exp(-1j * rng.uniform(-9, 9, 16))
    plain, compensated = products(total, difference), products(total * turn, difference * turn)
    np.testing.assert_allclose(compensated.cross_power, plain.cross_power, atol=1e-13)
    np.testing.assert_allclose(compensated.sum_power, plain.sum_power, atol=1e-13)
    assert plain.count == 16


ORDERS: dict[str, tuple[Callable[[Array, Array], Array], Callable[[float, float, int], float]]] = {
    "aperture, then ratio": (
        lambda total, difference: discriminate(
            products(*(synthesise(z, np.zeros(z.shape[-1]))[:, None] for z in (total, difference))), ratio, EQUAL
        ),
        lambda gamma, snr, pulses: float(steady_mean(gamma, pulses * snr)),
    ),
    "products, then ratio": (
        lambda total, difference: discriminate(products(total, difference), ratio, EQUAL),
        lambda gamma, snr, pulses: float(steady_looks_mean(gamma, snr, pulses)),
    ),
    "ratio, then mean": (
        lambda total, difference: np.mean(
            discriminate(products(total[..., None], difference[..., None]), ratio, EQUAL), axis=-1
        ),
        lambda gamma, snr, _pulses: float(steady_mean(gamma, snr)),
    ),
}


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(("gamma", "snr", "pulses"), [(0.5, 0.1, 32), (-0.8, 0.5, 8)])
def test_mean_of_each_order_of_accumulation(order: str, gamma: float, snr: float, pulses: int) -> None:
    """At 32 pulses of -10 dB: 0.480, 0.046 and 0.048 of 0.5. Where no variance exists the standard error is nominal."""
    rng = np.random.default_rng(49)
    total, difference = circular(rng, (2, 40_000, pulses))
    sample = ORDERS[order][0](total + np.sqrt(snr), difference + gamma * np.sqrt(snr))
    expected = ORDERS[order][1](gamma, snr, pulses)
    standard_error = np.std(sample) / np.sqrt(len(sample))
    assert standard_error < 0.011
    assert abs(np.mean(sample) - expected) < 3.5 * standard_error


@pytest.mark.parametrize("pitch", [0.3, 0.5, 0.9])
def test_slope_at_the_crossing_is_the_closed_form(pitch: float) -> None:
    half = pitch / 2
    expected = {
        "gaussian": half / GAUSSIAN_WIDTH**2,
        "sinc": 1 / half - np.pi / np.tan(np.pi * half),
        "jinc": np.pi * jv(2, np.pi * half) / j1(np.pi * half),
    }
    for name, slope in expected.items():
        found = crossover_slope(pattern_named(name), pitch * BEAMWIDTH, BEAMWIDTH)
        assert found * BEAMWIDTH == pytest.approx(slope, rel=1e-10)
        pair = make_beams(name, 2, pitch)
        assert found == pytest.approx(float(discriminant_slope(pair, elevation_at(0.0), 0.0)), rel=1e-10)


@pytest.mark.parametrize(("pattern", "pitch"), [("sinc", 0.0), ("sinc", 2.8), ("jinc", -0.5)])
def test_beams_without_a_crossing_are_refused(pattern: str, pitch: float) -> None:
    """One on the other; a sidelobe whose slope is the other way; upper and lower exchanged."""
    with refused(UserError, "slope", "greater than 0"):
        crossover_slope(pattern_named(pattern), pitch * BEAMWIDTH, BEAMWIDTH)


@pytest.mark.parametrize(("turn", "remaining"), [(0.0, 1.5e-3), (20.0, 1.5e-2)])
def test_linear_inversion_is_the_tangent_of_the_exact_one(turn: float, remaining: float) -> None:
    """Off by the cube of gamma: a tenth of it leaves a thousandth; turned and squinted, by the square: a hundredth."""
    pair, squint = replace(make_beams("jinc", 2), rotation=np.deg2rad(turn)), 0.3 * BEAMWIDTH
    gammas = np.array([0.5, 0.05])
    linear, exact = invert_linear(pair, gammas, squint), invert(pair, gammas, squint)
    crossing = elevation_at(-0.3 * np.tan(np.deg2rad(turn)))
    slope = float(discriminant_slope(pair, crossing, squint))
    np.testing.assert_allclose(offset_of(linear.elevation), offset_of(crossing + gammas / slope), atol=1e-9)
    np.testing.assert_allclose(linear.slope, slope, rtol=1e-12)
    off = offset_of(linear.elevation) - offset_of(exact.elevation)
    assert off[0] > 0.05
    assert abs(off[1]) < remaining * off[0]


def test_linear_inversion_of_unlike_beams_is_the_tangent_between_them() -> None:
    pair = replace(make_beams(count=2), patterns=(PATTERNS["jinc"].scaled(1.2), PATTERNS["sinc"]))
    small = elevation_at(np.array([-1e-4, 0.0, 1e-4]))
    found = invert_linear(pair, discriminant(pair, small, 0.0), 0.0)
    np.testing.assert_allclose(offset_of(found.elevation), offset_of(small), atol=1e-8)


def test_linear_inversion_says_why_there_is_no_elevation() -> None:
    found = invert_linear(make_beams(count=2), np.array([-1.01, -1.0, 1.0, 1.01, np.nan]), 0.0)
    reasons = [Reason.BELOW, Reason.INSIDE, Reason.INSIDE, Reason.ABOVE, Reason.NOT_FINITE]
    assert found.reason.tolist() == reasons
    assert np.isfinite(found.elevation).tolist() == np.isfinite(found.slope).tolist() == [r == 0 for r in reasons]
    beside = invert_linear(make_beams("sinc", 2, pitch=2.8), np.zeros(1), 0.0)
    assert beside.reason.tolist() == [Reason.NO_DOMAIN]


@pytest.mark.parametrize("sign", [1, -1], ids=["rising", "falling"])
def test_slope_table_is_inverted_between_its_nodes(sign: int) -> None:
    pair, angle = make_beams("jinc", 2), np.linspace(-0.8, 0.8, 17) * BEAMWIDTH
    gamma = discriminant(pair, np.pi / 4 + angle, 0.0)
    table = SlopeTable(tuple(angle.tolist()), tuple((sign * gamma).tolist()))
    at_nodes = table.invert(pair, sign * gamma, 0.0)
    np.testing.assert_allclose(offset_of(at_nodes.elevation), angle / BEAMWIDTH, atol=1e-9)
    between = (angle[1:] + angle[:-1]) / 2
    found = table.invert(pair, sign * discriminant(pair, np.pi / 4 + between, 0.0), 0.0)
    np.testing.assert_allclose(offset_of(found.elevation), between / BEAMWIDTH, atol=1e-3)
    exact = sign * discriminant_slope(pair, np.pi / 4 + between, 0.0)
    np.testing.assert_allclose(found.slope, exact, rtol=0.006)
    beyond = table.invert(pair, np.array([-2.0, 2.0, np.nan]), 0.0)
    assert beyond.reason.tolist() == [Reason.BELOW, Reason.ABOVE, Reason.NOT_FINITE]
    assert np.isnan(beyond.elevation).all()


@pytest.mark.parametrize(
    ("angle", "gamma", "parts"),
    [
        ((-1.0, 0.0, 1.0), (-0.5, 0.5, 0.4), ["changes sign", "between 0 and 1 rad"]),
        ((-1.0, 0.0, 1.0), (-0.5, -0.5, 0.5), ["changes sign", "between -1 and 0 rad"]),
        ((-1.0, 0.0, 1.0), (0.3, 0.3, 0.3), ["changes sign"]),
        ((-1.0, 1.0, 0.0), (-0.5, 0.0, 0.5), ["do not increase"]),
        ((-1.0, 0.0, 1.0), (-0.5, np.nan, 0.5), ["not finite"]),
        ((-1.0, 0.0), (-0.5, 0.0, 0.5), ["2 angles and 3 values"]),
        ((0.0,), (0.0,), ["2 or more"]),
    ],
)
def test_a_slope_table_that_cannot_be_inverted_is_refused(
    angle: tuple[float, ...], gamma: tuple[float, ...], parts: list[str]
) -> None:
    with refused(UserError, *parts):
        SlopeTable(angle, gamma)


@ESTIMATORS
@pytest.mark.parametrize("pattern", sorted(PATTERNS))
def test_elevations_are_exact_without_noise_over_the_domain_of_the_pair(pattern: str, name: str) -> None:
    pair = make_beams(pattern, 2)
    low, high = (float(offset_of(end)) for end in discriminant_domain(pair, 0.0))
    offset = np.clip(np.linspace(0.99 * low, 0.99 * high, 41), -0.9, 0.9)
    channels = np.tensordot(pair.response(elevation_at(offset), 0.0), SUM_DIFFERENCE.T, 1)
    seen = Looks.of(1e6 * channels[:, None, :, None] * channels[:, None, None, :], 1)
    found = estimate(seen, pair, (1e-3, 2e-3), discriminant=name)
    np.testing.assert_allclose(offset_of(found.elevation[:, 0]), offset, atol=1e-5)
    assert np.all(found.validity == Validity.OK)
    np.testing.assert_allclose(found.cnr[:, 0], 1e6 / (1 / (1e3 + 5e2)), rtol=1e-5)


def test_a_lossless_hybrid_gives_the_elevations_and_sigmas_of_the_bare_pair() -> None:
    """The same draws, turned by the hybrid: single precision of the covariance is all that differs."""
    pair, rng, shape = make_beams("jinc", 2), np.random.default_rng(50), (400, 8)
    lower_upper = np.sqrt(50.0) * pair.response(elevation_at(0.1), 0.0)[:, None, None] * circular(rng, shape)
    lower_upper = lower_upper + circular(rng, (2, *shape))
    bare = monopulse_elevation(multilook(lower_upper, 1, 8), pair, MonopulseSettings(min_cnr_db=0.0))
    made = sum_difference_channels(np.eye(2), HYBRID)
    formed = np.tensordot(made.transform @ HYBRID, lower_upper, 1)
    assert made.noise_powers == pytest.approx((2.0, 2.0))
    found = estimate(images_of(formed[0], formed[1], 8), pair.combined(made.matrix), tuple(made.noise_powers))
    np.testing.assert_allclose(offset_of(found.elevation), offset_of(bare.elevation), atol=2e-5)
    np.testing.assert_allclose(found.sigma, bare.sigma, rtol=1e-4)
    np.testing.assert_allclose(found.cnr, bare.cnr, rtol=1e-4)


@pytest.mark.parametrize("noise", [(2.0, 2.0), (1.0, 6.0)])
@pytest.mark.parametrize(("looks", "cnr"), few(1, [(16, 30.0), (4, 300.0)]))
def test_sigma_and_cnr_are_what_the_sample_has(looks: int, cnr: float, noise: NoisePowers) -> None:
    """Standard error of the rms 0.9 %; sigma takes energy and discriminant from the same samples: 2 %."""
    pair, trials = make_beams("jinc", 2), 6000
    found = estimate(target(pair, 0.3, (trials, looks), cnr, noise, 51), pair, noise)
    normal = (offset_of(found.elevation[:, 0]) - 0.3) * BEAMWIDTH / found.sigma[:, 0]
    assert np.mean(normal) == pytest.approx(0, abs=3.5 / np.sqrt(trials) + 0.03)
    assert np.sqrt(np.mean(normal**2)) == pytest.approx(1, abs=3.5 * standard_error_of_rms(normal) + 0.02)
    detector_noise = 1 / (1 / noise[0] + 1 / noise[1])
    assert np.mean(found.cnr) * detector_noise == pytest.approx(cnr, rel=3.5 / np.sqrt(trials * looks) + 0.01)


@pytest.mark.parametrize("offset", [0.0, 0.2, -0.45])
@pytest.mark.parametrize("noise", [(2.0, 2.0), (1.0, 6.0)])
def test_sigma_is_the_stochastic_bound(offset: float, noise: NoisePowers) -> None:
    """Of the whitened channels, for the mean covariance of K looks; in equal noise, that of the two detectors."""
    pair, looks, energy, weights = make_beams("jinc", 2), 4, 40.0, np.sqrt(1 / np.array(noise))[:, None]
    response, slope = pair.response(elevation_at(offset), 0.0), pair.slope(elevation_at(offset), 0.0)
    channels = SUM_DIFFERENCE @ response
    covariance = energy * np.multiply.outer(channels, channels) + looks * np.diag(noise)
    seen = Looks.of(covariance[None, None], looks)
    found = estimate(seen, pair, noise)
    assert offset_of(found.elevation[0, 0]) == pytest.approx(offset, abs=1e-5)
    whitened, change = (weights * SUM_DIFFERENCE @ of_beams for of_beams in (response, slope))
    bound = stochastic_deviation(np.array(energy), looks, beam_power(whitened), information_of(whitened, change))
    assert found.sigma[0, 0] == pytest.approx(bound, rel=1e-4)
    if noise[0] == noise[1]:
        of_detectors = stochastic_crb(pair, elevation_at(offset), 0.0, energy / looks, looks)
        assert bound == pytest.approx(of_detectors, rel=1e-12)


def test_sigma_uses_the_slope_of_its_inversion(tmp_path: Path) -> None:
    pair = make_beams("jinc", 2)
    looks = target(pair, 0.0, (10, 16), 1000.0, EQUAL, 52)
    slope = crossover_slope(PATTERNS["jinc"], 0.5 * BEAMWIDTH, BEAMWIDTH)
    half = 0.7 * slope * BEAMWIDTH
    table = tmp_path / "slope.csv"
    table.write_text(f"angle_rad,gamma\n{-0.7 * BEAMWIDTH},{half}\n{0.7 * BEAMWIDTH},{-half}\n", encoding="utf-8")
    linear, falling = estimate(looks, pair, inverse="linear"), estimate(looks, pair, slope_table=str(table))
    np.testing.assert_allclose(offset_of(falling.elevation), -offset_of(linear.elevation), atol=1e-9)
    np.testing.assert_allclose(falling.sigma, linear.sigma, rtol=1e-3)
    assert np.all(falling.validity == Validity.OK)


@ESTIMATORS
def test_pixels_without_elevation_say_why(name: str) -> None:
    pair, looks = make_beams("jinc", 2), 16
    rng = np.random.default_rng(53)
    signals = [
        target(pair, 0.1, (100, looks), 100.0, EQUAL, 54),
        target(pair, 0.1, (1000, looks), 0.0, EQUAL, 55),
        images_of(circular(rng, (100, looks)), 30 * circular(rng, (100, looks)), looks),
        images_of(np.zeros((2, looks), complex), np.zeros((2, looks), complex), looks),
        images_of(np.zeros((2, looks), complex), np.ones((2, looks), complex) * 9, looks),
        images_of(30 * circular(rng, (100, looks)), 20 * circular(rng, (100, looks)), looks),
        images_of(np.full((1, looks), np.nan + 0j), np.ones((1, looks), complex), looks),
    ]
    found = [estimate(seen, pair, discriminant=name) for seen in signals]
    ok, noise, difference, nothing, only_difference, two, missing = (seen.validity[:, 0] for seen in found)
    assert np.all(ok == Validity.OK)
    # 1000 pixels, false alarms of 1e-4.
    assert np.count_nonzero(~np.isin(noise, [Validity.LOW_CNR, Validity.NO_SIGNAL])) <= 2
    assert np.all(nothing == Validity.NO_SIGNAL)
    if name == "tls":
        assert np.mean(difference == Validity.OUTSIDE_PAIR) > 0.95
        assert np.all(only_difference == Validity.OUTSIDE_PAIR)
    assert not np.any(np.isin(np.concatenate([difference, only_difference]), [Validity.OK]))
    assert np.all(np.isin(two, [Validity.NOT_ONE_SCATTERER, Validity.OUTSIDE_PAIR]))
    assert np.count_nonzero(two == Validity.NOT_ONE_SCATTERER) > 50
    assert np.all(missing == Validity.MISSING_DATA)
    assert np.all(np.isinf(found[3].sigma))


def test_a_single_look_is_refused_as_it_fits_one_scatterer_whatever_it_is() -> None:
    with refused(UserError, "range_looks", "azimuth_looks", "2 looks or more"):
        SumDifferenceSettings(range_looks=1, azimuth_looks=1)
    assert SumDifferenceSettings(range_looks=1, azimuth_looks=2).azimuth_looks == 2


def test_one_scatterer_is_seldom_taken_for_two() -> None:
    pair = make_beams("jinc", 2)
    for looks, cnr in ((4, 1e4), (16, 30.0), (64, 10.0), (4, 5.0)):
        validity = estimate(target(pair, 0.3, (4000, looks), cnr, (1.0, 3.0), 56), pair, (1.0, 3.0)).validity
        assert np.count_nonzero(validity == Validity.NOT_ONE_SCATTERER) <= 8


def test_looks_on_sloping_ground_are_taken_for_one_scatterer() -> None:
    """A tenth of a beamwidth between the looks' elevations: far above the noise of 50 dB, and little of the power."""
    pair, rng = make_beams("jinc", 2), np.random.default_rng(59)
    response = pair.response(elevation_at(np.linspace(0.2, 0.3, 16)), 0.0)
    amplitude = np.sqrt(1e5) * circular(rng, (200, 16))
    total, difference = (amplitude * (response[:, 1] + sign * response[:, 0]) for sign in (1, -1))
    noise = circular(rng, (2, 200, 16))
    found = estimate(images_of(total + noise[0], difference + noise[1], 16), pair)
    assert np.all(found.validity == Validity.OK)
    assert np.median(offset_of(found.elevation)) == pytest.approx(0.25, abs=0.01)


def test_a_signal_below_a_stated_cnr_is_of_low_cnr_and_not_outside() -> None:
    """Without one 256 looks of -1.5 dB are enough."""
    pair = make_beams("jinc", 2)
    signal = target(pair, 0.0, (100, 256), 0.7, EQUAL, 60)
    assert np.all(estimate(signal, pair).validity == Validity.OK)
    found = estimate(signal, pair, min_cnr_db=5.0)
    assert np.all(np.isfinite(found.elevation))
    assert np.all(found.validity == Validity.LOW_CNR)


def test_complex_beams_are_inverted_by_the_real_part_of_their_ratio() -> None:
    pair = make_beams("jinc", 2).scaled(np.array([1.0, np.exp(0.4j)]))
    offset = np.linspace(-0.4, 0.4, 9)
    channels = np.tensordot(pair.response(elevation_at(offset), 0.0), SUM_DIFFERENCE.T, 1)
    covariance = (1e6 * channels[:, None, :, None] * channels[:, None, None, :].conj()).astype(np.complex64)
    found = estimate(Looks.of(covariance, 1), pair)
    np.testing.assert_allclose(offset_of(found.elevation[:, 0]), offset, atol=1e-5)
    assert np.all(found.validity == Validity.OK)


@pytest.mark.parametrize(
    ("channels", "beams"),
    [
        ((1.0, 1.0), (1.0, 1.0)),
        ((0.7, -0.5), (1.0, 1.0)),
        ((0.7 * np.exp(2j), 0.5 * np.exp(-1j)), (0.9, 1.3)),
        ((2.0, 3j), (np.exp(0.3j), 1.1 * np.exp(-0.2j))),
    ],
)
def test_gains_of_channels_and_beams_are_told_apart(
    channels: tuple[complex, complex], beams: tuple[complex, complex]
) -> None:
    matrix = np.diag(channels) @ SUM_DIFFERENCE @ np.diag(beams)
    channel_gains, beam_gains = separated_gains(matrix)
    np.testing.assert_allclose(np.diag(channel_gains) @ SUM_DIFFERENCE @ np.diag(beam_gains), matrix, atol=1e-12)
    assert np.mean(np.abs(beam_gains) ** 2) == pytest.approx(1)
    assert np.iscomplexobj(beam_gains) == np.iscomplexobj(beams)
    np.testing.assert_allclose(beam_gains[0] / beam_gains[1], beams[0] / beams[1], atol=1e-12)


@pytest.mark.parametrize(
    "matrix",
    [
        np.eye(2),
        [[-1, 1], [1, 1]],
        [[1, 1], [1, -1.1]],
        [[1, 1], [0, 0]],
        np.ones((2, 3)),
        [[1, np.nan], [-1, 1]],
        [[0, 0], [0, 0]],
    ],
)
def test_a_matrix_that_forms_no_sum_and_difference_is_refused(matrix: Array) -> None:
    with refused(UserError, "channel matrix", "sum and difference"):
        separated_gains(matrix)


def test_calibrated_channels_are_sum_and_difference_with_the_noise_that_is_said() -> None:
    """Receivers of unlike gain and noise behind a hybrid, and beams of unlike gain before it."""
    receivers, before, rng = np.diag([0.7 * np.exp(2j), 0.5]), np.array([0.9, 1.1]), np.random.default_rng(62)
    matrix = receivers @ SUM_DIFFERENCE @ np.diag(before)
    made = sum_difference_channels(np.diag([2.0, 3.0]), matrix)
    beams = made.matrix
    np.testing.assert_allclose(made.transform @ matrix, SUM_DIFFERENCE @ beams, atol=1e-12)
    noise = made.transform @ (np.sqrt([[2.0], [3.0]]) * circular(rng, (2, 40_000)))
    powers = np.mean(np.abs(noise) ** 2, axis=1)
    np.testing.assert_allclose(powers, made.noise_powers, rtol=3.5 / np.sqrt(40_000))


def test_correlated_noise_is_refused_and_that_of_equal_receivers_before_the_hybrid_is_not() -> None:
    made = sum_difference_channels(HYBRID @ np.diag([3.0, 3.0]) @ HYBRID.T, HYBRID)
    assert made.noise_powers == pytest.approx((6.0, 6.0))
    with refused(UserError, "correlation of 0.2", "independent"):
        sum_difference_channels(HYBRID @ np.diag([1.0, 1.5]) @ HYBRID.T, HYBRID)


@pytest.mark.parametrize("powers", [(0.0, 1.0), (1.0, -1.0), (1.0, np.nan)])
def test_unknown_noise_is_refused(powers: NoisePowers) -> None:
    with refused(UserError, "noise powers", "greater than 0"):
        discriminate(Products(np.ones(1), np.ones(1), np.ones(1), 1), ratio, powers)
