"""What pulses and frequencies cannot sample is refused, in one sentence with the limit; what they can, is not."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers import (
    BEAMWIDTH,
    assert_one_sentence,
    circular,
    elevation_at,
    flat_scene,
    make_aperture,
    make_sensor,
    refused,
)
from phase_errors import white_phase
from scipy.spatial.transform import Rotation

from sal_height.errors import Rejected
from sal_height.geometry.grid import Grid
from sal_height.geometry.trajectory import Trajectory
from sal_height.imaging.autofocus.gradient import apply_phase
from sal_height.imaging.checks import (
    check_doppler_centroid,
    check_dwell,
    check_frames,
    check_pulse_times,
    check_pulses,
    check_range_window,
    describe_strip_centroid,
    describe_unverified_squint,
)
from sal_height.imaging.focus import ImageSettings, focus_dwell
from sal_height.imaging.pixels import slant_plane_grid
from sal_height.sensor.sensor import PhaseHistory, Sensor
from sal_height.simulation.flight import SimulatedFlight
from sal_height.simulation.preset import load_preset, preset_names
from sal_height.simulation.scene import PointScatterer

REACH, SPEED = 5000.0, 50.0


def antenna_of(pulses: int, way: float) -> np.ndarray:
    """Straight eastwards, `way` m from the first pulse to the last."""
    return make_aperture().position + np.linspace(-way / 2, way / 2, pulses)[:, None] * np.array([1.0, 0.0, 0.0])


def refusal(reason: str, *parts: str) -> pytest.RaisesExc[Exception]:
    """A `Rejected` of that reason whose sentence holds the parts."""
    return refused(Rejected, *parts, reason=reason)


def test_pulses_may_be_half_the_antenna_apart_and_no_farther() -> None:
    """Two-way, a step of half the antenna samples the main lobe's half that is processed: 10 kHz at 50 m/s and 1 cm."""
    sensor = make_sensor()
    check_pulses(sensor, antenna_of(101, 100 * 0.005), make_aperture())
    with refusal("aliased in azimuth", "0.00501 m", "0.005 m", "1e+04 Hz", "50 m/s"):
        check_pulses(sensor, antenna_of(101, 100 * 0.00501), make_aperture())


def test_stated_pulse_repetition_frequency_is_enough_at_any_speed() -> None:
    """And anywhere: 15 m from the origin, positions are rounded by more than in it."""
    for speed in np.random.default_rng(80).uniform(10, 300, 50):
        rate = 2 * speed / 0.01
        antenna = make_aperture().position + (15 + speed / rate * np.arange(99))[:, None] * np.array([1.0, 0.0, 0.0])
        check_pulses(make_sensor(), antenna, make_aperture(velocity=(speed, 0, 0)))


def test_aperture_must_be_longer_than_half_the_antenna() -> None:
    """Which then resolves 0.775 m, as the beam does."""
    sensor = make_sensor()
    check_pulses(sensor, antenna_of(4, 0.00501), make_aperture())
    with refusal("too few pulses", "4 pulses", "0.00499 m", "0.005 m"):
        check_pulses(sensor, antenna_of(4, 0.00499), make_aperture())


@pytest.mark.parametrize(("share", "enough"), [(1.001, True), (0.999, False)])
def test_range_window_must_hold_where_the_beams_meet_level_ground(share: float, enough: bool) -> None:
    """Boresights 4 beamwidths apart at 45 degrees: the ground between them, in a flat world, by the law of sines."""
    first, last = elevation_at(np.array([-2.0, 2.0]))
    height = REACH * np.cos((first + last) / 2)
    lit = height / np.cos(last) - height / np.cos(first)
    assert lit == pytest.approx(3.1, abs=1e-3)
    bandwidth = 299_792_458 / 2 / (share * lit) * 64
    sensor = make_sensor(
        bandwidth=bandwidth, elevation_boresights=(first, np.pi / 4, last), noise_power=(1.0, 1.0, 1.0)
    )
    if enough:
        check_range_window(sensor, REACH)
        return
    limit = f"{299_792_458 / 2 / lit:.4g} Hz"
    with refusal("aliased in range", "3.1 m", "3.097 m", limit):
        check_range_window(sensor, REACH)


@cache
def dwell() -> tuple[SimulatedFlight, PhaseHistory]:
    """Level ground under the small preset."""
    preset = replace(load_preset("small"), dwells=1)
    flight = SimulatedFlight(preset, preset.make_sensor(), flat_scene(), 1, seed=81)
    return flight, flight.phase_history(0)


