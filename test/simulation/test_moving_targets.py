"""Moving targets (SAL paper, section 4): where they appear, when that wraps, and how they defocus."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from helpers import flat_scene, make_aperture, make_sensor
from scipy.special import fresnel, sici

from sal_height.geometry.earth import sphere_point
from sal_height.geometry.frames import ApertureState
from sal_height.imaging.formers.backprojection import backproject, backproject_points
from sal_height.imaging.pixels import Processing, slant_plane_grid
from sal_height.sensor.sensor import PhaseHistory, Sensor, processed_angle
from sal_height.simulation.flight import SimulatedFlight
from sal_height.simulation.preset import load_preset
from sal_height.simulation.scene import PointScatterer, Scene, VisibleSurface, visible_surface
from sal_height.simulation.spotlight import simulate_dwell
from sal_height.simulation.stripmap import simulate_block

REACH, SPEED = 5000.0, 50.0
NORTH = -REACH * np.sqrt(0.5)
Array = npt.NDArray[np.float64]


def scene_of(*points: PointScatterer, north: float = NORTH) -> Scene:
    """Point targets on dark ground."""
    ground = flat_scene(north=north, half=5.0)
    return replace(ground, brightness=np.zeros_like(ground.brightness), points=points)


def movers(aperture: ApertureState, *points: PointScatterer) -> VisibleSurface:
    """Point targets, seen by the aperture."""
    surface = visible_surface(scene_of(*points), aperture, 1, (0.075, 0.05), (-2.0, 2.0), (4998.0, 5002.0))
    kept = surface.deterministic
    return VisibleSurface(*(getattr(surface, name)[kept] for name in surface.__dataclass_fields__))


def mover(radial: float = 0.0, along: float = 0.0, east: float = 0.0) -> PointScatterer:
    return PointScatterer(east, NORTH, 0.0, 1.0, radial_velocity=radial, along_velocity=along)


def timed_track(sensor: Sensor, pulses: int) -> tuple[Array, Array]:
    """Times (s) about the middle, and positions (m) of the antenna."""
    seconds = (np.arange(pulses) - (pulses - 1) / 2) / sensor.pulse_repetition_frequency
    return seconds, make_aperture().position + SPEED * seconds[:, None] * np.array([1.0, 0.0, 0.0])


def spotlight_profile(sensor: Sensor, point: PointScatterer, along: Array) -> npt.NDArray[np.complex128]:
    """Focused image of a target in a spotlight dwell at places (m) along the flight, its beam taken off."""
    seconds, antenna = timed_track(sensor, sensor.pulse_count)
    surface = movers(make_aperture(), point)
    reference = np.full(sensor.pulse_count, REACH)
    samples = simulate_dwell(sensor, surface, np.ones(1), antenna, reference, seconds)
    history = PhaseHistory(0, seconds - seconds[0], reference, samples.astype(np.complex64))
    grid = slant_plane_grid(sensor, make_aperture(), REACH, 1, 1, 1.0)
    slant_range = float(surface.slant_range[0])
    middle = make_aperture().position + slant_range * grid.row_direction
    step = float(along[1] - along[0])
    grid = replace(grid, origin=middle + along[0] * grid.col_direction, cols=len(along), col_spacing=step)
    image = backproject(history, antenna, sensor, Processing("rectangular"), grid)[1, 0]
    return np.asarray(image / sensor.beams.response(surface.elevation, surface.squint)[0, 1])


def peak_of(along: Array, profile: npt.NDArray[np.complexfloating]) -> float:
    """Place of the greatest power, by a parabola through its neighbours."""
    power = np.abs(profile) ** 2
    top = int(np.argmax(power))
    low, middle, high = power[top - 1 : top + 2]
    return float(along[top] + (along[1] - along[0]) * (low - high) / (2 * (low - 2 * middle + high)))


@pytest.mark.parametrize("radial", [1e-3, -2.5e-3])
@pytest.mark.parametrize("east", [0.0, 0.2])
def test_receding_target_appears_behind_its_place_in_spotlight(radial: float, east: float) -> None:
    """By range times radial velocity over speed: at 1 mm/s by 10 cm, two thirds of the footprint's half width."""
    along = np.arange(-0.8, 0.8, 2e-3)
    profile = spotlight_profile(make_sensor(), mover(radial, east=east), along)
    assert peak_of(along, profile) == pytest.approx(east - REACH * radial / SPEED, abs=2e-4)
    assert np.abs(profile).max() == pytest.approx(1, abs=1e-3)


