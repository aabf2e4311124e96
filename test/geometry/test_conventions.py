"""Axes of aviation become those of ROS."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sal_height.geometry import BODY_AXES, MAP_AXES, Axes, Mounting, PlatformState, rotation_matrix

IN_SPACE = {"enu": ("east", "north", "up"), "ned": ("north", "east", "down")}
ON_BOARD = {"flu": ("forward", "left", "up"), "frd": ("forward", "right", "down")}
OPPOSITE = {"down": "up", "right": "left"}


@pytest.mark.parametrize(("names", "matrices"), [(IN_SPACE, MAP_AXES), (ON_BOARD, BODY_AXES)], ids=["map", "body"])
def test_each_axis_points_where_its_name_says(
    names: dict[str, tuple[str, ...]], matrices: dict[str, np.ndarray]
) -> None:
    assert names.keys() == matrices.keys()
    usual = next(iter(names.values()))
    for name, axes in names.items():
        for vector, word in zip(np.eye(3), axes, strict=True):
            along = usual.index(OPPOSITE.get(word, word))
            expected = np.eye(3)[along] * (-1 if word in OPPOSITE else 1)
            np.testing.assert_array_equal(matrices[name] @ vector, expected)
        assert np.linalg.det(matrices[name]) == pytest.approx(1)


def test_a_state_in_axes_of_aviation_is_the_same_in_those_of_ros() -> None:
    """Heading 30 degrees (from north over east), pitch 10 up, roll 5 to the right: by aviation's own angles.

    In ROS yaw is from east over north, pitch is positive downwards.
    """
    yaw, pitch, roll = 30.0, 10.0, 5.0
    aviation = Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True)
    ros = Rotation.from_euler("ZYX", [90 - yaw, -pitch, roll], degrees=True)
    variances = np.arange(1.0, 7.0)
    given = PlatformState(
        5,
        np.array([10.0, 20.0, -30.0]),
        aviation.as_quat(),
        np.array([1.0, 2.0, -3.0]),
        np.diag(variances),
        np.array([[4.0, 1.0, 2.0], [1.0, 5.0, 3.0], [2.0, 3.0, 6.0]]),
    )
    state = Axes("ned", "frd").state(given)
    assert state.stamp_ns == 5
    np.testing.assert_array_equal(state.position, [20.0, 10.0, 30.0])
    np.testing.assert_array_equal(state.velocity, [2.0, 1.0, 3.0])
    np.testing.assert_allclose(rotation_matrix(state.orientation), ros.as_matrix(), rtol=0, atol=1e-15)
    np.testing.assert_array_equal(np.diag(state.covariance), variances[[1, 0, 2, 4, 3, 5]])
    forward_left_up = [[4.0, -1.0, -2.0], [-1.0, 5.0, 3.0], [-2.0, 3.0, 6.0]]
    np.testing.assert_array_equal(state.velocity_covariance, forward_left_up)
    assert Axes().state(given) is given


def test_a_mounting_in_axes_of_aviation_is_the_same_in_those_of_ros() -> None:
    """2 m ahead, 1 m to the right, 0.5 m below, turned to the right by 40 degrees."""
    turned = tuple(Rotation.from_euler("z", 40, degrees=True).as_quat().tolist())
    mounting = Axes(body="frd").mounting(Mounting("radar", (2.0, 1.0, 0.5), turned))
    assert mounting.frame_id == "radar"
    assert mounting.lever_arm == (2.0, -1.0, -0.5)
    np.testing.assert_allclose(mounting.axes.as_rotvec(degrees=True), [0, 0, -40], rtol=0, atol=1e-12)
    assert Axes(map="ned").mounting(mounting) is mounting
