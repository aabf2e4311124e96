"""A sensor's mounting moves heights as rigid-body geometry says, which this file writes out by itself.

Echoes of a single point come from formulas in this file: positions, attitudes and beams owe nothing to the simulator,
so that a wrong sign there and in the processing cannot cancel. Lengths in m, angles in rad; x forward, y left, z up.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from helpers import Array, direct_history, make_sensor

from sal_height.elevation import ESTIMATORS, MlSettings
from sal_height.geometry import AT_BASE_LINK, Mounting, PlatformState, Trajectory
from sal_height.imaging import ImageSettings, Slc
from sal_height.pipeline import Compressor, heights
from sal_height.sensor import PhaseHistory, Sensor
from sal_height.simulation import SimulatedFlight, flight_of, load_preset
from sal_height.simulation.preset import MountingSettings

EARTH = 6_371_000.0
RANGE, SPEED, MIDDLE = 5000.0, 50.0, np.pi / 4
BEAM = 1.55e-4
"""Wavelength over the 0.01 m of the antenna, in both directions."""

IMAGES = {
    "spotlight": ImageSettings(air="none", azimuth_window="rectangular", rows=15, cols=9),
    "stripmap": ImageSettings(air="none", azimuth_window="rectangular", rows=15, cols=0),
}
"""An odd number of rows: the point is at the reference range and thus in the middle of the middle one."""

ONE_LOOK = MlSettings(range_looks=1, azimuth_looks=1)


def about_x(angle: float) -> Array:
    """Matrix of a turn about x: it lifts the left side."""
    return np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])


def quaternion_about_x(angle: float) -> tuple[float, float, float, float]:
    return float(np.sin(angle / 2)), 0.0, 0.0, float(np.cos(angle / 2))


def height_on_sphere(point: Array) -> float:
    return float(np.linalg.norm(point + np.array([0, 0, EARTH])) - EARTH)


@dataclass(frozen=True)
class Case:
    """A point seen by an antenna on a rolling platform that flies east; `roll` is that in the middle of the pulses."""

    mode: str
    look_side: int = 1
    roll: float = 0.0
    roll_rate: float = 0.0
    arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    boresight_roll: float = 0.0
    offset: float = 0.3 * BEAM

    @property
    def sensor(self) -> Sensor:
        """The sensor with its mounting described."""
        count = {"spotlight": 48, "stripmap": 400}[self.mode]
        return make_sensor(
            mode=self.mode,
            look_side=self.look_side,
            pulse_count=count,
            pulse_repetition_frequency={"spotlight": 30e3, "stripmap": 12e3}[self.mode],
            pattern="sinc",
            elevation_boresights=tuple(MIDDLE + BEAM * np.array([-0.75, -0.25, 0.25, 0.75])),
            noise_power=(1.0,) * 4,
            mounting=Mounting("antenna", self.arm, quaternion_about_x(self.boresight_roll)),
        )

    @property
    def times(self) -> Array:
        return np.arange(self.sensor.pulse_count) / self.sensor.pulse_repetition_frequency

    def body(self, seconds: float) -> tuple[Array, Array]:
        """Position of base_link, and the matrix that turns its axes into those of map."""
        late = seconds - float(self.times[-1]) / 2
        turn = about_x(self.roll + self.roll_rate * late)
        start = np.array([0.0, self.look_side * RANGE * np.sin(MIDDLE), RANGE * np.cos(MIDDLE)])
        return start + np.array([SPEED * late, 0.0, 0.0]), turn

    def antenna(self, seconds: float) -> tuple[Array, Array]:
        """Position of the antenna, and the matrix that turns the sensor's axes into those of map."""
        position, turn = self.body(seconds)
        return position + turn @ self.arm, turn @ about_x(self.boresight_roll)

    @property
    def point(self) -> Array:
        """The point: at the reference range, across the flight, and off the middle of the beams by the offset."""
        position, axes = self.antenna(float(self.times[-1]) / 2)
        elevation = MIDDLE + self.offset
        across = axes @ [0.0, -self.look_side * np.sin(elevation), -np.cos(elevation)]
        return position + RANGE * across

    def history(self) -> PhaseHistory:
        """Echoes of the point; the antenna is held on it in spotlight, fixed to the platform in stripmap."""
        sensor, times, point = self.sensor, self.times, self.point
        positions = np.array([self.antenna(t)[0] for t in times])
        pointed = np.full(len(times), times[-1] / 2) if self.mode == "spotlight" else times
        sight = np.array([axes.T @ (point - position) for position, axes in map(self.antenna, pointed)])
        elevation = np.arctan2(-self.look_side * sight[:, 1], -sight[:, 2])
        squint = np.arcsin(sight[:, 0] / np.linalg.norm(sight, axis=1))
        steps = (elevation - np.array(sensor.elevation_boresights)[:, None]) / BEAM
        beams = np.sinc(steps) * np.sinc(squint / BEAM)
        reference = np.full(len(times), RANGE)
        echo = direct_history(sensor, point[None], np.full(1, 1e4), positions, reference)
        return PhaseHistory(0, times, reference, (beams[..., None] * echo).astype(np.complex64))

    def track(self) -> Trajectory:
        """Odometry of base_link, every millisecond."""
        end = int(self.times[-1] * 1e3) + 3
        states = []
        for milli in range(-2, end):
            position, _ = self.body(milli * 1e-3)
            angle = self.roll + self.roll_rate * (milli * 1e-3 - float(self.times[-1]) / 2)
            quaternion = np.array(quaternion_about_x(angle))
            velocity = np.array([SPEED, 0.0, 0.0])
            states.append(PlatformState(milli * 1_000_000, position, quaternion, velocity, np.zeros((6, 6))))
        return Trajectory(states)

    def height_error(self, described: Mounting | None = None) -> float:
        """Estimated minus true height of the point when the sensor is said to be mounted so; None: as it is."""
        sensor = self.sensor
        if described is not None:
            sensor = replace(sensor, mounting=described, config_hash="")
        slc = Compressor().add(self.history(), self.track(), sensor, IMAGES[self.mode])
        assert slc
        return brightest_height(slc, sensor) - height_on_sphere(self.point)


