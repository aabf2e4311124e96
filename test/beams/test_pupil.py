"""Aberrated pupils: jinc without aberrations, closed forms to first order, symmetries and slopes."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import make_beams, refused
from scipy.integrate import dblquad
from scipy.special import jv

from sal_height.beams.pattern import detector_pattern, pattern_named
from sal_height.beams.pupil import ZERNIKE, aberrated_derivatives, aberrated_pattern
from sal_height.errors import UserError

E = np.linspace(-6, 6, 25)
A = 0.3 * E[::-1]


def only(name: str, waves: float) -> tuple[float, ...]:
    return tuple(waves * (term == name) for term in ZERNIKE)


@pytest.mark.parametrize("size", [(0.0, 0.0), (0.6, 0.4)])
def test_without_aberrations_it_is_the_described_pattern(size: tuple[float, float]) -> None:
    found, expected = aberrated_pattern(only("coma", 0.0), size), detector_pattern("jinc", size)
    for kind in ("amplitude", "slope", "azimuth_slope"):
        np.testing.assert_allclose(getattr(found, kind)(E, A), getattr(expected, kind)(E, A), atol=1e-10)


def test_defocus_is_that_of_an_integral() -> None:
    """On the axis, mean of exp(j phi (2 s - 1)) over the area s: sin(phi) / phi; beside it by quadrature."""
    pattern = aberrated_pattern(only("defocus", 0.07))
    phase = 2 * np.pi * 0.07 * np.sqrt(3)
    assert pattern.amplitude(0.0, 0.0) == pytest.approx(np.sin(phase) / phase, abs=1e-12)

    def field(angle: float, radius: float) -> float:
        at = phase * (2 * radius**2 - 1) + np.pi * radius * 0.8 * np.cos(angle)
        return float(np.cos(at) * radius / np.pi)

    expected = dblquad(field, 0, 1, 0, 2 * np.pi, epsabs=1e-9)[0]
    assert pattern.amplitude(0.8, 0.0).real == pytest.approx(expected, abs=1e-8)


def test_first_order_of_coma_is_a_bessel_function() -> None:
    """The transform of R_3^1 cos t is proportional to J4(x) / x cos(azimuth) (Born and Wolf, section 9.4)."""
    derivative = aberrated_derivatives(only("coma", 0.0))[list(ZERNIKE).index("coma")]
    x = np.pi * E[E != 0]
    expected = 2 * np.pi * 2 * np.sqrt(8) * jv(4, x) / x
    np.testing.assert_allclose(derivative.amplitude(E[E != 0], 0.0), expected, atol=1e-10)


def test_even_terms_are_complex_and_symmetric_and_odd_ones_real() -> None:
    for name in ZERNIKE:
        found, opposite = (aberrated_pattern(only(name, sign * 0.1)).amplitude(E, A) for sign in (1, -1))
        mirrored = aberrated_pattern(only(name, 0.1)).amplitude(-E, -A)
        if "coma" in name:
            np.testing.assert_allclose(found.imag, 0, atol=1e-11)
            np.testing.assert_allclose(mirrored, opposite, atol=1e-11)
        else:
            np.testing.assert_allclose(mirrored, found, atol=1e-11)
            np.testing.assert_allclose(opposite, found.conj(), atol=1e-11)


def test_terms_have_the_mean_square_1_and_derivatives_are_differences() -> None:
    """To second order the amplitude on the axis is 1 - (2 pi c)^2 / 2 (Marechal)."""
    base = (0.02, -0.03, 0.01, 0.05, 0.02, -0.04)
    for index, derivative in enumerate(aberrated_derivatives(base)):
        step = 1e-4 * np.eye(len(base))[index]
        higher, lower = (aberrated_pattern(tuple(base + sign * step)).amplitude(E, A) for sign in (1, -1))
        np.testing.assert_allclose(derivative.amplitude(E, A), (higher - lower) / 2e-4, atol=1e-6)
        small = aberrated_pattern(tuple(100 * step)).amplitude(0.0, 0.0)
        assert np.abs(small) == pytest.approx(1 - (2 * np.pi * 0.01) ** 2 / 2, abs=2e-5)


def test_slopes_are_derivatives() -> None:
    pattern = aberrated_pattern((0.05, 0.03, -0.02, 0.06, 0.01, 0.02), (0.5, 0.0))
    for slope, step in ((pattern.slope, (1e-5, 0.0)), (pattern.azimuth_slope, (0.0, 1e-5))):
        change = pattern.amplitude(E + step[0], A + step[1]) - pattern.amplitude(E - step[0], A - step[1])
        np.testing.assert_allclose(slope(E, A), change / 2e-5, atol=1e-7)


def test_what_cannot_have_aberrations_is_refused() -> None:
    with refused(UserError, "circular"):
        make_beams("sinc", 4).aberrated(only("coma", 0.1))
    with refused(UserError, "needed"):
        make_beams("jinc", 4).aberrated((0.1,))
    beams = make_beams("jinc", 4)
    assert beams.aberrated(()) is beams.aberrated((0.0,) * 6) is beams
    assert beams.patterns[0] is pattern_named("jinc")


def test_gains_of_channels_stay() -> None:
    gains, terms = np.array([0.5, 1.0, 2.0, 3.0j]), only("coma", 0.05)
    beams = make_beams("jinc", 4)
    places = np.linspace(*beams.span, 5)
    expected = beams.aberrated(terms).response(places, 0.0) * gains
    np.testing.assert_allclose(beams.scaled(gains).aberrated(terms).response(places, 0.0), expected)
