"""Which model a pixel is given: thresholds at their rates, and probabilities that are those of the stated ensemble."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import BEAMWIDTH, circular, elevation_at, few, make_beams
from scipy import integrate, stats
from scipy.ndimage import uniform_filter

from sal_height.beams.array import Beams
from sal_height.elevation.estimators.maximum_likelihood import MlSettings, ml_elevation
from sal_height.elevation.layover._order_kernels import invert_diagonals, weigh_priors
from sal_height.elevation.layover.extended import STEEPNESS
from sal_height.elevation.layover.order import (
    EM_STEPS,
    NEIGHBOURS,
    PRIOR,
    SPREADS,
    TWO,
    detection_threshold,
    log_evidence_of_one,
    log_evidence_of_spread,
    log_probabilities,
    path_length,
)
from sal_height.elevation.looks.looks import DwellColumns, Looks

ONE_PERCENT = 0.01
NOWHERE = np.zeros(0, np.intp), np.zeros(0, np.intp)
PATTERN_NAMES = pytest.mark.parametrize("pattern", ["sinc", "jinc"])


@PATTERN_NAMES
@pytest.mark.parametrize("looks", few(1, [4, 1, 16]))
def test_threshold_is_that_of_noise_in_the_best_direction(pattern: str, looks: int) -> None:
    """Greatest power of noise over direction, 50 000 trials: standard error 0.045 % of 1 %; the bound is 10 % above."""
    beams, rng, trials = make_beams(pattern), np.random.default_rng(51), 50_000
    unit = beams.response(elevation_at(np.arange(-3.75, 3.76, 0.05)), 0.0)
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    power = np.zeros((trials, len(unit)), np.float32)
    for _ in range(looks):
        noise = circular(rng, (trials, beams.count)).astype(np.complex64)
        power += np.abs(noise @ unit.T.astype(np.float32)) ** 2
    share = np.mean(power.max(axis=1) > detection_threshold(path_length(beams, 0.0), looks, ONE_PERCENT))
    assert 0.0075 < share < 0.0112


@pytest.mark.parametrize(("looks", "length"), [(0.6, 3.0), (1.0, 0.0), (4.0, 12.0), (400.0, 100.0)])
@pytest.mark.parametrize("rate", [1e-9, 1e-3, 0.5])
def test_threshold_solves_its_equation(looks: float, length: float, rate: float) -> None:
    """P of noise at the threshold, from scipy's distribution."""
    level, law = detection_threshold(length, looks, rate), stats.gamma(looks)
    assert law.sf(level) + length * np.sqrt(level / np.pi) * law.pdf(level) == pytest.approx(rate, rel=1e-7)


def test_evidence_of_one_is_the_likelihood_integrated_over_the_prior() -> None:
    """Laplace's approximation of the integral over elevation and log power: a tenth off at 4 looks."""
    looks, explained, turning, domain = 4.0, 60.0, 2.0, 7.5

    def likelihood(elevation: float, log_power: float) -> float:
        power = np.exp(log_power)
        energy = explained - (explained - looks) * turning * elevation**2  # the peak's own curvature
        return float(np.exp(energy * power / (1 + power) - looks * np.log1p(power) - 50))

    low, high = np.log(2.0), np.log(2.0) + np.log(1e4)
    integral, _ = integrate.dblquad(likelihood, low, high, -0.7, 0.7)
    expected = np.log(integral / (domain * (high - low))) + 50
    found = log_evidence_of_one(np.array(explained), np.array(looks), np.array(turning), domain)
    assert float(found) == pytest.approx(expected, abs=0.15)


def test_evidence_of_spread_is_the_mean_over_the_prior() -> None:
    """With the gamma law of the power along the slope, which has K - 1/2 degrees."""
    along, looks, power, turning = 9.0, 4.0, 20.0, 2.5
    excess = power * turning * SPREADS**2
    gain = np.exp(along * excess / (1 + excess)) / (1 + excess) ** (looks - 0.5)
    found = log_evidence_of_spread(*(np.array(x) for x in (along, looks * (1 + power), looks, turning, 1.0)), 1.0)
    log_spread = np.linspace(np.log(SPREADS[0]), np.log(SPREADS[-1]), 1000)
    density = np.exp(-STEEPNESS * log_spread)
    gains = np.interp(log_spread, np.log(SPREADS), gain)
    assert float(found) == pytest.approx(np.log(np.average(gains, weights=density)), abs=0.3)


