"""Directions, positions and heights on a spherical earth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import make_aperture

from sal_height.geometry.earth import EARTH_RADIUS, above_place, height_of, sphere_coordinates, sphere_point
from sal_height.geometry.frames import angles_of, look_direction, shift_along, squint_on_cone
from sal_height.geometry.grid import Grid
from sal_height.geometry.trajectory import locate_at_elevation

SIDES = pytest.mark.parametrize("side", [1, -1], ids=["right", "left"])
ATTITUDES = pytest.mark.parametrize(
    "angles", [(0.0, 0.0, 0.0), (0.2, 0.0, 0.0), (0.0, 0.15, 0.0), (0.0, 0.0, -0.3), (0.11, -0.07, 0.23)]
)
PLATFORM_HEIGHT = 3535.534


@SIDES
def test_look_direction_follows_rep_103(side: int) -> None:
    """Forward is x, left is y, up is z; elevation grows from nadir to the look side, squint to the front."""
    np.testing.assert_allclose(look_direction(0.0, 0.0, side), [0, 0, -1], atol=1e-15)
    np.testing.assert_allclose(look_direction(np.pi / 2, 0.0, side), [0, -side, 0], atol=1e-15)
    np.testing.assert_allclose(look_direction(0.3, np.pi / 2, side), [1, 0, 0], atol=1e-15)
    half, third = np.sqrt(0.5), np.sqrt(3) / 2
    np.testing.assert_allclose(
        look_direction(np.pi / 4, np.pi / 6, side), [0.5, -side * third * half, -third * half], atol=1e-15
    )


@SIDES
@ATTITUDES
def test_angles_direction_cone_and_position_agree(side: int, angles: tuple[float, float, float]) -> None:
    aperture = make_aperture(angles=angles, velocity=(48.0, 3.0, -1.0))
    rng = np.random.default_rng(1)
    elevation, squint = rng.uniform(0.2, 1.3, 50), rng.uniform(-0.2, 0.2, 50)
    slant_range = rng.uniform(1e3, 4e4, 50)
    sight = slant_range[:, None] * (look_direction(elevation, squint, side) @ aperture.rotation.T)
    points = aperture.position + sight

    seen_range, seen_elevation, seen_squint = angles_of(points, aperture, side)
    np.testing.assert_allclose(seen_range, slant_range, rtol=1e-14)
    np.testing.assert_allclose(seen_elevation, elevation, atol=1e-13)
    np.testing.assert_allclose(seen_squint, squint, atol=1e-13)

    along = sight @ aperture.direction
    np.testing.assert_allclose(squint_on_cone(elevation, along / slant_range, aperture, side), squint, atol=1e-13)
    np.testing.assert_allclose(locate_at_elevation(elevation, slant_range, along, aperture, side), points, atol=1e-8)


def test_squint_on_the_cone_of_level_flight_is_its_arcsine() -> None:
    assert squint_on_cone(0.7, 0.3, make_aperture(), 1) == pytest.approx(np.arcsin(0.3), abs=1e-15)


def test_direction_of_flight_is_a_unit_vector() -> None:
    np.testing.assert_allclose(make_aperture(velocity=(3.0, 0.0, -4.0)).direction, [0.6, 0.0, -0.8], atol=1e-15)


@SIDES
def test_earth_curvature_lifts_the_point_at_5_km_by_98_cm(side: int) -> None:
    point = locate_at_elevation(np.pi / 4, 5000.0, 0.0, make_aperture(PLATFORM_HEIGHT), side)
    np.testing.assert_allclose(point, [0.0, -side * 5000 * np.sqrt(0.5), 9.41e-5], atol=5e-8)
    assert height_of(point) == pytest.approx(0.98110, abs=5e-6)  # five digits are given


@pytest.mark.parametrize("elevation", [0.1, 0.5, np.pi / 4, 1.2])
@pytest.mark.parametrize("slant_range", [5e3, 35e3])
def test_height_follows_the_law_of_cosines(elevation: float, slant_range: float) -> None:
    """r^2 = (R + H)^2 + rho^2 - 2 (R + H) rho cos(theta) and dh/dtheta = (R + H) rho sin(theta) / r."""
    aperture = make_aperture(PLATFORM_HEIGHT)
    centre_distance = EARTH_RADIUS + PLATFORM_HEIGHT
    radius = np.sqrt(centre_distance**2 + slant_range**2 - 2 * centre_distance * slant_range * np.cos(elevation))
    heights = height_of(locate_at_elevation(elevation + np.array([-1e-5, 0, 1e-5]), slant_range, 0.0, aperture, 1))
    assert heights[1] == pytest.approx(radius - EARTH_RADIUS, abs=1e-8)
    slope = centre_distance * slant_range * np.sin(elevation) / radius
    assert (heights[2] - heights[0]) / 2e-5 == pytest.approx(slope, rel=1e-8)


def test_point_on_the_sphere_lies_at_its_arc_distance() -> None:
    arc, height = 40e3, 700.0
    angle, radius = arc / EARTH_RADIUS, EARTH_RADIUS + height
    level, up = radius * np.sin(angle), radius * np.cos(angle) - EARTH_RADIUS
    np.testing.assert_allclose(sphere_point(arc, 0.0, height), [level, 0, up], atol=1e-8)
    np.testing.assert_allclose(sphere_point(-0.6 * arc, 0.8 * arc, height), [-0.6 * level, 0.8 * level, up], atol=1e-8)


def test_sphere_coordinates_undo_sphere_point() -> None:
    rng = np.random.default_rng(2)
    east, north = rng.uniform(-50e3, 50e3, (2, 100))
    height = rng.uniform(-100, 5000, 100)
    east[0] = north[0] = 0.0
    back = sphere_coordinates(sphere_point(east, north, height))
    np.testing.assert_allclose(back, [east, north, height], atol=1e-8)


def test_plumb_undoes_height_of_to_the_last_digit() -> None:
    """And there is nothing beyond the horizon."""
    rng = np.random.default_rng(6)
    points = sphere_point(*rng.uniform(-2e5, 2e5, (2, 100)), rng.uniform(-100, 9000, 100))
    height = height_of(points)
    np.testing.assert_allclose(above_place(points[:, 0], points[:, 1], height), points, rtol=0, atol=1e-11)
    assert np.isnan(above_place(EARTH_RADIUS, EARTH_RADIUS, 0.0)[2])


def test_height_does_not_suffer_from_the_size_of_the_earth() -> None:
    """The difference of two radii of 6e6 m would be good to 1e-9 m only."""
    point = np.array([3.0, -4.0, 1e-3])
    assert height_of(point) == pytest.approx(1e-3 + 25 / (2 * (EARTH_RADIUS + 1e-3)), abs=1e-15)


def test_pixels_of_a_grid() -> None:
    grid = Grid(np.array([1.0, 2, 3]), np.array([0.0, -1, 0]), np.array([1.0, 0, 0]), 0.5, 0.25, 3, 4)
    pixels = grid.pixels()
    assert pixels.shape == (*grid.shape, 3) == (3, 4, 3)
    np.testing.assert_allclose(pixels[2, 3], [1.75, 1.0, 3.0], atol=1e-15)
    np.testing.assert_allclose(grid.points(2, 3), pixels[2, 3], atol=1e-15)
    np.testing.assert_allclose(grid.points(0.5, [0, 1.5]), [[1, 1.75, 3], [1.375, 1.75, 3]], atol=1e-15)


@SIDES
@ATTITUDES
@pytest.mark.parametrize("velocity", [(48.0, 3.0, -1.0), (-50.0, 0.0, -5.0), (0.0, 50.0, 4.0)])
def test_a_surface_farther_along_the_flight_keeps_its_range_and_elevation(
    side: int, angles: tuple[float, float, float], velocity: tuple[float, float, float]
) -> None:
    """By finite differences, to 1e-6: of an aircraft that sinks, climbs or drifts it does not move along its course."""
    course = np.arctan2(velocity[1], velocity[0])
    aperture = make_aperture(angles=(angles[0], angles[1], angles[2] + course), velocity=velocity)
    elevation, slant_range = 0.8, 5000.0
    along = slant_range * float(aperture.rotation @ look_direction(elevation, 0.0, side) @ aperture.direction)
    before, here, after = (
        locate_at_elevation(elevation, slant_range, along + step, aperture, side) for step in (-0.5, 0.0, 0.5)
    )
    shift = shift_along(aperture, (here - aperture.position) / slant_range)
    np.testing.assert_allclose(after - before, shift, atol=1e-6)
    np.testing.assert_allclose(
        shift_along(replace(aperture, sliding=True), np.array([0.0, 0.6, -0.8])), aperture.direction
    )
