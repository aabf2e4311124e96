"""Tracked heights in their places: on the circle of range and Doppler, with what the pose leaves open beside."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation

from sal_height.elevation.array.estimate import Validity
from sal_height.geometry.earth import EARTH_RADIUS, above_place, height_of, sphere_point
from sal_height.geometry.frames import ApertureState, aperture_at
from sal_height.geometry.grid import Grid
from sal_height.geometry.trajectory import locate_at_elevation, locate_at_height
from sal_height.relief.heights import HeightField, Surface
from sal_height.relief.position_error import circle_covariance, height_variance, pose_covariance
from sal_height.relief.smoothing import TrackedRelief
from sal_height.relief.tracked import (
    ground_spacings,
    look_side_of,
    tracked_field,
)

Array = npt.NDArray[np.float64]

RANGE, LOOK = 5000.0, np.pi / 4


def make_aperture(heading: float = 0.3, climb: float = 0.02, sliding: bool = False) -> ApertureState:
    """A flight that climbs, with the body turned a little out of it."""
    velocity = 100 * np.array([np.cos(heading) * np.cos(climb), np.sin(heading) * np.cos(climb), np.sin(climb)])
    rotation = Rotation.from_euler("ZYX", [heading + 0.01, -0.015, 0.02]).as_matrix()
    position = np.array([300.0, -200.0, RANGE * np.cos(LOOK)])
    return ApertureState(position, velocity, rotation, 10.0, np.zeros((6, 6)), sliding)


def make_grid(aperture: ApertureState, look_side: int, shape: tuple[int, int] = (6, 5)) -> Grid:
    """Pixels of 2 m and 3 m in the slant plane, around the line of sight abeam."""
    along = aperture.direction
    right = np.cross(along, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    sight = look_side * np.sin(LOOK) * right - np.cos(LOOK) * np.cross(right, along)
    origin = aperture.position + (RANGE - 5) * sight - 6 * along
    return Grid(origin, sight, along, 2.0, 3.0, *shape)


@pytest.mark.parametrize("look_side", [1, -1])
@pytest.mark.parametrize("squint", [0.0, 0.2])
def test_the_place_of_a_height_is_that_of_its_elevation(look_side: int, squint: float) -> None:
    """Located by elevation first, and again by the height that comes out: within a micrometre at 5 km."""
    aperture = make_aperture()
    elevation = LOOK + np.linspace(-0.3, 0.3, 7)[:, None]
    slant_range = RANGE + np.array([-300.0, 0.0, 400.0])
    along = slant_range * np.sin(squint)
    positions = locate_at_elevation(elevation, slant_range, along, aperture, look_side)
    again = locate_at_height(height_of(positions), slant_range, along, aperture, look_side)
    np.testing.assert_allclose(again, positions, atol=1e-6)


def test_there_is_no_place_too_high_or_too_low() -> None:
    aperture = make_aperture()
    beyond = RANGE * 1.01
    heights = np.array([aperture.position[2] + beyond, 0.0, aperture.position[2] - beyond])
    found = np.isfinite(locate_at_height(heights, RANGE, 0.0, aperture, 1)).all(axis=-1)
    assert found.tolist() == [False, True, False]


def test_the_point_above_a_place() -> None:
    points = sphere_point([0.0, 3000.0, -40e3], [0.0, -4000.0, 20e3], [100.0, -50.0, 2000.0])
    np.testing.assert_allclose(above_place(points[:, 0], points[:, 1], [100.0, -50.0, 2000.0]), points, atol=1e-6)


@pytest.mark.parametrize("look_side", [1, -1])
def test_look_side_and_ground_spacings(look_side: int) -> None:
    aperture = make_aperture(climb=0.0)
    grid = make_grid(aperture, look_side)
    assert look_side_of(grid, aperture) == look_side
    assert ground_spacings(grid) == pytest.approx((2.0 / np.sin(LOOK), 3.0))


def field_of(grid: Grid, aperture: ApertureState, look_side: int, height: Array, sigma: float) -> HeightField:
    """Scatterers at `height` in the pixels, found off their centres by a third of a pixel; NaN: none."""
    points = grid.points(np.arange(grid.rows)[:, None] + 0.3, np.arange(grid.cols) - 0.3)
    there = aperture_at(points, aperture)
    sight = points - there.position
    slant_range = np.linalg.norm(sight, axis=-1)
    positions = locate_at_height(height, slant_range, sight @ aperture.direction, there, look_side)
    seen = np.isfinite(height)
    validity = np.where(seen, Validity.OK, Validity.OUTSIDE_ARRAY).astype(np.uint8)
    own = circle_covariance(np.where(seen, sigma, np.nan), positions, aperture)
    surface = Surface.seen_from(aperture, positions, own, np.full(grid.shape, 10.0))
    return HeightField(grid, validity, (surface,))


@pytest.mark.parametrize("look_side", [1, -1])
@pytest.mark.parametrize("sliding", [False, True])
def test_a_tracked_scatterer_stays_on_its_circle(look_side: int, sliding: bool) -> None:
    """Its distance from, and its way along, the flight; its height is the tracked one. In a strip, too."""
    aperture = make_aperture(sliding=sliding)
    grid = make_grid(aperture, look_side)
    height = np.random.default_rng(1).uniform(-5, 5, grid.shape)
    field = field_of(grid, aperture, look_side, height, 1.0)
    relief = TrackedRelief(height + 3.0, np.full(grid.shape, 0.5), np.zeros(grid.shape, np.bool_))
    result = tracked_field(field, relief, aperture, 1.4)
    assert np.all(result.validity == Validity.OK)
    np.testing.assert_allclose(height_of(result.first.positions), height + 3.0, atol=1e-6)
    np.testing.assert_allclose(result.first.height, height + 3.0, atol=1e-9)
    np.testing.assert_allclose(result.first.sigma, 0.5)
    before, after = field.first.positions - aperture.position, result.first.positions - aperture.position
    np.testing.assert_allclose(after @ aperture.direction, before @ aperture.direction, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(after, axis=-1), np.linalg.norm(before, axis=-1), atol=1e-6)
    moved = np.linalg.norm(result.first.positions - field.first.positions, axis=-1)
    np.testing.assert_allclose(moved, 3.0 / np.sin(LOOK), rtol=0.05)


def test_validity_says_where_a_height_comes_from() -> None:
    """Down a column, measured pixels between others: beyond, of a gap, of a vague sigma, an outlier and a gap by it."""
    aperture = make_aperture()
    grid = make_grid(aperture, 1, (10, 1))
    nothing = np.nan
    height = np.array([nothing, 1.0, nothing, 2.0, nothing, 3.0, 9.0, nothing, 3.0, nothing])[:, None]
    field = field_of(grid, aperture, 1, height, 1.0)
    field.validity[2], field.validity[4], field.validity[7] = (
        Validity.MISSING_DATA,
        Validity.LOW_CNR,
        Validity.SATURATED,
    )
    vague = 1.4
    sigma = np.full((10, 1), 0.5)
    sigma[4] = vague * 1.01
    outlier = height == 9.0
    result = tracked_field(field, TrackedRelief(np.ones((10, 1)), sigma, outlier), aperture, vague)
    expected = [
        *(Validity.OUTSIDE_ARRAY, Validity.OK, Validity.INTERPOLATED, Validity.OK, Validity.LOW_CNR, Validity.OK),
        *(Validity.LOW_CNR, Validity.SATURATED, Validity.OK, Validity.OUTSIDE_ARRAY),
    ]
    assert result.validity[:, 0].tolist() == expected
    usable = np.isin(result.validity, (Validity.OK, Validity.INTERPOLATED))
    for values in (result.first.height, result.first.sigma, result.first.positions[..., 0]):
        np.testing.assert_array_equal(np.isfinite(values), usable)
    assert len(result.surfaces) == 1
    nowhere = TrackedRelief(np.full((10, 1), 2 * EARTH_RADIUS), sigma, outlier)
    assert tracked_field(field, nowhere, aperture, vague).validity[1, 0] == Validity.OUTSIDE_ARRAY


def test_a_run_of_consistent_heights_is_a_step_and_not_overwritten() -> None:
    """The far half of the image lies 3 m higher than a track that does not follow; one pixel stands alone."""
    aperture = make_aperture()
    grid = make_grid(aperture, 1)
    height = np.where(np.arange(6) < 3, 0.0, 3.0)[:, None] + np.zeros(grid.shape)
    height[1, 2] = 7.0
    field = field_of(grid, aperture, 1, height, 0.1)
    relief = TrackedRelief(np.zeros(grid.shape), np.full(grid.shape, 0.05), np.abs(height) > 1)
    result = tracked_field(field, relief, aperture, 1.4)
    np.testing.assert_array_equal(result.validity[3:], Validity.OK)
    np.testing.assert_array_equal(result.first.height[3:], field.first.height[3:])
    np.testing.assert_array_equal(result.first.sigma[3:], field.first.sigma[3:])
    assert result.validity[1, 2] == Validity.LOW_CNR


def test_an_error_that_all_pixels_share_makes_no_company() -> None:
    """The far half of the image has heights metres apart, to 0.1 m each and to 10 m all together."""
    aperture = replace(make_aperture(), covariance=np.diag([10.0, 10.0, 10.0, 0.0, 0.0, 0.0]) ** 2)
    grid = make_grid(aperture, 1)
    height = np.where(np.arange(6) < 3, 0.0, 2.0 * np.arange(6))[:, None] + np.arange(grid.cols) % 3
    field = field_of(grid, aperture, 1, np.where(np.arange(6)[:, None] < 3, 0.0, height), 0.1)
    relief = TrackedRelief(np.zeros(grid.shape), np.full(grid.shape, 0.05), np.abs(field.first.height) > 0.5)
    assert np.all(tracked_field(field, relief, aperture, 1.4).validity[3:] == Validity.LOW_CNR)


@pytest.mark.parametrize("validity", [Validity.TWO_SCATTERERS, Validity.THREE_SCATTERERS, Validity.EXTENDED])
def test_what_is_not_one_surface_stays_what_it_is(validity: Validity) -> None:
    aperture = make_aperture()
    grid = make_grid(aperture, 1)
    field = field_of(grid, aperture, 1, np.ones(grid.shape), 0.1)
    field.validity[2, 2] = validity
    field.validity[4, 2] = Validity.NO_SIGNAL
    both = replace(field, surfaces=(field.first, field.first))
    relief = TrackedRelief(np.zeros(grid.shape), np.full(grid.shape, 0.05), np.zeros(grid.shape, np.bool_))
    result = tracked_field(both, relief, aperture, 1.4)
    assert result.validity[2, 2] == validity
    assert [surface.height[2, 2] for surface in result.surfaces] == pytest.approx([1.0, 1.0])
    assert result.first.height[2, 1] == pytest.approx(0.0, abs=1e-9)


def test_what_the_pose_leaves_open_is_not_averaged() -> None:
    """It is not in the sigma that is tracked, and is on top of the tracked one again."""
    aperture = replace(make_aperture(), covariance=np.diag([0.1, 0.1, 0.2, 1e-5, 1e-5, 1e-5]) ** 2)
    grid = make_grid(aperture, 1)
    field = field_of(grid, aperture, 1, np.zeros(grid.shape), 0.7)
    common = pose_covariance(field.first.positions, aperture)
    assert common is not None
    shared = height_variance(common, field.first.positions)
    assert np.all(shared > 0.03)
    np.testing.assert_allclose(field.first.sigma, np.sqrt(0.7**2 + shared), rtol=1e-9)
    np.testing.assert_allclose(field.first.own_sigma, 0.7, rtol=1e-9)
    relief = TrackedRelief(field.first.height, np.full(grid.shape, 0.2), np.zeros(grid.shape, np.bool_))
    tracked = tracked_field(field, relief, aperture, 1.4)
    np.testing.assert_allclose(tracked.first.sigma, np.sqrt(0.2**2 + shared), rtol=1e-6)