def test_probabilities_are_those_of_bayes_rule() -> None:
    evidence = np.array([[[0.0, 3.0, 2.0, -np.inf, 1.0], [900.0, 0.0, 0.0, 0.0, 905.0]]])
    found = np.exp(log_probabilities(evidence, NOWHERE, DwellColumns(1, 2)))[0]
    np.testing.assert_allclose(found.sum(axis=1), 1, rtol=1e-12)
    expected = PRIOR * np.exp(evidence[0, 0])
    np.testing.assert_allclose(found[0], expected / expected.sum(), rtol=1e-12)
    assert found[1, 0] / found[1, 4] == pytest.approx(PRIOR[0] / PRIOR[4] * np.exp(-5), rel=1e-9)


def test_pixels_around_say_what_is_frequent() -> None:
    """One that may be a pair or spread is most likely what 48 clear ones around it are; alone it is as PRIOR says."""
    evidence = np.zeros((7, 7, 5))
    evidence[..., 2] = 20.0
    evidence[3, 3, [2, 4]] = 20.0
    everywhere = tuple(np.indices((7, 7)).reshape(2, -1))
    found = np.exp(log_probabilities(evidence, everywhere, DwellColumns(1, 7)))[3, 3]
    pairs, spread = 48 + PRIOR[2] / PRIOR[2:].sum(), PRIOR[4] / PRIOR[2:].sum()
    assert found[2] / found[4] == pytest.approx(pairs / spread, rel=1e-3)
    # A pixel is no evidence of what is frequent around itself.
    evidence[3, 3, 2] = 21.0
    here = np.array([0]), np.array([0])
    alone = np.exp(log_probabilities(evidence[3:4, 3:4], here, DwellColumns(1, 1)))[0, 0]
    assert alone[2] / alone[4] == pytest.approx(np.e * PRIOR[2] / PRIOR[4], rel=1e-9)


def ensemble(beams: Beams, model: int, pixels: int, looks: int, rng: np.random.Generator) -> np.ndarray:
    """Looks (pixels, looks, M) of a model with parameters of the prior; several are 0.3 beamwidths apart at least."""
    half = np.ptp(beams.span) / 2 / BEAMWIDTH
    samples = circular(rng, (pixels, looks, beams.count))
    if model == 4:
        low, high = SPREADS[[0, -1]] ** -STEEPNESS
        spread = rng.uniform(high, low, (pixels, 1)) ** (-1 / STEEPNESS)
        pieces = (np.arange(24) - 11.5) / 24 * np.sqrt(12)
        offsets = rng.uniform(-half, half, (pixels, 1)) + spread * pieces
        cnr = np.broadcast_to(10 ** rng.uniform(0, 4, (pixels, 1)) / 24, offsets.shape)
    else:
        offsets = np.sort(rng.uniform(-half, half, (50 * pixels, model)), axis=1)
        apart = (np.diff(offsets, axis=1) > 0.3).all(axis=1)
        offsets = offsets[apart][:pixels]
        cnr = 10 ** rng.uniform(0, 4, offsets.shape)
    for offset, power in zip(offsets.T, cnr.T, strict=True):
        amplitude = np.sqrt(power)[:, None, None] * circular(rng, (pixels, looks, 1))
        samples += amplitude * beams.response(elevation_at(offset), 0.0)[:, None]
    return samples


@pytest.mark.parametrize(
    ("pattern", "channels", "looks"), few(1, [("jinc", 16, 4), ("sinc", 16, 16), ("gaussian", 8, 16)])
)
def test_of_pixels_with_probability_nine_tenths_as_many_are_right(pattern: str, channels: int, looks: int) -> None:
    """Over 6000 pixels of the stated prior; of some 800 with .85 to .95 the standard error is 1 %."""
    beams, rng = make_beams(pattern, channels), np.random.default_rng([64, channels, looks])
    counts = np.round(6000 * PRIOR).astype(int)
    samples = np.concatenate([ensemble(beams, n, count, looks, rng) for n, count in enumerate(counts)])
    truth, order = np.repeat(np.arange(len(PRIOR)), counts), rng.permutation(len(samples))
    truth, samples = truth[order], samples[order]
    covariance = np.einsum("pkm,pkn->pmn", samples, samples.conj()).real.astype(np.float32)[:, None]
    probability = ml_elevation(Looks.of(covariance, looks), beams, MlSettings()).order_probability
    assert probability is not None
    probability = probability[:, 0]
    np.testing.assert_allclose(probability.sum(axis=1), 1, rtol=1e-9)
    greatest = probability.max(axis=1)
    near = (greatest > 0.85) & (greatest < 0.95)
    right = probability.argmax(axis=1) == truth
    assert near.sum() > 400
    assert np.mean(right[near]) == pytest.approx(np.mean(greatest[near]), abs=0.03 + 0.015)
    sure = greatest > 0.99
    assert np.mean(right[sure]) > 0.97


