"""The simulator: phase history against the sum written out, noise and speckle against their statistics, the flight."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import (
    BEAMWIDTH,
    direct_history,
    elevation_at,
    flat_scene,
    make_aperture,
    make_sensor,
    sensor_with_complex_beams,
)

from sal_height.geometry.earth import EARTH_RADIUS, height_of
from sal_height.geometry.frames import angles_of, look_direction
from sal_height.geometry.grid import Grid
from sal_height.geometry.trajectory import Trajectory
from sal_height.imaging.formers.backprojection import backproject
from sal_height.imaging.pixels import Processing, aim_point, azimuth_resolution, slant_plane_grid
from sal_height.numeric.windows import noise_gain, window
from sal_height.sensor.sensor import PhaseHistory, Sensor
from sal_height.simulation.flight import SimulatedFlight
from sal_height.simulation.preset import load_preset
from sal_height.simulation.receiver_noise import receiver_noise
from sal_height.simulation.scene import VisibleSurface, visible_surface
from sal_height.simulation.spotlight import cell_power, draw_amplitudes, simulate_dwell


def scatterers(positions: np.ndarray, power: np.ndarray, deterministic: np.ndarray) -> VisibleSurface:
    slant_range, elevation, squint = angles_of(positions, make_aperture(), 1)
    heights, still = height_of(positions), np.zeros_like(positions)
    return VisibleSurface(positions, heights, power, slant_range, elevation, squint, deterministic, still)


def straight_track(sensor: Sensor) -> np.ndarray:
    along = (np.arange(sensor.pulse_count) - (sensor.pulse_count - 1) / 2) * 50 / sensor.pulse_repetition_frequency
    return make_aperture().position + along[:, None] * np.array([1.0, 0.0, 0.0])


@pytest.mark.parametrize("frequencies", [16, 17])
def test_phase_history_is_the_sum_over_scatterers_written_out(frequencies: int) -> None:
    sensor = make_sensor(sample_count=frequencies, pulse_count=6)
    rng = np.random.default_rng(5)
    offsets, squints = rng.uniform(-0.7, 0.7, 5), rng.uniform(-0.5, 0.5, 5) * BEAMWIDTH
    ranges = 5000 + rng.uniform(-0.5, 0.5, 5)
    positions = make_aperture().position + ranges[:, None] * look_direction(elevation_at(offsets), squints, 1)
    surface = scatterers(positions, np.ones(5), np.ones(5, bool))
    amplitudes = rng.standard_normal(5) + 1j * rng.standard_normal(5)
    antenna, reference = straight_track(sensor), 5000 + rng.uniform(-0.1, 0.1, 6)

    weighted = sensor.beams.response(elevation_at(offsets), squints).T * amplitudes
    expected = direct_history(sensor, positions, weighted, antenna, reference)
    samples = simulate_dwell(sensor, surface, amplitudes, antenna, reference)
    assert samples.shape == (3, 6, frequencies)
    np.testing.assert_allclose(samples, expected, atol=3e-5 * np.abs(expected).max())


def test_noise_is_circular_independent_and_of_the_stated_power() -> None:
    sensor = make_sensor(noise_power=(1.0, 4.0, 0.25))
    pulses = 500
    noise = receiver_noise(sensor, pulses, np.random.default_rng(6)).reshape(3, -1)
    standard_error = 1 / np.sqrt(noise.shape[1])  # relative, of a mean of |n|^2: 0.56 %
    normal = noise / np.sqrt(sensor.noise_power)[:, None]
    correlation = normal @ normal.conj().T / noise.shape[1]
    np.testing.assert_allclose(correlation, np.eye(3), atol=3.5 * standard_error)
    np.testing.assert_allclose(np.mean(normal**2, axis=1), 0, atol=3.5 * standard_error)


def test_speckle_fluctuates_and_point_targets_do_not() -> None:
    sensor = make_sensor(noise_power=(2.0, 2.0, 2.0))
    count = 20_000
    power = np.concatenate([np.full(count, 0.5), [9.0]])
    surface = scatterers(np.full((count + 1, 3), [0.0, -3000.0, 0.0]), power, np.arange(count + 1) == count)
    amplitudes = draw_amplitudes(surface, cell_power(100.0, sensor, 48), np.random.default_rng(7))
    unit = 100.0 * 2.0 / (48 * 64)  # CNR times the noise power of an unweighted image
    assert amplitudes[-1] == pytest.approx(np.sqrt(9 * unit), rel=1e-12)
    speckle = amplitudes[:-1] / np.sqrt(0.5 * unit)
    standard_error = 1 / np.sqrt(count)
    assert np.mean(np.abs(speckle) ** 2) == pytest.approx(1, abs=3.5 * standard_error)
    assert np.mean(np.abs(speckle) ** 4) == pytest.approx(
        2, abs=3.5 * np.sqrt(20) * standard_error
    )  # exponential power
    assert np.abs(np.mean(speckle**2)) < 3.5 * standard_error


def focused(sensor: Sensor, samples: np.ndarray, name: str) -> np.ndarray:
    aperture = make_aperture()
    grid = slant_plane_grid(sensor, aperture, 5000.0, 63, 48, 1.0)
    reference = np.full(sensor.pulse_count, 5000.0)
    history = PhaseHistory(0, np.zeros(sensor.pulse_count), reference, samples.astype(np.complex64))
    return backproject(history, straight_track(sensor), sensor, Processing(name), grid)


def standard_error_of_power(weights: np.ndarray, pixels: int) -> float:
    """Relative, of the mean power of a speckled image: by Parseval the samples are independent, with powers w^2."""
    return float(np.sqrt(np.mean(weights**4) / np.mean(weights**2) ** 2 / pixels))


@pytest.mark.parametrize("name", ["rectangular", "taylor"])
def test_focused_level_ground_has_the_stated_cnr(name: str) -> None:
    """Independent of the window: what it adds to the noise, it adds to the clutter.

    The beam is made so wide that it is level over the image. The ground spans one ambiguity in range and azimuth, so
    that each cell gets from beyond one edge what it loses over the other.
    """
    cnr, dwells = 100.0, 6
    sensor = make_sensor(aperture=1e-4, elevation_boresights=(np.pi / 4,), noise_power=(3.0,))
    aperture = make_aperture()
    cell = sensor.range_resolution, azimuth_resolution(sensor, aperture, 5000.0)
    half_east, half_range = sensor.pulse_count / 2 * cell[1], sensor.range_window / 2
    surface = visible_surface(
        flat_scene(north=-5000 * np.sqrt(0.5), half=5.0),
        aperture,
        1,
        cell,
        (-half_east, half_east),
        (5000 - half_range, 5000 + half_range),
    )
    rng = np.random.default_rng(8)
    powers = []
    for _ in range(dwells):
        amplitudes = draw_amplitudes(surface, cell_power(cnr, sensor, sensor.pulse_count), rng)
        reference = np.full(sensor.pulse_count, 5000.0)
        samples = simulate_dwell(sensor, surface, amplitudes, straight_track(sensor), reference)
        powers.append(np.mean(np.abs(focused(sensor, samples, name)) ** 2))
    weights = window(name, sensor.sample_count)
    noise = 3.0 * noise_gain(weights) / (sensor.pulse_count * sensor.sample_count)
    standard_error = standard_error_of_power(weights, dwells * 63 * 48)  # 0.7 and 0.9 %
    assert np.mean(powers) / noise == pytest.approx(cnr, rel=3.5 * standard_error)


@pytest.mark.parametrize("name", ["rectangular", "taylor"])
def test_noise_in_the_image_is_that_of_a_sample_over_their_number_times_the_windows_gain(name: str) -> None:
    sensor = make_sensor(noise_power=(1.0, 4.0, 0.25))
    samples = receiver_noise(sensor, sensor.pulse_count, np.random.default_rng(9))
    power = np.mean(np.abs(focused(sensor, samples, name)) ** 2, axis=(1, 2))
    weights = window(name, sensor.sample_count)
    expected = noise_gain(weights) * np.array(sensor.noise_power) / (sensor.pulse_count * sensor.sample_count)
    np.testing.assert_allclose(power, expected, rtol=3.5 * standard_error_of_power(weights, 63 * 48))  # 6 and 8 %


@pytest.fixture(scope="module")
def flight() -> SimulatedFlight:
    preset = load_preset("small")
    return SimulatedFlight(preset, preset.make_sensor(), flat_scene(), dwells=3, seed=4)


def test_same_seed_and_dwell_give_identical_bytes_and_others_do_not(flight: SimulatedFlight) -> None:
    first = flight.phase_history(1).samples.tobytes()
    assert flight.phase_history(1).samples.tobytes() == first
    assert flight.phase_history(2).samples.tobytes() != first
    assert replace(flight, seed=5).phase_history(1).samples.tobytes() != first


def test_noise_of_one_dwell_has_nothing_to_do_with_that_of_another(flight: SimulatedFlight) -> None:
    noise_only = replace(flight, preset=replace(flight.preset, cnr_db=-60.0))
    first, second = (noise_only.phase_history(dwell).samples.ravel() for dwell in (1, 2))
    correlation = np.vdot(first, second) / np.linalg.norm(first) / np.linalg.norm(second)
    assert abs(correlation) < 3.5 / np.sqrt(len(first))


@pytest.mark.parametrize("look_side", ["left", "right"])
def test_middle_dwell_passes_abeam_of_the_scene_at_the_stated_range_and_angle(look_side: str) -> None:
    preset = load_preset("small")
    preset = replace(preset, sensor=replace(preset.sensor, look_side=look_side))
    flight = SimulatedFlight(preset, preset.make_sensor(), flat_scene(12.0), dwells=5, seed=0)
    aperture = flight.aperture(2)
    slant_range, elevation, squint = angles_of(np.array([0.0, 0.0, 12.0]), aperture, flight.sensor.look_side)
    assert slant_range == pytest.approx(5000.0, abs=1e-9)
    assert elevation == pytest.approx(np.pi / 4, abs=1e-12)
    assert squint == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(aim_point(flight.sensor, aperture, 5000.0), [0, 0, 12.0], atol=1e-9)
    step = flight.aperture(3).position - aperture.position
    np.testing.assert_allclose(step, [preset.flight.dwell_spacing_m, 0, 0], atol=1e-6)  # dwells start at full ns


def test_odometry_of_a_flight_covers_every_dwell_once_and_gives_its_antenna_positions(flight: SimulatedFlight) -> None:
    states = [state for dwell in range(flight.dwells) for state in flight.platform_states(dwell)]
    stamps = [state.stamp_ns for state in states]
    assert np.all(np.diff(stamps) == 5_000_000)  # 200 Hz
    for dwell in range(flight.dwells):
        seen = Trajectory([state for number in range(dwell + 1) for state in flight.platform_states(number)])
        start = flight.dwell_start_ns(dwell)
        antenna = flight.position(start * 1e-9 + flight.pulse_times)
        np.testing.assert_allclose(seen.positions(start, flight.pulse_times), antenna, atol=1e-11)
        aperture, stated = seen.aperture(start, flight.pulse_times), flight.aperture(dwell)
        np.testing.assert_allclose(aperture.position, stated.position, atol=1e-11)
        assert aperture.length == pytest.approx(stated.length, rel=1e-9)


def test_dwell_lights_the_ground_in_the_main_lobe(flight: SimulatedFlight) -> None:
    """Of a circular aperture, 1.22 beamwidths to each side."""
    surface = flight.surface(0)
    along = surface.positions[:, 0] - flight.aperture(0).position[0]
    footprint = 1.22 * flight.sensor.beamwidth * 5000
    assert -footprint < along.min() < -0.96 * footprint
    assert 0.96 * footprint < along.max() < footprint
    assert np.ptp(surface.slant_range) == pytest.approx(flight.sensor.range_window, rel=0.01)


def test_dwell_lights_more_ground_with_the_detector_axis_turned(flight: SimulatedFlight) -> None:
    """The last of eight beams, half a beamwidth apart, points 1.75 sin(30 degrees) = 0.875 beamwidths ahead."""
    turned = replace(flight, sensor=replace(flight.sensor, detector_rotation=np.pi / 6, config_hash=""))
    along = turned.surface(0).positions[:, 0] - turned.aperture(0).position[0]
    footprint = flight.sensor.beamwidth * 5000
    assert along.max() == pytest.approx((1.22 + 0.875) * footprint, abs=0.04 * footprint)


def test_complex_beams_turn_the_phase_of_echoes() -> None:
    sensor = sensor_with_complex_beams(sample_count=16, pulse_count=4)
    offsets, squints = np.array([0.3, -0.4]), np.array([0.1, 0.3]) * BEAMWIDTH
    positions = make_aperture().position + 5000.1 * look_direction(elevation_at(offsets), squints, 1)
    antenna, reference = straight_track(sensor), np.full(4, 5000.0)
    response = sensor.beams.response(elevation_at(offsets), squints)
    assert np.iscomplexobj(response)
    surface = scatterers(positions, np.ones(2), np.ones(2, bool))
    samples = simulate_dwell(sensor, surface, np.array([1.0, 2j]), antenna, reference)
    expected = direct_history(sensor, positions, response.T * np.array([1.0, 2j]), antenna, reference)
    np.testing.assert_allclose(samples, expected, atol=3e-5 * np.abs(expected).max())


EXTENT = 1.5


def beam_overlap(sensor: Sensor, grid: Grid, heights: np.ndarray) -> np.ndarray:
    """Mean of h_m h_n over the elevations that scatterers at `heights` have at the range of each pixel of a grid."""
    slant_range, _, squint = angles_of(grid.pixels(), make_aperture(), 1)
    radius, centre, ranges = EARTH_RADIUS + heights, EARTH_RADIUS + make_aperture().position[2], slant_range[..., None]
    elevation = np.arccos((centre**2 + ranges**2 - radius**2) / (2 * ranges * centre))
    response = sensor.beams.response(elevation, squint[..., None])
    return np.einsum("rchm,rchn->mn", response, response) / elevation.size


@pytest.mark.parametrize("rotation", [0.0, 0.26])
def test_deep_ground_correlates_detectors_by_the_overlap_of_their_beams_over_its_elevations(rotation: float) -> None:
    """Speckle of scatterers that fill all elevations evenly: E[g_m g_n*] is the mean of h_m h_n over them.

    At one range, an extent E in height spans the elevations between those of -E / 2 and E / 2: here 2.7 beamwidths.
    """
    sensor = make_sensor(
        bandwidth=8e9,
        pattern="sinc",
        elevation_boresights=tuple(elevation_at(np.array([-1.0, -0.5, 0.0, 0.5, 1.0]))),
        noise_power=(1.0,) * 5,
        detector_rotation=rotation,
    )
    aperture, dwells, rows, cols = make_aperture(), 4, 30, 10
    cell = sensor.range_resolution, azimuth_resolution(sensor, aperture, 5000.0)
    scene = replace(flat_scene(north=-5000 * np.sqrt(0.5), height=1.0, half=5.0), extent=EXTENT)
    surface = visible_surface(scene, aperture, 1, cell, (-0.8, 0.8), (4999.4, 5000.6))
    grid = slant_plane_grid(sensor, aperture, 5000.0, rows, cols, 1.0)
    rng, reference = np.random.default_rng(17), np.full(sensor.pulse_count, 5000.0)
    covariance = np.zeros((5, 5), complex)
    for _ in range(dwells):
        amplitudes = draw_amplitudes(surface, 1.0, rng)
        samples = simulate_dwell(sensor, surface, amplitudes, straight_track(sensor), reference)
        history = PhaseHistory(0, np.zeros(sensor.pulse_count), reference, samples.astype(np.complex64))
        slc = backproject(history, straight_track(sensor), sensor, Processing("rectangular"), grid).reshape(5, -1)
        covariance += slc @ slc.conj().T / (dwells * rows * cols)

    expected = beam_overlap(sensor, grid, 1.0 + EXTENT * ((np.arange(400) + 0.5) / 400 - 0.5))
    power = np.diagonal(expected)
    standard_error = np.sqrt(np.multiply.outer(power, power) / (dwells * rows * cols))  # 3 % of the powers
    assert np.all(np.abs(covariance - expected) < 4 * standard_error)
    assert np.abs(beam_overlap(sensor, grid, np.ones(1)) - expected).max() > 10 * standard_error.max()
