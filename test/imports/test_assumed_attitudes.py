"""Attitudes of tracks that have none: from the ranges to a followed point, or level along the track."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sal_height.geometry import Mounting, Trajectory
from sal_height.imaging import line_of_sight
from sal_height.imports import Description, level_states
from sal_height.imports.assumed_attitudes import FOLLOWED_SIGMA, followed_squint, with_assumed_attitudes
from sal_height.numeric import F64
from sal_height.sensor import PhaseHistory, Sensor
from sal_height.simulation import MountingSettings

START_NS, SPEED, HEIGHT = 10**18, 80.0, 1500.0
PULSES = np.arange(168) / 400.0
STAMPS = START_NS + np.arange(-50, 100) * 10**7


def described(side: str = "right", boresight_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Description:
    return Description(
        "mine", side, 150e6, 1.0, 2.0, (0.7, 0.8), 0.03, mounting=MountingSettings(boresight_rad=boresight_rad)
    )


def antenna(seconds: F64) -> F64:
    return np.stack([SPEED * seconds, 0 * seconds, HEIGHT + 0 * seconds], axis=-1)


def positions() -> F64:
    return antenna((STAMPS - START_NS) * 1e-9)


def following(squint: float, side: int, start_s: float = 0.0) -> PhaseHistory:
    """A dwell whose ranges are those to a point on the ground."""
    sent_from = antenna(start_s + PULSES)
    ahead = np.hypot(HEIGHT, HEIGHT) * np.tan(squint)
    point = sent_from[len(PULSES) // 2] + np.array([ahead, -side * HEIGHT, -HEIGHT])
    ranges = np.linalg.norm(point - sent_from, axis=1)
    return PhaseHistory(START_NS + round(1e9 * start_s), PULSES, ranges, np.zeros((2, len(PULSES), 8), np.complex64))


def sensor_of(description: Description) -> Sensor:
    return description.sensor(len(PULSES), 8, 400.0)


def squint_of(states: Trajectory, sensor: Sensor, history: PhaseHistory) -> float:
    aperture = states.mounted(sensor.mounting).aperture(history.stamp_ns, history.pulse_times)
    return float(np.arcsin(line_of_sight(sensor, aperture) @ aperture.direction))


@pytest.mark.parametrize("squint", [-0.3, 0.0, 0.0785])
@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize("boresight_rad", [(0.0, 0.0, 0.0), (0.0, 0.02, -0.05)])
def test_beams_are_turned_to_the_point_that_the_ranges_follow(
    squint: float, side: str, boresight_rad: tuple[float, float, float]
) -> None:
    """Whatever turn of the mounting is described."""
    described_ = described(side, boresight_rad)
    sensor, history = sensor_of(described_), following(squint, {"right": 1, "left": -1}[side])
    states = with_assumed_attitudes(level_states(STAMPS, positions()), [history], sensor, described_)
    assert squint_of(Trajectory(states), sensor, history) == pytest.approx(squint, abs=2e-4)
    np.testing.assert_allclose(np.sqrt(np.diag(states[0].covariance)), [0, 0, 0, 0.05, 0.05, FOLLOWED_SIGMA])
    assert Rotation.from_quat(states[0].orientation).as_matrix()[2, 2] == pytest.approx(1.0)


def test_each_dwell_has_its_own_point() -> None:
    """In its middle, and whatever the order of the dwells."""
    sensor, histories = sensor_of(described()), [following(-0.05, 1, 0.5), following(0.1, 1)]
    states = with_assumed_attitudes(level_states(STAMPS, positions()), histories, sensor, described())
    squints = [squint_of(Trajectory(states), sensor, history) for history in histories]
    assert squints == pytest.approx([-0.05, 0.1], abs=2e-3)


def test_ranges_that_follow_no_point_leave_the_heading_open(caplog: pytest.LogCaptureFixture) -> None:
    sensor, constant = sensor_of(described()), replace(following(0.1, 1), reference_range=np.full(len(PULSES), 2121.0))
    level = level_states(STAMPS, positions())
    assert followed_squint(constant, Trajectory(level)) is None
    with caplog.at_level(logging.WARNING):
        states = with_assumed_attitudes(level, [constant], sensor, described())
    np.testing.assert_allclose(np.sqrt(np.diag(states[0].covariance)), [0, 0, 0, 0.05, 0.05, 0.1])
    for state, before in zip(states, level, strict=True):
        np.testing.assert_array_equal(state.orientation, before.orientation)
    for part in (
        "The track has no attitudes",
        "0.05 rad in roll",
        "0.1 rad in heading",
        "by 72.3 m here",
        "nothing shows",
    ):
        assert part in caplog.text


def test_a_description_states_how_level_the_flight_is() -> None:
    steady = replace(described(), assumed_attitude_sigma_rad=0.002, assumed_heading_sigma_rad=0.003)
    states = with_assumed_attitudes(level_states(STAMPS, positions()), [following(0.1, 1)], sensor_of(steady), steady)
    np.testing.assert_allclose(np.sqrt(np.diag(states[0].covariance)), [0, 0, 0, 0.002, 0.002, 0.003])


def test_an_arm_of_the_sensor_does_not_matter() -> None:
    sensor = replace(sensor_of(described()), mounting=Mounting(lever_arm=(0.0, 0.0, -1.0)), config_hash="")
    history = following(0.0785, 1)
    states = with_assumed_attitudes(level_states(STAMPS, positions()), [history], sensor, described())
    assert squint_of(Trajectory(states), sensor, history) == pytest.approx(0.0785, abs=2e-4)
