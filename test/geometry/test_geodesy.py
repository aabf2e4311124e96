"""Positions on the ellipsoid, the axes there, and axes of aviation that become those of ROS."""

from __future__ import annotations

import numpy as np
import pytest
from pyproj import Geod, Transformer
from scipy.spatial.transform import Rotation

from sal_height.geometry import BODY_AXES, MAP_AXES, Axes, Mounting, Origin, PlatformState, rotation_matrix
from sal_height.geometry.geodesy import local_axes
from sal_height.numeric import F64

PLACES_DEG = [(0.0, 0.0, 0.0), (48.1, 11.3, 600.0), (-33.9, 151.2, 12_000.0), (89.9, -170.0, -50.0)]
TO_SPACE = Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
"""Longitude, latitude and height to earth-centred, earth-fixed coordinates."""


def in_space(latitude: float, longitude: float, height: float) -> F64:
    """Earth-centred, earth-fixed coordinates (m) of a place in rad."""
    return np.array(TO_SPACE.transform(longitude, latitude, height, radians=True))


@pytest.mark.parametrize("place", PLACES_DEG)
def test_map_coordinates_are_components_along_the_axes_at_the_origin(place: tuple[float, float, float]) -> None:
    """By vectors in space (EPSG method 9837), up to 200 km away; 10 nm are what float64 has of 6400 km.

    Back it is 2 um: PROJ takes one step of Bowring's formula.
    """
    rng = np.random.default_rng(3)
    here = np.radians(place[0]), np.radians(place[1]), place[2]
    origin = Origin(*here)
    others = here + rng.uniform(-0.02, 0.02, (50, 3)) * [1, 1, 1e5]
    others[:, 0] = np.clip(others[:, 0], -np.pi / 2, np.pi / 2)
    expected = [local_axes(*here[:2]) @ (in_space(*other) - in_space(*here)) for other in others]
    positions = origin.to_map(*others.T)
    np.testing.assert_allclose(positions, expected, rtol=0, atol=2e-8)
    latitude, longitude, height = origin.to_geodetic(positions)
    np.testing.assert_allclose(in_space(latitude, longitude, height), in_space(*others.T), rtol=0, atol=5e-6)


@pytest.mark.parametrize("place", PLACES_DEG[:3])
def test_axes_are_the_directions_in_which_coordinates_grow(place: tuple[float, float, float]) -> None:
    """North along the meridian and east along the parallel, by geodesics of 1 m; up along the normal."""
    latitude, longitude = np.radians(place[:2])
    origin, geodesic = Origin(latitude, longitude, 0.0), Geod(ellps="WGS84")
    np.testing.assert_allclose(origin.to_map(latitude, longitude, 1.0), [0, 0, 1], atol=1e-8)
    for azimuth, axis in ((90.0, [1, 0, 0]), (0.0, [0, 1, 0])):
        there_longitude, there_latitude, _ = geodesic.fwd(place[1], place[0], azimuth, 1.0)
        there = origin.to_map(np.radians(there_latitude), np.radians(there_longitude), 0.0)
        np.testing.assert_allclose(there, axis, atol=1e-6)


@pytest.mark.parametrize("place", [(0.84, 0.2, 400.0), (0.842, 0.21, 8000.0), (0.83, 0.15, 12_000.0)])
def test_local_axes_at_a_place_in_map_are_those_of_its_coordinates(place: tuple[float, float, float]) -> None:
    """Up to 400 km from the origin, where up differs by 70 mrad, to 1e-10 rad; 1e-6 rad are 3.5 mm of height."""
    origin = Origin(0.84, 0.2, 400.0)
    turn = origin.turn_at(origin.to_map(*place))
    expected = local_axes(0.84, 0.2) @ local_axes(*place[:2]).T
    np.testing.assert_allclose(turn, expected, rtol=0, atol=1e-10)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), rtol=0, atol=1e-14)


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
