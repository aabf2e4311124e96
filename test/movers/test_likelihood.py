"""Likelihood of the lag: what stands still is taken for a mover no more often than stated, whatever it is made of."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

from sal_height.movers.likelihood import HYPOTHESES, LagLikelihood

Complex = npt.NDArray[np.complex128]

BINS = 23
FREQUENCIES = (np.arange(BINS) - BINS // 2) / 32
LAGS = np.arange(-50, 51) * 0.02
STILL = len(LAGS) // 2
LIKELIHOOD = LagLikelihood(FREQUENCIES, np.sinc(FREQUENCIES + LAGS[:, None]), np.abs(FREQUENCIES + LAGS[:, None]) < 1)


def circular(rng: np.random.Generator, *shape: int) -> Complex:
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)


def point(_: np.random.Generator) -> Complex:
    return np.ones(BINS, np.complex128)


def pair(rng: np.random.Generator) -> Complex:
    """Two points as bright as each other in one cell: where their spectra cancel is by chance."""
    phase = 2 * np.pi * rng.uniform()
    return np.asarray(1 + np.exp(1j * (phase - 2 * np.pi * FREQUENCIES)))


def speckle(rng: np.random.Generator) -> Complex:
    places = rng.uniform(-4, 4, 60)
    return np.asarray(np.exp(-2j * np.pi * FREQUENCIES[:, None] * places) @ circular(rng, 60))


def spectrum(target: Callable[[np.random.Generator], Complex], lag: float, snr: float, seed: int) -> Complex:
    rng = np.random.default_rng([91, seed])
    clean = target(rng) * np.sinc(FREQUENCIES + lag)
    noisy = clean * np.sqrt(snr / np.mean(np.abs(clean) ** 2)) + circular(rng, BINS)
    return np.broadcast_to(noisy, (1, len(LAGS), BINS))


def ratio(target: Callable[[np.random.Generator], Complex], lag: float, snr: float, seed: int) -> tuple[float, float]:
    """Twice the logarithm of the likelihood ratio against what stands still, and the most likely lag."""
    (told,) = LIKELIHOOD.of(spectrum(target, lag, snr, seed))
    return float(2 * (told.max() - told[STILL])), float(LAGS[told.argmax()])


@pytest.mark.parametrize("snr", [10.0, 100.0])
@pytest.mark.parametrize("target", [point, pair, speckle])
def test_what_stands_still_is_no_mover(target: Callable[[np.random.Generator], Complex], snr: float) -> None:
    """Of 300 at a rate of 5 %, 15 are allowed, and three standard errors more: 26."""
    threshold = 2 * np.log(HYPOTHESES / 0.05)
    alarms = sum(ratio(target, 0.0, snr, seed)[0] > threshold for seed in range(300))
    assert alarms <= 26


@pytest.mark.parametrize("lag", [-0.7, 0.4])
@pytest.mark.parametrize(("target", "error"), [(point, 0.03), (speckle, 0.25)])
def test_the_lag_is_found(target: Callable[[np.random.Generator], Complex], lag: float, error: float) -> None:
    """Root mean square over 60 targets of 20 dB; a point tells more than speckle."""
    found = np.array([ratio(target, lag, 100.0, seed)[1] for seed in range(60)])
    assert np.sqrt(np.mean((found - lag) ** 2)) < error
    assert abs(np.mean(found) - lag) < error


@pytest.mark.parametrize("lag", [0.2, 0.9])
def test_it_is_the_likelihood_of_a_gaussian_cloud(lag: float) -> None:
    """At one lag, over widths and powers, against the density written out; with sidelobes and without."""
    spectra = spectrum(speckle, lag, 10.0, 1)
    number = int(np.argmin(np.abs(LAGS - lag)))
    known = np.abs(FREQUENCIES + LAGS[number]) < 1
    assert np.all(known) == (lag == 0.2)
    apart = FREQUENCIES[:, None] - FREQUENCIES
    together = (known[:, None] & known) | (apart == 0)
    best = -np.inf
    for gains in (np.sinc(FREQUENCIES + LAGS[number]), np.where(known, np.sinc(FREQUENCIES + LAGS[number]), 0.0)):
        for width in (0.0, 0.15, 0.3, 0.6, 1.2, 2.4, 4.8, 9.6, 1e3):
            alike = together * np.exp(-2 * (np.pi * width * apart) ** 2)
            for decibels in range(-10, 41, 2):
                covariance = np.eye(BINS) + 10 ** (decibels / 10) * gains[:, None] * alike * gains
                _, log_det = np.linalg.slogdet(covariance)
                misfit = np.real(spectra[0, 0].conj() @ np.linalg.solve(covariance, spectra[0, 0]))
                best = max(best, -log_det - misfit)
    assert LIKELIHOOD.of(spectra)[0, number] == pytest.approx(best, rel=1e-5)


def test_many_targets_have_the_likelihoods_that_each_has_alone() -> None:
    many = np.concatenate([spectrum(speckle, 0.2, 10.0, seed) for seed in range(3)])
    alone = [LIKELIHOOD.of(one[None])[0] for one in many]
    np.testing.assert_allclose(LIKELIHOOD.of(many), alone, rtol=1e-5)