def brightest_height(slc: Slc, sensor: Sensor) -> float:
    """Height in the pixel with the greatest power, which is in the middle row."""
    field = heights(slc, sensor, ESTIMATORS["ml"], ONE_LOOK)
    power = np.sum(np.abs(slc.images) ** 2, axis=0)
    row, col = np.unravel_index(np.argmax(power), power.shape)
    assert row == slc.grid.rows // 2
    return float(field.first.height[row, col])


MODES = pytest.mark.parametrize("mode", ["spotlight", "stripmap"])
SIDES = pytest.mark.parametrize("side", [1, -1])
EXACT = 2e-4
"""Error of a height that geometry alone determines, m. The point lies up to half a column off the pixel."""


@MODES
@SIDES
def test_a_lever_arm_to_the_left_on_a_rolled_platform_lifts_heights_by_its_sine(mode: str, side: int) -> None:
    """Rolled by 1 degree, 1 m to the left is 17.45 mm up; without the arm the antenna is taken to be as much lower."""
    roll = np.deg2rad(1.0)
    case = Case(mode, side, roll=roll, arm=(0.0, 1.0, 0.0))
    assert case.height_error() == pytest.approx(0.0, abs=EXACT)
    assert case.height_error(AT_BASE_LINK) == pytest.approx(-0.01745, abs=EXACT)


@MODES
@SIDES
def test_a_boresight_rotation_in_roll_moves_heights_by_the_slant_range_times_its_sine(mode: str, side: int) -> None:
    """A left side lifted by d turns a right-looking beam towards nadir, a left-looking one away: R sin(el) d high."""
    turn = 1e-5
    case = Case(mode, side, boresight_roll=turn)
    elevation = MIDDLE + case.offset
    assert case.height_error() == pytest.approx(0.0, abs=EXACT)
    closed_form = side * RANGE * np.sin(elevation) * turn
    assert abs(closed_form) == pytest.approx(0.0354, abs=1e-4)
    assert case.height_error(AT_BASE_LINK) == pytest.approx(closed_form, abs=EXACT)