def shared_by_filters(evidence: np.ndarray, here: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Probabilities of the models by moving averages over the whole image."""
    weighed = np.exp(evidence - evidence.max(axis=-1, keepdims=True)) * PRIOR
    found = weighed / weighed.sum(axis=-1, keepdims=True)
    usual = PRIOR[TWO:] / PRIOR[TWO:].sum()
    for _ in range(EM_STEPS):
        shares = np.zeros((*evidence.shape[:2], len(usual)))
        shares[here] = np.where(found[here][:, :TWO].sum(axis=1, keepdims=True) > 0.5, 0.0, found[here][:, TWO:])
        around = uniform_filter(shares, (NEIGHBOURS, NEIGHBOURS, 1), mode="constant")[here] * NEIGHBOURS**2
        around += usual - shares[here]
        prior = np.tile(PRIOR, (len(around), 1))
        prior[:, TWO:] = PRIOR[TWO:].sum() * around / around.sum(axis=1, keepdims=True)
        weighed = np.exp(evidence[here] - evidence[here].max(axis=-1, keepdims=True)) * prior
        found[here] = weighed / weighed.sum(axis=-1, keepdims=True)
    return found


def test_shares_of_the_models_are_those_of_moving_averages() -> None:
    """Of an image with an edge on every side within reach, and of some of its pixels only."""
    rng = np.random.default_rng(64)
    evidence = rng.normal(0, 3, (13, 9, 5))
    here = np.nonzero(rng.random((13, 9)) < 0.7)
    found = np.exp(log_probabilities(evidence, here, DwellColumns(1, 9)))
    np.testing.assert_allclose(found, shared_by_filters(evidence, here), rtol=1e-9)


def test_pixels_of_another_dwell_are_no_neighbours() -> None:
    """The probabilities of three dwells side by side are those of each alone, to the last bit."""
    rng = np.random.default_rng(65)
    evidence, chosen = rng.normal(0, 3, (13, 12, 5)), rng.random((13, 12)) < 0.7
    together, one = log_probabilities(evidence, np.nonzero(chosen), DwellColumns(3, 4)), DwellColumns(1, 4)
    for part in DwellColumns(3, 4).slices:
        alone = log_probabilities(evidence[:, part], np.nonzero(chosen[:, part]), one)
        np.testing.assert_array_equal(together[:, part], alone)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_small_matrices_are_inverted_as_by_lapack(count: int) -> None:
    root = np.random.default_rng([65, count]).normal(size=(20, count, count))
    matrices, diagonals = root @ np.swapaxes(root, 1, 2), np.empty((20, count))
    invert_diagonals(matrices.copy(), diagonals)
    np.testing.assert_allclose(diagonals, np.diagonal(np.linalg.inv(matrices), axis1=1, axis2=2), rtol=1e-7)


@pytest.mark.parametrize("hermitian", [False, True])
@pytest.mark.parametrize("count", [2, 3])
def test_shares_of_the_prior_are_those_of_matrix_algebra(count: int, hermitian: bool) -> None:
    """Pixels of random information, real and complex."""
    rng, looks, ranges = np.random.default_rng([66, count]), np.arange(1.0, 21), np.array([7.5, 9.2])

    def positive(is_complex: bool) -> np.ndarray:
        root = rng.normal(size=(20, count, count)) + (1j * rng.normal(size=(20, count, count)) if is_complex else 0.0)
        return root @ np.swapaxes(root.conj(), 1, 2)

    turning, inverses, information = positive(hermitian), positive(hermitian), positive(is_complex=False)
    powers, found = rng.uniform(2, 50, (20, count)), np.empty(20)
    weigh_priors(turning, inverses, powers, information, looks, ranges, found)
    power = powers[:, :, None] * np.eye(count)
    known = power @ np.linalg.inv(power + inverses) @ power
    of_places = 2 * looks[:, None, None] * (turning * np.swapaxes(known, 1, 2)).real
    scaled = ranges[:, None, None, None] ** 2 / (2 * np.pi) * np.stack([of_places, information]) + np.eye(count)
    np.testing.assert_allclose(found, -0.5 * np.linalg.slogdet(scaled)[1].sum(axis=0), rtol=1e-7)
