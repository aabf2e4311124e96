"""Stripmap: beams that pass over the ground, blocks that join, and images with the stated carrier-to-noise ratio."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import (
    BEAMWIDTH,
    bare_scatterers,
    direct_history,
    elevation_at,
    flat_scene,
    make_aperture,
    make_sensor,
    sensor_with_complex_beams,
)
from scipy.spatial.transform import Rotation
from scipy.special import erf

from sal_height.beams.apertures import GAUSSIAN_WIDTH
from sal_height.geometry.frames import angles_of, look_direction
from sal_height.imaging.formers.backprojection import backproject_points
from sal_height.imaging.pixels import Processing, image_beams
from sal_height.sensor.sensor import PhaseHistory, Sensor, aperture_length, processed_angle
from sal_height.simulation.flight import SimulatedFlight
from sal_height.simulation.preset import load_preset
from sal_height.simulation.scene import VisibleSurface
from sal_height.simulation.spotlight import cell_power, draw_amplitudes
from sal_height.simulation.stripmap import mean_square_gain, simulate_block

REACH, SPEED, PRF = 5000.0, 50.0, 20e3
FORWARD = np.array([1.0, 0.0, 0.0])


def strip_sensor(**changes: object) -> Sensor:
    values = {"mode": "stripmap", "pattern": "sinc", "pulse_repetition_frequency": PRF, "sample_count": 16}
    return make_sensor(**{**values, **changes})


def track(pulses: int) -> np.ndarray:
    along = (np.arange(pulses) - (pulses - 1) / 2) * SPEED / PRF
    return make_aperture().position + along[:, None] * FORWARD


def at(slant_range: np.ndarray, along: np.ndarray, offset: float = 0.0) -> np.ndarray:
    """Points abeam of the track at an elevation `offset` beamwidths above the middle of the beams."""
    abeam = np.asarray(slant_range)[..., None] * look_direction(elevation_at(offset), 0.0, 1)
    return make_aperture().position + abeam + np.asarray(along)[..., None] * FORWARD


def history_of(sensor: Sensor, surface: VisibleSurface, amplitudes: np.ndarray, antenna: np.ndarray) -> PhaseHistory:
    level = np.broadcast_to(np.eye(3), (len(antenna), 3, 3))
    reference = np.full(len(antenna), REACH)
    return PhaseHistory(
        0, np.zeros(len(antenna)), reference, simulate_block(sensor, surface, amplitudes, antenna, level, reference)
    )


def focused(sensor: Sensor, history: PhaseHistory, antenna: np.ndarray, points: np.ndarray) -> np.ndarray:
    processing = Processing("rectangular", angle=processed_angle(sensor))
    image = backproject_points(history, antenna, sensor, processing, points.reshape(-1, 3), FORWARD)
    return image.reshape(-1, *points.shape[:-1])


@pytest.mark.parametrize(
    "sensor",
    [
        strip_sensor(),
        strip_sensor(pattern="jinc"),
        strip_sensor(detector_rotation=0.3),
        sensor_with_complex_beams(mode="stripmap", sample_count=16, pulse_repetition_frequency=PRF),
    ],
    ids=["sinc", "jinc", "turned", "complex"],
)
def test_every_pulse_weighs_a_scatterer_by_where_the_body_sees_it_then(sensor: Sensor) -> None:
    """Written out, on a body that turns and an antenna that wanders."""
    rng, pulses = np.random.default_rng(40), 5
    along = rng.uniform(-0.4, 0.4, 6)
    positions = at(REACH + rng.uniform(-0.3, 0.3, 6), along, 0.4)
    amplitudes = rng.standard_normal(6) + 1j * rng.standard_normal(6)
    antenna = track(pulses) + rng.uniform(-1e-2, 1e-2, (pulses, 3))
    rotation = Rotation.from_rotvec(rng.uniform(-0.3, 0.3, (pulses, 3)) * BEAMWIDTH).as_matrix()
    reference = REACH + rng.uniform(-0.1, 0.1, pulses)
    expected = np.empty((3, pulses, 16), complex)
    for p in range(pulses):
        state = replace(make_aperture(), position=antenna[p], rotation=rotation[p])
        _, elevation, squint = angles_of(positions, state, 1)
        weighted = sensor.beams.response(elevation, squint).T * amplitudes
        expected[:, p] = direct_history(sensor, positions, weighted, antenna[[p]], reference[[p]])[:, 0]
    surface = bare_scatterers(positions, np.ones(6), deterministic=True)
    samples = simulate_block(sensor, surface, amplitudes, antenna, rotation, reference)
    np.testing.assert_allclose(samples, expected, atol=3e-5 * np.abs(expected).max())


def test_pulse_lights_a_beamwidth_before_and_behind_where_its_beam_is() -> None:
    """A body that has turned right looks backwards on its right: here by half a beamwidth."""
    sensor = strip_sensor()
    width = BEAMWIDTH * REACH
    along = np.array([-1.45, -0.55, -0.45, 0.45, 0.55]) * width
    yawed = Rotation.from_euler("z", -0.5 * BEAMWIDTH / np.sin(np.pi / 4)).as_matrix()
    lit = []
    for rotation in (np.eye(3), yawed):
        powers = [
            np.sum(np.abs(simulate_block(
                sensor, bare_scatterers(at(np.array([REACH]), np.array([x])), np.ones(1), deterministic=True),
                np.ones(1), track(1), rotation[None], np.array([REACH]),
            )) ** 2)
            for x in along
        ]  # fmt: skip
        lit.append(np.array(powers) > 0)
    np.testing.assert_array_equal(lit[0], [False, True, True, True, True])
    np.testing.assert_array_equal(lit[1], [True, True, True, True, False])


def test_mean_square_gain_is_that_of_the_pattern_over_one_beamwidth() -> None:
    """The integral of sinc^2 from -1/2 to 1/2, (2 / pi) (Si(pi) - 2 / pi)."""
    assert mean_square_gain(strip_sensor().beams) == pytest.approx(0.7737, abs=1e-4)
    assert aperture_length(strip_sensor(), REACH) == pytest.approx(0.775, rel=1e-12)


def test_focused_level_ground_has_the_stated_cnr() -> None:
    """Ground at the boresight's elevation that spans one ambiguity in range, under the noise of an unweighted image."""
    cnr, noise_power, pulses, columns = 50.0, 3.0, 720, 160
    sensor = strip_sensor(elevation_boresights=(elevation_at(0.0),), noise_power=(noise_power,))
    cell = sensor.range_resolution, 0.005
    ranges = REACH + (np.arange(32) - 15.5) * cell[0] / 2
    places = (np.arange(1400) - 699.5) * cell[1] / 2
    positions = at(*(grid.ravel() for grid in np.meshgrid(ranges, places)))
    surface = bare_scatterers(positions, np.full(len(positions), 0.25), deterministic=False)
    rows, cols = REACH + (np.arange(16) - 7.5) * cell[0], (np.arange(columns) - columns / 2) * cell[1]
    pixels = at(*np.meshgrid(rows, cols))
    rng, antenna, trials = np.random.default_rng(41), track(pulses), 3
    expected = cnr * noise_power / (310 * 16)  # 0.775 m at 2.5 mm, 16 frequencies
    powers = []
    for _ in range(trials):
        amplitudes = draw_amplitudes(surface, cell_power(cnr, sensor, 310, mean_square_gain(sensor.beams)), rng)
        image = focused(sensor, history_of(sensor, surface, amplitudes, antenna), antenna, pixels)
        powers.append(np.nanmean(np.abs(image) ** 2))
    # The beam's weights make neighbours a little dependent: 1.05 times as many cells as in an even aperture.
    standard_error = np.sqrt(1.05 / (trials * 16 * columns))  # 1.2 %
    assert np.mean(powers) / expected == pytest.approx(1, abs=3.5 * standard_error)


