"""Phase errors: generators against their statistics, and a measure that knows what an image cannot see."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from phase_errors import ATMOSPHERE, lower_band, power_law_phase, residual_phase, white_phase

from sal_height.imaging.autofocus.phase_error import PhaseInformation, detrended, without_shift

TIME = np.linspace(-1.0, 1.0, 64)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_mean_and_line_are_taken_off_and_nothing_else() -> None:
    parabola = TIME**2 - np.mean(TIME**2)
    np.testing.assert_allclose(detrended(parabola + 3.0 - 40.0 * TIME), parabola, atol=1e-12)


@pytest.mark.parametrize("exponent", [None, ATMOSPHERE], ids=["white", "power law"])
def test_generator_has_the_stated_rms_and_no_trend(exponent: float | None) -> None:
    rng = np.random.default_rng(1)
    phase = white_phase(64, 2.5, rng) if exponent is None else power_law_phase(64, 2.5, exponent, rng)
    assert rms(phase) == pytest.approx(2.5, rel=1e-12)
    np.testing.assert_allclose(detrended(phase), phase, atol=1e-12)


@pytest.mark.parametrize("exponent", [0.0, 1.0, 1.5])
def test_power_law_has_its_exponent(exponent: float) -> None:
    """Slope of the mean periodogram of 400 records between 4 and 64 cycles; Hann window against leakage.

    Standard error .01 of a slope over four octaves; removing the trend touches the first cycles only.
    """
    rng = np.random.default_rng(2)
    records = np.array([power_law_phase(256, 1.0, exponent, rng) for _ in range(400)])
    power = np.mean(np.abs(np.fft.rfft(records * np.hanning(256))) ** 2, axis=0)
    cycles = np.arange(4, 65)
    slope = np.polyfit(np.log(cycles), np.log(power[cycles]), 1)[0]
    assert slope == pytest.approx(-exponent, abs=0.06)


def test_residual_ignores_mean_shift_and_whole_turns() -> None:
    rng = np.random.default_rng(3)
    truth = white_phase(64, 10.0, rng)
    estimate = truth + 1.7 + 23.4 * TIME + 2 * np.pi * rng.integers(-3, 4, 64)
    assert rms(residual_phase(estimate, truth)) < 1e-9


def test_residual_is_the_difference_where_it_is_small() -> None:
    rng = np.random.default_rng(4)
    truth, error = white_phase(64, 10.0, rng), power_law_phase(64, 0.3, ATMOSPHERE, rng)
    np.testing.assert_allclose(residual_phase(truth - error, truth), error, atol=2e-3)


@pytest.mark.parametrize("pulses", [8, 300])
def test_information_is_solved_with_mean_and_trend_known(pulses: int) -> None:
    """Against the inverse on what is orthogonal to both; the information is that of steps from pulse to pulse."""
    step = np.diff(np.eye(pulses), axis=0)
    information = step.T @ (np.arange(1.0, pulses)[:, None] * step)
    line = np.linalg.qr(np.stack([np.ones(pulses), np.arange(pulses)], axis=1))[0]
    others = scipy.linalg.null_space(line.T)
    inverse = others @ np.linalg.inv(others.T @ information @ others) @ others.T
    found = PhaseInformation.of(lower_band(information, 3))
    slopes = information @ TIME[np.arange(pulses) % 64] ** 2
    np.testing.assert_allclose(found.solve(slopes), inverse @ slopes, atol=1e-5 * np.abs(inverse @ slopes).max())
    assert found.variance == pytest.approx(np.trace(inverse) / pulses, rel=1e-5)


def test_shift_is_taken_off_a_smooth_phase_only() -> None:
    """A phase that jumps by more than half a turn has no course that could be called a trend."""
    rng = np.random.default_rng(5)
    turns = 2 * np.pi * rng.integers(-3, 4, 64)
    np.testing.assert_allclose(without_shift(TIME**2 + 20 * TIME + turns), detrended(TIME**2), atol=1e-12)
    rough = white_phase(64, 10.0, rng) + 5 * TIME
    kept = np.exp(1j * (without_shift(rough) - rough))
    np.testing.assert_allclose(kept, kept[0], atol=1e-9)
