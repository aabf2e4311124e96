"""Noise of the discriminant: closed forms against integrals over densities, and against Monte Carlo."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers import circular, elevation_at, make_beams, refused
from scipy import stats
from scipy.integrate import quad
from scipy.special import ndtr

from sal_height.errors import UserError
from sal_height.theory.discriminator_noise import (
    NORMAL_SHARES,
    SteadyLaw,
    cnr_detector_of,
    gaussian_law,
    gaussian_mean,
    s68_of,
    steady_looks_mean,
    steady_mean,
    straight_power,
)

CASES = pytest.mark.parametrize(("kappa", "cnr"), [(0.75, 10**0.5), (-0.5, 1.0), (0.3, 30.0), (1.0, 0.1), (0.0, 3.0)])
LOOKS = pytest.mark.parametrize("looks", [1, 2, 4, 16])


def discriminants(kappa: float, cnr: float, looks: int, trials: int, seed: int, steady: bool) -> np.ndarray:
    rng = np.random.default_rng(seed)
    signal = np.sqrt(cnr) * (1.0 if steady else circular(rng, (trials, looks)))
    total = signal + circular(rng, (trials, looks))
    difference = kappa * signal + circular(rng, (trials, looks))
    return np.sum((difference * total.conj()).real, axis=1) / np.sum(np.abs(total) ** 2, axis=1)


def average_over_sum_channel(function, cnr: float) -> float:
    """Mean over the steady target's Sigma of `function`(|Sigma|, phase): trapezoids over the phase, quad over the rest.

    Given Sigma = r exp(j phase), Re Delta / Sigma is normal around kappa sqrt(C) cos(phase) / r, variance 1 / (2 r^2).
    """
    phase = (np.arange(512) + 0.5) * 2 * np.pi / 512
    signal = np.sqrt(cnr)

    def of_radius(r: float) -> float:
        density = 2 * r * np.exp(-((r - signal) ** 2) - 2 * r * signal * (1 - np.cos(phase)))
        return float(np.mean(density * function(r, phase)))

    span = (max(0.0, signal - 6.5), signal + 6.5)
    return quad(of_radius, *span, points=[signal], epsabs=1e-12, epsrel=1e-12, limit=400)[0]


@CASES
def test_mean_of_a_steady_target_is_that_of_its_conditional_means(kappa: float, cnr: float) -> None:
    mean = average_over_sum_channel(lambda r, phase: kappa * np.sqrt(cnr) * np.cos(phase) / r, cnr)
    assert steady_mean(kappa, cnr) == pytest.approx(mean, abs=1e-9)


@CASES
def test_mean_of_a_fluctuating_target_is_that_of_steady_ones_of_exponential_power(kappa: float, cnr: float) -> None:
    mean = quad(lambda x: steady_mean(kappa, cnr * x) * np.exp(-x), 0, 50, epsabs=1e-12, limit=200)[0]
    assert gaussian_mean(kappa, cnr) == pytest.approx(mean, abs=1e-9)


@LOOKS
@CASES
def test_mean_of_steady_looks_sums_over_poisson(kappa: float, cnr: float, looks: int) -> None:
    j = np.arange(2000)
    mean = kappa * looks * cnr * np.sum(stats.poisson.pmf(j, looks * cnr) / (looks + j))
    assert steady_looks_mean(kappa, cnr, looks) == pytest.approx(mean, abs=1e-9)


def test_steady_looks_lie_between_one_look_and_very_many() -> None:
    assert steady_looks_mean(0.75, 3.0, 1) == pytest.approx(steady_mean(0.75, 3.0), abs=1e-14)
    means = steady_looks_mean(0.75, 3.0, np.array([1, 2, 4, 16, 10_000]))
    assert np.all(np.diff(means) < 0)
    assert means[-1] == pytest.approx(gaussian_mean(0.75, 3.0), abs=1e-4)


@LOOKS
@CASES
def test_law_of_a_fluctuating_target_is_that_of_its_regression(kappa: float, cnr: float, looks: int) -> None:
    """Given the power of Sigma, of a Gamma law, mu is normal: its distribution and spread by quadrature over that."""
    law = gaussian_law(kappa, cnr, looks)
    residual, scale = 1 + kappa**2 * cnr / (cnr + 1), cnr + 1
    mean, reach = float(law.mean()), stats.gamma(looks, scale=scale).isf(1e-13)

    def density(p: float) -> float:
        return (p / scale) ** (looks - 1) * math.exp(-p / scale) / (scale * math.gamma(looks))

    for share in (0.02, 0.16, 0.6, 0.99):
        mu = law.ppf(share)
        assert law.cdf(mu) == pytest.approx(share, abs=1e-12)

        def below(p: float, mu: float = float(mu)) -> float:
            return float(ndtr((mu - mean) * math.sqrt(2 * p / residual)))

        integral = quad(lambda p: below(p) * density(p), 0, reach, epsabs=1e-12, epsrel=1e-12, limit=500)[0]
        assert integral == pytest.approx(share, abs=1e-9)
    variance = quad(lambda p: residual / 2 / p * density(p), 0, np.inf, epsrel=1e-11, limit=500)[0] if looks > 1 else 0
    assert law.std() == (pytest.approx(np.sqrt(variance), rel=1e-8) if looks > 1 else np.inf)
    assert quad(law.pdf, law.mean(), mu)[0] == pytest.approx(0.99 - 0.5, abs=1e-9)


@CASES
def test_law_of_a_steady_target_is_that_of_its_conditional_laws(kappa: float, cnr: float) -> None:
    law = SteadyLaw(kappa, cnr)
    for mu in (-2.0, -0.3, 0.0, kappa, 0.8):

        def below(r: float, phase: np.ndarray, mu: float = mu) -> np.ndarray:
            return stats.norm.cdf((mu - kappa * np.sqrt(cnr) * np.cos(phase) / r) * r * np.sqrt(2))

        assert law.cdf(mu) == pytest.approx(average_over_sum_channel(below, cnr), abs=1e-9)
    for share in (0.05, *NORMAL_SHARES, 0.5, 0.999):
        assert law.cdf(law.ppf(share)) == pytest.approx(share, abs=1e-9)


def test_half_width_of_a_law_is_that_between_its_quantiles() -> None:
    """With many looks Student's law is the normal one."""
    assert s68_of(stats.t(20_000, 0.3, 0.2)) == pytest.approx(0.2, rel=1e-4)
    law = SteadyLaw(0.5, 3.0)
    assert law.cdf(law.ppf(0.5)) == pytest.approx(0.5, abs=1e-9)
    assert s68_of(law) == pytest.approx((law.ppf(NORMAL_SHARES[1]) - law.ppf(NORMAL_SHARES[0])) / 2, abs=1e-12)


