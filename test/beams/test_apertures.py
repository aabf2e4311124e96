"""Profiles along one axis and their means over a detector."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import sici

from sal_height.beams.apertures import GAUSSIAN, NARROW, SINC, Profile

PROFILES = pytest.mark.parametrize("profile", [SINC, GAUSSIAN], ids=["sinc", "gaussian"])
PLACES = np.array([0.0, 1e-9, 0.25, -0.3, 0.5, 1.0, -1.7, 4.2])


@PROFILES
@pytest.mark.parametrize("width", [1e-7, 0.99 * NARROW, 1.01 * NARROW, 0.6, 1.0, 1.2, 5.0])
def test_mean_is_the_integral_over_the_width(profile: Profile, width: float) -> None:
    """Integrated over a variable from -1 to 1, so that no digits are lost in narrow widths."""
    for x in PLACES:
        for mean, point in ((profile.mean, profile.value), (profile.mean_slope, profile.slope)):
            expected = quad(lambda t, f=point, x=x: float(f(x + t * width / 2)) / 2, -1, 1, epsabs=1e-13)[0]
            assert mean(x, width) == pytest.approx(expected, abs=1e-12)


@PROFILES
def test_integral_and_slope_belong_to_the_value(profile: Profile) -> None:
    step = 1e-5  # error of the central differences below 1e-9
    x = np.linspace(-3, 3, 101)
    for function, derivative in ((profile.integral, profile.value), (profile.value, profile.slope)):
        np.testing.assert_allclose(
            derivative(x), (function(x + step) - function(x - step)) / (2 * step), atol=2e-9, rtol=0
        )


def test_touching_detectors_have_the_sine_integrals_of_the_paper() -> None:
    """SAL paper, section 2: Si(a) - Si(a - b), up to the factor b of the detector's width."""
    a, b = np.pi * PLACES, np.pi * 0.5
    np.testing.assert_allclose(SINC.mean(PLACES - 0.25, 0.5), (sici(a)[0] - sici(a - b)[0]) / b, atol=1e-15)


def test_widths_broadcast() -> None:
    widths = np.array([0.2, 1e-5, 0.7])
    each = [SINC.mean(PLACES, width) for width in widths]
    np.testing.assert_allclose(SINC.mean(PLACES[:, None], widths), np.stack(each, axis=-1), atol=1e-10)