def track(yaw: float) -> Trajectory:
    """Odometry that says the body has turned left by `yaw` (rad)."""
    attitude = Rotation.from_euler("z", yaw).as_quat()
    return Trajectory([replace(state, orientation=attitude) for state in dwell()[0].platform_states(0)])


LOOK = np.sin(np.pi / 4)
"""A yaw moves where the beams meet the ground by itself times this and the range."""


@pytest.mark.parametrize("side", [-1, 1])
def test_attitude_that_is_off_by_more_than_the_beam_is_refused(side: int) -> None:
    """Half the beam, which is wider than the image: 0.3875 m or 100 * 0.3875 / (1.55e-6 * 5000) = 5000 Hz.

    Held off the limit by a tenth of the beam: the centroid of a dwell of speckle scatters.
    """
    flight, history = dwell()
    settings = ImageSettings(air="none", former="backprojection", rows=4, cols=4)
    for beamwidths in (0.0, 0.4):
        inside = focus_dwell(history, track(side * beamwidths * BEAMWIDTH / LOOK), flight.spectrum, settings)
        assert np.isfinite(inside.images).all()
    for beamwidths in (0.6, 1.0):
        with refusal("Doppler centroid outside the band", "5000 Hz", "attitude"):
            focus_dwell(history, track(side * beamwidths * BEAMWIDTH / LOOK), flight.spectrum, settings)


@pytest.mark.parametrize("yaw", [0.0, 0.7 * BEAMWIDTH / LOOK])
def test_a_car_that_outshines_the_ground_does_not_move_the_centroid(yaw: float) -> None:
    """Of four times the ground's power and 8 mm/s, a beam off. Beams that look elsewhere are found nevertheless."""
    flight, without = dwell()
    car = PointScatterer(0.0, 1.0, 1.0, 10**3.4, 8e-3, 0.0)
    history = replace(flight, scene=replace(flight.scene, points=(car,))).phase_history(0)
    assert np.sum(np.abs(history.samples) ** 2) > 4 * np.sum(np.abs(without.samples) ** 2)
    settings = ImageSettings(air="none", former="backprojection", rows=4, cols=4)
    if yaw:
        with refusal("Doppler centroid outside the band", "attitude"):
            focus_dwell(history, track(yaw), flight.spectrum, settings)
        return
    assert not focus_dwell(history, track(0.0), flight.spectrum, settings).doubts


def grid_of(sensor: Sensor, cols: int) -> Grid:
    return slant_plane_grid(sensor, make_aperture(), REACH, 4, cols, 1.0)


@pytest.mark.parametrize("yaw", [0.0, 0.9 * BEAMWIDTH])
def test_stated_centroid_is_that_of_a_point(yaw: float) -> None:
    """A point x m ahead of the beams' middle: 2 v x / (wavelength * range), the sign that of an approaching target.

    The beams' middle need not be abeam of the flight.
    """
    sensor, antenna, aperture = make_sensor(), antenna_of(48, 47 * SPEED / 30e3), make_aperture(angles=(0, 0, yaw))
    look = np.array([0, -np.sin(np.pi / 4), -np.cos(np.pi / 4)])
    middle = aperture.position + REACH * aperture.rotation @ look
    for ahead, inside in ((0.38, True), (-0.38, True), (0.4, False), (-0.4, False)):
        delay = np.linalg.norm(middle + np.array([ahead, 0, 0]) - antenna, axis=-1) - REACH
        samples = np.exp(-1j * (sensor.centre_wavenumber * delay))[None, :, None] * np.ones((3, 1, 64))
        history = PhaseHistory(0, np.arange(48) / 30e3, np.full(48, REACH), samples.astype(np.complex64))
        grid = grid_of(sensor, 4)
        if inside:
            check_doppler_centroid(history, antenna, sensor, aperture, grid)
            continue
        centroid = 2 * SPEED * ahead / (sensor.wavelength * REACH)
        with refusal("Doppler centroid outside the band", f"{centroid:+.4g} Hz", "5000 Hz"):
            check_doppler_centroid(history, antenna, sensor, aperture, grid)
        wide = grid_of(sensor, 20)  # 0.97 m: the image is what matters
        assert wide.cols * wide.col_spacing > 0.9
        check_doppler_centroid(history, antenna, sensor, aperture, wide)


