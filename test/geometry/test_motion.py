"""Uncertainty in gaps of the odometry against simulated motion, and single rotations against those of scipy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from sal_height.geometry import (
    ASSUMED_ACCELERATION,
    ASSUMED_TURNING,
    NOT_STATED,
    Motion,
    Mounting,
    PlatformState,
    Trajectory,
)
from sal_height.geometry.motion import attitude_between, quaternion_of, rotation_matrix
from sal_height.geometry.trajectory import shown_acceleration

TRIALS, STEPS = 4000, 400


def bent_away(share: float, gap_s: float, rng: np.random.Generator) -> tuple[float, float, float]:
    """Variances of what lies between the true path and the one through its ends, at that part of a gap.

    The path follows from white acceleration of 1 unit/sqrt(Hz) by two sums. First of all four of position and velocity
    at both ends are known, then position alone; the third is that of the velocity with all four known.
    """
    step = gap_s / STEPS
    acceleration = rng.standard_normal((TRIALS, STEPS)) / np.sqrt(step)
    velocity = np.concatenate([np.zeros((TRIALS, 1)), np.cumsum(acceleration, axis=1) * step], axis=1)
    middle = (velocity[:, 1:] + velocity[:, :-1]) / 2
    path = np.concatenate([np.zeros((TRIALS, 1)), np.cumsum(middle, axis=1) * step], axis=1)
    at, end, speed = path[:, round(share * STEPS)], path[:, -1], velocity[:, -1]
    cubic = end * (3 * share**2 - 2 * share**3) + speed * gap_s * (share**3 - share**2)
    slope = 6 * end * (share - share**2) / gap_s + speed * (3 * share**2 - 2 * share)
    off = velocity[:, round(share * STEPS)] - slope
    return float(np.var(at - cubic)), float(np.var(at - share * end)), float(np.var(off))


@pytest.mark.parametrize("share", [0.25, 0.5, 0.9])
@pytest.mark.parametrize("gap_s", [0.1, 2.0])
def test_the_covariance_is_that_of_random_accelerations(share: float, gap_s: float) -> None:
    """The standard error of a variance from 4000 trials is 2.2 %, and steps of a 400th take up to 1 % off it."""
    clamped, supported, slope = bent_away(share, gap_s, np.random.default_rng(round(100 * share + gap_s)))
    motion = Motion(acceleration=0.3, turning=0.02, interval_s=0.0)
    variances = motion.variances(share * gap_s, (1 - share) * gap_s)
    expected = np.repeat([0.09 * clamped, 0.0004 * supported, 0.09 * slope], 3)
    np.testing.assert_allclose(variances, expected, rtol=0.09)


def test_what_is_no_gap_leaves_nothing_open() -> None:
    motion = Motion(acceleration=0.3, turning=0.02, interval_s=0.05)
    assert not motion.variances(0.02, 0.03).any()
    assert motion.variances(0.02, 0.0301).all()
    assert not motion.variances(0.0, 1.0).any()  # at a sample


def test_what_is_not_known_of_the_motion_leaves_nothing_open_until_it_is_assumed() -> None:
    unknown = Motion(NOT_STATED, NOT_STATED, 0.05)
    assert not unknown.variances(0.1, 0.1).any()
    assert unknown.with_assumed == Motion(ASSUMED_ACCELERATION, ASSUMED_TURNING, 0.05)
    assert Motion(0.3, NOT_STATED, 0.05).with_assumed == Motion(0.3, ASSUMED_TURNING, 0.05)


def state(seconds: float) -> PlatformState:
    covariance = np.diag([1e-4] * 3 + [1e-8] * 3)
    return PlatformState(
        round(seconds * 1e9),
        np.array([50 * seconds, 0, 900]),
        np.array([0, 0, 0, 1.0]),
        np.array([50.0, 0, 0]),
        covariance,
    )


@pytest.mark.parametrize("arm", [(0.0, 0.0, 0.0), (0.0, 0.0, -2.0)])
def test_the_aperture_in_a_gap_has_the_covariance_of_the_samples_and_of_the_gap(
    arm: tuple[float, float, float],
) -> None:
    """An error of the roll moves an antenna that is 2 m below by so much sideways."""
    states = [state(seconds) for seconds in (0.0, 0.1, 0.5, 0.6)]
    motion = Motion(acceleration=0.3, turning=0.02, interval_s=0.15)
    track = Trajectory(states, motion=motion).mounted(Mounting(lever_arm=arm))
    pulses = np.array([-0.01, 0.01])
    outside, inside = track.aperture(50_000_000, pulses).covariance, track.aperture(300_000_000, pulses).covariance
    grown = motion.variances(0.2, 0.2)
    roll, sideways = 1e-8 + grown[3], 1e-4 + grown[1]
    assert outside[1, 1] == pytest.approx(1e-4 + 1e-8 * arm[2] ** 2)
    assert inside[1, 1] == pytest.approx(sideways + roll * arm[2] ** 2)
    assert inside[3, 3] == pytest.approx(roll)
    assert track.between(200_000_000, 400_000_000).motion == motion
    assert track.followed_by(Trajectory(states[2:])).motion == motion


def test_the_velocity_in_a_gap_has_the_covariance_of_the_samples_and_of_the_gap() -> None:
    motion = Motion(acceleration=0.3, turning=0.02, interval_s=0.15)
    states = [replace(state(t), velocity_covariance=1e-6 * np.eye(3)) for t in (0.0, 0.1, 0.5, 0.6)]
    track, pulses = Trajectory(states, motion=motion), np.array([-0.01, 0.01])
    np.testing.assert_allclose(track.velocity_covariance(50_000_000, pulses), 1e-6 * np.eye(3))
    grown = motion.variances(0.2, 0.2)[8]
    np.testing.assert_allclose(track.velocity_covariance(300_000_000, pulses), (1e-6 + grown) * np.eye(3))


def test_samples_show_random_accelerations() -> None:
    """Of the sum of the three components, so that the square is three times that of each of them."""
    rng, gap_s, density = np.random.default_rng(7), 0.2, 0.3
    step = gap_s / STEPS
    found = []
    for _ in range(TRIALS // 4):
        acceleration = density * rng.standard_normal((STEPS, 3)) / np.sqrt(step)
        velocity = np.concatenate([np.zeros((1, 3)), np.cumsum(acceleration, axis=0) * step])
        moved = ((velocity[1:] + velocity[:-1]) / 2 * step).sum(axis=0)
        straight = state(gap_s)
        after = replace(straight, position=straight.position + moved, velocity=straight.velocity + velocity[-1])
        found.append(shown_acceleration(state(0.0), after) ** 2)
    assert np.mean(found) == pytest.approx(3 * density**2, rel=0.1)  # standard error 2.6 %
    assert shown_acceleration(state(0.0), state(gap_s)) < 1e-9


def test_the_motion_that_samples_show_counts_as_stated_and_the_rest_of_what_is_assumed_is_apart() -> None:
    """A straight track shows none; one whose positions are off shows more than is assumed of the acceleration."""
    motion, pulses = Motion(NOT_STATED, NOT_STATED, 0.05), np.array([-0.01, 0.01])
    straight = Trajectory([state(0.0), state(0.2)], motion=motion)
    assumed = motion.with_assumed.variances(0.1, 0.1)
    np.testing.assert_allclose(straight.assumed(100_000_000, pulses).in_gaps, assumed, rtol=0.03)
    np.testing.assert_allclose(straight.aperture(100_000_000, pulses).covariance, state(0.0).covariance)
    assert straight.assumed(100_000_000, pulses).gap_s == pytest.approx(0.2)
    off = replace(state(0.2), position=state(0.2).position + np.array([0.0, 0.02, 0.0]))
    shaken = Trajectory([state(0.0), off], motion=motion)
    shown = replace(motion, acceleration=shown_acceleration(state(0.0), off)).variances(0.1, 0.1)
    assert shown[0] > assumed[0]
    np.testing.assert_allclose(shaken.velocity_covariance(100_000_000, pulses), np.diag(shown[6:]))
    left = np.concatenate([np.zeros(3), assumed[3:6], np.zeros(3)])
    np.testing.assert_allclose(shaken.assumed(100_000_000, pulses).in_gaps, left)
    stated = Trajectory([state(0.0), off], motion=Motion(0.0, 0.0, 0.05))
    assert not stated.velocity_covariance(100_000_000, pulses).any()
    assert not stated.assumed(100_000_000, pulses).in_gaps.any()


def test_matrices_are_those_of_scipy_whatever_the_norm() -> None:
    for quaternion in np.random.default_rng(131).standard_normal((100, 4)):
        expected = Rotation.from_quat(quaternion).as_matrix()
        np.testing.assert_allclose(rotation_matrix(quaternion), expected, atol=1e-15)


def test_quaternions_are_those_of_scipy_whichever_component_is_greatest() -> None:
    for rotation in Rotation.from_quat(np.random.default_rng(133).standard_normal((100, 4))):
        matrix = rotation.as_matrix()
        np.testing.assert_allclose(quaternion_of(matrix), Rotation.from_matrix(matrix).as_quat(), atol=1e-14)
    for half_turn in np.diag([2.0, 2.0, 2.0]):
        np.testing.assert_allclose(quaternion_of(np.diag(half_turn - 1)), [*half_turn / 2, 0.0], atol=1e-15)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-9, 1e-6, 0.1, 3.0])
def test_attitudes_between_two_are_those_of_scipy(angle: float) -> None:
    """On the shorter arc, whichever of the two signs that stand for one rotation a quaternion has."""
    rng = np.random.default_rng(132)
    first = Rotation.from_quat(rng.standard_normal(4))
    axis = rng.standard_normal(3)
    second = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)) * first
    for share in (0.0, 0.3, 1.0):
        expected = Slerp([0, 1], Rotation.concatenate([first, second]))(share).as_matrix()
        for sign in (1, -1):
            found = rotation_matrix(attitude_between(1.01 * first.as_quat(), sign * second.as_quat(), share))
            np.testing.assert_allclose(found, expected, atol=3e-15)
