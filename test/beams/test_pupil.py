"""Pupil integrals against brute force."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest
from helpers import assert_one_sentence
from numpy.polynomial.legendre import leggauss
from scipy.special import jv

from sal_height.beams.pattern import PATTERNS, Pattern, apodised_pattern, detector_pattern
from sal_height.beams.pupil import ChordSum, chord_count, chords, jinc_sums
from sal_height.errors import UserError

Array = npt.NDArray[np.float64]

SIZE = (0.6, 1.2)
PLACES = [(0.0, 0.0), (0.3, 0.0), (0.7, 0.2), (-1.4, -0.5), (0.2, 1.9), (6.1, -4.4)]


def coma(u: Array, v: Array) -> npt.NDArray[np.complex128]:
    """A tapered aperture with a phase that is not even: beams of neither symmetry."""
    return np.exp(-3 * (u**2 + v**2) + 1j * (0.7 + 8 * u**3 - 2 * v + 3 * u * v))


def brute_force(weighting: Callable[[Array, Array], Array], size: tuple[float, float], e: float, a: float) -> complex:
    """Integral over the disc in polar coordinates and over the detector in its own, normalised as a point's."""
    node, weight = leggauss(60)
    r, turn = (node + 1) / 4, 2 * np.pi * np.arange(160) / 160
    u, v = r[:, None] * np.cos(turn), r[:, None] * np.sin(turn)
    pupil = weighting(u, v) * (weight * r)[:, None]
    node, weight = leggauss(24)
    along = sum(w / 2 * np.exp(-2j * np.pi * u * (e + t * size[0] / 2)) for t, w in zip(node, weight, strict=True))
    across = sum(w / 2 * np.exp(-2j * np.pi * v * (a + t * size[1] / 2)) for t, w in zip(node, weight, strict=True))
    return complex(np.sum(pupil * along * across) / np.sum(pupil))


@pytest.mark.parametrize("size", [SIZE, (0.0, 1.2), (0.6, 0.0), (1e-5, 2e-4), (3.0, 0.1)], ids=str)
@pytest.mark.parametrize("place", PLACES, ids=str)
def test_detector_behind_a_circular_aperture(size: tuple[float, float], place: tuple[float, float]) -> None:
    expected = brute_force(lambda u, _: np.ones_like(u), size, *place)
    assert detector_pattern("jinc", size).amplitude(*place) == pytest.approx(expected.real, abs=1e-10)


@pytest.mark.parametrize(
    ("place", "amplitude"),
    [((0.0, 0.0), 0.831597), ((0.3, 0.0), 0.741662), ((0.7, 0.2), 0.394412), ((1.4, -0.5), -0.094461)],
)
def test_detector_of_the_paper(place: tuple[float, float], amplitude: float) -> None:
    """Known values to their six digits (SAL paper, figure 4: 0.6 by 1.2 beamwidths)."""
    assert detector_pattern("jinc", SIZE).amplitude(*place) == pytest.approx(amplitude, abs=5.1e-7)


@pytest.mark.parametrize("offset", [0.0, 0.5, 3.0, 20.0, 100.0, 1000.0])
def test_chords_suffice(offset: float) -> None:
    """Coefficients from number 2 N - 2 on are left out (cos^2 of tau shifts them by 2)."""
    count = chord_count(offset)
    assert np.max(np.abs(jv(2 * count - 2 + np.arange(40), np.pi * offset))) < 1e-14
    e, a = offset * np.cos([0.0, 0.8, 1.5]), offset * np.sin([0.0, 0.8, 1.5])
    for part in jinc_sums(SIZE):
        few, many = (np.sum(part.along(e, n) * part.across(a, n), 1) for n in (chord_count(offset + 1), 2 * count + 16))
        np.testing.assert_allclose(few, many, atol=1e-12)


def test_chords_cover_the_disc() -> None:
    u, half, weight = chords(16)
    np.testing.assert_allclose(np.hypot(u, half), 0.5, rtol=1e-15)
    assert np.sum(2 * half * weight) == pytest.approx(np.pi / 4, rel=1e-15)


@pytest.mark.parametrize("reach", [2.0, 15.0, 60.0])
def test_values_are_within_the_stated_error_of_the_integral(reach: float) -> None:
    rng = np.random.default_rng(6)
    e, a = rng.uniform(-reach, reach, (2, 200))
    for part in jinc_sums(SIZE):
        count = 2 * chord_count(2 * reach)
        exact = np.sum(part.along(e, count) * part.across(a, count), axis=1)
        np.testing.assert_allclose(part(e, a), exact, atol=1e-10, rtol=0)


