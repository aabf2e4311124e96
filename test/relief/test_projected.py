"""Heights of a dwell in the axes of a projection: places exact, errors turned as the ground is."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers import make_aperture
from scipy.spatial.transform import Rotation

from sal_height.geometry import ApertureState, Grid, Origin, Projection, sphere_coordinates, sphere_point
from sal_height.relief import HeightField, ProjectedAxes, ReliefMap, Surface

ORIGIN = Origin(math.radians(48.1), math.radians(11.3), 560.0)
AXES = ProjectedAxes.around(Projection.of("utm", ORIGIN))
SHAPE = (30, 20)


def seen_from(east: float, north: float) -> ApertureState:
    """A platform 3 km above a place and 3 km south of it."""
    return replace(make_aperture(), position=np.array([east, north - 3000.0, 3000.0]))


def field_at(east: float, north: float, height: float) -> HeightField:
    """Pixels 1 m apart on ground of one height above the sphere, around a place; errors 3 m east, 1 m north, 2 m up."""
    easts, norths = np.meshgrid(east + np.arange(SHAPE[1]), north + np.arange(SHAPE[0]))
    positions = sphere_point(easts, norths, height)
    own, level = np.broadcast_to(np.diag([9.0, 1.0, 4.0]), (*SHAPE, 3, 3)).copy(), np.full(SHAPE, height)
    surface = Surface(level, np.full(SHAPE, 2.0), np.full(SHAPE, 20.0), positions, np.zeros(SHAPE), own, own / 4)
    grid = Grid(positions[0, 0], np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0]), 1.0, 1.0, *SHAPE)
    return HeightField(grid, np.zeros(SHAPE, np.uint8), (surface,))


@pytest.mark.parametrize("place", [(100.0, -200.0), (9_000.0, 4_000.0), (-30_000.0, 15_000.0)])
def test_pixels_are_where_the_projection_has_them(place: tuple[float, float]) -> None:
    """On the sphere of the map the height would be wrong by 0.3 m at 33 km."""
    field = field_at(*place, 100.0)
    expected = AXES.projection.coordinates(field.surfaces[0].positions)
    placed, _ = AXES.field(field, seen_from(*place))
    found = np.stack(sphere_coordinates(placed.surfaces[0].positions), axis=-1)
    np.testing.assert_allclose(found + np.append(AXES.false_origin, 0.0), expected, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(placed.surfaces[0].height, found[..., 2])


def test_axes_turn_by_the_convergence_of_the_meridian() -> None:
    """East of the origin at longitude 11.3, zone 32: convergence is (longitude - 9 degrees) sin(latitude)."""
    for east, north in ((0.0, 0.0), (20_000.0, -10_000.0)):
        here = sphere_point(east, north, 0.0)
        latitude, longitude, _ = ORIGIN.to_geodetic(here)
        turn = AXES.turn(here)
        eastward = turn @ ORIGIN.turn_at(here) @ [1.0, 0.0, 0.0]
        up = sphere_point(*sphere_coordinates(AXES.positions(here))[:2], 1.0) - sphere_point(
            *sphere_coordinates(AXES.positions(here))[:2], 0.0
        )
        convergence = (longitude - math.radians(9.0)) * math.sin(latitude)
        assert math.atan2(eastward[1], eastward[0]) == pytest.approx(convergence, rel=2e-3)
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), rtol=0, atol=1e-12)
        np.testing.assert_allclose(turn @ ORIGIN.turn_at(here) @ [0, 0, 1], up, rtol=0, atol=1e-5)


@pytest.mark.parametrize("place", [(0.0, 0.0), (30_000.0, -20_000.0)])
def test_the_turn_hardly_changes_over_a_dwell(place: tuple[float, float]) -> None:
    """By less than 30 urad over 5 km, as errors and directions of a dwell are turned as one."""
    here = AXES.turn(sphere_point(*place, 0.0))
    for step in ((5_000.0, 0.0), (0.0, 5_000.0)):
        there = AXES.turn(sphere_point(place[0] + step[0], place[1] + step[1], 0.0))
        assert np.linalg.norm(Rotation.from_matrix(here.T @ there).as_rotvec()) < 3e-5


def test_errors_and_the_aperture_turn_with_the_ground() -> None:
    field = field_at(20_000.0, -10_000.0, 100.0)
    aperture = seen_from(20_000.0, -10_000.0)
    placed, seen = AXES.field(field, aperture)
    turn = AXES.turn(field.grid.points((SHAPE[0] - 1) / 2, (SHAPE[1] - 1) / 2))
    before, after = field.surfaces[0], placed.surfaces[0]
    np.testing.assert_allclose(after.own_covariance[3, 4], turn @ before.own_covariance[3, 4] @ turn.T, atol=1e-12)
    assert after.common_covariance is not None
    np.testing.assert_allclose(np.trace(after.common_covariance, axis1=-2, axis2=-1), 14.0 / 4, rtol=1e-12)
    np.testing.assert_allclose(seen.velocity, turn @ aperture.velocity, atol=1e-12)
    distances = [np.linalg.norm(a.positions[3, 4] - s.position) for a, s in ((before, aperture), (after, seen))]
    assert distances[0] == pytest.approx(distances[1], rel=1e-3), "the scale of UTM is 0.9996 to 1.001"


def test_a_map_made_in_the_axes_is_one_in_the_projection() -> None:
    """Cells have their edges at multiples of the cell size in eastings and northings, and the exact heights there."""
    relief_map = ReliefMap(2.0, 10_000)
    for east in (0.0, 8.0):
        field, _ = AXES.field(field_at(east, 50.0, 100.0), seen_from(east, 50.0))
        relief_map.add(field)
    relief = relief_map.relief()
    assert relief is not None
    placed = AXES.relief(relief)
    assert (placed.east - 1.0) % 2.0 == 0
    assert (placed.north - 1.0) % 2.0 == 0
    row, col = (int(index) for index in np.argwhere(np.isfinite(placed.height))[40])
    place = np.array([placed.east + 2.0 * col, placed.north + 2.0 * row, 0.0])
    east, north, _ = sphere_coordinates(AXES.projection.positions(place))
    expected = AXES.projection.coordinates(sphere_point(east, north, 100.0))[2]
    assert placed.height[row, col] == pytest.approx(expected, abs=1e-4), "float32 has 8 um of 100 m"
