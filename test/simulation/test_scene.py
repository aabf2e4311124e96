"""What an aperture sees of the ground: power, shadow, layover."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import flat_scene, make_aperture, refused

from sal_height.errors import UserError
from sal_height.geometry.earth import EARTH_RADIUS, height_of, sphere_coordinates, sphere_point
from sal_height.geometry.frames import angles_of
from sal_height.simulation.scene import LAYERS, PointScatterer, Scene, VisibleSurface, visible_surface

PLATFORM_HEIGHT = 5000 * np.sqrt(0.5)
DISTANCE = PLATFORM_HEIGHT  # on the ground, seen at 45 degrees
CELL = (0.1, 0.05)
EAST = (-5.0, 5.0)
WALL = 3.0  # m
THICKNESS = 1.0

WAYS = pytest.mark.parametrize(
    ("side", "speed", "outwards"),
    [(1, 50.0, -1), (-1, 50.0, 1), (1, -50.0, 1), (-1, -50.0, -1)],
    ids=["right, east", "left, east", "right, west", "left, west"],
)


def profile_scene(heights: np.ndarray, distances: np.ndarray, outwards: int, *points: PointScatterer) -> Scene:
    """Ground that varies across the flight only; `distances` grow away from the platform."""
    height = np.repeat(heights[::outwards, None], 2, axis=1)
    return Scene(
        "profile", np.array([-20.0, 20.0]), outwards * distances[::outwards], height, np.ones_like(height), points
    )


def see(scene: Scene, side: int = 1, speed: float = 50.0) -> tuple[VisibleSurface, np.ndarray]:
    """What the aperture sees, and how far north each scatterer is, counted outwards."""
    angles = (0.0, 0.0, 0.0) if speed > 0 else (0.0, 0.0, np.pi)
    aperture = make_aperture(PLATFORM_HEIGHT, angles=angles, velocity=(speed, 0.0, 0.0))
    surface = visible_surface(scene, aperture, side, CELL, EAST, (4985.0, 5015.0))
    return surface, np.abs(sphere_coordinates(surface.positions)[1])


def wall_scene(outwards: int) -> Scene:
    """A wall of 3 m on level ground, its roof from DISTANCE to DISTANCE + 1 m; the faces are 1 cm wide."""
    distances = DISTANCE + np.array([-25, -0.01, 0, THICKNESS, THICKNESS + 0.01, 25])
    return profile_scene(np.array([0, 0, WALL, WALL, 0, 0]), distances, outwards)


@pytest.mark.parametrize("slope", [0.0, 0.3, -0.3])
def test_ground_of_brightness_one_has_power_one_per_resolution_cell(slope: float) -> None:
    distances = DISTANCE + np.arange(-40, 40.25, 0.5)
    surface, _ = see(profile_scene(slope * (distances - DISTANCE), distances, -1))
    cells = 30.0 / CELL[0] * (EAST[1] - EAST[0]) / CELL[1]
    assert surface.power.sum() == pytest.approx(cells, rel=2e-3)  # one scatterer in 600 more or less at the ends
    per_metre, _ = np.histogram(surface.slant_range, np.arange(4986, 5015), weights=surface.power)
    np.testing.assert_allclose(per_metre, cells / 30, rtol=0.06)  # one scatterer in 20 more or less


def test_terrain_of_few_nodes_is_as_even() -> None:
    """Between nodes 3 km apart range is no linear function of distance."""
    scene, cell = profile_scene(np.zeros(3), DISTANCE + np.array([-3000.0, 0.0, 3000.0]), -1), (CELL[0], 5.0)
    surface = visible_surface(scene, make_aperture(PLATFORM_HEIGHT), 1, cell, EAST, (4985.0, 5015.0))
    per_metre, _ = np.histogram(surface.slant_range, np.arange(4986, 5015), weights=surface.power)
    np.testing.assert_allclose(per_metre, 1 / cell[0] * (EAST[1] - EAST[0]) / cell[1], rtol=0.06)


@pytest.mark.parametrize("slope", [0.0, 0.9], ids=["level", "nearly across the line of sight"])
def test_scatterers_lie_closer_than_half_a_cell(slope: float) -> None:
    """Along the flight, in range, and on the arc of equal range: what lies across it is sampled as densely."""
    distances = DISTANCE + np.arange(-40, 40.25, 0.5)
    surface, _ = see(profile_scene(slope * (distances - DISTANCE), distances, -1))
    assert np.diff(np.unique(np.round(surface.positions[:, 0], 9))).max() < 0.5001 * CELL[1]
    one_strip = np.isclose(surface.positions[:, 0], surface.positions[0, 0])
    for coordinate in (surface.slant_range, 5000 * surface.elevation):
        assert np.diff(np.sort(coordinate[one_strip])).max() < 0.51 * CELL[0]


def test_scatterers_lie_on_the_terrain_and_are_seen_under_their_angles() -> None:
    distances = DISTANCE + np.arange(-40, 40.25, 0.5)
    scene = profile_scene(np.sin(distances / 7), distances, -1)
    surface, _ = see(scene)
    east, north, height = sphere_coordinates(surface.positions)
    np.testing.assert_allclose(surface.heights, scene.heights(east, north), atol=1e-6)
    np.testing.assert_allclose(surface.heights, height, atol=1e-8)
    seen = angles_of(surface.positions, make_aperture(PLATFORM_HEIGHT), 1)
    np.testing.assert_allclose((surface.slant_range, surface.elevation, surface.squint), seen, rtol=1e-14, atol=1e-15)
    assert not surface.deterministic.any()


@WAYS
def test_shadow_of_a_wall_at_45_degrees_is_as_long_as_the_wall_is_high(side: int, speed: float, outwards: int) -> None:
    _, distance = see(wall_scene(outwards), side, speed)
    behind = distance[distance > DISTANCE + THICKNESS + 0.01]
    # Seen over the far edge from a platform of finite height; the sphere falls off under the shadow.
    fall = WALL * DISTANCE / EARTH_RADIUS
    length = (DISTANCE + THICKNESS) * (WALL + fall) / (PLATFORM_HEIGHT - WALL)
    assert length == pytest.approx(WALL, rel=3e-3)
    sampling = 0.5 * CELL[0] * np.sqrt(2)
    assert behind.min() == pytest.approx(DISTANCE + THICKNESS + length, abs=sampling)
    assert behind.max() > DISTANCE + 20
    before = distance[distance < DISTANCE - 0.01]
    assert before.max() == pytest.approx(DISTANCE, abs=sampling)


def test_wall_nearer_than_the_range_window_hides_the_ground_within() -> None:
    aperture, window = make_aperture(PLATFORM_HEIGHT), (5002.1, 5015.0)
    surface = visible_surface(wall_scene(-1), aperture, 1, CELL, EAST, window)
    distance = np.abs(sphere_coordinates(surface.positions)[1])
    assert distance.min() == pytest.approx(DISTANCE + THICKNESS + WALL, abs=0.08)  # 1 cm longer, and the sampling
    level = visible_surface(
        profile_scene(np.zeros(2), DISTANCE + np.array([-25, 25]), -1), aperture, 1, CELL, EAST, window
    )
    assert np.abs(sphere_coordinates(level.positions)[1]).min() == pytest.approx(DISTANCE + 2, abs=0.1)


@WAYS
def test_wall_puts_ground_face_and_roof_at_one_range(side: int, speed: float, outwards: int) -> None:
    """Layover: a point z up the face is as far away as the ground z before the wall, z sqrt(2) across the sight."""
    surface, _ = see(wall_scene(outwards), side, speed)
    z = 2.5
    foot = sphere_point(0.0, DISTANCE, 0.0)  # 1 m below the map's plane
    slant_range = np.hypot(foot[1], PLATFORM_HEIGHT - foot[2]) - z * np.sqrt(0.5)
    here = np.abs(surface.slant_range - slant_range) < CELL[0] / 2
    ground, face, roof = (
        surface.elevation[here & (np.abs(surface.heights - height) < 0.15)] for height in (0.0, z, WALL)
    )
    assert len(roof) > 0
    assert np.mean(face) - np.mean(ground) == pytest.approx(z * np.sqrt(2) / slant_range, rel=0.05)


def test_face_of_a_wall_has_the_power_of_the_range_it_spans() -> None:
    surface, distance = see(wall_scene(-1))
    face = (surface.heights > 1e-9) & (distance < DISTANCE - 1e-9)
    span = (WALL - 0.01) * np.sqrt(0.5)
    assert surface.power[face].sum() == pytest.approx(span / CELL[0] * 10.0 / CELL[1], rel=0.01)


def test_brightness_scales_the_power() -> None:
    distances = DISTANCE + np.array([-40.0, 40.0])
    scene = profile_scene(np.zeros(2), distances, -1)
    bright = Scene("bright", scene.east, scene.north, scene.height, 2.5 * scene.brightness)
    np.testing.assert_allclose(see(bright)[0].power, 2.5 * see(scene)[0].power, rtol=1e-12)


def test_point_target_is_added_with_its_own_power_if_it_is_lit() -> None:
    distances = DISTANCE + np.array([-40.0, 40.0])
    post = PointScatterer(east=1.0, north=-DISTANCE, height=2.0, power=30.0)
    beside = PointScatterer(east=5.1, north=-DISTANCE, height=2.0, power=30.0)  # would alias in azimuth
    beyond = PointScatterer(east=1.0, north=-DISTANCE - 25.0, height=0.0, power=30.0)  # would alias in range
    surface, _ = see(profile_scene(np.zeros(2), distances, -1, beside, post, beyond))
    (index,) = np.flatnonzero(surface.deterministic)
    coordinates = np.array(sphere_coordinates(surface.positions[index]))
    np.testing.assert_allclose(coordinates, [post.east, post.north, post.height], atol=1e-8)
    assert (surface.power[index], surface.heights[index]) == (30.0, 2.0)
    seen = angles_of(surface.positions[[index]], make_aperture(PLATFORM_HEIGHT), 1)
    stated = (surface.slant_range[[index]], surface.elevation[[index]], surface.squint[[index]])
    np.testing.assert_array_equal(stated, seen)


def test_beside_the_terrain_there_is_nothing() -> None:
    distances = DISTANCE + np.array([-40.0, 40.0])
    wide = profile_scene(np.zeros(2), distances, -1)
    narrow = Scene("narrow", np.array([-1.0, 1.0]), wide.north, wide.height, wide.brightness)
    surface, _ = see(narrow)
    assert np.abs(surface.positions[:, 0]).max() <= 1.0
    assert surface.power.sum() == pytest.approx(30.0 / CELL[0] * 2.0 / CELL[1], rel=2e-2)
    assert np.isfinite(surface.elevation).all()


def test_level_ground_is_lit_in_a_wide_swath_too() -> None:
    distances = DISTANCE + np.array([-25.0, 25.0])
    scene = Scene("wide", np.array([-90.0, 90.0]), -distances[::-1], np.zeros((2, 2)), np.ones((2, 2)))
    extent = (-80.0, 80.0)
    surface = visible_surface(scene, make_aperture(PLATFORM_HEIGHT), 1, CELL, extent, (4999.0, 5001.0))
    assert surface.power.sum() == pytest.approx(2.0 / CELL[0] * 160.0 / CELL[1], rel=0.05)


def test_terrain_is_bilinear_between_nodes_and_nan_outside() -> None:
    scene = Scene(
        "s", np.array([0.0, 2.0]), np.array([0.0, 1.0]), np.array([[0.0, 4], [2, 10]]), np.array([[1.0, 3], [1, 3]])
    )
    np.testing.assert_allclose(scene.heights([0.0, 2.0, 1.0, 0.5], [1.0, 0.0, 0.5, 0.25]), [2, 4, 4, 1.75])
    np.testing.assert_allclose(scene.brightnesses(1.0, [0.0, 1.0]), [2, 2])
    assert np.isnan(scene.heights([2.1, 1.0], [0.5, -0.1])).all()
    assert scene.reference_height == 3.0


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"height": np.zeros((3, 2))}, "(2, 2), 2 x 2 or more"),
        ({"brightness": np.ones((2, 1))}, "brightness (2, 1)"),
        ({"east": np.array([1.0, 1.0])}, "must increase"),
        ({"north": np.array([1.0, 0.0])}, "must increase"),
        ({"height": np.array([[0.0, np.nan], [0, 0]])}, "heights must be finite"),
        ({"brightness": np.array([[1.0, -1.0], [0, 0]])}, "0 or more"),
    ],
)
def test_useless_terrain_is_refused_in_one_sentence(changes: dict[str, np.ndarray], complaint: str) -> None:
    good = {"east": np.arange(2.0), "north": np.arange(2.0), "height": np.zeros((2, 2)), "brightness": np.ones((2, 2))}
    with refused(UserError, "Scene hill", complaint):
        Scene("hill", **{**good, **changes})


def test_flight_beside_the_scene_is_refused_in_one_sentence() -> None:
    scene = profile_scene(np.zeros(2), DISTANCE + np.array([200.0, 300.0]), -1)
    with refused(UserError, "profile", "4985.0 to 5015.0 m", "-5.0 to 5.0 m east"):
        see(scene)


def test_extent_spreads_the_scatterers_evenly_about_the_terrain_and_keeps_their_power() -> None:
    """Level ground 3 m deep: power per range stays, heights are even, and the middle is where it was."""
    distances = DISTANCE + np.arange(-40, 40.25, 0.5)
    flat = profile_scene(np.zeros(len(distances)), distances, -1)
    deep = replace(flat, extent=3.0)
    thin, thick = (
        visible_surface(s, make_aperture(PLATFORM_HEIGHT), 1, CELL, EAST, (4985.0, 5015.0)) for s in (flat, deep)
    )
    inside = [np.abs(s.slant_range - 5000) < 10 for s in (thin, thick)]
    powers = [np.sum(s.power[i]) for s, i in zip((thin, thick), inside, strict=True)]
    assert powers[1] == pytest.approx(powers[0], rel=2e-3)
    heights, power = thick.heights[inside[1]], thick.power[inside[1]]
    per_layer, _ = np.histogram(heights, np.linspace(-1.5, 1.5, LAYERS + 1), weights=power)
    np.testing.assert_allclose(per_layer, powers[0] / LAYERS, rtol=0.02)
    assert np.average(heights**2, weights=power) == pytest.approx(3.0**2 / 12, rel=0.01)
    np.testing.assert_allclose(height_of(thick.positions), thick.heights, atol=1e-8)
    np.testing.assert_array_equal(np.sort(thick.slant_range[np.abs(thick.heights) < 1e-9]), np.sort(thin.slant_range))


def test_extent_below_zero_is_refused() -> None:
    with refused(UserError, "Scene flat", "extent is -1.0 m", "0 or more"):
        replace(flat_scene(), extent=-1.0)


@pytest.mark.parametrize("extent", [0.0, 2.0])
def test_scene_without_terrain_within_the_extents_is_refused(extent: float) -> None:
    scene = replace(flat_scene(), extent=extent)
    with pytest.raises(UserError, match="has no terrain"):
        visible_surface(scene, make_aperture(), 1, CELL, (500.0, 501.0), (4985.0, 5015.0))
