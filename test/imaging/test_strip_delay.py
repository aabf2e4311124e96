"""A strip through air: the delay of its echoes changes with where the antenna is, not with where each block looks."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sal_height.geometry import PlatformState, Trajectory, height_of, path_through_air
from sal_height.imaging import ImageSettings, Slc
from sal_height.numeric import F64, vertex
from sal_height.pipeline import Compressor
from sal_height.sensor import PhaseHistory
from sal_height.simulation import SimulatedFlight, flight_of, load_preset

BLOCKS = 6
ROLL_RATE = 0.01006
"""rad/s: from block to block the delay of the ground in the middle grows by 35.5 times half a wavelength."""


@cache
def level_flight() -> SimulatedFlight:
    return flight_of(replace(load_preset("sal_stripmap"), dwells=BLOCKS), seed=1)


@cache
def track_of(roll_rate: float, climb: float) -> Trajectory:
    """Of a platform that rolls (rad/s) and climbs (m/s)."""
    up = np.array([0.0, 0.0, climb])

    def flown(state: PlatformState) -> PlatformState:
        seconds = state.stamp_ns * 1e-9
        turn = Rotation.from_rotvec([roll_rate * seconds, 0.0, 0.0])
        orientation = (turn * Rotation.from_quat(state.orientation)).as_quat()
        position, velocity = state.position + up * seconds, state.velocity + up
        return replace(state, position=position, velocity=velocity, orientation=orientation)

    states = {state.stamp_ns: state for block in range(BLOCKS) for state in level_flight().track(block).states}
    return Trajectory([flown(states[stamp]) for stamp in sorted(states)])


def delay(antenna: F64, target: F64) -> float:
    """Of the standard atmosphere, m."""
    above, ground = float(height_of(antenna)), float(height_of(target))
    off_nadir = np.arccos((above - ground) / np.linalg.norm(target - antenna))
    return path_through_air(level_flight().sensor.wavelength, above, ground, off_nadir).delay


def focused(
    roll_rate: float, climb: float, *, flown_in_air: bool, air: str, rising_pa: float = 0.0
) -> tuple[float, float]:
    """Greatest amplitude of the image of a point abeam, which all pulses see alike, and how far on it lies, m.

    Args:
        roll_rate: of the platform, rad/s.
        climb: of the platform, m/s.
        flown_in_air: whether echoes are delayed.
        air: the parameter of that name.
        rising_pa: how much more pressure is measured at each block than at the last.
    """
    flight, track, compressor = level_flight(), track_of(roll_rate, climb), Compressor()
    sensor, reference, look = flight.sensor, 5000.0, flight.preset.flight.look_angle_rad
    settings = ImageSettings(rows=46, cols=128, autofocus="never", air=air)
    starts = [flight.dwell_start_ns(block) for block in range(BLOCKS)]
    abeam = track.positions(starts[BLOCKS // 2], flight.pulse_times[:1])[0]
    target = abeam + reference * np.array([0.0, -np.sin(look), -np.cos(look)])
    number = np.arange(sensor.sample_count) - sensor.sample_count // 2
    wavenumber = sensor.centre_wavenumber + sensor.wavenumber_step * number
    images: list[Slc] = []
    for block, start_ns in enumerate(starts):
        antenna = track.positions(start_ns, flight.pulse_times)
        farther = np.linalg.norm(antenna - target, axis=1) - reference
        if flown_in_air:
            farther += [delay(position, target) for position in antenna]
        echo = np.exp(-1j * wavenumber * farther[:, None]).astype(np.complex64)
        samples = np.repeat(echo[None], sensor.detector_count, axis=0)
        history = PhaseHistory(start_ns, flight.pulse_times, np.full(len(antenna), reference), samples)
        image = compressor.add(
            history, track, sensor, settings.model_copy(update={"air_pressure_pa": 101_325.0 + block * rising_pa})
        )
        images += [image] if image else []
    brightest = max(images, key=lambda slc: float(np.abs(slc.images).max()))
    power = np.abs(brightest.images[0]) ** 2
    row, col = np.unravel_index(power.argmax(), power.shape)
    offset, _ = vertex(*np.log(power[row, col - 1 : col + 2]))
    found = brightest.grid.points(row, col + offset) - target
    return float(np.sqrt(power.max())), float(found @ track.aperture(starts[0], flight.pulse_times).direction)


def test_roll_leaves_the_image_in_focus() -> None:
    """In air that is not taken out the point is focused as well; that of blocks which look elsewhere would not join."""
    plain, _ = focused(ROLL_RATE, 0.0, flown_in_air=True, air="none")
    corrected, _ = focused(ROLL_RATE, 0.0, flown_in_air=True, air="standard")
    assert corrected == pytest.approx(plain, rel=0.01)


def test_air_that_changes_from_block_to_block_leaves_the_image_in_focus() -> None:
    """And in its place: a block's range is that in its own air."""
    plain, at_rest = focused(0.0, 0.0, flown_in_air=True, air="measured")
    corrected, place = focused(0.0, 0.0, flown_in_air=True, air="measured", rising_pa=3.3)
    assert corrected == pytest.approx(plain, rel=0.01)
    assert place == pytest.approx(at_rest, abs=0.0002)


def test_a_climb_does_not_move_the_image_along_the_flight() -> None:
    """By R / V times the rate of the delay, 11 mm at 1 m/s, and the delay times the angle of climb, 16 mm."""
    vacuum, plain, corrected = (
        focused(0.0, 1.0, flown_in_air=flown, air=air)[1]
        for flown, air in ((False, "none"), (True, "none"), (True, "standard"))
    )
    assert plain - vacuum == pytest.approx(-0.027, abs=0.002)
    assert corrected == pytest.approx(vacuum, abs=0.001)
