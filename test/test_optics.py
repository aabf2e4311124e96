"""Beam patterns against the physics of their apertures."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import assert_one_sentence
from scipy.integrate import quad
from scipy.optimize import brentq

from sal_height.errors import UserError
from sal_height.optics import GAUSSIAN_WIDTH, PATTERNS, pattern_named

NAMES = sorted(PATTERNS)


def pupil_transform(name: str, e: float, a: float) -> float:
    """Amplitude pattern from its aperture: integral of cos(2 pi u e) over a pupil of diameter (or side) 1."""

    def chord(u: float) -> float:
        half = np.sqrt(0.25 - u * u) if name == "jinc" else 0.5
        return 2 * half * np.sinc(2 * half * a) * np.cos(2 * np.pi * u * e)

    area = np.pi / 4 if name == "jinc" else 1.0
    return quad(chord, -0.5, 0.5, epsabs=1e-12, limit=200)[0] / area


@pytest.mark.parametrize("name", ["jinc", "sinc"])
@pytest.mark.parametrize(("e", "a"), [(0.0, 0.0), (0.3, 0.0), (0.7, 0.2), (-1.4, -0.5), (0.2, 1.9)])
def test_pattern_is_the_fourier_transform_of_the_pupil(name: str, e: float, a: float) -> None:
    assert PATTERNS[name].amplitude(e, a) == pytest.approx(pupil_transform(name, e, a), abs=1e-9)


@pytest.mark.parametrize(("name", "width"), [("sinc", 0.88589), ("jinc", 1.02899), ("gaussian", 1.02899)], ids=str)
def test_half_power_width(name: str, width: float) -> None:
    half = brentq(lambda e: float(PATTERNS[name].amplitude(e, 0.0)) ** 2 - 0.5, 0.1, 0.9)
    assert 2 * half == pytest.approx(width, abs=6e-6)  # the widths are rounded to five digits


@pytest.mark.parametrize(("name", "null"), [("sinc", 1.0), ("jinc", 1.219670)])
def test_first_null(name: str, null: float) -> None:
    assert brentq(lambda e: float(PATTERNS[name].amplitude(e, 0.0)), 0.8, 1.5) == pytest.approx(null, abs=1e-6)


@pytest.mark.parametrize(("name", "slope"), [("gaussian", 0.65464), ("sinc", 4 - np.pi), ("jinc", 0.633342)])
def test_slope_of_a_pair_half_a_beamwidth_apart(name: str, slope: float) -> None:
    pattern = PATTERNS[name]
    assert -pattern.slope(0.25, 0.0) / pattern.amplitude(0.25, 0.0) == pytest.approx(slope, abs=6e-6)


@pytest.mark.parametrize("name", NAMES)
def test_slope_is_the_derivative_of_the_amplitude(name: str) -> None:
    pattern = PATTERNS[name]
    e = np.concatenate([np.linspace(-3, 3, 241), [1e-9, 5e-5, 9.99e-5, 1.001e-4, -2e-4, 1.2197]])[:, None]
    a = np.array([0.0, 0.2, -0.7])
    step = 1e-5  # error of the central difference: step^2 / 6 * |h'''| < 1e-9, rounding 1e-11
    difference = (pattern.amplitude(e + step, a) - pattern.amplitude(e - step, a)) / (2 * step)
    np.testing.assert_allclose(pattern.slope(e, a), difference, atol=2e-9)


@pytest.mark.parametrize("name", NAMES)
def test_boresight_has_amplitude_one_and_no_slope(name: str) -> None:
    assert PATTERNS[name].amplitude(0.0, 0.0) == 1.0
    assert PATTERNS[name].slope(0.0, 0.0) == 0.0


def test_circular_patterns_depend_on_the_distance_alone() -> None:
    turn = np.linspace(0, 2 * np.pi, 13)
    for name in ("gaussian", "jinc"):
        around = PATTERNS[name].amplitude(0.8 * np.cos(turn), 0.8 * np.sin(turn))
        np.testing.assert_allclose(around, PATTERNS[name].amplitude(0.8, 0.0), atol=1e-14)


def test_gaussian_has_the_stated_width() -> None:
    assert PATTERNS["gaussian"].amplitude(GAUSSIAN_WIDTH, GAUSSIAN_WIDTH) == pytest.approx(np.exp(-1), abs=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_pattern_is_found_by_its_name(name: str) -> None:
    assert pattern_named(name).name == name


def test_unknown_pattern_is_refused_with_those_allowed() -> None:
    with pytest.raises(UserError) as refusal:
        pattern_named("cosine")
    assert_one_sentence(str(refusal.value), "'cosine'", "gaussian, jinc, sinc")
