"""Two scatterers in a pixel: told from one as often as promised, and each at its bound."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import BEAMWIDTH, circular, elevation_at, make_beams, multilook, offset_of

from sal_height.beams.array import Beams
from sal_height.beams.pattern import PATTERNS, Pattern
from sal_height.elevation import layover
from sal_height.elevation.layover import TwoScatterers, detection_threshold, two_scatterers
from sal_height.elevation.likelihood import OBJECTIVES, peak_elevation, search_guard
from sal_height.elevation.looks import Looks

ONE_PERCENT = 0.01
STEP = 1e-3
"""Of central differences, beamwidths: good to 1e-5 of the bound."""

PATTERN_NAMES = pytest.mark.parametrize("pattern", ["sinc", "jinc"])


def bent(pattern: Pattern) -> Pattern:
    """A complex pattern, whose phase grows with the square of the angle."""

    def phasor(e: np.ndarray) -> np.ndarray:
        return np.exp(0.3j * np.asarray(e) ** 2)

    return Pattern(
        "bent",
        lambda e, a: pattern.amplitude(e, a) * phasor(e),
        lambda e, a: (pattern.slope(e, a) + 0.6j * np.asarray(e) * pattern.amplitude(e, a)) * phasor(e),
        lambda e, a: pattern.azimuth_slope(e, a) * phasor(e),
        pattern.main_lobe,
    )


def beams_named(name: str) -> Beams:
    if name != "complex":
        return make_beams(name)
    patterns = tuple(bent(PATTERNS["jinc"]) if i % 3 else PATTERNS["jinc"] for i in range(16))
    return replace(make_beams(), patterns=patterns)


def pixels_of(
    beams: Beams, offsets: np.ndarray, cnrs: tuple[float, ...], looks: int, rng: np.random.Generator
) -> np.ndarray:
    """Covariance (pixels, 1, M, M) of fluctuating scatterers at `offsets` (pixels, scatterers) in unit noise."""
    slc = circular(rng, (len(offsets), looks, beams.count))
    for offset, cnr in zip(offsets.T, cnrs, strict=True):
        response = beams.response(elevation_at(offset), 0.0)[:, None]
        slc += response * np.sqrt(cnr) * circular(rng, (len(offset), looks, 1))
    return multilook(np.moveaxis(slc, -1, 0), 1, looks, hermitian=beams.is_complex).covariance[:, :]


def find(covariance: np.ndarray, beams: Beams, looks: int, squint: np.ndarray | None = None) -> TwoScatterers:
    """At unit noise and 1 % false alarms, of images with one column or as many as `squint`."""
    return find_in(Looks.of(covariance, looks, 0.0 if squint is None else squint), beams)


def find_in(looks: Looks, beams: Beams) -> TwoScatterers:
    """In all pixels."""
    single = peak_elevation(looks, beams, OBJECTIVES["normalised"], search_guard(beams))
    return two_scatterers(looks, beams, single, np.full(single.shape, True), ONE_PERCENT)


def noise_free(beams: Beams, offsets: np.ndarray, energies: tuple[float, float], squint: float) -> np.ndarray:
    """Covariance (pixels, M, M) of independent scatterers at `offsets` (pixels, 2)."""
    response = beams.response(elevation_at(offsets), squint)
    return np.einsum("s,psm,psn->pmn", energies, response, response.conj())


def pairs(separation: np.ndarray | float, count: int = 40, half: float = 3.6) -> np.ndarray:
    """Offsets (pairs, 2) of pairs of one separation, all over the array."""
    middle = np.linspace(-half, half, count) * (1 - np.max(separation) / 2 / half)
    return np.stack([middle - separation / 2, middle + separation / 2], axis=-1)


@pytest.mark.parametrize("name", [*sorted(PATTERNS), "complex"])
@pytest.mark.parametrize("separation", [0.5, 1.0, 2.9])
def test_both_are_exact_without_noise_in_columns_of_their_own_squint(name: str, separation: float) -> None:
    beams, offsets, looks = beams_named(name), pairs(separation), 4
    squints = np.array([-0.4, 0.0, 0.7, 0.0]) * BEAMWIDTH
    covariance = np.stack([noise_free(beams, offsets, (4e4, 1e4), s) for s in squints], axis=1)
    kind = np.complex64 if name == "complex" else np.float32
    result = find(covariance.astype(kind), beams, looks, squints)
    assert np.all(result.detected)
    np.testing.assert_allclose(
        offset_of(result.elevation), np.broadcast_to(offsets[:, None], result.elevation.shape), atol=5e-4
    )
    gram = np.stack(
        [np.linalg.inv(a.conj() @ np.swapaxes(a, -1, -2)) for s in squints for a in [responses(beams, offsets, s)]], 1
    )
    taken_for_noise = np.diagonal(gram, axis1=-2, axis2=-1).real
    np.testing.assert_allclose(result.power + taken_for_noise, [[[1e4, 2.5e3]]] * np.ones((40, 4, 1)), rtol=5e-3)


def responses(beams: Beams, offsets: np.ndarray, squint: float) -> np.ndarray:
    return beams.response(elevation_at(offsets), squint)


def numerical_bound(beams: Beams, offsets: tuple[float, float], signal: np.ndarray, squint: float) -> np.ndarray:
    """Beamwidths, of 4 looks, by the Fisher information of Gaussian channels of covariance A S A^H + s I.

    Slepian-Bangs; unknown are the elevations, Hermitian S, and s.
    """

    def covariance(x: np.ndarray) -> np.ndarray:
        a = responses(beams, x[:2], squint).T
        signal = np.array([[x[2], x[4] + 1j * x[5]], [x[4] - 1j * x[5], x[3]]])
        return a @ signal @ a.conj().T + x[6] * np.eye(len(a))

    point = np.array([*offsets, *np.diagonal(signal).real, signal[0, 1].real, signal[0, 1].imag, 1.0])
    inverse = np.linalg.inv(covariance(point))
    slopes = [
        inverse @ (covariance(point + STEP * unit) - covariance(point - STEP * unit)) / (2 * STEP) for unit in np.eye(7)
    ]
    fisher = 4 * np.array([[np.trace(first @ second).real for second in slopes] for first in slopes])
    return np.sqrt(np.diagonal(np.linalg.inv(fisher))[:2])


def two_source_crb(
    beams: Beams, elevations: np.ndarray, squint: float, cnrs: np.ndarray | tuple[float, float], looks: int
) -> np.ndarray:
    """Cramer-Rao bound (rad) of two independent Gaussian scatterers of unknown power, shape (..., 2)."""
    model = layover._PairModel.of(beams, elevations, np.asarray(squint))
    signal = np.maximum(cnrs, 0.0)[..., None] * np.eye(2)
    return model.bound(signal @ np.linalg.inv(signal + model.gram) @ signal, looks)


PAIRS = pytest.mark.parametrize(
    ("offsets", "cnrs"), [((-0.5, 0.5), (100.0, 100.0)), ((1.2, 1.7), (3.0, 50.0)), ((-3.5, 2.0), (0.5, 9.0))]
)


@pytest.mark.parametrize("name", ["sinc", "jinc", "gaussian", "complex"])
@PAIRS
def test_bound_is_the_inverse_fisher_information(
    name: str, offsets: tuple[float, float], cnrs: tuple[float, float]
) -> None:
    beams, squint = beams_named(name), 0.3 * BEAMWIDTH
    bound = two_source_crb(beams, elevation_at(offsets), squint, cnrs, 4) / BEAMWIDTH
    np.testing.assert_allclose(bound, numerical_bound(beams, offsets, np.diag(cnrs), squint), rtol=5e-5)


@pytest.mark.parametrize("name", ["sinc", "complex"])
@PAIRS
def test_bound_of_a_few_looks_knows_how_they_interfere(
    name: str, offsets: tuple[float, float], cnrs: tuple[float, float]
) -> None:
    """Amplitudes that are correlated, as those of a few looks always are; less noise, at first order, is 1e-6 off."""
    beams = beams_named(name)
    signal = 1e4 * np.diag(cnrs).astype(complex)
    signal[0, 1] = 0.8 * np.exp(0.9j) * np.sqrt(signal[0, 0] * signal[1, 1])
    signal[1, 0] = signal[0, 1].conj()
    model = layover._PairModel.of(beams, elevation_at(offsets), 0.0)
    bound = model.bound(signal - model.gram, 4) / BEAMWIDTH
    np.testing.assert_allclose(bound, numerical_bound(beams, offsets, signal, 0.0), rtol=5e-4)


def test_bound_broadcasts_and_is_infinite_for_one_scatterer() -> None:
    cnrs = np.array([[1.0, 1.0], [1.0, 0.0], [-1.0, 2.0]])
    bound = two_source_crb(make_beams(), elevation_at([-0.5, 0.5]), 0.0, cnrs, 4)
    np.testing.assert_array_equal(np.isfinite(bound), [[True, True], [False, False], [False, False]])


@PATTERN_NAMES
@pytest.mark.parametrize("looks", [1, 4, 16])
def test_threshold_is_that_of_noise_in_the_best_direction(pattern: str, looks: int) -> None:
    """Greatest power of noise over direction, 50 000 trials: standard error 0.045 % of 1 %; the bound is 10 % above."""
    beams, rng, trials = make_beams(pattern), np.random.default_rng(51), 50_000
    unit = beams.response(elevation_at(np.arange(-3.75, 3.76, 0.05)), 0.0)
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    power = np.zeros((trials, len(unit)), np.float32)
    for _ in range(looks):
        noise = circular(rng, (trials, beams.count)).astype(np.complex64)
        power += np.abs(noise @ unit.T.astype(np.float32)) ** 2
    share = np.mean(power.max(axis=1) > detection_threshold(beams, 0.0, looks, ONE_PERCENT))
    assert 0.0075 < share < 0.0112


@PATTERN_NAMES
@pytest.mark.parametrize("looks", [2, 4, 8, 16])
@pytest.mark.parametrize("level", [0, 5, 10, 15, 20, 25])
def test_one_scatterer_is_taken_for_two_as_often_as_promised(pattern: str, looks: int, level: int) -> None:
    """3000 pixels at `level` dB anywhere in the array: standard error 0.18 % of 1 %, 3.5 of them allowed."""
    beams, rng = make_beams(pattern), np.random.default_rng(52)
    covariance = pixels_of(beams, rng.uniform(-3.75, 3.75, (3000, 1)), (10 ** (level / 10),), looks, rng)
    result = find(covariance, beams, looks)
    assert np.mean(result.detected) < ONE_PERCENT + 3.5 * np.sqrt(ONE_PERCENT / 3000)


def test_false_alarms_are_not_much_rarer_than_promised() -> None:
    """Measured 0.7 % of 20 000 pixels, standard error 0.06 %: the detector does not give away what it could see."""
    beams, rng = make_beams("sinc"), np.random.default_rng(53)
    covariance = pixels_of(beams, rng.uniform(-3.75, 3.75, (20_000, 1)), (10.0,), 8, rng)
    assert 0.005 < np.mean(find(covariance, beams, 8).detected) < 0.0125


@PATTERN_NAMES
@pytest.mark.parametrize("separation", [0.5, 0.75, 1.0, 2.0])
@pytest.mark.parametrize("ratio", [1.0, 10**-0.6])
def test_two_are_detected_and_each_is_at_its_bound(pattern: str, separation: float, ratio: float) -> None:
    """20 dB, the second as strong or 6 dB weaker, 16 looks, 2000 pixels.

    Standard error of half the width from 16 to 84 %: 2.1 %; the mean over Gaussian looks makes 16 / 15 of the
    variance, or 3 % more width.
    """
    beams, rng, looks, cnrs = make_beams(pattern), np.random.default_rng(54), 16, (100.0, 100.0 * ratio)
    offsets = rng.uniform(-2.5, 2.5, (2000, 1)) + np.array([-separation / 2, separation / 2])
    result = find(pixels_of(beams, offsets, cnrs, looks, rng), beams, looks)
    found = result.detected[:, 0]
    assert np.mean(found) > 0.999
    error = (offset_of(result.elevation[:, 0]) - offsets)[found]
    bound = two_source_crb(beams, elevation_at(offsets), 0.0, cnrs, looks)[found] / BEAMWIDTH
    np.testing.assert_allclose(half_width(error / bound), 1.03, atol=0.08)
    score = error / result.sigma[:, 0][found] * BEAMWIDTH
    np.testing.assert_allclose(half_width(score), 1, atol=0.08)
    assert np.mean(np.abs(score) > 3) < 0.0027 + 3.5 * np.sqrt(0.0027 / 4000) + 0.002  # few looks: longer tails
    np.testing.assert_allclose(result.power[:, 0][found].mean(axis=0), cnrs, rtol=0.06)  # fitted to noise, too


def test_sigma_knows_the_noise_in_the_amplitudes() -> None:
    """At 7 dB and 64 looks noise makes up 5 % of the bound; the standard error of the median of 1000 is below 1 %."""
    beams, rng, cnrs = make_beams("sinc"), np.random.default_rng(60), (5.0, 5.0)
    result = find(pixels_of(beams, np.tile([-0.5, 0.5], (1000, 1)), cnrs, 64, rng), beams, 64)
    bound = two_source_crb(beams, elevation_at([-0.5, 0.5]), 0.0, cnrs, 64)
    np.testing.assert_allclose(np.nanmedian(result.sigma[:, 0], axis=0), bound, rtol=0.03)


def half_width(values: np.ndarray) -> np.ndarray:
    """Half the distance from the 16 to the 84 % quantile of each column."""
    low, high = np.percentile(values, [16, 84], axis=0)
    return (high - low) / 2


@pytest.mark.parametrize(
    ("separation", "cnr", "looks", "least", "most"),
    [(0.5, 10.0, 4, 0.80, 0.90), (0.3, 10.0, 4, 0.34, 0.46), (0.2, 10.0, 4, 0.07, 0.15), (0.1, 10.0, 4, 0.0, 0.02)],
)
def test_too_near_ones_are_found_less_often_and_never_too_sure(
    separation: float, cnr: float, looks: int, least: float, most: float
) -> None:
    """3000 pixels, standard error of the share 0.9 % at most.

    Whatever passes for a pair by chance is as rare as false alarms; beside them sigma holds the errors.
    """
    beams, rng = make_beams("sinc"), np.random.default_rng(55)
    offsets = rng.uniform(-2.5, 2.5, (3000, 1)) + np.array([-separation / 2, separation / 2])
    result = find(pixels_of(beams, offsets, (cnr, cnr), looks, rng), beams, looks)
    assert least < np.mean(result.detected) < most
    too_sure = np.abs(result.elevation[:, 0] - elevation_at(offsets)) > 3 * result.sigma[:, 0]
    assert np.mean(too_sure.any(axis=1)) < 0.0027 * 2 * np.mean(result.detected) + 2 * ONE_PERCENT
    for values in (result.elevation, result.power, result.sigma):
        np.testing.assert_array_equal(np.isfinite(values).any(axis=2) | result.detected, result.detected)


@pytest.mark.parametrize("name", ["sinc", "complex"])
def test_no_pair_explains_more_than_the_one_that_was_found(name: str) -> None:
    """Against all pairs in steps of 0.04 beamwidths, over the array and 3 beamwidths around it.

    0.1 noise powers are left to pairs at the least separation; 14 make a detection.
    """
    beams, rng, looks = beams_named(name), np.random.default_rng(56), 4
    offsets = np.sort(rng.uniform(-3.5, 3.5, (150, 2)), axis=1)
    covariance = pixels_of(beams, offsets, (10.0, 30.0), looks, rng)
    result = find(covariance, beams, looks)
    found = np.flatnonzero(result.detected[:, 0])
    assert len(found) > 100
    place = np.arange(-6.98, 7, 0.04)
    fine = responses(beams, place, 0.0)
    fine /= np.linalg.norm(fine, axis=1, keepdims=True)
    overlap = fine.conj() @ fine.T
    apart = np.abs(place[:, None] - place) > layover.LEAST_SEPARATION
    weight = np.divide(1, 1 - np.abs(overlap) ** 2, where=apart, out=np.zeros(apart.shape))
    for pixel in found:
        products = fine.conj() @ covariance[pixel, 0] @ fine.T
        own = np.diagonal(products).real
        dense = np.max((own[:, None] + own - 2 * (overlap.conj() * products).real) * weight)
        a = beams.response(result.elevation[pixel, 0], 0.0).T
        mine = np.trace(a @ np.linalg.pinv(a) @ covariance[pixel, 0]).real
        assert mine > dense - 0.1


@pytest.mark.parametrize("name", ["sinc", "complex"])
def test_pixels_are_suspicious_by_what_a_second_one_beside_the_single_explains(name: str) -> None:
    """Against projectors, in units of the noise power."""
    beams, rng = beams_named(name), np.random.default_rng(59)
    covariance = pixels_of(beams, rng.uniform(-3.5, 3.5, (20, 2)), (10.0, 3.0), 4, rng)[:, 0]
    first, grid = elevation_at(rng.uniform(-3.5, 3.5, 20)), layover._PairGrid.of(beams, 0.0)
    gain = grid.gain_beside(covariance, first)
    for pixel, matrix in enumerate(covariance):
        one = beams.response(first[pixel], 0.0)
        nodes = beams.response(grid.nodes, 0.0)
        beyond = nodes - np.outer(nodes @ one.conj(), one) / np.linalg.norm(one) ** 2
        norm = np.linalg.norm(beyond, axis=1)
        apart = norm > np.sqrt(layover.LEAST_RESIDUE) * np.linalg.norm(nodes, axis=1)
        unit = beyond[apart] / norm[apart, None]
        expected = np.max(np.einsum("jm,mn,jn->j", unit.conj(), matrix, unit).real)
        assert gain[pixel] == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("name", ["sinc", "complex"])
def test_the_climb_starts_from_the_two_nodes_that_explain_most(name: str) -> None:
    """Against projectors of all pairs of nodes."""
    beams, rng = beams_named(name), np.random.default_rng(60)
    covariance = pixels_of(beams, rng.uniform(-3.5, 3.5, (10, 2)), (10.0, 3.0), 4, rng)[:, 0]
    grid = layover._PairGrid.of(beams, 0.0)

    def explained(elevations: np.ndarray) -> np.ndarray:
        pair = np.swapaxes(beams.response(elevations, 0.0), -1, -2)
        return np.trace(pair @ np.linalg.pinv(pair) @ covariance, axis1=-2, axis2=-1).real

    pairs = grid.nodes[np.argwhere(grid.weight > 0)]
    best = np.max([explained(pair) for pair in pairs], axis=0)
    np.testing.assert_allclose(explained(grid.best(covariance)), best, rtol=1e-4)


def test_a_second_one_outside_the_array_is_no_height() -> None:
    beams, rng = make_beams("sinc"), np.random.default_rng(57)
    covariance = pixels_of(beams, np.tile([1.0, 4.75], (500, 1)), (100.0, 100.0), 8, rng)
    assert np.mean(find(covariance, beams, 8).detected) < 0.02


def test_missing_data_are_no_pair() -> None:
    beams = make_beams("jinc")
    result = find(np.zeros((2, 3, 16, 16), np.float32), beams, 4, np.zeros(3))
    assert not result.detected.any()
    assert np.isnan(result.elevation).all()


def test_blocks_and_units_of_power_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    beams, rng = make_beams("jinc"), np.random.default_rng(58)
    covariance = pixels_of(beams, rng.uniform(-3, 3, (60, 2)), (20.0, 20.0), 4, rng).reshape(10, 6, 16, 16)
    squint = np.array([0.0, 0.1, 0.0, 0.2, 0.1, 0.0]) * BEAMWIDTH
    whole = find_in(Looks.of(covariance, 4, squint), beams)
    monkeypatch.setattr(layover, "PIXELS_AT_ONCE", 3)
    parts = find_in(Looks.of(2**-30 * covariance, 4, squint, 2**-30), beams)
    assert 10 < whole.detected.sum() < 60
    np.testing.assert_array_equal(parts.detected, whole.detected)
    for name in ("elevation", "power", "sigma"):
        np.testing.assert_allclose(getattr(parts, name), getattr(whole, name), rtol=1e-4)
