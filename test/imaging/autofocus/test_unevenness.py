"""Ground of uneven brightness: what the spectrum of the echo says of how far it moves the Doppler centroid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import circular, few

from sal_height.geometry.trajectory import Trajectory
from sal_height.imaging.autofocus.coherence import Coherence, beam_coherence
from sal_height.imaging.autofocus.phase_linking import MAIN_LOBE, Likelihood, find_trend, speckle_classes, uneven_trend
from sal_height.imaging.focus import ImageSettings, focus_dwell
from sal_height.simulation.flight import SimulatedFlight, flight_of
from sal_height.simulation.preset import load_preset
from sal_height.simulation.scenes import load_scene

SNR, RESPONSES = 50.0, 300
REACH_M, SPEED_MPS = 5000.0, 50.0


def coherence_of(preset_name: str):
    preset = load_preset(preset_name)
    sensor = preset.make_sensor()
    flight = SimulatedFlight(preset, sensor, load_scene(preset.scene), 1, seed=1)
    antenna = flight.position(flight.dwell_start_ns(0) * 1e-9 + flight.pulse_times)
    return beam_coherence(sensor, antenna)


def speckle_of(
    brightness: np.ndarray, rng: np.random.Generator, *, preset_name: str = "sal_spotlight", count: int = RESPONSES
) -> np.ndarray:
    """Responses of ground of this brightness at each azimuth of the beam, that of all responses or of each."""
    coherence = coherence_of(preset_name)
    amplitude = np.sqrt(SNR * coherence.profile * brightness)
    pulses = len(coherence.waves)
    echo = (circular(rng, (count, 2 * pulses)) * amplitude) @ coherence.waves.T
    return echo + circular(rng, (count, pulses))


def trend_of(modes: np.ndarray, coherence: Coherence) -> tuple[float, float]:
    """The trend of responses without phase errors, and its standard error, rad."""
    snr = np.full(len(modes), float(np.mean(np.abs(modes) ** 2)) - 1)
    likelihood = Likelihood.of(speckle_classes(modes, snr), coherence)
    return find_trend(modes, snr, coherence, likelihood, np.zeros(modes.shape[-1]))


def over_main_lobe(coherence: Coherence) -> np.ndarray:
    """From -1 to 1 over the main lobe, beyond it to both sides."""
    lobe = np.flatnonzero(coherence.profile >= MAIN_LOBE * coherence.profile.max())
    return np.interp(np.arange(len(coherence.profile)), lobe[[0, -1]], [-1.0, 1.0])


def test_a_turned_axis_of_detectors_looks_like_uneven_ground() -> None:
    """Range cells then look at other places along the flight: 17 to 20 cm are stated in place of 2 to 5, and hold."""
    stated = {}
    for turned in (0.0, np.radians(15)):
        sal = load_preset("sal_spotlight")
        sensor = replace(sal.sensor, detector_rotation_rad=turned, pulse_repetition_frequency_hz=60e3)
        flight = flight_of(replace(sal, sensor=sensor), seed=1)
        metres = flight.sensor.wavelength * flight.sensor.pulse_repetition_frequency / (4 * np.pi) * REACH_M / SPEED_MPS
        errors = []
        for number in range(3):
            states = [
                replace(s, velocity_covariance=0.005**2 * np.eye(3), covariance=np.diag([0.0] * 3 + [1e-10] * 3))
                for s in flight.track(number).states
            ]
            image = ImageSettings(air="none", rows=184, cols=12)
            focus = focus_dwell(flight.phase_history(number), Trajectory(states), flight.sensor, image).focus
            assert focus is not None
            assert abs(focus.trend) < 3 * focus.trend_error
            errors.append(metres * focus.trend_error)
        stated[turned] = errors
    assert max(stated[0.0]) < 0.06
    assert 0.15 < min(stated[np.radians(15)]) < max(stated[np.radians(15)]) < 0.22


DRAWS = pytest.mark.parametrize(("draws", "error"), few(1, [(15, 0.2), (60, 0.1)]), ids=["few", "all"])
"""Numbers of draws, and the standard error of their rms."""


@DRAWS
def test_trends_by_steps_anywhere_are_as_far_as_stated(draws: int, error: float) -> None:
    """Steps of 2 to 20 dB at any azimuth of the main lobe and beside it; 0.85 of what is stated, to 3.5 of error."""
    rng = np.random.default_rng(21)
    coherence = coherence_of("sal_spotlight")
    azimuths, ratios = np.linspace(-1, 1, 128), []
    for _ in range(draws):
        step = 10 ** (rng.choice([-1, 1]) * rng.uniform(0.2, 2.0))
        modes = speckle_of(np.where(azimuths > rng.uniform(-0.75, 0.75), step, 1.0), rng)
        trend, stated = trend_of(modes, coherence)
        ratios.append(trend / stated)
    assert np.sqrt(np.mean(np.square(ratios))) == pytest.approx(0.85, abs=3.5 * error)
    assert np.abs(ratios).max() < 4


@DRAWS
def test_ground_of_another_slope_in_each_block_is_as_far_off_as_stated(draws: int, error: float) -> None:
    """Of which a slope hardly shows in the spectrum of all; 2.5 standard errors of the rms are allowed."""
    rng = np.random.default_rng(24)
    coherence = coherence_of("sal_stripmap")
    u, ratios = over_main_lobe(coherence), []
    for _ in range(draws):
        slopes = rng.choice([-1, 1], 12) * rng.uniform(0.1, 0.35, 12)
        brightness = np.repeat(np.exp(np.outer(slopes, u)), 8, axis=0)
        trend, stated = trend_of(speckle_of(brightness, rng, preset_name="sal_stripmap", count=96), coherence)
        ratios.append(trend / stated)
    assert np.sqrt(np.mean(np.square(ratios))) == pytest.approx(1.0, abs=2.5 * error)


@pytest.mark.parametrize("order", [2, 3, 5])
def test_a_shape_that_no_shift_makes_tells_how_large_a_slope_may_be(order: int) -> None:
    """By how much each order has of a step, (1 / (2 k - 1) + 1 / (2 k + 3)) / 4. To 25 %: sidelobes mix orders."""
    rng, coherence = np.random.default_rng(25), coherence_of("sal_spotlight")
    u = over_main_lobe(coherence)
    by_slope, _ = trend_of(speckle_of(np.exp(0.2 * u), rng, count=8000), coherence)
    shape = np.polynomial.legendre.Legendre.basis(order)(u)
    modes = speckle_of(np.exp(0.2 * shape), rng, count=8000)
    found = uneven_trend(modes, np.full(8000, SNR), coherence)
    of_slope, of_shape = ((1 / (2 * k - 1) + 1 / (2 * k + 3)) / 4 for k in (1, order))
    assert found == pytest.approx(abs(by_slope) * np.sqrt(of_slope / of_shape / 5), rel=0.25)


def test_even_ground_has_no_unevenness_but_that_of_speckle() -> None:
    """A twentieth of the beam's half width, which is a quarter of the band."""
    rng, coherence = np.random.default_rng(22), coherence_of("sal_spotlight")
    found = [uneven_trend(speckle_of(np.ones(128), rng), np.full(RESPONSES, SNR), coherence) for _ in range(20)]
    assert max(found) < np.pi / 2 / 20


