"""Vibration and laser: phases of the variance that theory gives them, and what they do to an image."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import yaml
from helpers import refused
from scipy.constants import g, speed_of_light
from scipy.special import jv

from sal_height.errors import UserError
from sal_height.simulation import SimulatedFlight, flight_of, load_preset, parse_preset
from sal_height.simulation.flight import VIBRATION
from sal_height.simulation.impairments import Impairments
from sal_height.simulation.phase_errors import Vibration, VibrationBand, VibrationLine, laser_phase
from sal_height.simulation.preset import SHIPPED

TRUE = replace(load_preset("small"), cnr_db=60.0)


def flight_with(impairments: Impairments) -> SimulatedFlight:
    return flight_of(replace(TRUE, impairments=impairments), seed=3)


@pytest.mark.parametrize("linewidth_hz", [100.0, 1e5])
def test_phase_of_a_laser_walks_until_the_echo_is_back(linewidth_hz: float) -> None:
    """4 pi linewidth min(t, 2 R / c), each to 4 standard errors of 4000 walks, 9 %."""
    seconds, rng = 1e-5 * np.arange(13), np.random.default_rng(1)
    walks = np.array([laser_phase(linewidth_hz, seconds, 5000.0, rng) for _ in range(4000)])
    for lag in (1, 3, 4, 12):  # the echo is back after 3.34 pulses
        variance = np.mean((walks[:, lag] - walks[:, 0]) ** 2)
        expected = 4 * np.pi * linewidth_hz * min(seconds[lag], 2 * 5000.0 / speed_of_light)
        assert variance == pytest.approx(expected, rel=0.09)


def deramped(linewidth_hz: float, pulse_s: float, seed: int = 3) -> SimulatedFlight:
    """A flight whose records are a sample longer than its pulses."""
    rate_hz = 64 / pulse_s
    sensor = replace(
        TRUE.sensor, waveform="deramped", pulse_duration_s=pulse_s, sampling_rate_hz=rate_hz, sample_count=65
    )
    impairments = Impairments(laser_linewidth_hz=linewidth_hz, laser_within_pulse=linewidth_hz > 0)
    return flight_of(replace(TRUE, sensor=sensor, impairments=impairments), seed)


@pytest.mark.parametrize("linewidth_hz", [2e4, 2e5])
def test_a_beat_note_keeps_in_its_cell_what_a_walk_within_the_pulse_leaves(linewidth_hz: float) -> None:
    """2 (a T - 1 + exp(-a T)) / (a T)^2 of its power, a = 2 pi linewidth, in a pulse T that ends before its echo comes.

    It is the mean of the autocorrelation exp(-a t) over the record; 100 dwells, within four of their standard errors.
    """
    pulse_s = 5e-6
    flight = deramped(linewidth_hz, pulse_s)
    kept = [np.mean(np.abs(np.exp(1j * flight.sample_phase(dwell)).mean(axis=1)) ** 2) for dwell in range(100)]
    x = 2 * np.pi * linewidth_hz * pulse_s * 65 / 64
    expected = 2 * (x - 1 + np.exp(-x)) / x**2
    error = np.std(kept) / np.sqrt(len(kept))
    assert error < 0.02
    assert np.mean(kept) == pytest.approx(expected, abs=4 * error + 1e-3)


def test_of_a_beat_note_longer_than_the_way_of_the_echo_the_coherent_share_stays() -> None:
    """exp(-4 pi linewidth R / c) of its power in a cell of no width; 2000 walks of 60 times that way, within 5 %."""
    way_s, linewidth_hz, rng = 2 * 5000.0 / speed_of_light, 5000.0, np.random.default_rng(4)
    seconds = np.linspace(0.0, 60 * way_s, 600)
    beats = np.array([np.exp(1j * laser_phase(linewidth_hz, seconds, 5000.0, rng)) for _ in range(500)])
    kept, x = np.mean(np.abs(beats.mean(axis=1)) ** 2), 2 * np.pi * linewidth_hz * way_s
    coherent = np.exp(-x)
    spread = 2 * ((1 - coherent) / x - coherent) / 60  # of the rest, what is in the cell of a pulse of 60 ways
    assert kept == pytest.approx(coherent + spread, rel=0.01)


def test_the_walk_within_pulses_turns_the_raw_samples() -> None:
    walking, steady = deramped(2e5, 5e-6), deramped(0.0, 5e-6)
    turned, samples = walking.phase_history(0).samples, steady.phase_history(0).samples
    expected = samples * np.exp(1j * walking.sample_phase(0))
    noise = np.sqrt(walking.sensor.noise_power[0])
    assert np.abs(turned - expected).max() < 12 * noise
    assert np.abs(turned - samples).max() > 100 * noise
    assert np.all(walking.pulse_phase(0) == 0)


def test_phases_of_dwells_are_drawn_alone_and_again_the_same() -> None:
    first, second = flight_with(Impairments(laser_linewidth_hz=1e4)), flight_with(Impairments(laser_linewidth_hz=1e4))
    np.testing.assert_array_equal(first.pulse_phase(1), second.pulse_phase(1))
    assert abs(np.corrcoef(first.pulse_phase(0), first.pulse_phase(1))[0, 1]) < 0.5
    assert np.all(laser_phase(0.0, first.pulse_times, 5000.0, np.random.default_rng(0)) == 0)


def test_an_antenna_farther_away_has_a_phase_of_4_pi_over_the_wavelength() -> None:
    """Over three dwells of 64 ms, the phase of a line has its amplitude and frequency, and lags where it is farther."""
    flight = flight_with(Impairments(vibration=Vibration(lines=(VibrationLine(2e-6, 40.0),))))
    preset = replace(flight.preset, sensor=replace(flight.preset.sensor, pulse_count=64))
    slow = replace(flight, sensor=replace(flight.sensor, pulse_repetition_frequency=1000.0), preset=preset)
    phase = np.concatenate([slow.pulse_phase(dwell) for dwell in range(3)])
    times = np.concatenate([slow.dwell_start_ns(dwell) * 1e-9 + slow.pulse_times for dwell in range(3)])
    waves = np.stack([np.cos(2 * np.pi * 40 * times), np.sin(2 * np.pi * 40 * times)], axis=1)
    found, left, *_ = np.linalg.lstsq(waves, phase)
    assert np.hypot(*found) == pytest.approx(4 * np.pi * 2e-6 / flight.sensor.wavelength, rel=1e-6)
    assert left.item() < 1e-9
    farther = flight.preset.impairments.vibration.drawn(
        np.random.default_rng(np.random.SeedSequence(flight.seed, spawn_key=(VIBRATION,)))
    ).displacement(times)[:, 0]
    np.testing.assert_allclose(phase, -4 * np.pi / flight.sensor.wavelength * farther, atol=1e-6)


def test_acceleration_of_a_band_is_what_its_density_says() -> None:
    """Mean square over 20 000 times: g^2 times density times width, within 5 %."""
    band = VibrationBand(density_g2_per_hz=0.01, lowest_hz=20.0, highest_hz=2000.0)
    motion = Vibration(bands=(band,)).drawn(np.random.default_rng(2))
    seconds = np.random.default_rng(3).uniform(0, 100, 20_000)
    acceleration = motion.acceleration(seconds)[:, 0]
    assert np.mean(acceleration**2) == pytest.approx(g**2 * 0.01 * 1980, rel=0.05)


def test_a_vibration_makes_paired_echoes_of_bessel_functions() -> None:
    """Echoes of a phase of amplitude m have the amplitudes J_n(m), at n frequencies of the vibration to each side."""
    pulses = TRUE.sensor.pulse_count
    frequency, depth = 6 * TRUE.sensor.pulse_repetition_frequency_hz / pulses, 0.8
    line = VibrationLine(depth * TRUE.sensor.wavelength_m / (4 * np.pi), frequency)
    shaken = flight_with(Impairments(vibration=Vibration(lines=(line,))))
    still, moved = flight_with(Impairments()).phase_history(0), shaken.phase_history(0)
    products = np.sum(moved.samples * still.samples.conj(), axis=(0, 2))
    powers = np.sum(np.abs(still.samples) ** 2, axis=(0, 2))
    spectrum = np.abs(np.fft.fft(products / powers)) / pulses
    np.testing.assert_allclose(spectrum[[0, 6, -6, 12, -12]], np.abs(jv([0, 1, 1, 2, 2], depth)), atol=0.01)


@pytest.mark.parametrize(
    ("key", "value", "parts"),
    [
        ("laser_linewidth_hz", -1, ("laser_linewidth_hz",)),
        ("laser_within_pulse", True, ("laser_within_pulse is true", "'spectrum'", "must be false")),
        ("air", {"pressure_pa": 1013}, ("air", "1013 Pa", "70000 to 130000 are allowed", "in Pa")),
        ("air", {"pressure_pa": 101_325, "height_m": 5000}, ("101325 Pa at 5000 m", "as it is at height_m")),
        ("vibration", {"lines": [{"amplitude_m": 1e-6}]}, ("frequency_hz",)),
        ("vibration", {"bands": [{"density_g2_per_hz": 1, "lowest_hz": 9, "highest_hz": 3}]}, ("lowest_hz", "below")),
    ],
)
def test_settings_that_are_none_are_said_in_one_sentence(key: str, value: object, parts: tuple[str, ...]) -> None:
    content = yaml.safe_load((SHIPPED / "small.yaml").read_text())
    with refused(UserError, *parts):
        parse_preset(content | {"impairments": {key: value}}, "small")


def test_a_laser_belongs_to_a_lidar() -> None:
    content = yaml.safe_load((SHIPPED / "xband_relief.yaml").read_text())
    with refused(UserError, "laser_linewidth_hz is 2000", "wavelength_m 0.03", "leave it out"):
        parse_preset(content | {"impairments": {"laser_linewidth_hz": 2000.0}}, "radar.yaml")
