"""Finite detectors against closed forms and brute force, for the patterns there are and for one made up."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest
from helpers import BEAMWIDTH, make_sensor
from numpy.polynomial.legendre import leggauss
from scipy.special import erf, sici

from sal_height.beams import apertures
from sal_height.beams.apertures import GAUSSIAN_WIDTH, PatternFunction, average_over_detector
from sal_height.beams.pattern import PATTERNS, Pattern, aperture_pattern, detector_pattern

Array = npt.NDArray[np.float64]

SIZE = (0.6, 1.2)
SIZES = [SIZE, (0.0, 1.2), (0.6, 0.0), (1e-5, 2e-4), (3.0, 0.1), (20.0, 7.0)]
PLACES = [(0.0, 0.0), (0.3, 0.0), (0.7, 0.2), (-1.4, -0.5), (0.2, 1.9), (6.1, -4.4)]


def sinc_mean(x: float, width: float) -> float:
    """Mean of sin(pi t) / (pi t) over an interval: SAL paper, section 2."""
    if width < 1e-3:
        return float(np.sinc(x))
    ends = sici(np.pi * (x + np.array([-0.5, 0.5]) * width))[0]
    return float(np.diff(ends)[0] / (np.pi * width))


def gaussian_mean(x: float, width: float) -> float:
    """Mean of the Gaussian over an interval."""
    if width < 1e-3:
        return math.exp(-(x**2) / (2 * GAUSSIAN_WIDTH**2))
    ends = erf((x + np.array([-0.5, 0.5]) * width) / (GAUSSIAN_WIDTH * math.sqrt(2)))
    return float(np.diff(ends)[0]) * GAUSSIAN_WIDTH * math.sqrt(np.pi / 2) / width


@pytest.mark.parametrize(("name", "mean"), [("sinc", sinc_mean), ("gaussian", gaussian_mean)])
@pytest.mark.parametrize("size", SIZES, ids=str)
def test_product_patterns_have_their_closed_form(
    name: str, mean: Callable[[float, float], float], size: tuple[float, float]
) -> None:
    """The tolerance is what an interval narrower than 1e-3 beamwidths differs from a point by, pi^2 / 24 width^2."""
    pattern = detector_pattern(name, size)
    for e, a in PLACES:
        assert pattern.amplitude(e, a) == pytest.approx(mean(e, size[0]) * mean(a, size[1]), abs=2e-8)
        if min(size) > 1e-3:
            assert pattern.amplitude(e, a) == pytest.approx(mean(e, size[0]) * mean(a, size[1]), abs=1e-11)


def pupil_mean(size: tuple[float, float], e: float, a: float) -> float:
    """Integral over the pupil disc in polar coordinates, each point with the transform of the detector."""
    node, weight = leggauss(100)
    r, turn = (node + 1) / 4, 2 * np.pi * np.arange(240) / 240
    u, v = r[:, None] * np.cos(turn), r[:, None] * np.sin(turn)
    pupil = np.sinc(size[0] * u) * np.sinc(size[1] * v) * (weight * r)[:, None]
    return float(np.sum(pupil * np.cos(2 * np.pi * (u * e + v * a))) / np.sum((weight * r)[:, None] + 0 * u))


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_detector_behind_a_circular_aperture(size: tuple[float, float]) -> None:
    pattern = detector_pattern("jinc", size)
    for place in PLACES:
        assert pattern.amplitude(*place) == pytest.approx(pupil_mean(size, *place), abs=1e-11)


@pytest.mark.parametrize(
    ("place", "amplitude"),
    [((0.0, 0.0), 0.831597), ((0.3, 0.0), 0.741662), ((0.7, 0.2), 0.394412), ((1.4, -0.5), -0.094461)],
)
def test_detector_of_the_paper(place: tuple[float, float], amplitude: float) -> None:
    """Known values to their six digits (SAL paper, figure 4: 0.6 by 1.2 beamwidths)."""
    assert detector_pattern("jinc", SIZE).amplitude(*place) == pytest.approx(amplitude, abs=5.1e-7)


def quadrature(function: PatternFunction, size: tuple[float, float], e: Array, a: Array) -> Array:
    """Mean over the detector by a product rule of 40 nodes at each offset: exact to rounding, nothing tabulated."""
    node, weight = leggauss(40)
    along, across = (np.multiply.outer(node / 2, width) for width in size)
    values = function(e[:, None, None] + along[:, None], a[:, None, None] + across)
    return np.einsum("pij,i,j->p", values, weight / 2, weight / 2)


@pytest.mark.parametrize("name", sorted(PATTERNS))
@pytest.mark.parametrize("kind", ["amplitude", "slope", "azimuth_slope"])
def test_interpolation_keeps_the_stated_error(name: str, kind: str) -> None:
    """At offsets anywhere, and at those beside the sides of the squares; ten times better than what is promised."""
    e, a = np.random.default_rng(6).uniform([[-1], [-2]], [[3], [1]], (2, 300))
    e[:50], a[25:75] = 1 + np.tile([-1e-9, 1e-9], 25), -1 + np.tile([1e-9, -1e-9], 25)
    found = getattr(detector_pattern(name, SIZE), kind)(e, a)
    np.testing.assert_allclose(found, quadrature(getattr(PATTERNS[name], kind), SIZE, e, a), atol=1e-12, rtol=0)


def test_a_value_does_not_depend_on_those_beside_it() -> None:
    """Nor on the order in which squares are tabulated."""
    e, a = np.random.default_rng(6).uniform(-3, 3, (2, 500))
    average = average_over_detector(PATTERNS["jinc"].amplitude, SIZE)
    alone = np.array([average(x, y) for x, y in zip(e[::-1], a[::-1], strict=True)])[::-1]
    np.testing.assert_allclose(detector_pattern("jinc", SIZE).amplitude(e, a), alone, atol=1e-15, rtol=0)


def test_fewer_points_break_the_stated_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(apertures, "POINTS", 10)
    e, a = np.random.default_rng(6).uniform(-1, 1, (2, 300))
    found = average_over_detector(PATTERNS["sinc"].amplitude, SIZE)(e, a)
    assert np.max(np.abs(found - quadrature(PATTERNS["sinc"].amplitude, SIZE, e, a))) > 1e-11


def test_a_pattern_is_tabulated_once() -> None:
    """Also for another sensor with the same detectors."""
    assert detector_pattern("jinc", SIZE) is detector_pattern("jinc", SIZE)
    calls = []

    def counted(e: npt.ArrayLike, a: npt.ArrayLike) -> Array:
        calls.append(1)
        return PATTERNS["jinc"].amplitude(e, a)

    average = average_over_detector(counted, SIZE)
    average(np.linspace(-1, 1, 1000), 0.0)
    calls.clear()
    average(np.linspace(-1, 1, 1000), 0.1)
    assert not calls


def test_averages_broadcast_and_keep_complex_values() -> None:
    average = average_over_detector(lambda e, a: np.exp(1j * (0.4 * np.asarray(e) - 1.1 * np.asarray(a))), SIZE)
    gain = np.sinc(0.4 * SIZE[0] / (2 * np.pi)) * np.sinc(1.1 * SIZE[1] / (2 * np.pi))
    e, a = np.linspace(-1, 1, 300)[:, None], np.linspace(-0.5, 0.5, 301)
    assert average(e, a).shape == (300, 301)
    np.testing.assert_allclose(average(e, a), gain * np.exp(1j * (0.4 * e - 1.1 * a)), atol=1e-12)
    np.testing.assert_allclose(average(e[:2], a[:3]), gain * np.exp(1j * (0.4 * e[:2] - 1.1 * a[:3])), atol=1e-12)
    assert average(np.zeros((0, 3)), 0.0).shape == (0, 3)


def test_offsets_that_are_not_finite_have_no_value() -> None:
    pattern = detector_pattern("jinc", SIZE)
    e = np.append(np.linspace(-1, 1, 40_000), [np.inf, np.nan])
    values = pattern.amplitude(e, 0.0)
    assert np.isnan(values[-2:]).all()
    assert np.isfinite(values[:-2]).all()


def raised_cosine(e: npt.ArrayLike, a: npt.ArrayLike) -> Array:
    """Line aperture weighted with 1 + cos(2 pi u): a sinc and half of each of its neighbours; null at 2 beamwidths."""
    e, a = np.asarray(e), np.asarray(a)
    return (np.sinc(e) + (np.sinc(e - 1) + np.sinc(e + 1)) / 2) * (np.sinc(a) + (np.sinc(a - 1) + np.sinc(a + 1)) / 2)


@pytest.fixture
def hann(monkeypatch: pytest.MonkeyPatch) -> Pattern:
    """A new pattern: one entry of the registry."""
    pattern = aperture_pattern("hann", raised_cosine, main_lobe=2.0)
    monkeypatch.setitem(PATTERNS, "hann", pattern)
    return pattern


def test_a_new_pattern_is_one_entry_of_the_registry(hann: Pattern) -> None:
    """Its finite detectors are means of itself, no other pattern's (they were those of a circular aperture)."""
    sensor = make_sensor(pattern="hann", detector_size=SIZE)
    offset = np.array([0.0, 0.8, -1.3])
    seen = sensor.beams.response(np.pi / 4 + offset * BEAMWIDTH, 0.3 * BEAMWIDTH)[:, 1]

    def mean(x: float, width: float) -> float:
        return sinc_mean(x, width) + (sinc_mean(x - 1, width) + sinc_mean(x + 1, width)) / 2

    expected = [mean(x, SIZE[0]) * mean(0.3, SIZE[1]) for x in offset.tolist()]
    np.testing.assert_allclose(seen, expected, atol=1e-11)
    assert hann.main_lobe < detector_pattern("hann", SIZE).main_lobe < hann.main_lobe + SIZE[1] / 2


def test_slopes_without_a_formula_are_those_of_the_amplitude(hann: Pattern) -> None:
    """Held against the formulas of a pattern that has them."""
    sinc = PATTERNS["sinc"]
    without = aperture_pattern("sinc", sinc.amplitude, sinc.main_lobe)
    e, a = np.random.default_rng(8).uniform(-3, 3, (2, 200))
    np.testing.assert_allclose(without.slope(e, a), sinc.slope(e, a), atol=3e-11, rtol=0)
    np.testing.assert_allclose(without.azimuth_slope(e, a), sinc.azimuth_slope(e, a), atol=3e-11, rtol=0)
    step = 1e-5  # error of the central difference: 1e-9
    difference = (hann.amplitude(e + step, a) - hann.amplitude(e - step, a)) / (2 * step)
    np.testing.assert_allclose(hann.slope(e, a), difference, atol=2e-9)
