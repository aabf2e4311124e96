"""Where a mounted antenna is and where it looks, against rotation matrices written out in this file."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import Array, refused

from sal_height.errors import UserError
from sal_height.geometry import AT_BASE_LINK, Mounting, PlatformState, Trajectory

RATE = 0.2
"""Roll, pitch and yaw rate of the platforms in turn, rad/s."""

SPEED = np.array([40.0, 30.0, -2.0])


def turn(axis: int, angle: float) -> Array:
    """Matrix of a right-handed turn by `angle` about an axis: 0 x, 1 y, 2 z."""
    first, second = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[first, first] = matrix[second, second] = np.cos(angle)
    matrix[second, first], matrix[first, second] = np.sin(angle), -np.sin(angle)
    return matrix


def quaternion(axis: int, angle: float) -> Array:
    values = np.zeros(4)
    values[axis], values[3] = np.sin(angle / 2), np.cos(angle / 2)
    return values


def turning_platform(axis: int, covariance: Array | None = None, states: int = 11) -> list[PlatformState]:
    """Odometry every 5 ms of a platform that turns about one of its axes, not turned at time 0."""
    covariance = np.zeros((6, 6)) if covariance is None else covariance
    return [
        PlatformState(round(t * 1e9), SPEED * t, quaternion(axis, RATE * t), SPEED, covariance)
        for t in np.arange(states) * 5e-3
    ]


@pytest.mark.parametrize("states", [2, 11])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_antenna_is_at_the_turned_end_of_the_lever_arm(axis: int, states: int) -> None:
    """Position p + C a and velocity v + w x C a, whichever axis the platform turns about; two states are a dwell's.

    The chord of the arm between two states is 0.2 um from its arc.
    """
    arm = np.array([0.5, -1.0, 2.0])
    track = Trajectory(turning_platform(axis, states=states)).mounted(Mounting(lever_arm=(0.5, -1.0, 2.0)))
    times = np.linspace(0.0, 5e-3 * (states - 1), 8)
    expected = [SPEED * t + turn(axis, RATE * t) @ arm for t in times]
    np.testing.assert_allclose(track.positions(0, times), expected, atol=1e-10)
    middle = float(times[0] + times[-1]) / 2
    rate = RATE * np.eye(3)[axis]
    velocity = SPEED + np.cross(rate, turn(axis, RATE * middle) @ arm)
    np.testing.assert_allclose(track.aperture(0, times).velocity, velocity, atol=1e-7)


def test_the_arm_of_a_platform_that_is_turned_and_turning_sweeps_at_right_angles_to_both() -> None:
    """Heading north, rolling at 0.2 rad/s: 2 m below, the antenna sweeps to the west, where the left side points."""
    turned = [
        PlatformState(round(t * 1e9), SPEED * t, _north(RATE * t), SPEED, np.zeros((6, 6))) for t in (0.0, 5e-3, 0.01)
    ]
    aperture = Trajectory(turned, Mounting(lever_arm=(0.0, 0.0, -2.0))).aperture(0, np.array([0.0, 1e-9]))
    np.testing.assert_allclose(aperture.velocity - SPEED, [-2 * RATE, 0.0, 0.0], atol=1e-7)


def _north(roll: float) -> Array:
    """Quaternion of a platform that heads north (90 degrees from east, about z) and is then rolled."""
    half, tilt = np.sqrt(0.5), roll / 2
    return half * np.array([np.sin(tilt), np.sin(tilt), np.cos(tilt), np.cos(tilt)])


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_rotation_turns_the_axes_of_the_sensor_into_those_of_the_platform(axis: int) -> None:
    """A direction d of the sensor frame is C_platform C_mounting d in map; the rotations do not commute."""
    about = (axis + 1) % 3
    x, y, z, w = quaternion(about, 0.3).tolist()
    track = Trajectory(turning_platform(axis)).mounted(Mounting(rotation=(x, y, z, w)))
    aperture = track.aperture(0, np.array([0.02, 0.03]))
    np.testing.assert_allclose(aperture.rotation, turn(axis, RATE * 0.025) @ turn(about, 0.3), atol=1e-12)
    np.testing.assert_allclose(aperture.position, SPEED * 0.025, atol=1e-12)


def test_an_uncertain_attitude_makes_the_position_of_the_antenna_uncertain() -> None:
    """Var = s^2 (|a|^2 I - a a^T) of an isotropic error s of attitude; 1e5 random draws agree to 4 standard errors."""
    arm, sigma, draws = np.array([0.5, -1.0, 2.0]), 1e-3, 100_000
    covariance = np.diag([0.0] * 3 + [sigma**2] * 3)
    track = Trajectory(turning_platform(0, covariance)).mounted(Mounting(lever_arm=(0.5, -1.0, 2.0)))
    found = track.aperture(0, np.array([0.0, 1e-9])).covariance
    np.testing.assert_allclose(found[:3, :3], sigma**2 * (arm @ arm * np.eye(3) - np.outer(arm, arm)), atol=1e-18)
    np.testing.assert_array_equal(found[3:, 3:], covariance[3:, 3:])
    errors = sigma * np.random.default_rng(1).standard_normal((draws, 3))
    moved = np.cross(errors, arm)
    np.testing.assert_allclose(found[:3, 3:], moved.T @ errors / draws, atol=4 * sigma**2 * 2.3 / np.sqrt(draws))


def test_no_mounting_changes_no_bit_of_a_track() -> None:
    states, times = turning_platform(0), np.linspace(0, 0.05, 7)
    plain = Trajectory(states)
    for same in (plain.mounted(Mounting("camera")), plain.mounted(Mounting("arm", (1.0, 0, 0))).mounted(AT_BASE_LINK)):
        np.testing.assert_array_equal(same.positions(0, times), plain.positions(0, times))
        np.testing.assert_array_equal(same.aperture(0, times).rotation, plain.aperture(0, times).rotation)


@pytest.mark.parametrize(
    ("values", "parts"),
    [
        ({"lever_arm": (0.0, float("nan"), 0.0)}, ("lever arm", "nan", "1000")),
        ({"lever_arm": (0.0, 0.0, 1001.0)}, ("lever arm", "1001", "1000")),
        ({"rotation": (0.0, 0.0, 0.0, 0.0)}, ("rotation", "quaternion", "norm 1")),
        ({"rotation": (float("nan"), 0.0, 0.0, 1.0)}, ("rotation", "nan")),
    ],
)
def test_an_impossible_mounting_is_refused_in_one_sentence(values: dict[str, tuple[float, ...]], parts: tuple) -> None:
    with refused(UserError, *parts):
        Mounting(**values)