@pytest.mark.parametrize(
    ("dark_db", "off_m", "stated_m"), [(0.0, 0.0, 0.025), (-3.0, 0.043, 0.054), (-10.0, 0.13, 0.15)]
)
def test_an_edge_of_a_shadow_across_the_flight_is_in_the_covariance_of_the_place(
    dark_db: float, off_m: float, stated_m: float
) -> None:
    """Level ground, half of it dark: how far the image of an exact flight is off, and how far is stated, to 1 cm."""
    preset = replace(load_preset("sal_spotlight"), dwells=1)
    street = load_scene(preset.scene)
    shadow = np.where(street.east > 0, 10 ** (dark_db / 10), 1.0) * np.ones_like(street.height)
    scene = replace(street, height=np.zeros_like(street.height), brightness=shadow)
    flight = SimulatedFlight(preset, preset.make_sensor(), scene, 1, seed=23)
    states = [replace(state, velocity_covariance=25e-6 * np.eye(3)) for state in flight.platform_states(0)]
    slc = focus_dwell(flight.phase_history(0), Trajectory(states), flight.spectrum, ImageSettings(air="none"))
    off = slc.placement.speed * preset.flight.slant_range_m / preset.flight.speed_mps
    stated = slc.placement.speed_error * preset.flight.slant_range_m / preset.flight.speed_mps
    assert abs(off) == pytest.approx(off_m, abs=0.01)
    assert stated == pytest.approx(stated_m, abs=0.01)
    assert not slc.doubts, "what is open is stated"
