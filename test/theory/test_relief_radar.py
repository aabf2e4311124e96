"""Noise of the sum-difference discriminator: closed forms against quadrature and Monte Carlo."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import circular, standard_error_of_rms
from scipy import stats
from scipy.integrate import quad

from sal_height.elevation.monopulse.estimators import (
    DISCRIMINANTS,
    NoisePowers,
    discriminate,
    discriminator_variance,
    products,
    products_variance,
    ratio,
    total_least_squares,
)
from sal_height.theory.discriminator_noise import SteadyLaw, SteadyMlLaw, s68_of
from sal_height.theory.link_budget import hybrid_gain, synthesise

Array = np.ndarray
EQUAL: NoisePowers = (1.0, 1.0)
SUM_DIFFERENCE = np.array([[1.0, 1.0], [-1.0, 1.0]])


def one_look(gamma: float, snr: float, trials: int, seed: int, noise: NoisePowers = EQUAL) -> tuple[Array, Array]:
    """Sigma and Delta of a steady target, shape (trials, 1); `snr` over a noise power of 1."""
    rng = np.random.default_rng(seed)
    parts = (np.sqrt(power) * circular(rng, (trials, 1)) for power in noise)
    return np.sqrt(snr) + next(parts), gamma * np.sqrt(snr) + next(parts)


def variance_of(law: SteadyLaw) -> float:
    """Of what lies within 1.5 of kappa: at 20 dB that is all but less than 1e-18."""
    edges = np.linspace(law.kappa - 1.5, law.kappa + 1.5, 20_001)
    middle, share = (edges[1:] + edges[:-1]) / 2, np.diff(law.cdf(edges))
    return float(np.sum(share * middle**2) - np.sum(share * middle) ** 2)


@pytest.mark.parametrize("gamma", [-1.0, 0.0, 0.5])
@pytest.mark.parametrize(("name", "law", "times"), [("ratio", SteadyLaw, 1), ("tls", SteadyMlLaw, 2)])
def test_variance_at_20_db_is_the_first_order_one_within_3_per_cent(
    name: str, law: type[SteadyLaw], times: int, gamma: float
) -> None:
    """One pulse train, steady target. The exact law says how far it is: 1 to 1.5 %, or 2 to 3.1 % for the exact ML.

    Second order leaves 0.2 % of it; the standard error of the sample's variance is 0.3 %.
    """
    trials, snr = 200_000, 100.0
    first = float(discriminator_variance(gamma, snr, EQUAL))
    assert first == pytest.approx((1 + gamma**2) / (2 * snr), rel=1e-15)
    exact = variance_of(law(gamma, snr)) / first
    assert abs(exact - 1) < (0.03 if times * abs(gamma) < 2 else 0.0315)
    assert exact - 1 == pytest.approx(times * (1 + 2 * gamma**2) / (1 + gamma**2) / snr, abs=0.002)
    sample = discriminate(products(*one_look(gamma, snr, trials, 43)), DISCRIMINANTS[name], EQUAL)
    share = np.var(sample) / first
    standard_error = 2 * standard_error_of_rms(sample - np.mean(sample)) / np.std(sample) * share
    assert standard_error < 0.004
    assert abs(share - exact) < 3.5 * standard_error


@pytest.mark.parametrize("noise", [(1.0, 4.0), (1.0, 0.25)])
@pytest.mark.parametrize("gamma", [-0.8, 0.4])
def test_unequal_noise_has_the_variance_that_is_said_and_no_bias(gamma: float, noise: NoisePowers) -> None:
    """26 dB in Sigma: second order adds less than 1.2 % to the variance, and gamma / (2 x) to the mean."""
    trials, snr = 100_000, 400.0
    sample = discriminate(products(*one_look(gamma, snr, trials, 44, noise)), total_least_squares, noise)
    variance = float(discriminator_variance(gamma, snr, noise))
    assert np.mean(sample) == pytest.approx(gamma * (1 + 1 / (2 * snr)), abs=3.5 * np.sqrt(variance / trials))
    assert np.var(sample) / variance == pytest.approx(1, abs=3.5 * np.sqrt(2 / trials) + 0.012)


@pytest.mark.parametrize(("gamma", "snr"), [(0.5, 0.5), (-0.3, 3.0), (1.0, 30.0), (0.0, 1000.0)])
def test_law_of_the_maximum_likelihood_is_that_of_its_sample(gamma: float, snr: float) -> None:
    """Kolmogorov and Smirnov see 1.95 / sqrt(trials) = 1 % of probability."""
    sample = discriminate(products(*one_look(gamma, snr, 40_000, 46)), total_least_squares, EQUAL)
    law = SteadyMlLaw(gamma, snr)
    assert stats.kstest(sample, law.cdf).pvalue > 0.001
    low, high = np.quantile(sample, (0.158655, 0.841345))
    assert s68_of(law) == pytest.approx((high - low) / 2, rel=0.02)


def test_law_of_the_maximum_likelihood_is_that_of_two_independent_phases() -> None:
    """The density of a phase in noise, and the difference of two such, by quadrature."""
    gamma, snr = 0.4, 2.0
    root = np.sqrt(snr * (1 + gamma**2) / 2)

    def density(phase: Array) -> Array:
        along = root * np.cos(phase)
        rest = np.sqrt(np.pi) * along * np.exp(along**2 - root**2) * (2 - 2 * stats.norm.cdf(-along * np.sqrt(2)))
        return (np.exp(-(root**2)) + rest) / (2 * np.pi)

    phase = np.arange(256) * 2 * np.pi / 256
    for mu in (-2.0, 0.1, 0.4, 3.0):

        def below(half: float) -> float:
            apart = 2 * (half - np.arctan(gamma))
            return float(2 * np.mean(density(phase) * density(apart - phase)) * 2 * np.pi)

        share = quad(below, -np.pi / 2, np.arctan(mu), epsabs=1e-11)[0]
        assert SteadyMlLaw(gamma, snr).cdf(mu) == pytest.approx(share, abs=1e-9)


@pytest.mark.parametrize("noise", [(1.0, 1.0), (1.0, 0.25)])
def test_products_of_weak_pulses_have_more_variance_than_their_coherent_sum(noise: NoisePowers) -> None:
    """400 pulses of -3 dB: 2.6 or 2 times as much. Second order adds 1 %; the standard error is 1.6 %."""
    gamma, snr, pulses, trials = 0.5, 0.5, 400, 8000
    rng = np.random.default_rng(61)
    total = np.sqrt(snr) + np.sqrt(noise[0]) * circular(rng, (trials, pulses))
    difference = gamma * np.sqrt(snr) + np.sqrt(noise[1]) * circular(rng, (trials, pulses))
    coherent = [synthesise(channel, np.zeros(1))[:, None] for channel in (total, difference)]
    samples = [discriminate(products(*z), total_least_squares, noise) for z in ((total, difference), coherent)]
    expected = [
        float(products_variance(gamma, snr * pulses, pulses, noise)),
        float(discriminator_variance(gamma, snr * pulses, noise)),
    ]
    assert expected[0] / expected[1] == pytest.approx(1 + 1 / snr / (1 / noise[0] + gamma**2 / noise[1]))
    for sample, variance in zip(samples, expected, strict=True):
        assert np.var(sample) / variance == pytest.approx(1, abs=3.5 * np.sqrt(2 / trials) + 0.02)


@pytest.mark.parametrize(("coupling", "loss_db"), [(2**-0.5, 0.0), (1.0, 0.0), (2**-0.5, 3.0)])
def test_hybrid_before_the_receivers_gains_what_is_said(coupling: float, loss_db: float) -> None:
    """0, 3.01 and -3 dB; the laws of gamma before and after have that ratio of widths within second order."""
    gain = float(hybrid_gain(coupling, 10 ** (loss_db / 10)))
    assert 10 * np.log10(gain) == pytest.approx(20 * np.log10(coupling * np.sqrt(2)) - loss_db)
    rng, trials, gamma, snr = np.random.default_rng(57), 40_000, 0.5, 100.0
    half = np.array([[1 - gamma], [1 + gamma]])[:, None] * np.sqrt(snr / 2)  # lower, upper: (u + l)^2 / 2 = snr
    after = np.tensordot(SUM_DIFFERENCE, half + circular(rng, (2, trials, 1)), 1)
    before = coupling * np.tensordot(SUM_DIFFERENCE, half, 1) / 10 ** (loss_db / 20) + circular(rng, (2, trials, 1))
    widths = [np.std(discriminate(products(*channels), ratio, EQUAL)) for channels in (after, before)]
    assert widths[0] ** 2 / widths[1] ** 2 == pytest.approx(gain, rel=3.5 * np.sqrt(4 / trials) + 0.02)
    assert s68_of(SteadyLaw(gamma, snr)) == pytest.approx(widths[0], rel=0.02)
