"""Lit surfaces and cells of the ground of scenes whose layover and shadow are known in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import flat_scene, make_aperture, make_beams, make_sensor

from sal_height.geometry.earth import sphere_point
from sal_height.geometry.grid import Grid
from sal_height.imaging.pixels import azimuth_resolution, slant_plane_grid
from sal_height.numeric.arrays import F64
from sal_height.simulation.lit_surfaces import GroundCells, LitSurfaces, ground_cells, lit_surfaces
from sal_height.simulation.scene import Scene, visible_surface

SENSOR = make_sensor()
CELL = SENSOR.range_resolution, azimuth_resolution(SENSOR, make_aperture(), 5000.0)
BEAMS = make_beams("jinc", count=16)
AIM = -5000 * np.sqrt(0.5)
"""North of the ground that is 5000 m away at 45 degrees, but for the earth's curvature, m."""

DROP = float(-sphere_point(0.0, AIM, 0.0)[2])
"""By which the ground there lies below the tangent plane of the map, m."""


def truth_of(
    scene: Scene, rows: int = 90, off: tuple[float, float] = (0.0, 0.0), reach: tuple[float, float] | None = None
) -> tuple[LitSurfaces, Grid, F64]:
    """Lit surfaces, at places so many pixels off the middle, grid, and slant range of each row in mid-image.

    The reach of pixels is that without a window unless another is given.
    """
    half = 9 * CELL[1]
    surface = visible_surface(scene, make_aperture(), 1, CELL, (-half, half), (4994.0, 5006.0))
    grid = slant_plane_grid(SENSOR, make_aperture(), 5000.0, rows, 12, 1.2)
    ranges = np.linalg.norm(grid.points(np.arange(rows), 5.5) - make_aperture().position, axis=-1)
    seen = grid.points(*(index + shift for index, shift in zip(np.indices(grid.shape), off, strict=True)))
    half_cell = CELL[0] / 2, CELL[1] / 2
    truth = lit_surfaces(
        surface, make_aperture(), grid, CELL, reach or half_cell, BEAMS, seen=seen if any(off) else None
    )
    return truth, grid, ranges


def profile(north: list[float], height: list[float]) -> Scene:
    """Terrain along north (m, from AIM), the same at every east."""
    values = np.repeat(np.array(height)[:, None], 2, axis=1)
    return Scene("profile", np.array([-10.0, 10.0]), AIM + np.array(north), values, np.ones(values.shape))


def range_of(north: float, height: float) -> float:
    """Slant range of a point beside the track, m."""
    return float(np.linalg.norm(sphere_point(0.0, AIM + north, height) - make_aperture().position))


@pytest.mark.parametrize("reach", [None, (1.1 * CELL[0], CELL[1] / 2)])
def test_level_ground_is_one_surface_of_power_one(reach: tuple[float, float] | None) -> None:
    """Whatever the reach of its pixels."""
    truth, _, _ = truth_of(flat_scene(2.5, north=AIM), reach=reach)
    inside = truth.inside[0]
    assert np.count_nonzero(inside) > 100
    np.testing.assert_array_equal(truth.count[inside], 1)
    np.testing.assert_allclose(truth.height[0], 2.5, atol=1e-9)
    assert np.mean(truth.power[0]) == pytest.approx(1, rel=0.02)
    assert not truth.shadow.any()


def test_lowest_and_highest_scatterers_are_those_over_the_plane_of_the_surface() -> None:
    """On level ground and on a slope all scatterers are in the plane; a kerb of 6 cm has all heights in between."""
    for top in (0.0, 1.0):
        truth, _, _ = truth_of(profile([-20.0, 20.0], [0.0, top]))
        np.testing.assert_allclose(np.stack([truth.lowest[0], truth.highest[0]]), 0.0, atol=2e-3)
    kerb, _, _ = truth_of(profile([-20.0, -1e-3, 0.0, 20.0], [0.06, 0.06, 0.0, 0.0]))
    assert np.nanmax(kerb.highest[0] - kerb.lowest[0]) == pytest.approx(0.06, abs=0.02)
    there = np.isfinite(kerb.highest)
    heights = np.stack([kerb.height + kerb.lowest, kerb.height + kerb.highest])[:, there]
    assert heights.min() > -0.03
    assert heights.max() < 0.09
    assert np.all(kerb.lowest[there] <= 1e-9)
    assert np.all(kerb.highest[there] >= -1e-9)