def test_radial_velocities_that_differ_by_half_wavelength_times_prf_look_the_same() -> None:
    """Up to the turn by which the ends of the band differ: pi pulses times bandwidth over carrier frequency."""
    sensor, along = make_sensor(), np.arange(-1.1, 1.1, 5e-3)
    period = sensor.wavelength * sensor.pulse_repetition_frequency / 2
    first, second = (spotlight_profile(sensor, mover(radial), along) for radial in (3e-3, 3e-3 + period))
    turn = np.pi * sensor.pulse_count * sensor.bandwidth * sensor.wavelength / 299_792_458.0
    assert turn < 2e-3
    phase = np.vdot(first, second) / abs(np.vdot(first, second))  # the range of the target as it was in the first pulse
    np.testing.assert_allclose(second / phase, first, atol=turn)


@pytest.mark.parametrize("share", [0.24, 0.26, -0.24, -0.26])
def test_radial_velocity_is_unambiguous_up_to_a_quarter_wavelength_times_prf(share: float) -> None:
    """Beyond, the target appears on the other side, one ambiguity (wavelength range PRF / 2 speed) away."""
    sensor = make_sensor()
    unit = sensor.wavelength * sensor.pulse_repetition_frequency
    ambiguity = unit * REACH / (2 * SPEED)
    along = np.arange(-0.5, 0.5, 1e-3) * ambiguity
    seen = share - np.round(share * 2) / 2
    assert (seen == share) == (abs(share) < 0.25)
    found = peak_of(along, spotlight_profile(sensor, mover(share * unit), along))
    assert found == pytest.approx(-REACH / SPEED * seen * unit, abs=2e-3)


@pytest.mark.parametrize("speed", [0.3, -0.6])
def test_along_velocity_defocuses_by_its_quadratic_phase(speed: float) -> None:
    """Phase at the aperture's ends 4 pi / wavelength ((v - v_a)^2 - v^2) (T / 2)^2 / (2 range): a Fresnel integral."""
    sensor = make_sensor(pulse_count=480)
    ends = sensor.pulse_count / sensor.pulse_repetition_frequency / 2
    phase = 2 * np.pi / sensor.wavelength * ((SPEED - speed) ** 2 - SPEED**2) * ends**2 / REACH
    assert 1.2 < abs(phase) < 4
    limit = np.sqrt(2 * abs(phase) / np.pi)
    sine, cosine = fresnel(limit)
    expected = np.hypot(sine, cosine) / limit
    centre = spotlight_profile(sensor, mover(along=speed), np.array([0.0, 1e-3]))[0]
    assert abs(centre) == pytest.approx(expected, abs=3e-4)
    assert expected < 0.95


def strip_sensor() -> Sensor:
    return make_sensor(mode="stripmap", pattern="sinc", pulse_repetition_frequency=20e3, sample_count=32)


def strip_profile(sensor: Sensor, point: PointScatterer, along: Array) -> npt.NDArray[np.complex128]:
    """Focused stripmap image of a target at places (m) along the flight."""
    seconds, antenna = timed_track(sensor, 1000)
    surface = movers(replace(make_aperture(), sliding=True), point)
    reference = np.full(len(antenna), REACH)
    level = np.broadcast_to(np.eye(3), (len(antenna), 3, 3))
    samples = simulate_block(sensor, surface, np.ones(1), antenna, level, reference, seconds)
    history = PhaseHistory(0, seconds - seconds[0], reference, samples)
    forward = np.array([1.0, 0.0, 0.0])
    points = sphere_point(0.0, NORTH, 0.0) + along[:, None] * forward
    processing = Processing("rectangular", angle=processed_angle(sensor))
    return backproject_points(history, antenna, sensor, processing, points, forward)[1]


def passage(centre: float) -> float:
    """Mean of sinc over one beamwidth about `centre` (beamwidths): what a target's passage leaves of its amplitude."""
    (high, _), (low, _) = sici(np.pi * (centre + 0.5)), sici(np.pi * (centre - 0.5))
    return float(high - low) / np.pi