def test_noise_has_no_centroid_to_refuse() -> None:
    """Also none of few samples, whose products agree by chance in a direction that would be outside."""
    sensor, antenna = make_sensor(sample_count=4), antenna_of(48, 47 * SPEED / 30e3)
    rng, outside = np.random.default_rng(82), 0
    for _ in range(60):
        noise = circular(rng, (3, 48, 4)).astype(np.complex64)
        history = PhaseHistory(0, np.arange(48) / 30e3, np.full(48, REACH), noise)
        outside += abs(np.angle(np.sum(noise[:, :-1].conj() * noise[:, 1:]))) > 1.1
        check_doppler_centroid(history, antenna, sensor, make_aperture(), grid_of(sensor, 4))
    assert outside > 20


def test_white_phase_errors_do_not_look_like_a_wrong_attitude() -> None:
    flight, history = dwell()
    for seed in range(20):
        phase = white_phase(flight.sensor.pulse_count, 3.0, np.random.default_rng([83, seed]))
        slc = focus_dwell(
            apply_phase(history, -phase),
            track(0.0),
            flight.spectrum,
            ImageSettings(air="none", former="backprojection", rows=4, cols=4),
        )
        assert np.isfinite(slc.images).all()


TO_AVIATION = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""From east-north-up to north-east-down."""

FORWARD_RIGHT_DOWN = np.diag([1.0, -1.0, -1.0])
"""From forward-left-up."""


@pytest.mark.parametrize(
    ("map_axes", "body_axes", "said"),
    [
        (TO_AVIATION, FORWARD_RIGHT_DOWN, "as if z pointed down"),
        (TO_AVIATION, np.eye(3), "3.14 rad away from up"),
        (np.eye(3), FORWARD_RIGHT_DOWN, "3.14 rad away from up"),
    ],
    ids=["both", "map", "base_link"],
)
def test_odometry_in_the_frames_of_aviation_is_refused(map_axes: np.ndarray, body_axes: np.ndarray, said: str) -> None:
    """All of it is turned alike, so that nothing in the data contradicts it."""
    flight, history = dwell()
    states = [
        replace(
            state,
            position=map_axes @ state.position,
            velocity=map_axes @ state.velocity,
            orientation=Rotation.from_matrix(map_axes @ np.eye(3) @ body_axes).as_quat(),
        )
        for state in flight.platform_states(0)
    ]
    with refusal("odometry frames", said):
        focus_dwell(history, Trajectory(states), flight.spectrum, ImageSettings(air="none", rows=4, cols=4))


@pytest.mark.parametrize(("height", "fits"), [(100.0, True), (-1750.0, True), (-1780.0, False)])
def test_antenna_may_be_below_the_origin_by_half_its_height_above_the_ground(height: float, fits: bool) -> None:
    """It looks down at 45 degrees from 5 km: half of 3536 m is 1768 m."""
    aperture = replace(make_aperture(), position=np.array([0.0, 0.0, height]))
    if fits:
        check_frames(make_sensor(), aperture, REACH)
        return
    with refusal("odometry frames", "z = -1780 m", "3536 m"):
        check_frames(make_sensor(), aperture, REACH)


@pytest.mark.parametrize(("ratio", "fits"), [(1.0, True), (0.92, True), (1.09, True), (10.0, False), (0.89, False)])
def test_stated_pulse_repetition_frequency_must_be_that_of_the_pulse_times(ratio: float, fits: bool) -> None:
    sensor, times = make_sensor(), np.arange(48) / 30e3
    sensor = replace(sensor, pulse_repetition_frequency=30e3 * ratio, config_hash="")
    if fits:
        check_pulse_times(sensor, times)
        return
    with refusal("pulse times", "3e+04 Hz", f"{3e4 * ratio:.4g} Hz", "10%"):
        check_pulse_times(sensor, times)


@pytest.mark.parametrize(("wavelength", "limit"), [(1.55e-6, 0.07), (1e-3, 0.15)])
@pytest.mark.parametrize("side", [-1, 1])
def test_squint_that_doppler_cannot_confirm_is_said(wavelength: float, limit: float, side: int) -> None:
    """Half of wavelength * PRF / (2 speed) is 1e-3 * 30e3 / 200 = 0.15 rad; the lidar's is 2e-4, less than gusts."""
    sensor = make_sensor(wavelength=wavelength, pulse_repetition_frequency=30e3)
    near, far = (make_aperture(angles=(0, 0, side * np.arcsin(np.sin(share * limit) / LOOK))) for share in (0.99, 1.01))
    assert describe_unverified_squint(sensor, near) == ""
    where = "ahead of" if side > 0 else "behind"
    assert_one_sentence(describe_unverified_squint(sensor, far), f"{1.01 * limit:.3g} rad {where}", f"{limit:.3g} rad")


