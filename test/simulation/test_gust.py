"""Gusts: the strength and spectrum that are asked for, derivatives that fit, and odometry that resolves the motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from helpers import bare_scatterers, blocks, direct_history, few, flat_scene, multilook
from scipy.integrate import quad
from scipy.spatial.transform import Rotation

from sal_height.beams.array import column_squint
from sal_height.elevation.estimators.maximum_likelihood import MlSettings, ml_elevation
from sal_height.elevation.looks.looks import look_grid
from sal_height.geometry.grid import Grid
from sal_height.geometry.trajectory import Trajectory
from sal_height.imaging.formers.backprojection import backproject
from sal_height.imaging.formers.choice import FORMERS
from sal_height.imaging.pixels import Processing, slant_plane_grid, slc_noise_power
from sal_height.numeric.windows import broadening
from sal_height.relief.heights import height_field
from sal_height.sensor.sensor import PhaseHistory, processed_angle
from sal_height.simulation.flight import SimulatedFlight
from sal_height.simulation.gust import FASTEST, MOUNT_RESIDUAL, SLOWEST, gust_motion, gust_spectra, response
from sal_height.simulation.preset import load_preset
from sal_height.simulation.stripmap import simulate_block

Array = npt.NDArray[np.float64]

PRESETS = ("sal_spotlight", "sal_stripmap", "xband_relief")
SPEED = 50.0


def test_gust_spectra_hold_the_power_of_one_metre_per_second() -> None:
    for axis in range(3):
        power = quad(lambda w, a=axis: gust_spectra(np.array(w), SPEED)[a], 0, np.inf, limit=200)[0]
        assert power == pytest.approx(1, abs=1e-6)


def test_velocity_has_the_power_that_the_aircraft_takes_from_the_gusts() -> None:
    motions = [gust_motion(3.0, SPEED, np.random.default_rng(seed)) for seed in range(300)]
    measured = np.mean([m.velocity(0.0) ** 2 for m in motions], axis=0)
    for axis in range(3):
        power = quad(
            lambda w, a=axis: gust_spectra(np.array(w), SPEED)[a] * response(np.array(w)) ** 2,
            SLOWEST,
            FASTEST,
            limit=500,
        )[0]
        assert np.sum(motions[0].amplitude[:, axis] ** 2) / 2 == pytest.approx(9 * power, rel=1e-3)
        assert measured[axis] == pytest.approx(9 * power, rel=3.5 * np.sqrt(2 / 300))
        assert 0.1 < power < 0.9


def test_velocity_acceleration_and_attitude_are_those_of_the_displacement() -> None:
    motion, step = gust_motion(2.0, SPEED, np.random.default_rng(50)), 1e-4
    t = np.linspace(0, 30, 40)
    made = (motion.displacement(t + step) - motion.displacement(t - step)) / (2 * step)
    np.testing.assert_allclose(made, motion.velocity(t), atol=1e-5)
    made = (motion.velocity(t + step) - motion.velocity(t - step)) / (2 * step)
    np.testing.assert_allclose(made, motion.acceleration(t), atol=1e-3)
    forward = motion.rotation(t).as_matrix()[:, :, 0]
    np.testing.assert_allclose(forward[:, 1:], MOUNT_RESIDUAL * motion.velocity(t)[:, 1:] / SPEED, atol=1e-9)
    left_wing_up = motion.rotation(t).as_matrix()[:, 2, 1]
    np.testing.assert_allclose(left_wing_up, -MOUNT_RESIDUAL * motion.acceleration(t)[:, 1] / 9.80665, atol=1e-9)


def gusty(name: str, gust: float, **changes: object) -> SimulatedFlight:
    preset = load_preset(name)
    preset = replace(preset, flight=replace(preset.flight, gust_mps=gust), **changes)
    return SimulatedFlight(preset, preset.make_sensor(), flat_scene(), preset.dwells, seed=6)


def track_of(flight: SimulatedFlight, dwells: range) -> Trajectory:
    """As odometry gives it."""
    return Trajectory([state for dwell in dwells for state in flight.platform_states(dwell)])


@pytest.mark.parametrize("name", few(2, PRESETS))
def test_odometry_gives_positions_to_a_twentieth_of_a_wavelength_and_velocities_of_the_track(name: str) -> None:
    """In the strongest gusts that a preset may have."""
    flight = gusty(name, 20.0)
    seen = track_of(flight, range(flight.dwells))
    worst = 0.0
    for dwell in range(flight.dwells):
        start = flight.dwell_start_ns(dwell)
        truth = flight.position(start * 1e-9 + flight.pulse_times)
        worst = max(worst, np.abs(seen.positions(start, flight.pulse_times) - truth).max())
        stated, interpolated = flight.aperture(dwell), seen.aperture(start, flight.pulse_times)
        np.testing.assert_allclose(interpolated.velocity, stated.velocity, atol=1e-3)
        np.testing.assert_allclose(interpolated.rotation, stated.rotation, atol=5e-3 * flight.sensor.beamwidth)
    assert worst < flight.sensor.wavelength / 20


def test_flight_in_gusts_still_passes_the_middle_of_the_scene_at_the_stated_range() -> None:
    calm, rough = gusty("sal_spotlight", 0.0, dwells=3), gusty("sal_spotlight", 10.0, dwells=3)
    calm, rough = (replace(flight, dwells=3) for flight in (calm, rough))
    np.testing.assert_allclose(rough.aperture(1).position, calm.aperture(1).position, atol=1e-6)
    assert np.linalg.norm(rough.aperture(2).position - calm.aperture(2).position) > 1e-3
    np.testing.assert_array_equal(calm.aperture(1).rotation, np.eye(3))


def azimuth_cut(flight: SimulatedFlight, steps: Array, former: str) -> npt.NDArray[np.complex64]:
    """Response of a point abeam of the middle dwell, `steps` resolutions along the body, focused with odometry."""
    middle, sensor = flight.dwells // 2, flight.sensor
    stripmap = sensor.mode == "stripmap"
    dwells = range(middle - 1, middle + 2) if stripmap else range(middle, middle + 1)
    start = flight.dwell_start_ns(dwells[0])
    times = np.concatenate([(flight.dwell_start_ns(d) - start) * 1e-9 + flight.pulse_times for d in dwells])
    aperture, reach = flight.aperture(middle), flight.preset.flight.slant_range_m
    boresight = np.array([0, -np.sin(np.pi / 4), -np.cos(np.pi / 4)])
    point = aperture.position + reach * aperture.rotation @ boresight
    antenna, reference = flight.position(start * 1e-9 + times), np.full(len(times), reach)
    if stripmap:
        rotation = flight._gust.rotation(start * 1e-9 + times).as_matrix()
        surface = bare_scatterers(point[None], np.ones(1), deterministic=True)
        samples = simulate_block(sensor, surface, np.ones(1), antenna, rotation, reference)[3:5].mean(axis=0)
    else:
        samples = direct_history(sensor, point[None], [1.0], antenna, reference)
    history = PhaseHistory(0, times, reference, samples[None].astype(np.complex64))
    track = track_of(flight, range(flight.dwells)).positions(start, times)
    processing = Processing("rectangular", angle=processed_angle(sensor) if stripmap else 0.0)
    resolution = sensor.wavelength * reach / (2 * aperture.length)
    sight = point - track.mean(axis=0)
    sight -= (sight @ aperture.forward) * aperture.forward
    step = resolution * (steps[1] - steps[0])
    start_point = point + resolution * steps[0] * aperture.forward
    grid = Grid(start_point, sight / np.linalg.norm(sight), aperture.forward, resolution, step, 1, len(steps))
    name = {"spotlight": "specan", "stripmap": "range_doppler"}[sensor.mode] if former == "fast" else former
    return FORMERS[name].form(history, track, sensor, processing, grid)[0, 0]


def peak_sidelobe_db(power: np.ndarray) -> float:
    """Greatest power beyond the first minima to both sides of the middle, relative to it."""
    middle = len(power) // 2
    right = middle + int(np.argmax(np.diff(power[middle:]) > 0))
    left = middle - int(np.argmax(np.diff(power[middle::-1]) > 0))
    return float(10 * np.log10(max(power[:left].max(), power[right:].max()) / power[middle]))


@pytest.mark.parametrize("former", ["backprojection", "fast"])
@pytest.mark.parametrize("name", few(2, PRESETS))
def test_point_focuses_in_gusts_as_on_a_straight_track(name: str, former: str) -> None:
    steps = np.arange(-96, 97) / 32
    calm, rough = (np.abs(azimuth_cut(gusty(name, gust), steps, former)) ** 2 for gust in (0.0, 1.0))
    assert 10 * np.log10(rough[96] / calm[96]) == pytest.approx(0, abs=0.5)
    assert peak_sidelobe_db(rough) == pytest.approx(peak_sidelobe_db(calm), abs=1.0)


def test_spotlight_heights_are_right_in_gusts_and_with_the_attitude_they_leave() -> None:
    """Level ground, seen with the odometry; the mount is off by a third of a beamwidth, the track by 15 degrees."""
    flight = replace(gusty("small", 10.0), scene=flat_scene(3.7), dwells=5)
    sensor, image = flight.sensor, flight.preset.image
    processing = Processing()
    noise = slc_noise_power(sensor, processing, sensor.pulse_count)[0]
    widened = broadening(processing.range_weights(sensor.sample_count))
    track, errors, turns = track_of(flight, range(flight.dwells)), [], []
    for dwell in range(flight.dwells):
        history = flight.phase_history(dwell)
        aperture = track.aperture(history.stamp_ns, history.pulse_times)
        grid = slant_plane_grid(sensor, aperture, 5000.0, image.rows, image.cols, widened)
        antenna = track.positions(history.stamp_ns, history.pulse_times)
        slc, coarse = backproject(history, antenna, sensor, processing, grid), look_grid(grid, *blocks(2, 2))
        squint = column_squint(coarse, aperture, sensor.beams, sensor.look_side)
        looks = multilook(slc, 2, 2, squint=squint, noise_power=noise)
        estimate = ml_elevation(looks, sensor.beams, MlSettings(layover=False))
        errors.append(height_field(estimate, looks, grid, coarse, aperture, sensor.look_side).first.height - 3.7)
        turns.append(Rotation.from_matrix(aperture.rotation).magnitude())
    error = np.concatenate([e[np.isfinite(e)] for e in errors])
    assert len(error) > 300
    assert np.mean(error) == pytest.approx(0, abs=3 * np.std(error) / np.sqrt(len(error)))
    assert min(turns) > 0.3 * sensor.beamwidth


@pytest.mark.parametrize("name", PRESETS)
def test_gusts_bend_the_track_by_many_wavelengths(name: str) -> None:
    """Over a flight, about the straight line between its ends: what the images above are free of."""
    flight = gusty(name, 1.0)
    seconds = np.linspace(0, (flight.dwells - 1) * flight.preset.dwell_spacing_m / flight.preset.flight.speed_mps, 99)
    positions = flight.position(seconds)
    straight = positions[0] + np.linspace(0, 1, 99)[:, None] * (positions[-1] - positions[0])
    assert np.linalg.norm(positions - straight, axis=-1).max() > 50 * flight.sensor.wavelength
