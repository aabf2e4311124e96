"""The truth against which heights are judged, and the bound on judging them."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import (
    elevation_at,
    flat_scene,
    make_aperture,
    make_beams,
    make_sensor,
    multilook,
    offset_of,
    target_slc,
)

from sal_height.elevation.array.bounds import speckle_crb
from sal_height.elevation.estimators.maximum_likelihood import MlSettings, ml_elevation
from sal_height.geometry.earth import height_of
from sal_height.geometry.frames import angles_of, look_direction
from sal_height.geometry.grid import Grid, pixels_at
from sal_height.imaging.pixels import azimuth_resolution, slant_plane_grid, strip_grid
from sal_height.simulation.lit_surfaces import Truth, truth_image
from sal_height.simulation.scene import Scene, VisibleSurface, visible_surface

SENSOR = make_sensor()
CELL = SENSOR.range_resolution, azimuth_resolution(SENSOR, make_aperture(), 5000.0)
BEAMS = make_beams("jinc", count=16)
BROADENING = 1.2


def image_grid(rows: int = 20, cols: int = 12) -> Grid:
    return slant_plane_grid(SENSOR, make_aperture(), 5000.0, rows, cols, BROADENING)


def truth_of(surface: VisibleSurface, grid: Grid) -> Truth:
    return truth_image(surface, make_aperture(), grid, CELL[0] * CELL[1], BEAMS)


def seen(scene: Scene) -> VisibleSurface:
    half = 9 * CELL[1]
    return visible_surface(scene, make_aperture(), 1, CELL, (-half, half), (4997.0, 5003.0))


def scatterers(
    grid: Grid, pixels: list[tuple[float, float]], offsets: list[float], power: list[float]
) -> VisibleSurface:
    """Scatterers in given pixels, `offsets` beamwidths above the middle of the beams."""
    aperture = make_aperture()
    sight = grid.points(*np.array(pixels).T) - aperture.position
    slant_range = np.linalg.norm(sight, axis=-1)
    squint = np.arcsin(sight[:, 0] / slant_range)
    positions = aperture.position + slant_range[:, None] * look_direction(elevation_at(offsets), squint, 1)
    angles = angles_of(positions, aperture, 1)
    return VisibleSurface(
        positions,
        height_of(positions),
        np.array(power),
        *angles,
        np.zeros(len(power), dtype=bool),
        np.zeros_like(positions),
    )


def test_level_ground_is_level_of_power_one_and_single() -> None:
    scene = flat_scene(2.5, north=-5000 * np.sqrt(0.5))
    truth = truth_of(seen(scene), image_grid())
    np.testing.assert_allclose(truth.height, 2.5, atol=1e-9)
    assert np.mean(truth.power) == pytest.approx(1, rel=0.02)  # of two or three samples per pixel and direction
    assert np.all(truth.single)


def test_step_puts_low_ground_before_and_high_ground_behind_it() -> None:
    """A step of 0.5 m, running away from the sensor: seen over the edge, nothing is hidden or laid over."""
    north = -5000 * np.sqrt(0.5) + np.array([-40.0, 0.0, 1.0, 40.0])
    height = np.repeat(np.array([0.5, 0.5, 0.0, 0.0])[:, None], 2, axis=1)
    scene = Scene("ramp", np.array([-10.0, 10.0]), north, height, np.ones((4, 2)))
    grid = image_grid(rows=40)
    surface = seen(scene)
    truth = truth_of(surface, grid)
    edge = surface.slant_range[(surface.heights > 1e-9) & (surface.heights < 0.5 - 1e-9)]
    slant_range = np.linalg.norm(grid.pixels() - make_aperture().position, axis=-1)
    before, behind = slant_range < edge.min() - grid.row_spacing, slant_range > edge.max() + grid.row_spacing
    assert np.count_nonzero(before) > 100
    assert np.count_nonzero(behind) > 100
    np.testing.assert_allclose(truth.height[before], 0.0, atol=1e-9)
    np.testing.assert_allclose(truth.height[behind], 0.5, atol=1e-9)


def test_wall_lays_ground_face_and_roof_over_each_other() -> None:
    north = -5000 * np.sqrt(0.5) + np.array([-40.0, -0.01, 0.0, 40.0])
    height = np.repeat(np.array([2.0, 2.0, 0.0, 0.0])[:, None], 2, axis=1)
    surface = seen(Scene("wall", np.array([-10.0, 10.0]), north, height, np.ones((4, 2))))
    grid = image_grid(rows=50)
    truth = truth_of(surface, grid)
    foot = surface.slant_range[surface.heights < 1e-9].max()
    slant_range = np.linalg.norm(grid.pixels() - make_aperture().position, axis=-1)
    # Three surfaces 1 m apart in height at the middle of the face's range, one before it and one behind.
    assert not truth.single[np.abs(slant_range - foot + np.sqrt(0.5)) < 0.2].any()
    assert truth.single[slant_range > foot + 0.2].all()
    assert truth.single[slant_range < foot - 2 * np.sqrt(0.5) - 0.2].all()


def test_truth_is_the_mean_weighted_by_the_power_received() -> None:
    grid = image_grid()
    offsets, powers = [-0.2, 0.1, 1.0], [1.0, 3.0, 5.0]
    surface = scatterers(grid, [(4.2, 3.1), (3.8, 3.3), (10.0, 7.0)], offsets, powers)
    truth = truth_of(surface, grid)
    gain = np.sum(BEAMS.response(surface.elevation, surface.squint) ** 2, axis=-1)
    received = gain[:2] * powers[:2]
    share = received / received.sum()
    assert truth.height[4, 3] == pytest.approx(share @ surface.heights[:2], abs=1e-9)
    assert offset_of(truth.elevation[4, 3]) == pytest.approx(share @ offsets[:2], abs=1e-9)
    assert truth.height[10, 7] == pytest.approx(surface.heights[2], abs=1e-9)
    # A pixel is larger than the resolution cell to which powers refer.
    assert truth.power[10, 7] == pytest.approx(5.0 / BROADENING, rel=1e-9)
    assert truth.power[4, 3] == pytest.approx(received.sum() / (share @ gain[:2]) / BROADENING, rel=1e-9)
    empty = np.ones(grid.shape, dtype=bool)
    empty[4, 3] = empty[10, 7] = False
    np.testing.assert_array_equal(np.isnan(truth.height), empty)


@pytest.mark.parametrize(("half", "single"), [(0.09, True), (0.11, False)])
def test_elevations_spread_over_a_tenth_of_a_beamwidth_are_no_single_scatterer(half: float, single: bool) -> None:
    """Two elevations at either of two ranges."""
    grid = image_grid()
    pixels = [(3.8, 3), (3.8, 3), (4.2, 3), (4.2, 3)]
    truth = truth_of(scatterers(grid, pixels, [-half, half, -half, half], [1.0] * 4), grid)
    assert truth.single[4, 3] == single


@pytest.mark.parametrize(("half", "single"), [(0.09, True), (0.11, False)])
def test_slope_of_the_ground_counts_as_one_scatterer_whatever_its_elevations(half: float, single: bool) -> None:
    """Elevation grows with range by a beamwidth in the pixel; only what is left beside that makes it several."""
    grid = image_grid()
    pixels = [(3.8, 3), (3.8, 3), (4.2, 3), (4.2, 3)]
    offsets = [-0.5 - half, -0.5 + half, 0.5 - half, 0.5 + half]
    truth = truth_of(scatterers(grid, pixels, offsets, [1.0] * 4), grid)
    assert truth.single[4, 3] == single


def test_what_the_beams_do_not_see_does_not_count() -> None:
    """Scatterers as strong in the pixel, one of them 30 beamwidths above the array."""
    grid = image_grid()
    surface = scatterers(grid, [(4, 3), (4, 3)], [0.4, 34.0], [1.0, 1.0])
    truth = truth_of(surface, grid)
    assert truth.height[4, 3] == pytest.approx(surface.heights[0], abs=0.01)
    assert np.diff(surface.heights) > 10


def test_scatterers_beside_the_image_are_left_out() -> None:
    grid = image_grid()
    outside = [(-0.6, 3.0), (grid.rows - 0.4, 3.0), (3.0, -0.6), (3.0, grid.cols - 0.4)]
    assert np.isnan(truth_of(scatterers(grid, outside, [0.0] * 4, [1.0] * 4), grid).height).all()
    inside = [(-0.4, 3.0), (grid.rows - 0.6, 3.0), (3.0, -0.4), (3.0, grid.cols - 0.6)]
    assert np.count_nonzero(np.isfinite(truth_of(scatterers(grid, inside, [0.0] * 4, [1.0] * 4), grid).height)) == 4


@pytest.mark.parametrize(("looks", "cnr"), [(4, 100.0), (16, 30.0)])
def test_maximum_likelihood_comes_close_to_the_bound_and_not_below(looks: int, cnr: float) -> None:
    trials = 8000
    slc = target_slc(BEAMS, 0.6, trials, looks, cnr, np.random.default_rng(30))
    estimate = ml_elevation(multilook(slc, 1, looks), BEAMS, MlSettings(min_cnr_db=0.0, layover=False))
    squares = (estimate.elevation[:, 0] - elevation_at(0.6)) ** 2
    standard_error = np.std(squares) / np.sqrt(trials) / np.mean(squares) / 2  # of the rms, relative: 1 %
    bound = speckle_crb(BEAMS, elevation_at(0.6), 0.0, cnr, looks)
    assert standard_error < 0.02
    assert -3.5 * standard_error < np.sqrt(np.mean(squares)) / bound - 1 < 0.03 + 3.5 * standard_error


@pytest.mark.parametrize("skew", [0.0, 2e-2, -2e-2])
def test_pixels_at_undo_range_and_track_for_columns_that_do_not_run_along_the_track(skew: float) -> None:
    """A strip in crosswind: the velocity is off the body's forward axis, climbing, and the body tilted.

    Against the distance from the track and the place along it of points of the grid, which need not be pixels.
    """
    velocity = 50 * np.array([np.cos(skew), np.sin(skew), 0.4 * skew])
    aperture = make_aperture(velocity=tuple(velocity), angles=(0.02, -0.01, 0.03) if skew else (0.0, 0.0, 0.0))
    grid = strip_grid(SENSOR, aperture, 5000.0, (40, 900), (0.09, 0.005))
    cosine = grid.col_direction @ aperture.direction
    assert np.arccos(cosine) == pytest.approx(np.hypot(skew, 0.4 * skew), abs=0.04)
    rng = np.random.default_rng(31)
    row, col = rng.uniform(-2, 42, 500), rng.uniform(-50, 950, 500)
    sight = grid.points(row, col) - aperture.position
    along = sight @ aperture.direction
    across = np.linalg.norm(np.cross(sight, aperture.direction), axis=-1)
    found = pixels_at(across, along, aperture, grid)
    np.testing.assert_allclose(found[0], row, atol=1e-6)
    np.testing.assert_allclose(found[1], col, atol=1e-6)


def test_pixels_at_are_the_nearest_that_a_search_over_all_pixels_finds() -> None:
    """The pixel whose range and place along the track, in cells, are nearest to a target's off the plane."""
    aperture = make_aperture(velocity=(50 * np.cos(2e-2), 50 * np.sin(2e-2), 0.0))
    grid = strip_grid(SENSOR, aperture, 5000.0, (30, 200), (0.09, 0.005))
    pixels = grid.pixels() - aperture.position
    places = pixels @ aperture.direction
    distances = np.linalg.norm(np.cross(pixels, aperture.direction), axis=-1)
    rng = np.random.default_rng(32)
    for _ in range(40):
        across = rng.uniform(distances.min() + 0.2, distances.max() - 0.2)
        along = rng.uniform(places.min() + 0.2, places.max() - 0.2)
        row, col = (float(index) for index in pixels_at(np.array(across), np.array(along), aperture, grid))
        mismatch = ((distances - across) / grid.row_spacing) ** 2 + ((places - along) / grid.col_spacing) ** 2
        nearest = np.unravel_index(np.argmin(mismatch), grid.shape)
        # A row is 0.36 columns farther along the track, so the nearest pixel may be one beside that of the cell.
        assert abs(row - nearest[0]) < 0.75
        assert abs(col - nearest[1]) < 0.75