@pytest.mark.parametrize("height", [0.8, 1.2, 2.0])
def test_wall_lays_three_surfaces_over_each_other_from_the_range_of_its_top_to_that_of_its_foot(height: float) -> None:
    """Their heights at a range in between follow from the geometry of a plane: ground, face and roof."""
    truth, grid, ranges = truth_of(profile([-40.0, -0.01, 0.0, 40.0], [height, height, 0.0, 0.0]))
    top, foot, clear = range_of(-0.01, height), range_of(0.0, 0.0), 1.5 * grid.row_spacing
    laid_over = (ranges > top + clear) & (ranges < foot - clear)
    assert np.count_nonzero(laid_over) >= 2
    number = np.isfinite(truth.height[:, :, 5]).sum(axis=0)
    np.testing.assert_array_equal(number[laid_over], 3)
    np.testing.assert_array_equal(number[(ranges < top - clear) | (ranges > foot + clear)], 1)
    # The face, at a range r, is where its distance from the track is r.
    face = 5000 * np.sqrt(0.5) + DROP - np.sqrt(ranges[laid_over] ** 2 - AIM**2)
    found = np.sort(truth.height[:, laid_over, 5], axis=0)
    np.testing.assert_allclose(found[0], 0, atol=0.01)
    np.testing.assert_allclose(found[1], face, atol=0.02)
    np.testing.assert_allclose(found[2], height, atol=0.01)


def test_a_roof_counts_in_the_pixels_within_whose_reach_it_is() -> None:
    """Its edge is nearer than the ground below it: of roofs at ten heights, .9 cells more show it in .75 rows more."""
    rows = []
    for height in np.linspace(1.9, 2.1, 10):
        roof = profile([-40.0, -0.01, 0.0, 40.0], [height, height, 0.0, 0.0])
        for cells in (0.2, 1.1):
            truth, grid, _ = truth_of(roof, reach=(cells * CELL[0], CELL[1] / 2))
            rows.append(np.count_nonzero(np.nanmax(truth.height[:, :, 5], axis=0) > 1.8))
    assert np.mean(np.diff(rows)[::2]) == pytest.approx(0.9 * CELL[0] / grid.row_spacing, abs=0.15)


@pytest.mark.parametrize("height", [0.8, 1.5])
def test_shadow_of_a_fence_reaches_its_height_times_the_tangent_of_the_look_angle(height: float) -> None:
    north = [-40.0, -0.03, -0.02, -0.01, 0.0, 40.0]
    truth, grid, ranges = truth_of(profile(north, [0.0, 0.0, height, height, 0.0, 0.0]))
    tangent = (5000 * np.sqrt(0.5) + 0.02) / (5000 * np.sqrt(0.5) + DROP - height)
    begin, end = range_of(-0.03, 0.0), range_of(-0.02 - height * tangent, 0.0)
    clear = 1.5 * grid.row_spacing
    dark = (ranges > begin + clear) & (ranges < end - clear)
    empty = ~np.isfinite(truth.height[0, :, 5])
    assert np.count_nonzero(dark) >= 3
    assert empty[dark].all()
    assert not empty[(ranges < begin - clear) | (ranges > end + clear)].any()
    inner = (ranges > begin + 2 * clear) & (ranges < end - 2 * clear)
    assert truth.shadow[inner, 5].all()
    assert truth.shadow.sum(axis=0)[5] <= empty.sum() - 2


def test_slope_is_one_surface_as_wide_as_its_elevations_within_a_pixel() -> None:
    """A plane seen at incidence i spans 1 / tan i across the line of sight of a span of range."""
    incidence = np.radians(20.0)
    rise = np.tan(np.pi / 4 - incidence)
    truth, grid, _ = truth_of(profile([-40.0, 40.0], [40.0 * rise, -40.0 * rise]))
    inside = truth.inside[0]
    assert np.count_nonzero(inside) > 20
    np.testing.assert_array_equal(truth.count[inside], 1)
    pixel, margin = grid.row_spacing, CELL[0] / 2
    # Evenly spread over the pixel, and with a tenth of the density over half a cell on each side.
    places = np.linspace(-pixel / 2 - margin, pixel / 2 + margin, 20001)
    weight = np.where(
        np.abs(places) < pixel / 2, 1 + 0.1 * CELL[1] / grid.col_spacing, 0.1 * (1 + CELL[1] / grid.col_spacing)
    )
    spread = np.sqrt(np.average(places**2, weights=weight)) / np.tan(incidence) / 5000
    assert np.median(truth.spread[0][inside]) == pytest.approx(spread, rel=0.03)