@pytest.mark.parametrize("size", [(0.0, 0.0), SIZE], ids=str)
@pytest.mark.parametrize("place", PLACES, ids=str)
def test_weighted_aperture(size: tuple[float, float], place: tuple[float, float]) -> None:
    pattern = apodised_pattern(coma, size)
    assert pattern.name == "apodised"
    assert pattern.amplitude(*place).dtype == np.complex128
    assert pattern.amplitude(*place) == pytest.approx(brute_force(coma, size, *place), abs=1e-9)


def test_even_aperture_of_any_scale_is_the_circular_one() -> None:
    e, a = np.random.default_rng(7).uniform(-4, 4, (2, 100))
    for size in ((0.0, 0.0), SIZE):
        uniform = apodised_pattern(lambda u, _: np.full(u.shape, 3 - 4j), size)
        plain = detector_pattern("jinc", size)
        assert uniform.amplitude(e, a).dtype == np.float64
        for name in ("amplitude", "slope", "azimuth_slope"):
            np.testing.assert_allclose(getattr(uniform, name)(e, a), getattr(plain, name)(e, a), atol=1e-10)


def test_tilted_phase_displaces_the_beam() -> None:
    """exp(j 2 pi (u e0 + v a0)) looks at (e0, a0): the sign of the SAL paper's focal plane."""
    tilted = apodised_pattern(lambda u, v: np.exp(2j * np.pi * (0.4 * u - 1.1 * v)))
    e, a = np.random.default_rng(8).uniform(-3, 3, (2, 50))
    shifted = PATTERNS["jinc"].amplitude(e - 0.4, a + 1.1) / PATTERNS["jinc"].amplitude(-0.4, 1.1)
    np.testing.assert_allclose(tilted.amplitude(e, a), shifted, atol=1e-9)
    assert tilted.amplitude(e, a).dtype == np.float64  # the mirrored half of the aperture has the conjugate phase


def test_central_obscuration_is_followed_by_the_grid() -> None:
    """A hole of 0.3 diameters: the difference of two circular apertures; the edge costs digits."""
    pattern = apodised_pattern(lambda u, v: np.hypot(u, v) > 0.15)
    e = np.linspace(-3, 3, 61)
    whole, hole = PATTERNS["jinc"].amplitude(e, 0.0), 0.09 * PATTERNS["jinc"].amplitude(0.3 * e, 0.0)
    np.testing.assert_allclose(pattern.amplitude(e, 0.0), (whole - hole) / 0.91, atol=2e-3)


@pytest.mark.parametrize(
    ("weighting", "wrong"),
    [
        (lambda u, _: 0 * u, "is 0"),
        (lambda u, _: u, "is 0"),
        (lambda u, v: np.where(u + v > 0.1, np.nan, 1.0), "not finite"),
        (lambda u, _: np.inf + u, "not finite"),
    ],
    ids=["zero", "odd", "nan", "infinite"],
)
def test_aperture_without_a_boresight_amplitude_is_refused(
    weighting: Callable[[Array, Array], Array], wrong: str
) -> None:
    with pytest.raises(UserError) as refusal:
        apodised_pattern(weighting)
    assert_one_sentence(str(refusal.value), "apodisation", wrong)


@pytest.mark.parametrize(
    "pattern",
    [detector_pattern("jinc", SIZE), apodised_pattern(coma, SIZE)],
    ids=["jinc", "apodised"],
)
def test_slopes_are_the_derivatives(pattern: Pattern) -> None:
    assert isinstance(pattern.amplitude, ChordSum)
    e, a = np.random.default_rng(9).uniform(-3, 3, (2, 200))
    step = 1e-3  # error of the fourth-order difference: step^4 / 30 * pi^5 = 1e-11, and that of the values over step
    for slope, (x, y) in ((pattern.slope, (step, 0)), (pattern.azimuth_slope, (0, step))):
        near = pattern.amplitude(e + x, a + y) - pattern.amplitude(e - x, a - y)
        far = pattern.amplitude(e + 2 * x, a + 2 * y) - pattern.amplitude(e - 2 * x, a - 2 * y)
        np.testing.assert_allclose(slope(e, a), (8 * near - far) / (12 * step), atol=5e-8)
