"""Phasors of phases so large that float32 would have lost them."""

from __future__ import annotations

import numpy as np
import pytest

from sal_height.numeric._kernels import cosine_and_sine
from sal_height.numeric.transforms import SMALL, outer_phasors, unit_phasors


@pytest.mark.parametrize("largest", [np.pi, 1e3, 1e7])
def test_phasors_of_large_phases_keep_the_digits_of_small_ones(largest: float) -> None:
    """At 1e7 rad, a million turns of a lidar's light, the float64 phase itself is good to 2e-9."""
    phase = np.random.default_rng(64).uniform(-largest, largest, 20000)
    made = unit_phasors(phase)
    assert made.dtype == np.complex64
    assert np.abs(made - np.exp(1j * phase)).max() < 1e-6


def test_phasors_of_whole_quarter_turns() -> None:
    phase = np.pi / 2 * np.arange(-8, 9)
    np.testing.assert_allclose(unit_phasors(phase), 1j ** np.arange(-8, 9), atol=2e-7)


@pytest.mark.parametrize("shape", [(0,), (1,), (3, 5), (2, SMALL - 1), (3, SMALL), (7, 1, 2)])
def test_phasors_of_any_shape_however_they_are_shared_among_threads(shape: tuple[int, ...]) -> None:
    phase = np.random.default_rng(65).uniform(-9, 9, shape[::-1]).T  # not contiguous
    made = unit_phasors(phase)
    assert made.shape == shape
    np.testing.assert_allclose(made, np.exp(1j * phase), atol=1e-6)


@pytest.mark.parametrize("shape", [(1, 1), (3, 5), (4, SMALL), (0, 3)])
def test_phasors_of_products_are_those_of_all_pairs(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(66)
    first, second = rng.uniform(-1e3, 1e3, shape[0]), rng.uniform(-1e4, 1e4, shape[1])
    made = outer_phasors(first, second)
    assert made.dtype == np.complex64
    np.testing.assert_allclose(made, np.exp(1j * np.outer(first, second)), atol=1e-6)


def test_cosine_and_sine_count_turns() -> None:
    for turns in (0.0, 0.125, -0.25, 0.5, 1e6 + 0.375):
        cosine, sine = cosine_and_sine(turns)
        assert cosine == pytest.approx(np.cos(2 * np.pi * turns), abs=1e-6)
        assert sine == pytest.approx(np.sin(2 * np.pi * turns), abs=1e-6)