def test_height_of_a_slope_is_that_at_the_range_asked_for() -> None:
    """A plane rises by tan a / (sin l - cos l tan a) per metre of range, l the look angle; to both sides of a pixel."""
    rise = np.tan(np.radians(25.0))
    scene = profile([-40.0, 40.0], [40.0 * rise, -40.0 * rise])
    (before, grid, _), (after, _, _) = (truth_of(scene, off=(off, 0.1)) for off in (-0.25, 0.25))
    depth = grid.row_spacing * (grid.row_direction @ [0.0, -np.sqrt(0.5), -np.sqrt(0.5)])
    expected = 0.5 * depth * rise / (np.sqrt(0.5) * (1 - rise))
    middle = np.s_[0, 20:-20, 2:-2]
    np.testing.assert_allclose((after.height - before.height)[middle], expected, rtol=0.03)
    np.testing.assert_allclose(after.elevation[middle], before.elevation[middle])


def test_rise_along_the_flight_is_that_at_one_range() -> None:
    """On ground that rises by t along the flight and by s away from it: t / (1 - s cot l), l the look angle."""
    ahead, away = 0.3, np.tan(np.radians(25.0))
    scene = profile([-40.0, 40.0], [40.0 * away, -40.0 * away])
    truth, _, _ = truth_of(replace(scene, height=scene.height + ahead * scene.east))
    np.testing.assert_allclose(truth.rise[0, 20:-20, 2:-2], ahead / (1 - away), rtol=0.03)


CELL_SIZE = 0.05


def cells_of(north: list[float], height: list[float]) -> tuple[GroundCells, np.ndarray]:
    """Cells of a terrain along north (m, from AIM), and how far south of AIM each is, m."""
    scene, half = profile(north, height), 9 * CELL[1]
    surface = visible_surface(scene, make_aperture(), 1, CELL, (-half, half), (4994.0, 5006.0))
    grid = slant_plane_grid(SENSOR, make_aperture(), 5000.0, 90, 12, 1.2)
    cells = ground_cells(scene, surface, make_aperture(), grid, BEAMS, 1, CELL_SIZE)
    return cells, AIM - (cells.number[:, 0] + 0.5) * CELL_SIZE


@pytest.mark.parametrize("height", [0.5, 1.5])
def test_shadow_is_as_long_as_height_times_the_tangent_of_the_look_angle(height: float) -> None:
    cells, south = cells_of([-40.0, -0.002, -0.001, 0.0, 0.001, 40.0], [0.0, 0.0, height, height, 0.0, 0.0])
    down = make_aperture().position[2] - sphere_point(0.0, AIM, 0.0)[2]
    length = height * (-AIM) / (down - height)
    dark = south[~cells.lit]
    assert dark.min() == pytest.approx(0, abs=CELL_SIZE)
    assert dark.max() == pytest.approx(length, abs=CELL_SIZE)
    np.testing.assert_array_equal(cells.lit, (south <= dark.min() - 1e-9) | (south >= dark.max() + 1e-9))


def test_cells_are_in_the_pixels_of_their_range_and_inside_if_between_the_outermost_boresights() -> None:
    cells, south = cells_of([-40.0, 40.0], [0.0, 0.0])
    assert cells.lit.all()
    places = sphere_point(np.zeros(len(south)), AIM - south, np.zeros(len(south)))
    sight = places - make_aperture().position
    elevation = np.arctan2(-sight[:, 1], -sight[:, 2])
    np.testing.assert_array_equal(cells.inside, (elevation >= BEAMS.span[0]) & (elevation <= BEAMS.span[1]))
    assert 0.2 < cells.inside.mean() < 1
    pixel = (np.linalg.norm(sight, axis=-1) - 5000) / (1.2 * CELL[0]) + 44.5
    np.testing.assert_allclose(cells.pixel[:, 0], pixel, atol=0.51)
