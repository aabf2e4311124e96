"""A strip whose odometry is not enough: where it lies, what is refused, and that images are those without errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from helpers import Array, assert_one_sentence, refused
from scipy.spatial.transform import Rotation

from sal_height.errors import Rejected, UserError
from sal_height.geometry import PlatformState, Trajectory
from sal_height.imaging import ImageSettings, Slc, StripFocuser
from sal_height.sensor import PhaseHistory, Sensor
from sal_height.simulation import SimulatedFlight, flight_of, load_preset
from sal_height.simulation.impairments import Impairments
from sal_height.simulation.phase_errors import Vibration, VibrationLine
from sal_height.simulation.scene import PointScatterer

SETTINGS = ImageSettings(air="none", rows=46, cols=128)
BLOCKS = 4
SHAKEN = Impairments(vibration=Vibration(lines=(VibrationLine(10e-6, 50.0), VibrationLine(3e-6, 200.0))))


@cache
def flight_with(impairments: Impairments, blocks: int = BLOCKS) -> SimulatedFlight:
    return flight_of(replace(load_preset("sal_stripmap"), dwells=blocks, impairments=impairments), seed=6)


@cache
def history_of(impairments: Impairments, blocks: int, dwell: int) -> PhaseHistory:
    return flight_with(impairments, blocks).phase_history(dwell)


@dataclass(frozen=True)
class Stated:
    """What odometry says of a flight that it measures without errors, but for these.

    Attributes:
        sinking: error of the velocity along the line of sight, m/s.
        yaw: error of the attitude, by which the beams look farther ahead than it says, rad.
        speed_sigma: stated of each coordinate of the velocity, m/s.
        attitude_sigma: stated about each axis, rad.
    """

    sinking: float = 0.0
    yaw: float = 0.0
    speed_sigma: float = 0.0
    attitude_sigma: float = 0.0

    def said(self, state: PlatformState) -> PlatformState:
        """A sample of odometry: 45 degrees down to the right, the line of sight sinks by this velocity downwards."""
        down = np.array([0.0, -1.0, -1.0]) / np.sqrt(2)
        seconds = state.stamp_ns * 1e-9
        covariance = np.diag([1e-10] * 3 + [self.attitude_sigma**2] * 3)
        return replace(
            state,
            position=state.position - self.sinking * seconds * down,
            velocity=state.velocity - self.sinking * down,
            orientation=(Rotation.from_rotvec([0.0, 0.0, self.yaw]) * Rotation.from_quat(state.orientation)).as_quat(),
            covariance=covariance,
            velocity_covariance=self.speed_sigma**2 * np.eye(3),
        )


def images(
    impairments: Impairments,
    stated: Stated,
    settings: ImageSettings = SETTINGS,
    dark: Sequence[int] = (),
    blocks: int = BLOCKS,
) -> tuple[list[Slc], list[Rejected]]:
    """All images of a strip, and what was refused."""
    focuser, found, refused, flight = StripFocuser(), [], [], flight_with(impairments, blocks)
    for dwell in range(blocks):
        history = history_of(impairments, blocks, dwell)
        if dwell in dark:
            history = without_echoes(history, flight.sensor)
        track = Trajectory([stated.said(state) for state in flight.track(dwell).states])
        try:
            slc = focuser.focus_block(history, track, flight.sensor, settings)
        except Rejected as refusal:
            refused.append(refusal)
        else:
            found += [slc] if slc else []
    return found, refused


def without_echoes(history: PhaseHistory, sensor: Sensor) -> PhaseHistory:
    rng = np.random.default_rng(8)
    noise = np.sqrt(sensor.noise_power[0] / 2) * rng.standard_normal((*history.samples.shape, 2))
    return replace(history, samples=noise.view(np.complex128)[..., 0].astype(np.complex64))


def looks(slcs: Sequence[Slc]) -> Array:
    """Power of 16 columns, 8 cm, of all channels, as a logarithm over that of its row."""
    power = np.sum(np.abs(np.concatenate([slc.images for slc in slcs], axis=-1)) ** 2, axis=0)
    level = np.log(power.reshape(len(power), -1, 16).mean(axis=-1))
    return level - level.mean(axis=1, keepdims=True)


def by_place(slcs: Sequence[Slc], edges: Array) -> Array:
    """Power of all channels between places along the flight (m, in map), as a logarithm over that of its row."""
    power = np.concatenate([np.sum(np.abs(slc.images) ** 2, axis=0) for slc in slcs], axis=-1)
    place = np.concatenate([slc.grid.points(0.0, np.arange(slc.grid.cols))[:, 0] for slc in slcs])
    which = np.digitize(place, edges) - 1
    level = np.log([[row[which == part].mean() for part in range(len(edges) - 1)] for row in power])
    return np.asarray(level - level.mean(axis=1, keepdims=True))


@cache
def exact_images() -> list[Slc]:
    """Of a flight without errors."""
    return images(Impairments(), Stated(), SETTINGS.changed(autofocus="never"))[0]


def likeness(slcs: Sequence[Slc]) -> float:
    """Correlation of 12 cm wide looks with those of a flight without errors, at the same places in map."""
    exact = exact_images()
    ends = [slc.grid.points(0.0, np.array([0.0, slc.grid.cols]))[:, 0] for some in (exact, slcs) for slc in some]
    first = max(exact[0].grid.points(0.0, 0.0)[0], slcs[0].grid.points(0.0, 0.0)[0])
    edges = np.arange(first, min(np.max(ends[: len(exact)]), np.max(ends[len(exact) :])), 0.12)
    assert len(edges) > 8
    return float(np.corrcoef(by_place(exact, edges).ravel(), by_place(slcs, edges).ravel())[0, 1])


UNSURE = Stated(speed_sigma=0.005, attitude_sigma=2e-6)


def test_images_of_a_platform_that_vibrates_are_those_of_one_that_does_not() -> None:
    """Powers of looks of 8 cm correlate by .95, blurred by half a centimetre; without autofocus hardly at all."""
    exact = exact_images()
    focused, refused = images(SHAKEN, UNSURE)
    blurred, _ = images(SHAKEN, UNSURE, SETTINGS.changed(autofocus="never"))
    assert not refused
    alike, unlike = (np.corrcoef(looks(exact).ravel(), looks(some).ravel())[0, 1] for some in (focused, blurred))
    assert (alike, unlike) == (pytest.approx(0.95, abs=0.04), pytest.approx(0.1, abs=0.2))
    assert all(slc.autofocus_phase.shape == (256,) for slc in focused)


@pytest.mark.parametrize("speed", [-0.006, 0.004])
def test_error_of_the_velocity_is_found_and_the_image_placed_by_it(speed: float) -> None:
    """To .15 mm/s, 1.5 cm along the flight, of which the covariance tells; without, it lies 40 to 60 cm off."""
    found, refused = images(Impairments(), replace(UNSURE, sinking=speed))
    assert not refused
    assert likeness(found) > 0.9
    for slc in found:
        assert slc.placement.speed == pytest.approx(speed, abs=3 * slc.placement.speed_error)
        assert slc.placement.speed_error == pytest.approx(0.00015, rel=0.15)
        along = float(slc.aperture.direction @ slc.aperture.covariance[:3, :3] @ slc.aperture.direction)
        assert np.sqrt(along) == pytest.approx(slc.placement.speed_error * 5000.0 / 50.0, rel=1e-2)


def test_error_of_the_attitude_turns_the_beams_and_not_the_image() -> None:
    """A yaw of half a beam, beside an exact velocity: 45 degrees down, .35 of a beam, which is found to .05 of it.

    The ground is where it was: an image that was moved by .35 of a beam would lie 27 cm off.
    """
    yaw = 0.5 * 1.55e-4
    found, refused = images(Impairments(), Stated(yaw=-yaw, speed_sigma=1e-5, attitude_sigma=1e-4))
    assert not refused
    assert likeness(found) > 0.9
    for slc in found:
        assert slc.placement.pointing == pytest.approx(yaw / np.sqrt(2), abs=0.05 * 1.55e-4)
        assert abs(slc.placement.speed) < 1e-4


def test_where_the_phase_steps_at_random_the_attitude_places_the_image() -> None:
    """By a laser line of 100 kHz, of which no trend tells a velocity: 2e-5 rad of attitude are 10 cm."""
    found, refused = images(Impairments(laser_linewidth_hz=1e5), replace(UNSURE, attitude_sigma=2e-5))
    assert not refused
    assert likeness(found) > 0.9
    for slc in found:
        assert slc.placement.by_beams
        assert slc.placement.speed == 0.0
        assert slc.placement.speed_error * 5000.0 / 50.0 == pytest.approx(0.1, rel=0.1)


def test_blocks_are_all_focused_the_same_way_or_the_strip_begins_anew() -> None:
    """A block without echoes in a strip that needs autofocus is refused with the reason; the next begins a strip."""
    found, refused = images(SHAKEN, UNSURE, dark=(1,), blocks=BLOCKS + 1)
    assert [refusal.reason for refusal in refused] == ["autofocus"]
    assert_one_sentence(str(refused[0]), "0.005 m/s", "autofocus")
    assert found


def test_velocity_that_contradicts_what_odometry_states_is_refused() -> None:
    """6 mm/s where .1 mm/s is stated, 5 sigma being 1.2 mm/s: in every block."""
    stated = Stated(sinking=0.006, speed_sigma=1e-4, attitude_sigma=4e-6)
    found, refused = images(Impairments(), stated)
    assert not found
    assert {refusal.reason for refusal in refused} == {"Doppler centroid contradicts navigation"}
    assert len(refused) == BLOCKS


@pytest.mark.parametrize(
    ("autofocus", "sigma", "looked"),
    [("auto", 0.0, False), ("auto", 0.005, True), ("never", 0.005, False), ("always", 0.0, True)],
)
def test_autofocus_is_asked_for_or_needed(autofocus: str, sigma: float, looked: bool) -> None:
    stated = Stated(speed_sigma=sigma)
    found, _ = images(Impairments(), stated, SETTINGS.changed(autofocus=autofocus))
    assert all((slc.focus is not None) == looked for slc in found)
    assert found


def test_boresights_that_are_not_known_make_the_beams_uncertain() -> None:
    found, _ = images(Impairments(), Stated(), SETTINGS.changed(boresight_sigma_rad=1e-4))
    assert all(slc.focus for slc in found)
    assert found


def test_always_leaves_a_block_without_echoes_as_it_is_where_odometry_is_exact() -> None:
    found, refused = images(Impairments(), Stated(), SETTINGS.changed(autofocus="always"), dark=(2,))
    assert not refused
    assert [bool(slc.focus and slc.focus.trusted) for slc in found].count(False) == 1
    assert all(np.all(np.isfinite(slc.images)) for slc in found)


def test_always_is_refused_where_the_noise_is_not_known() -> None:
    flight, settings = flight_with(Impairments()), SETTINGS.changed(autofocus="always")
    sensor = replace(flight.sensor, noise_power=(0.0,) * flight.sensor.detector_count, config_hash="")
    with refused(UserError, "always", "auto or never"):
        StripFocuser().focus_block(flight.phase_history(0), flight.track(0), sensor, settings)


def test_strips_tell_how_well_they_know_the_middle_of_their_beams() -> None:
    """Uneven ground leaves some .11 mm/s, and noise a little, placed either way; none if left alone."""
    placed = [
        images(impairments, UNSURE, SETTINGS.changed(autofocus=autofocus))[0][-1].placement
        for impairments, autofocus in (
            (Impairments(), "auto"),
            (Impairments(laser_linewidth_hz=1e5), "auto"),
            (Impairments(), "never"),
        )
    ]
    assert all(1e-4 < one.beams_error < 1.4e-4 for one in placed[:2])
    assert placed[2].beams_error == 0.0


@cache
def flight_over(point: PointScatterer) -> tuple[SimulatedFlight, list[PhaseHistory]]:
    """The flight without errors over a point, and its pulses."""
    flight = flight_with(Impairments())
    flight = replace(flight, scene=replace(flight.scene, points=(point,)))
    return flight, [flight.phase_history(dwell) for dwell in range(flight.dwells)]


def peak_of(point: PointScatterer, autofocus: str, stated: Stated) -> float:
    """Power of the brightest pixel of a strip over a point, all channels together, dB."""
    (flight, histories), focuser = flight_over(point), StripFocuser()
    settings = ImageSettings(air="none", rows=46, cols=128, autofocus=autofocus)
    brightest = 0.0
    for dwell, history in enumerate(histories):
        track = Trajectory([stated.said(state) for state in flight.track(dwell).states])
        slc = focuser.focus_block(history, track, flight.sensor, settings)
        brightest = max(brightest, float(np.max(np.sum(np.abs(slc.images) ** 2, axis=0))) if slc else 0.0)
    return 10 * np.log10(brightest)


def test_a_reflector_that_outshines_the_ground_stays_sharp() -> None:
    """To 1 dB with 40 dB over a cell: autofocus took the way of its phase through the beam for a movement, and 6 dB."""
    reflector = PointScatterer(0.0, 0.5, 0.8, 1e4, 0.0, 0.0)
    assert peak_of(reflector, "always", Stated()) == pytest.approx(peak_of(reflector, "never", Stated()), abs=1.0)


def test_a_car_that_outshines_the_ground_refuses_no_block() -> None:
    car = PointScatterer(0.0, 0.5, 0.8, 10**3.5, 3.0, 0.0)
    assert np.isfinite(peak_of(car, "auto", Stated(speed_sigma=0.005)))