@MODES
def test_arm_and_boresight_are_described_in_the_axes_of_the_platform_not_in_each_others(mode: str) -> None:
    """With a turn of 0.5 rad between both axes the arm must not be taken for one in the sensor's."""
    case = Case(mode, roll=-0.25, arm=(0.4, 2.0, -1.5), boresight_roll=0.5, offset=-0.4 * BEAM)
    assert case.height_error() == pytest.approx(0.0, abs=EXACT)
    turned_only = replace(case.sensor.mounting, lever_arm=(0.0, 0.0, 0.0))
    up = 2.0 * np.sin(-0.25) - 1.5 * np.cos(-0.25)
    assert case.height_error(turned_only) == pytest.approx(-up, abs=2e-3)  # curvature: 2 m aside, at 3.5 km, are 1 mm


def test_a_lever_arm_moves_with_a_rolling_platform() -> None:
    """Within the dwell of 1.6 ms the antenna rises by 0.16 mm, a hundred wavelengths, at 0.1 m/s."""
    case = Case("spotlight", roll_rate=0.1, arm=(0.0, 1.0, 0.0))
    assert case.height_error() == pytest.approx(0.0, abs=EXACT)


def test_a_mounting_without_arm_and_rotation_changes_no_bit() -> None:
    """Neither of the samples, nor of the odometry, nor of the heights."""
    flight = small_flight()
    named = replace(flight.sensor, mounting=Mounting("camera"), config_hash="")
    mounted = replace(flight, sensor=named)
    np.testing.assert_array_equal(mounted.phase_history(0).samples, flight.phase_history(0).samples)
    fields = [heights_of(each, each.sensor) for each in (flight, mounted)]
    np.testing.assert_array_equal(fields[1], fields[0])
    assert np.isfinite(fields[0]).any()


def small_flight(**changes: Any) -> SimulatedFlight:
    """A dwell of the small preset in gusts of 1 m/s.

    Odometry comes at 1 kHz: between two attitudes 5 ms apart the gust's angular acceleration moves 1 m of arm by 11 nm.
    """
    preset = load_preset("small")
    flight = replace(preset.flight, gust_mps=1.0, odometry_rate_hz=1000.0)
    return flight_of(replace(preset, dwells=1, flight=flight, sensor=replace(preset.sensor, **changes)), seed=1)


def heights_of(flight: SimulatedFlight, sensor: Sensor) -> Array:
    """Heights that the first dwell of a flight gives if the sensor is described so."""
    slc = Compressor().add(
        flight.phase_history(0), flight.track(0), sensor, ImageSettings(air="none", rows=46, cols=12)
    )
    assert slc
    return heights(slc, sensor, ESTIMATORS["ml"], MlSettings()).first.height


def test_the_simulator_mounts_a_sensor_as_the_processing_takes_it_to_be() -> None:
    """The antenna flies as without mounting; base_link, rolled by -1 degree under it, is 17.45 mm higher.

    If the arm is not described, what gusts turn of it stays in the images: up to 1.5 mm in single pixels of this dwell,
    of which one fails for it.
    """
    roll = np.deg2rad(1.0)
    mounting = MountingSettings(lever_arm_m=(0.0, 1.0, 0.0), boresight_rad=(roll, 0.0, 0.0))
    plain, mounted = small_flight(), small_flight(mounting=mounting)
    expected = heights_of(plain, plain.sensor)
    np.testing.assert_array_equal(mounted.phase_history(0).samples, plain.phase_history(0).samples)
    np.testing.assert_allclose(heights_of(mounted, mounted.sensor), expected, atol=EXACT)
    without_arm = replace(mounted.sensor.mounting, lever_arm=(0.0, 0.0, 0.0))
    found = heights_of(mounted, replace(mounted.sensor, mounting=without_arm, config_hash=""))
    assert np.sum(np.isfinite(found) != np.isfinite(expected)) <= 1
    higher = (found - expected)[np.isfinite(found) & np.isfinite(expected)]
    assert higher.size > 70
    np.testing.assert_allclose(higher, np.sin(roll), atol=2e-3)