def test_noise_of_a_pixel_is_that_of_a_sample_over_those_of_its_aperture() -> None:
    sensor, pulses, antenna = strip_sensor(), 700, track(700)
    rng = np.random.default_rng(42)
    noise = (rng.standard_normal((3, pulses, 16)) + 1j * rng.standard_normal((3, pulses, 16))) / np.sqrt(2)
    history = PhaseHistory(0, np.zeros(pulses), np.full(pulses, REACH), noise.astype(np.complex64))
    rows, cols = REACH + (np.arange(14) - 6.5) * sensor.range_resolution, (np.arange(180) - 90) * 0.005
    image = focused(sensor, history, antenna, at(*np.meshgrid(rows, cols)))
    assert np.isfinite(image).all()
    mean = np.mean(np.abs(image) ** 2) * 310 * 16
    assert mean == pytest.approx(1, abs=3.5 / np.sqrt(image.size))  # 4 %


@pytest.mark.parametrize("offset", [0.0, 0.37])
def test_point_keeps_its_elevation_ratios_and_has_the_peak_of_the_mean_gain(offset: float) -> None:
    """A separable pattern: the beam's passage is one factor of all detectors, (2 / pi) Si(pi / 2)."""
    sensor, antenna = strip_sensor(), track(640)
    point = at(np.array([REACH + 0.1]), np.array([0.123]), offset)
    history = history_of(sensor, bare_scatterers(point, np.ones(1), deterministic=True), np.ones(1), antenna)
    peak = focused(sensor, history, antenna, point)[:, 0]
    np.testing.assert_allclose(np.abs(peak), 0.8726 * np.abs(np.sinc(offset - np.array([-0.5, 0, 0.5]))), rtol=1e-3)
    np.testing.assert_allclose((peak / peak[1]).imag, 0, atol=1e-4)


