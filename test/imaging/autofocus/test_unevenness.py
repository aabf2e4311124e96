"""Ground of uneven brightness: what the spectrum of the echo says of how far it moves the Doppler centroid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import circular

from sal_height.geometry.trajectory import Trajectory
from sal_height.imaging.autofocus.coherence import beam_coherence
from sal_height.imaging.autofocus.phase_linking import Likelihood, find_trend, speckle_classes
from sal_height.imaging.autofocus.unevenness import uneven_trend
from sal_height.imaging.focus import ImageSettings, focus_dwell
from sal_height.simulation.flight import SimulatedFlight
from sal_height.simulation.preset import load_preset
from sal_height.simulation.scenes import load_scene

SNR, RESPONSES = 50.0, 300


def coherence_of(preset_name: str):
    preset = load_preset(preset_name)
    sensor = preset.make_sensor()
    flight = SimulatedFlight(preset, sensor, load_scene(preset.scene), 1, seed=1)
    antenna = flight.position(flight.dwell_start_ns(0) * 1e-9 + flight.pulse_times)
    return beam_coherence(sensor, antenna)


def speckle_of(brightness: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Responses of ground of this brightness at each azimuth of the beam of `sal_spotlight`."""
    coherence = coherence_of("sal_spotlight")
    amplitude = np.sqrt(SNR * coherence.profile * brightness)
    pulses = len(coherence.waves)
    echo = (circular(rng, (RESPONSES, 2 * pulses)) * amplitude) @ coherence.waves.T
    return echo + circular(rng, (RESPONSES, pulses))


def test_trends_by_steps_anywhere_are_as_far_as_stated() -> None:
    """Steps of 2 to 20 dB at any azimuth of the main lobe: 60 draws, whose rms is known to 10 %."""
    rng = np.random.default_rng(21)
    coherence = coherence_of("sal_spotlight")
    azimuths, ratios = np.linspace(-1, 1, 128), []
    for _ in range(60):
        step = 10 ** (rng.choice([-1, 1]) * rng.uniform(0.2, 2.0))
        modes = speckle_of(np.where(azimuths > rng.uniform(-0.6, 0.6), step, 1.0), rng)
        snr = np.full(RESPONSES, float(np.mean(np.abs(modes) ** 2)) - 1)
        likelihood = Likelihood.of(speckle_classes(modes, snr), coherence)
        trend, error = find_trend(modes, snr, coherence, likelihood, np.zeros(64))
        ratios.append(trend / error)
    assert 0.5 < np.sqrt(np.mean(np.square(ratios))) < 1.3
    assert np.abs(ratios).max() < 4


def test_even_ground_has_no_unevenness_but_that_of_speckle() -> None:
    """A twentieth of the beam's half width, which is a quarter of the band."""
    rng, coherence = np.random.default_rng(22), coherence_of("sal_spotlight")
    found = [uneven_trend(speckle_of(np.ones(128), rng), np.full(RESPONSES, SNR), coherence) for _ in range(20)]
    assert max(found) < np.pi / 2 / 20


@pytest.mark.parametrize("dark_db", [-3.0, -10.0])
def test_an_edge_of_a_shadow_across_the_flight_is_in_the_covariance_of_the_place(dark_db: float) -> None:
    """Level ground, half of it dark: the image of an exact flight is off by no more than 3 of what is stated."""
    preset = replace(load_preset("sal_spotlight"), dwells=1)
    street = load_scene(preset.scene)
    shadow = np.where(street.east > 0, 10 ** (dark_db / 10), 1.0) * np.ones_like(street.height)
    scene = replace(street, height=np.zeros_like(street.height), brightness=shadow)
    flight = SimulatedFlight(preset, preset.make_sensor(), scene, 1, seed=23)
    states = [replace(state, velocity_covariance=25e-6 * np.eye(3)) for state in flight.platform_states(0)]
    slc = focus_dwell(flight.phase_history(0), Trajectory(states), flight.spectrum, ImageSettings())
    off = slc.placement.speed * preset.flight.slant_range_m / preset.flight.speed_mps
    stated = slc.placement.speed_error * preset.flight.slant_range_m / preset.flight.speed_mps
    assert 0.03 < abs(off) < 3 * stated
    assert stated < 0.4
    assert not slc.doubt, "what is open is stated"
