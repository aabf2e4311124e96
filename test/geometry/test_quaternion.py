"""Single rotations against those of scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from sal_height.geometry.motion import attitude_between, quaternion_of, rotation_matrix


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