@pytest.fixture(scope="module")
def flight() -> SimulatedFlight:
    preset = load_preset("sal_stripmap")
    preset = replace(
        preset, sensor=replace(preset.sensor, pulse_count=64, sample_count=16, detectors=2), cnr_db=40.0, dwells=8
    )
    return SimulatedFlight(preset, preset.make_sensor(), flat_scene(), preset.dwells, seed=4)


def test_blocks_are_one_unbroken_sequence_of_pulses(flight: SimulatedFlight) -> None:
    times = [flight.dwell_start_ns(dwell) * 1e-9 + flight.pulse_times for dwell in range(flight.dwells)]
    np.testing.assert_allclose(np.diff(np.concatenate(times)), 1 / PRF, rtol=1e-9)


def test_ground_of_two_blocks_is_the_same_and_has_the_same_speckle(flight: SimulatedFlight) -> None:
    """Cut differently into blocks, the same flight has the same echoes, in which noise is 40 dB down in the image."""
    first, second = (flight.surface(dwell) for dwell in (2, 3))
    common = np.intersect1d(first.positions[:, 0], second.positions[:, 0])
    assert len(common) > 0.5 * len(np.unique(first.positions[:, 0]))
    for position in (first.positions, second.positions):
        assert len(np.unique(position, axis=0)) == len(position)  # nothing twice
    clean = replace(flight, preset=replace(flight.preset, cnr_db=100.0))
    halves = [clean.phase_history(dwell).samples for dwell in (3, 4)]
    ends = np.unique(np.round(first.positions[:, 0], 6))  # no gap between tiles, and no overlap
    np.testing.assert_allclose(np.diff(ends), 0.005, atol=1e-5)
    again = replace(clean)
    np.testing.assert_array_equal(again.phase_history(4).samples, halves[1])
    # Neighbouring pulses see all but the same: their correlation does not break at the seam between two blocks.
    pulses = np.concatenate(halves, axis=1)[0]
    pairs = np.abs(np.sum(pulses[1:] * pulses[:-1].conj(), axis=-1))
    norms = np.linalg.norm(pulses, axis=-1)
    coherence = pairs / norms[1:] / norms[:-1]
    assert coherence[63] > coherence.min() * 0.99
    assert replace(clean, seed=5).phase_history(4).samples.tobytes() != halves[1].tobytes()


def test_surface_of_a_block_is_seen_from_abeam_and_reaches_as_far_as_its_pulses_light(flight: SimulatedFlight) -> None:
    surface, aperture = flight.surface(4), flight.aperture(4)
    np.testing.assert_allclose(surface.squint, 0, atol=1e-12)
    along = surface.positions[:, 0] - aperture.position[0]
    reach = BEAMWIDTH * REACH + 64 * SPEED / PRF / 2
    assert along.min() < -reach
    assert along.max() > reach


def test_ground_follows_a_platform_that_gusts_have_carried_ahead_or_back(flight: SimulatedFlight) -> None:
    """Over a long flight by more than what a block lights up."""
    preset = replace(flight.preset, flight=replace(flight.preset.flight, gust_mps=20.0), dwells=2000)
    long = replace(flight, preset=preset, dwells=2000, scene=flat_scene(half=400.0))
    reach = BEAMWIDTH * REACH + 64 * SPEED / PRF / 2
    drift = []
    for dwell in (0, 700, 1999):
        middle = long.aperture(dwell).position[0]
        drift.append(abs(middle - (dwell - 999.5) * 0.16))
        along = long.surface(dwell).positions[:, 0] - middle
        assert along.min() < -reach
        assert along.max() > reach
    assert max(drift) > 2 * reach


OFFSETS = np.linspace(-1.4, 1.4, 9)


def test_beams_that_separate_are_the_same_in_the_image() -> None:
    for pattern in ("sinc", "gaussian"):
        sensor = strip_sensor(pattern=pattern)
        for name in ("rectangular", "hamming"):
            seen, squint = image_beams(sensor, name).response(elevation_at(OFFSETS), 0.0), 0.0
            np.testing.assert_allclose(seen, sensor.beams.response(elevation_at(OFFSETS), squint), atol=1e-12)


