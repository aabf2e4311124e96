"""Autofocus on bright targets finds the phase, or its two halves disagree."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import circular
from phase_errors import power_law_phase, residual_phase, white_phase

from sal_height.imaging.autofocus.gradient import focus_targets, sharpness
from sal_height.imaging.autofocus.phase_error import detrended
from sal_height.numeric import Complex

BRIGHT = 10**1.5
"""Power of a target over the median of the picture."""

PULSES, HALF_WIDTH = 128, 20


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def points(cells: np.ndarray, rows: int, rng: np.random.Generator) -> Complex:
    """Responses of a point in each of the first range cells, at these azimuth cells, and of none in the others."""
    waves = np.exp(2j * np.pi / PULSES * cells[:, None] * np.arange(PULSES))
    seen = waves * np.exp(1j * rng.uniform(0, 7, (len(cells), 1)))
    return np.concatenate([seen, np.zeros((rows - len(cells), PULSES))])[:, None]


def test_targets_focus_in_every_place() -> None:
    """A target in one of five patches, anywhere in it, a smooth error of 5 rad rms over 128 pulses."""
    rng = np.random.default_rng(12)
    error = power_law_phase(PULSES, 5.0, 4.0, rng)
    seen = points(rng.uniform(-12, 12, 40), 200, rng)
    phase, standard_error = focus_targets(
        (seen + 0.3 * circular(rng, (2, 200, 1, PULSES))) * np.exp(1j * error), HALF_WIDTH, BRIGHT
    )
    assert rms(residual_phase(phase, error)) < 0.1
    assert standard_error < 0.1


def test_white_phases_come_off() -> None:
    """A window of a few cells would not let them through."""
    rng = np.random.default_rng(13)
    error = white_phase(PULSES, 0.8, rng)
    seen = 10 * points(rng.uniform(-12, 12, 40), 200, rng)
    phase, _ = focus_targets((seen + circular(rng, (2, 200, 1, PULSES))) * np.exp(1j * error), HALF_WIDTH, BRIGHT)
    assert rms(residual_phase(phase, error)) < 0.1


def test_standard_error_is_that_of_targets_in_noise() -> None:
    """Mean square of the phases' errors over what is stated: 1, over 30 scenes of 60 targets to +-0.15 (3 sigma)."""
    ratios = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        seen = points(rng.uniform(-12, 12, 60), 60, rng)
        phase, stated = focus_targets(seen + 0.7 * circular(rng, (1, 60, 1, PULSES)), HALF_WIDTH, 3.0)
        ratios.append(np.mean(detrended(phase) ** 2) / stated**2)
    assert np.mean(ratios) == pytest.approx(1, abs=0.15)


def test_what_spreads_over_range_cells_is_in_one_half() -> None:
    """Objects of a point and weaker ones in 8 range cells each: their structure is an error, which the halves show.

    Mean square of the phases' errors over what is stated, over 10 scenes of 24 objects: within a factor of 2.
    """
    ratios = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        weaker = sum(0.3 * points(rng.uniform(-12, 12, 24), 24, rng) for _ in range(3))
        seen = np.repeat(points(rng.uniform(-12, 12, 24), 24, rng) + weaker, 8, axis=0)
        phase, stated = focus_targets(seen + 0.02 * circular(rng, (1, 192, 1, PULSES)), HALF_WIDTH, 3.0)
        ratios.append(np.mean(detrended(phase) ** 2) / stated**2)
    assert 0.5 < np.mean(ratios) < 2


@pytest.mark.parametrize(("amplitude", "cycles"), [(1, 3), (4, 3), (9, 3), (4, 8)])
def test_bright_structure_does_not_decide(amplitude: float, cycles: float) -> None:
    """Four objects of four scatterers each, 30 dB over the points of the other 60 range cells: 4 standard errors."""
    t = np.arange(PULSES)
    for seed in range(4):
        rng = np.random.default_rng(seed)
        seen = points(rng.uniform(-12, 12, 64), 64, rng)
        for row in rng.choice(64, 4, replace=False):
            seen[row, 0] = 30 * np.sum(points(rng.uniform(-8, 8, 4), 4, rng), axis=(0, 1))
        error = amplitude * np.sin(2 * np.pi * cycles * t / PULSES + rng.uniform(0, 7))
        noisy = seen + 0.1 * circular(rng, (1, 64, 1, PULSES))
        phase, standard_error = focus_targets(noisy * np.exp(1j * error), HALF_WIDTH, BRIGHT)
        assert standard_error < 0.1
        assert rms(residual_phase(phase, error)) < 4 * standard_error


@pytest.mark.filterwarnings("error")
def test_a_single_range_cell_is_not_enough() -> None:
    """It has no two halves."""
    rng = np.random.default_rng(6)
    seen = points(np.array([3.0]), 1, rng) + 0.1 * circular(rng, (1, 1, 1, PULSES))
    assert focus_targets(seen, HALF_WIDTH, BRIGHT)[1] == np.inf


def test_a_single_target_is_not_enough() -> None:
    """No second one confirms what it says."""
    rng = np.random.default_rng(4)
    seen = points(np.array([3.0]), 64, rng)
    phase, standard_error = focus_targets(seen + 0.1 * circular(rng, (1, 64, 1, PULSES)), HALF_WIDTH, BRIGHT)
    assert standard_error == np.inf
    assert not np.any(phase)


@pytest.mark.filterwarnings("error")
def test_points_without_any_noise_and_pictures_of_all_cells_focus() -> None:
    """Nothing lies outside of a window as wide as all pulses; all targets lie alike in their cells."""
    rng = np.random.default_rng(5)
    seen = points(np.round(rng.uniform(-12, 12, 32)), 64, rng)
    error = 2 * np.sin(2 * np.pi * np.arange(PULSES) / PULSES)
    phase, standard_error = focus_targets((seen * np.exp(1j * error))[None], (PULSES - 1) // 2, BRIGHT)
    assert standard_error < 0.1
    assert rms(residual_phase(phase, error)) < 0.1


@pytest.mark.filterwarnings("error")
def test_equal_responses_leave_nothing_outside_and_need_no_phase() -> None:
    """Exactly nothing: a weight without a limit would be infinite."""
    seen = np.zeros((1, 64, 1, PULSES), np.complex128)
    seen[:, ::2] = 1
    phase, standard_error = focus_targets(seen, (PULSES - 1) // 2, BRIGHT)
    np.testing.assert_allclose(phase, 0, atol=1e-9)
    assert standard_error < 1e-9


def test_sharpness_counts_all_points_alike() -> None:
    """A point in a single cell has 1, one that is even over n cells 1 / n; what is dark does not count."""
    one = np.ones((1, 1, PULSES))
    even = 1000 * np.eye(PULSES)[:1][None]
    dark = np.zeros((1, 1, PULSES))
    cells = 2 * HALF_WIDTH + 1
    assert sharpness(one, HALF_WIDTH) == pytest.approx(1)
    assert sharpness(even, HALF_WIDTH) == pytest.approx(1 / cells)
    assert sharpness(np.concatenate([one, even, dark], axis=1), HALF_WIDTH) == pytest.approx((1 + 1 / cells) / 2)
    assert sharpness(dark, HALF_WIDTH) == 1
