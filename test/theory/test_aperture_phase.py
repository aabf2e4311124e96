"""What phases over an aperture do to images, against phases that the simulator draws."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.constants import speed_of_light

from sal_height.numeric import F64
from sal_height.simulation import laser_structure
from sal_height.simulation.impairments import Turbulence
from sal_height.simulation.phase_errors import Vibration, VibrationLine, laser_phase
from sal_height.theory import AperturePhase, phase_of_line, phase_of_structure, sum_of_phases

APERTURES = 1500
PULSES = 200
TOLERANCE = 0.08
"""Of an rms: the standard error of one over so many independent apertures is 1.8 %."""


def measured(phases: F64, duration: float) -> AperturePhase:
    """Rms trend (rad/s) and rest (rad) of phases of shape (apertures, pulses)."""
    seconds = (np.arange(PULSES) - (PULSES - 1) / 2) * duration / PULSES
    fitted = np.polynomial.polynomial.polyfit(seconds, phases.T, 1)
    rest = phases - np.polynomial.polynomial.polyval(seconds, fitted)
    return AperturePhase(float(np.sqrt(np.mean(fitted[1] ** 2))), float(np.sqrt(np.mean(rest**2))))


def assert_alike(expected: AperturePhase, found: AperturePhase) -> None:
    assert found.trend == pytest.approx(expected.trend, rel=TOLERANCE)
    assert found.rest == pytest.approx(expected.rest, rel=TOLERANCE)


@pytest.mark.parametrize("turns", [0.05, 0.7, 3.3])
def test_a_vibration_of_any_frequency(turns: float) -> None:
    duration, amplitude, wavelength = 2e-3, 3e-7, 1.55e-6
    lines = tuple(VibrationLine(amplitude, turns * factor / duration) for factor in (1.0, 1.6))
    rng, seconds = np.random.default_rng(1), np.arange(PULSES) * duration / PULSES
    drawn = [Vibration(lines=lines).drawn(rng).displacement(seconds)[:, 0] for _ in range(APERTURES)]
    radians = 4 * np.pi / wavelength
    expected = sum_of_phases(
        phase_of_line(radians * amplitude, 2 * np.pi * one.frequency_hz, duration) for one in lines
    )
    assert_alike(expected, measured(radians * np.array(drawn), duration))


@pytest.mark.parametrize("shares_of_a_dwell", [0.05, 0.5, 4.0])
def test_a_laser_whose_echo_is_long_or_short_under_way(shares_of_a_dwell: float) -> None:
    duration, linewidth = 1e-3, 2000.0
    slant_range = shares_of_a_dwell * duration * speed_of_light / 2
    rng, seconds = np.random.default_rng(2), np.arange(PULSES) * duration / PULSES
    drawn = [laser_phase(linewidth, seconds, slant_range, rng) for _ in range(APERTURES)]
    expected = phase_of_structure(laser_structure(linewidth, slant_range), duration)
    assert_alike(expected, measured(np.array(drawn), duration))


def test_a_laser_in_a_long_aperture_keeps_the_share_that_its_beat_note_keeps() -> None:
    """exp(-4 pi linewidth R / c): Richter et al., 1986."""
    found = phase_of_structure(laser_structure(5000.0, 5000.0), 10.0)
    kept = np.exp(-4 * np.pi * 5000.0 * 5000.0 / speed_of_light)
    assert 1 - found.spread_share == pytest.approx(kept, rel=1e-4)


def test_turbulence_that_is_flown_past() -> None:
    turbulence, speed, duration = Turbulence(ground_cn2=1.7e-14), 50.0, 0.02
    level = turbulence.structure(1.55e-6, 5000.0, 3500.0)
    rng, seconds = np.random.default_rng(3), np.arange(PULSES) * duration / PULSES
    drawn = [turbulence.drawn(level, speed, rng).displacement(seconds)[:, 0] for _ in range(APERTURES)]
    expected = phase_of_structure(lambda lag: level * (speed * lag) ** (5 / 3), duration)
    assert_alike(expected, measured(np.array(drawn), duration))


def test_a_steady_drift_is_a_trend_and_nothing_else() -> None:
    found = phase_of_structure(lambda lag: (30.0 * lag) ** 2, 0.4)
    assert found.trend == pytest.approx(30.0, rel=1e-6)
    assert found.rest < 1e-3