def test_turned_gaussian_beams_have_the_error_function_of_their_passage() -> None:
    """Of squared widths the Gaussian has the sum: x - s cos(psi) across, and s sin(psi) along, for a detector at s."""
    psi, width, squint = 0.3, GAUSSIAN_WIDTH, 0.2
    sensor, steps = strip_sensor(pattern="gaussian", detector_rotation=psi), np.array([-0.5, 0.0, 0.5])
    ends = (squint + np.array([[-0.5], [0.5]]) - steps * np.sin(psi)) / (np.sqrt(2) * width)
    passage = np.sqrt(np.pi / 2) * width * np.diff(erf(ends), axis=0)[0]
    straight = np.sqrt(2 * np.pi) * width * erf(0.5 / (np.sqrt(2) * width))
    across = np.exp(-((OFFSETS[:, None] - steps * np.cos(psi)) ** 2) / (2 * width**2))
    seen = image_beams(sensor, "rectangular").response(elevation_at(OFFSETS), squint * BEAMWIDTH)
    np.testing.assert_allclose(seen, across * passage / straight, atol=1e-8)


@pytest.mark.parametrize("radial", [0.0, 1e-3])
@pytest.mark.parametrize("window", ["rectangular", "hamming"])
def test_point_has_the_ratios_of_the_beams_of_the_image_at_its_peak(radial: float, window: str) -> None:
    """Round aperture and turned detectors; a mover's passage is off the beams' middle by v_r / v."""
    sensor, antenna = strip_sensor(pattern="jinc", detector_rotation=0.26), track(900)
    seconds = (np.arange(len(antenna)) - (len(antenna) - 1) / 2) / PRF
    point = at(np.array([REACH + 0.1]), np.array([0.05]), 0.37)
    sight = (point - make_aperture().position - [[0.05, 0, 0]]) / (REACH + 0.1)
    surface = replace(bare_scatterers(point, np.ones(1), deterministic=True), velocity=radial * sight)
    level, reference = np.broadcast_to(np.eye(3), (len(antenna), 3, 3)), np.full(len(antenna), REACH)
    surface = surface.after(-0.05 / SPEED)  # to when the antenna is in the middle of its track
    samples = simulate_block(sensor, surface, np.ones(1), antenna, level, reference, seconds)
    history, processing = PhaseHistory(0, seconds, reference, samples), Processing("rectangular", window, BEAMWIDTH)
    shown = point - REACH * radial / SPEED * FORWARD
    peak = backproject_points(history, antenna, sensor, processing, shown, FORWARD)[:, 0]
    expected = image_beams(sensor, window).response(elevation_at(0.37), radial / SPEED)
    np.testing.assert_allclose(peak / peak[1], expected / expected[1], atol=1e-3)
    still = sensor.beams.response(elevation_at(0.37), 0.0)
    assert np.abs(still / still[1] - expected / expected[1]).max() > 0.008


@pytest.mark.parametrize(("rotation", "left"), [(0.0, 0.2), (np.radians(15.0), 0.65)], ids=["straight", "turned"])
def test_speckled_ground_keeps_part_of_the_error_that_averaged_beams_take_off_points(
    rotation: float, left: float
) -> None:
    """Its detectors correlate as the mean of h_m h_n over the passage: there maximum likelihood looks for its match."""
    steps = (np.arange(8) - 3.5) / 2
    boresights, noise = tuple(elevation_at(steps)), (1.0,) * len(steps)
    changes = {"pattern": "jinc", "elevation_boresights": boresights, "noise_power": noise}
    sensor = strip_sensor(detector_rotation=rotation, **changes)
    passage = (np.arange(200) + 0.5) / 200 - 0.5
    trials, errors = np.arange(-2.5, 2.5, 1e-3), {}
    for name, beams in (("one direction", sensor.beams), ("averaged", image_beams(sensor, "rectangular"))):
        tried = beams.response(elevation_at(trials), 0.0)
        for true in (-1.4, -0.8, 0.8, 1.4):
            seen = sensor.beams.response(np.full(200, elevation_at(true)), passage * BEAMWIDTH)
            for kind, covariance in (("ground", seen.T @ seen), ("point", np.outer(seen.mean(0), seen.mean(0)))):
                match = np.einsum("tm,mn,tn->t", tried, covariance, tried) / np.sum(tried**2, axis=1)
                errors[name, kind, true] = trials[np.argmax(match)] - true
    worst = {key[:2]: max(abs(e) for k, e in errors.items() if k[:2] == key[:2]) for key in errors}
    assert worst["averaged", "point"] < 1.5e-3  # the step of the search
    assert worst["one direction", "point"] > 0.009
    assert worst["averaged", "ground"] < left * worst["one direction", "ground"]