@pytest.mark.parametrize("radial", [0.0, 1e-3, -2e-3])
@pytest.mark.parametrize("east", [0.0, 0.15])
def test_receding_target_appears_behind_its_place_in_stripmap(radial: float, east: float) -> None:
    """And with the amplitude of a passage off the beam's middle by radial velocity over speed.

    The taper of the beam pulls the peak a little towards the middle.
    """
    sensor, along = strip_sensor(), np.arange(-0.45, 0.45, 1e-3)
    shift = -REACH * radial / SPEED
    profile = strip_profile(sensor, mover(radial, east=east), along)
    assert peak_of(along, profile) == pytest.approx(east + shift, abs=1e-4 + 0.025 * abs(shift))
    there = strip_profile(sensor, mover(radial, east=east), np.array([east + shift]))[0]
    elevation = movers(make_aperture(), mover()).elevation[0]
    gain = np.sinc((elevation - sensor.elevation_boresights[1]) / sensor.beamwidth)
    assert abs(there) == pytest.approx(gain * passage(radial / SPEED / sensor.beamwidth), rel=1e-3)


def test_way_of_a_target_is_one_over_all_blocks_of_a_strip() -> None:
    """Cut into blocks of another length, the same flight has the same echoes."""
    preset = load_preset("sal_stripmap")
    point = PointScatterer(0.1, 0.0, 0.0, 1.0, radial_velocity=0.02, along_velocity=1.5)
    histories = []
    for pulses, dwells in ((64, 8), (128, 4)):
        sensor = replace(preset.sensor, pulse_count=pulses, sample_count=16, detectors=2)
        cut = replace(preset, sensor=sensor, cnr_db=100.0, dwells=dwells)
        flight = SimulatedFlight(cut, cut.make_sensor(), scene_of(point, north=0.0), dwells, seed=4)
        blocks = [flight.phase_history(dwell).samples for dwell in range(dwells)]
        histories.append(np.concatenate(blocks, axis=1))
    noise = np.sqrt(2.0)  # of the two, that of one sample is 1
    difference = np.abs(histories[0] - histories[1])
    assert np.abs(histories[0]).max() > 1000 * noise
    assert np.sqrt(np.mean(difference**2)) == pytest.approx(noise, rel=0.05)


def test_target_passes_its_place_when_the_antenna_is_abeam_of_it() -> None:
    """A surface seen by a sliding aperture has positions of one time; velocities are along the sight from abeam."""
    aperture = replace(make_aperture(), sliding=True)
    still, moving = (movers(aperture, mover(radial, along, east=1.5)) for radial, along in ((0, 0), (0.5, 2.0)))
    seconds = 1.5 / SPEED
    np.testing.assert_allclose(moving.after(seconds).positions, still.positions, atol=1e-6)
    sight = still.positions - np.array([still.positions[0, 0], 0, aperture.position[2]])
    expected = 0.5 * sight / np.linalg.norm(sight) + np.array([2.0, 0, 0])
    np.testing.assert_allclose(moving.velocity, expected, atol=1e-6)
    np.testing.assert_array_equal((moving.slant_range, moving.elevation), (still.slant_range, still.elevation))
    np.testing.assert_array_equal(still.after(1.0).positions, still.positions)


@pytest.mark.parametrize("heading", [1, -1])
def test_a_target_goes_on_from_dwell_to_dwell(heading: int) -> None:
    """In spotlight, too, it is at its place when the antenna is abeam of that, on passes to and fro."""
    turn = (0.0, 0.0, 0.0 if heading > 0 else np.pi)
    aperture = make_aperture(angles=turn, velocity=(heading * SPEED, 0.0, 0.0))
    seconds = np.array([-0.01, 0.0, 0.02])

    def ranges(radial: float) -> Array:
        scene = scene_of(mover(radial, east=0.5))
        places = (replace(aperture, position=aperture.position + later * aperture.velocity) for later in seconds)
        extent = (0.075, 0.05), (-2.0, 2.0), (4998.0, 5002.0)
        seen = [visible_surface(scene, there, heading, *extent) for there in places]
        return np.array([surface.slant_range[surface.deterministic][0] for surface in seen])

    expected = 8.0 * (seconds - heading * 0.5 / SPEED)
    np.testing.assert_allclose(ranges(8.0) - ranges(0.0), expected, atol=1e-5)