def test_yaw_of_a_tenth_of_a_radian_is_accepted_with_its_doubt() -> None:
    """Its Doppler, 4.6 MHz, is folded into the band of the pulses, here by chance to where the beams look."""
    flight, history = dwell()
    settings = ImageSettings(air="none", former="backprojection", rows=4, cols=4)
    assert focus_dwell(history, track(0.0), flight.spectrum, settings).doubts == ()
    fold = flight.spectrum.wavelength * flight.spectrum.pulse_repetition_frequency / (2 * SPEED)
    yaw = np.arcsin(round(0.1 * LOOK / fold) * fold / LOOK)
    slc = focus_dwell(history, track(yaw), flight.spectrum, settings)
    assert_one_sentence(slc.doubts[0].sentence, "abeam", "yaw")


@pytest.mark.parametrize("name", preset_names())
def test_no_preset_is_refused_or_doubted_in_gusts(name: str) -> None:
    """Of 2 m/s, in three flights of five dwells each."""
    preset = load_preset(name)
    preset = replace(preset, flight=replace(preset.flight, gust_mps=2.0), dwells=5)
    for seed in range(3):
        flight = SimulatedFlight(preset, preset.make_sensor(), flat_scene(), 5, seed)
        for number in range(5):
            aperture = flight.aperture(number)
            antenna = flight.position(flight.dwell_start_ns(number) * 1e-9 + flight.pulse_times)
            reference = np.full(len(antenna), preset.flight.slant_range_m)
            history = PhaseHistory(0, flight.pulse_times, reference, np.zeros((1, 1, 1), np.complex64))
            check_dwell(history, antenna, flight.spectrum, aperture)
            assert describe_unverified_squint(flight.spectrum, aperture) == ""


@pytest.mark.parametrize("yaw", [0.0, 0.9 * BEAMWIDTH])
def test_centroid_of_a_block_beyond_half_the_beam_is_said(yaw: float) -> None:
    """A point that keeps x m ahead of the middle of beams that move with the platform; PRF four times speed / antenna.

    0.37 of the PRF are 7400 Hz, 0.74 beamwidths or 0.5735 m.
    """
    sensor = make_sensor(mode="stripmap", pulse_repetition_frequency=20e3)
    antenna, aperture = antenna_of(256, 255 * SPEED / 20e3), make_aperture(angles=(0, 0, yaw))
    sight = aperture.rotation @ np.array([0, -np.sin(np.pi / 4), -np.cos(np.pi / 4)])
    for ahead, inside in ((0.0, True), (0.38, True), (-0.38, True), (0.4, False), (0.5735, False), (-0.5735, False)):
        doppler = 2 * SPEED / sensor.wavelength * (sight[0] + ahead / REACH)
        phase = 2 * np.pi * doppler * np.arange(256) / 20e3
        samples = np.exp(1j * phase)[None, :, None] * np.ones((3, 1, 64))
        history = PhaseHistory(0, np.arange(256) / 20e3, np.full(256, REACH), samples.astype(np.complex64))
        said = describe_strip_centroid(history, antenna, sensor, aperture)
        if inside:
            assert said == ""
        else:
            assert_one_sentence(said, f"{2 * SPEED * ahead / 7.75e-3:+.4g} Hz", "5000 Hz", "yaw")


@pytest.mark.parametrize(
    ("reason", "change"),
    [
        ("aliased in azimuth", {"azimuth_diameter": 0.003}),
        ("too few pulses", {"azimuth_diameter": 0.2}),
        ("aliased in range", {"bandwidth": 5e9}),
    ],
)
def test_dwells_are_checked_before_they_are_focused(reason: str, change: dict[str, float]) -> None:
    flight, history = dwell()
    sensor = replace(flight.spectrum, **change, config_hash="")
    with refusal(reason):
        focus_dwell(history, track(0.0), sensor, ImageSettings(air="none", former="backprojection", rows=4, cols=4))