@pytest.mark.parametrize("looks", [1, 4])
@pytest.mark.parametrize("steady", [True, False])
def test_means_are_those_of_monte_carlo(looks: int, steady: bool) -> None:
    """Within 3.5 standard errors: 0.006 for one look, 0.0026 for four."""
    kappa, cnr, trials = 0.75, 10**0.5, 40_000
    sample = discriminants(kappa, cnr, looks, trials, 61, steady)
    mean = steady_looks_mean(kappa, cnr, looks) if steady else gaussian_mean(kappa, cnr)
    assert abs(np.mean(sample) - mean) < 3.5 * np.std(sample) / np.sqrt(trials)


@pytest.mark.parametrize("steady", [True, False])
def test_laws_of_one_look_are_those_of_monte_carlo(steady: bool) -> None:
    """Kolmogorov and Smirnov see 1.95 / sqrt(trials) = 1 % of probability."""
    law = SteadyLaw(0.75, 10**0.5) if steady else gaussian_law(0.75, 10**0.5, 1)
    sample = discriminants(0.75, 10**0.5, 1, 40_000, 62, steady)
    assert stats.kstest(sample, law.cdf).pvalue > 0.001


@pytest.mark.parametrize("offset", [0.0, 0.2])
def test_cnr_of_the_sum_channel_is_what_two_detectors_of_unit_noise_add_up_to(offset: float) -> None:
    """Seen by Monte Carlo: 3.5 standard errors of the power of Sigma are 2.5 %."""
    pair, cnr, trials = make_beams("jinc", count=2), 10.0, 20_000
    in_sum = cnr / float(cnr_detector_of(1.0, pair, elevation_at(offset), 0.0))
    rng = np.random.default_rng(63)
    channels = np.sqrt(cnr) * circular(rng, (trials, 1)) * pair.response(elevation_at(offset), 0.0)
    power = np.abs((channels + circular(rng, (trials, 2))).sum(axis=1)) ** 2
    assert np.mean(power) / 2 - 1 == pytest.approx(in_sum, abs=3.5 * np.std(power) / 2 / np.sqrt(trials))


def test_a_detector_of_some_size_sees_less_and_is_still_the_one_meant() -> None:
    """The CNR is that of the detector at hand: a pattern of half the amplitude everywhere changes no ratio of CNRs."""
    pair = make_beams("jinc", count=2)
    half = replace(pair.patterns[0], amplitude=lambda e, a: pair.patterns[0].amplitude(e, a) / 2)
    dimmer = replace(pair, patterns=(half,))
    assert straight_power(pair) == pytest.approx(1.0, rel=1e-14)
    assert straight_power(dimmer) == pytest.approx(0.25, rel=1e-14)
    assert cnr_detector_of(1.0, dimmer, elevation_at(0.1), 0.0) == pytest.approx(
        cnr_detector_of(1.0, pair, elevation_at(0.1), 0.0), rel=1e-14
    )


def test_a_cnr_of_beams_that_see_nothing_straight_ahead_is_refused() -> None:
    pair = make_beams("jinc", count=2)
    blind = replace(pair.patterns[0], amplitude=lambda e, _a: np.zeros_like(np.asarray(e, dtype=np.float64)))
    with refused(UserError, "straight ahead"):
        cnr_detector_of(1.0, replace(pair, patterns=(blind,)), elevation_at(0.0), 0.0)
