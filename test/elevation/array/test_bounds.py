"""Cramer-Rao bounds against numerical Fisher informations and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import BEAMWIDTH, beams_named, elevation_at, make_beams

from sal_height.beams.pattern import PATTERNS
from sal_height.elevation.array.bounds import (
    conditional_crb,
    information,
    speckle_crb,
    stochastic_crb,
    stochastic_deviation,
)

STEP = 1e-3
"""Of central differences, beamwidths: good to STEP^2 / 6 * |a'''| / |a'|, 1e-5 of the bound."""


def inverse_of(information_matrix: np.ndarray) -> float:
    """Least standard deviation of the first parameter."""
    return float(np.sqrt(np.linalg.inv(information_matrix)[0, 0]))


BEAMS = pytest.mark.parametrize("name", [*sorted(PATTERNS), "complex"])
TARGETS = pytest.mark.parametrize(("offset", "cnr"), [(0.0, 100.0), (1.75, 3.0), (3.6, 0.5)])


@BEAMS
@TARGETS
@pytest.mark.parametrize("squint", [0.0, 0.4 * BEAMWIDTH])
def test_stochastic_bound_is_the_inverse_fisher_information(
    name: str, squint: float, offset: float, cnr: float
) -> None:
    """Slepian-Bangs for Gaussian channels with covariance P a a^H + s I, unknown elevation, P and s."""
    beams, looks = beams_named(name), 4

    def covariance(parameters: np.ndarray) -> np.ndarray:
        a = beams.response(elevation_at(parameters[0]), squint)
        return parameters[1] * np.outer(a, a.conj()) + parameters[2] * np.eye(len(a))

    point = np.array([offset, cnr, 1.0])
    inverse = np.linalg.inv(covariance(point))
    slopes = [
        inverse @ (covariance(point + STEP * unit) - covariance(point - STEP * unit)) / (2 * STEP) for unit in np.eye(3)
    ]
    fisher = looks * np.array([[np.trace(first @ second).real for second in slopes] for first in slopes])
    bound = stochastic_crb(beams, elevation_at(offset), squint, cnr, looks) / BEAMWIDTH
    assert bound == pytest.approx(inverse_of(fisher), rel=2e-5)


@BEAMS
@TARGETS
def test_conditional_bound_is_the_inverse_fisher_information(name: str, offset: float, cnr: float) -> None:
    """Slepian-Bangs for Gaussian channels of mean A_k a, unknown elevation and complex A_k, K |A|^2 in all."""
    beams, looks = beams_named(name), 3
    amplitudes = np.sqrt(cnr * looks * np.array([0.5, 0.2, 0.3])) * np.exp([0.3j, 1j, 2j])

    def mean(parameters: np.ndarray) -> np.ndarray:
        a = beams.response(elevation_at(parameters[0]), 0.0)
        return np.outer(parameters[1 : 1 + looks] + 1j * parameters[1 + looks :], a).ravel()

    point = np.concatenate([[offset], amplitudes.real, amplitudes.imag])
    slopes = np.array([(mean(point + STEP * u) - mean(point - STEP * u)) / (2 * STEP) for u in np.eye(len(point))])
    bound = conditional_crb(beams, elevation_at(offset), 0.0, cnr, looks) / BEAMWIDTH
    assert bound == pytest.approx(inverse_of(2 * (slopes.conj() @ slopes.T).real), rel=2e-5)


def test_speckle_bound_is_the_mean_of_the_conditional_one() -> None:
    beams, looks, cnr = make_beams("jinc"), 4, 5.0
    trials = 200_000
    energy = cnr * np.random.default_rng(41).gamma(looks, size=trials)
    variances = conditional_crb(beams, elevation_at(0.6), 0.0, energy / looks, looks) ** 2
    bound = speckle_crb(beams, elevation_at(0.6), 0.0, cnr, looks)
    assert bound**2 == pytest.approx(
        np.mean(variances), rel=3.5 * np.std(variances) / np.mean(variances) / 200_000**0.5
    )
    assert speckle_crb(beams, elevation_at(0.6), 0.0, cnr, 1) == np.inf


@pytest.mark.parametrize(("pattern", "closed"), [("sinc", np.pi**2 / 3), ("jinc", 32 / 15)])
@pytest.mark.parametrize("pitch", [0.3, 0.5, 0.8])
@pytest.mark.parametrize("offset", [0.0, 0.1])
def test_information_of_an_endless_array(pattern: str, closed: float, pitch: float, offset: float) -> None:
    """By Parseval. Of sinc, detectors beyond L hold cos^2(pi x) / x^2, that is 1 / (L pitch) of `closed` / pitch."""
    beams = make_beams(pattern, count=8001, pitch=pitch)
    there = information(beams, elevation_at(offset), 0.0) * BEAMWIDTH**2
    assert there == pytest.approx(closed / pitch, rel=1 / (4000 * pitch * closed) + 1e-6)


@pytest.mark.parametrize(("pattern", "array", "share"), [("sinc", 6.084, 0.196), ("jinc", 4.210, 0.163)])
def test_the_adjacent_pair_holds_a_fifth_of_the_information(pattern: str, array: float, share: float) -> None:
    beams = make_beams(pattern)
    whole, pair = (information(some, elevation_at(0.0), 0.0) * BEAMWIDTH**2 for some in (beams, beams.pair(7)))
    assert whole == pytest.approx(array, abs=5e-4)
    assert pair / whole == pytest.approx(share, abs=5e-4)


@pytest.mark.parametrize("offset", [0.0, 0.2, -0.4])
def test_bound_of_a_pair_is_that_of_its_discriminant(offset: float) -> None:
    """With mu = Delta / Sigma of sinc beams in closed form: (1 + mu^2) / (2 K C_S mu'^2) (1 + 1 / (C_S (1 + mu^2)))."""

    def discriminant(t: float) -> float:
        return float((4 * t - np.tan(np.pi * t)) / (1 - 4 * t * np.tan(np.pi * t)))

    looks, cnr, t = 4, 3.0, offset or 1e-6
    mu, slope = discriminant(t), (discriminant(t + STEP) - discriminant(t - STEP)) / (2 * STEP)
    in_sum = cnr * (np.sinc(t - 0.25) + np.sinc(t + 0.25)) ** 2 / 2
    expected = np.sqrt((1 + mu**2) / (2 * looks * in_sum * slope**2) * (1 + 1 / (in_sum * (1 + mu**2))))
    bound = stochastic_crb(make_beams("sinc").pair(4), elevation_at(-1.5 + t), 0.0, cnr, looks)
    assert bound / BEAMWIDTH == pytest.approx(expected, rel=2e-5)


def test_bounds_without_a_target_are_infinite_and_all_broadcast() -> None:
    beams, squint = make_beams("jinc"), np.zeros((3, 1))
    for bound in (conditional_crb, stochastic_crb, speckle_crb):
        result = bound(beams, elevation_at(np.array([0.0, 1.0])), squint, np.array([0.0, 2.0]), 4)
        assert result.shape == (3, 2)
        np.testing.assert_array_equal(np.isinf(result), np.tile([True, False], (3, 1)))


@pytest.mark.parametrize("determined", [0.0, -1e-12])
def test_bound_is_infinite_where_nothing_tells_of_elevation(determined: float) -> None:
    """Rounding leaves D a little below 0 where a pixel's beams do not turn."""
    assert stochastic_deviation(np.array([5.0]), 4, np.array([2.0]), np.array([determined])) == np.inf
