"""Windows: what they cost in noise and resolution."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import refused
from scipy.optimize import brentq
from scipy.signal import windows

from sal_height.errors import UserError
from sal_height.numeric.windows import WINDOWS, broadening, main_lobe, noise_gain, taylor, window

COUNT = 1024


def taylor_coefficients(bars: int, sidelobe_db: float) -> np.ndarray:
    """Cosine coefficients F_1 ... of the Taylor window 1 + 2 sum F_m cos(2 pi m x) (Carrara, appendix D)."""
    a = np.arccosh(10 ** (sidelobe_db / 20)) / np.pi
    dilation = bars**2 / (a**2 + (bars - 0.5) ** 2)
    order = np.arange(1, bars)

    def coefficient(m: int) -> float:
        above = np.prod(1 - m**2 / dilation / (a**2 + (order - 0.5) ** 2))
        below = np.prod([1 - m**2 / other**2 for other in order if other != m])
        return -((-1.0) ** m) * above / (2 * below)

    return np.array([coefficient(m) for m in order])


@pytest.mark.parametrize("name", sorted(WINDOWS))
@pytest.mark.parametrize("count", [2, 63, 64])
def test_mean_is_one_so_that_a_point_keeps_its_peak(name: str, count: int) -> None:
    assert window(name, count).shape == (count,)
    assert window(name, count).mean() == pytest.approx(1.0, abs=1e-12)


def test_taylor_window_is_the_textbook_sum_of_cosines() -> None:
    x = (np.arange(COUNT) - (COUNT - 1) / 2) / COUNT
    m = np.arange(1, 5)
    expected = 1 + 2 * np.cos(2 * np.pi * np.outer(x, m)) @ taylor_coefficients(5, 35.0)
    np.testing.assert_allclose(window("taylor", COUNT), expected, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "gain"),
    [
        ("rectangular", 1.0),
        ("hamming", 1 + 0.5 * (0.46 / 0.54) ** 2),
        ("taylor", 1 + 2 * np.sum(taylor_coefficients(5, 35.0) ** 2)),
    ],
)
def test_noise_gain_is_the_mean_square_of_the_cosine_series(name: str, gain: float) -> None:
    assert noise_gain(window(name, COUNT)) == pytest.approx(gain, rel=0.002)  # 1 / COUNT for the samples at the ends


@pytest.mark.parametrize(("name", "width"), [("rectangular", 0.88589), ("taylor", 1.188), ("hamming", 1.303)])
def test_broadening_is_the_ratio_of_half_power_widths(name: str, width: float) -> None:
    half = brentq(lambda bins: np.sinc(bins) ** 2 - 0.5, 0.1, 0.9)
    assert broadening(window(name, COUNT)) * 2 * half == pytest.approx(width, rel=0.005)


def test_unknown_window_is_refused_with_those_allowed() -> None:
    with refused(UserError, "'hann'", "hamming, rectangular, taylor"):
        window("hann", 64)


def test_one_sample_has_no_width() -> None:
    with refused(UserError, "1 samples", "must have more samples"):
        broadening(np.ones(1))


@pytest.mark.parametrize("count", [1, 2, 63, 256, 4097])
@pytest.mark.parametrize("sidelobe_db", [13.0, 35.0, 60.0])
def test_taylor_weights_are_those_of_scipy(count: int, sidelobe_db: float) -> None:
    """To the last digit."""
    expected = windows.taylor(count, nbar=5, sll=sidelobe_db)
    np.testing.assert_array_equal(taylor(count, sidelobe_db), expected)


@pytest.mark.parametrize("name", sorted(WINDOWS))
def test_main_lobe_ends_at_the_first_null_of_the_textbook(name: str) -> None:
    """Taylor's is s (A^2 + 1/4)^1/2 with cosh(pi A) = 10^(35/20) and s = 5 / (A^2 + 4.5^2)^1/2; Hamming's is 2."""
    a = np.arccosh(10 ** (35 / 20)) / np.pi
    nulls = {"rectangular": 1.0, "hamming": 2.0, "taylor": 5 / np.hypot(a, 4.5) * np.hypot(a, 0.5)}
    assert main_lobe(name) == pytest.approx(nulls[name], rel=0.005)  # of the 512 samples
