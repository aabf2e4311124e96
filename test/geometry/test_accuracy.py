"""Blocks of the odometry's covariances that state nothing, and what is missing in them."""

from __future__ import annotations

import numpy as np
import pytest

from sal_height.geometry.accuracy import (
    ASSUMED,
    EXACT,
    OdometryAccuracy,
    is_finite_covariance,
    known_pose,
    known_velocity,
    shortfall,
)
from sal_height.numeric import F64

WANTED = OdometryAccuracy(position_m=3.0, velocity_mps=0.2, attitude_rad=0.004, heading_rad=0.02).stated
STATED = np.diag([0.02, 0.03, 0.05, 1e-4, 2e-4, 5e-4]) ** 2
SPEEDS = np.diag([0.01, 0.02, 0.03]) ** 2


def with_block(pose: F64, first: int, block: F64) -> F64:
    changed = pose.copy()
    changed[first : first + 3, first : first + 3] = block
    return changed


def test_nothing_is_missing_in_what_is_stated() -> None:
    """Also where it is correlated, or all axes have the same number of a survey-grade navigation."""
    turned = STATED.copy()
    turned[0, 4] = turned[4, 0] = 1e-7
    alike = np.diag([0.05] * 3 + [4e-5] * 3) ** 2
    for pose in (STATED, turned, alike):
        assert not shortfall(pose, 0.005**2 * np.eye(3), WANTED).any()


@pytest.mark.parametrize(
    "block",
    [
        np.zeros((3, 3)),
        np.diag([-1.0, 0.0, 0.0]),
        -np.eye(3),
        np.diag([np.nan, 1.0, 1.0]),
        1e-12 * np.eye(3),
        99_999.0 * np.eye(3),
        np.array([[1e-4, 1.0, 0.0], [1.0, 1e-4, 0.0], [0.0, 0.0, 1e-4]]),
    ],
    ids=["zeros", "-1 first", "-1", "NaN", "tiny", "huge", "no covariance"],
)
def test_each_block_is_unknown_alone(block: F64) -> None:
    missing = np.sqrt(shortfall(with_block(STATED, 0, block), SPEEDS, WANTED))
    np.testing.assert_allclose(missing, [3.0, 3.0, 3.0, *[0.0] * 6], rtol=1e-9)
    missing = np.sqrt(shortfall(with_block(STATED, 3, block), SPEEDS, WANTED))
    np.testing.assert_allclose(missing, [0.0, 0.0, 0.0, 0.004, 0.004, 0.02, 0.0, 0.0, 0.0], rtol=1e-6)
    missing = np.sqrt(shortfall(STATED, block, WANTED))
    np.testing.assert_allclose(missing, [*[0.0] * 6, 0.2, 0.2, 0.2], rtol=1e-6)


def test_what_is_stated_in_an_unknown_block_counts_as_far_as_it_goes() -> None:
    """A heading that is known less well than was assumed, beside a roll and pitch of zero."""
    pose = np.diag([0.02, 0.03, 0.05, 0.0, 0.0, 0.015]) ** 2
    expected = [0.0, 0.0, 0.0, 0.004, 0.004, np.sqrt(0.02**2 - 0.015**2), 0.0, 0.0, 0.0]
    np.testing.assert_allclose(np.sqrt(shortfall(pose, SPEEDS, WANTED)), expected)
    wrong = np.diag([0.02, 0.03, 0.05, 0.0, 0.0, 0.025]) ** 2
    assert np.flatnonzero(shortfall(wrong, SPEEDS, WANTED)).tolist() == [3, 4]


def test_accuracy_is_stated_assumed_or_exact() -> None:
    some = OdometryAccuracy(position_m=0.0, heading_rad=0.03)
    assert some.stated.tolist() == [0.0] * 5 + [0.03] + [0.0] * 3
    assert some.assumed.tolist() == [0.0] * 3 + [2e-3] * 2 + [0.0] + [0.05] * 3
    assert some.with_assumed == OdometryAccuracy(0.0, 0.05, 2e-3, 0.03)
    assert OdometryAccuracy().with_assumed == ASSUMED
    assert not EXACT.stated.any()
    assert not EXACT.assumed.any()


@pytest.mark.parametrize("wrong", [-1.0, -1e-6, np.nan, np.inf])
def test_what_is_no_covariance_is_left_out_and_the_rest_stays(wrong: float) -> None:
    """A negative variance of one axis of the position: zeros for all of it, and what is stated of the attitude."""
    stated = np.diag([1e-4, wrong, 1e-4, 4e-8, 4e-8, 4e-8])
    assert not is_finite_covariance(stated)
    np.testing.assert_array_equal(known_pose(stated), np.diag([0.0] * 3 + [4e-8] * 3))
    np.testing.assert_array_equal(known_velocity(stated[:3, :3]), np.zeros((3, 3)))
    whole = np.diag([1e-4, 1e-4, 0.0, 4e-8, 4e-8, 4e-8])
    np.testing.assert_array_equal(known_pose(whole), whole)


def test_one_huge_number_in_all_axes_is_left_out() -> None:
    np.testing.assert_array_equal(known_pose(with_block(STATED, 0, 1e10 * np.eye(3))), with_block(STATED, 0, 0.0))
    assert not known_velocity(1e6 * np.eye(3)).any()


def test_covariances_beyond_all_bounds_count_as_nothing_known() -> None:
    """What is correlated stays so: 1e30 of two axes, correlated by a half, and a third that is known."""
    stated = np.array([[1e30, 5e29, 1e13], [5e29, 1e30, 0.0], [1e13, 0.0, 1e-2]])
    np.testing.assert_allclose(known_velocity(stated), [[1e6, 5e5, 1e1], [5e5, 1e6, 0.0], [1e1, 0.0, 1e-2]])
