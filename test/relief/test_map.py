"""Relief map: weights, sigmas that are true, dwells that disagree, growth, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from helpers import blocks, few, make_aperture, make_sensor, refused
from scipy.spatial.transform import Rotation

from sal_height.elevation.array.estimate import ElevationEstimate, Validity
from sal_height.elevation.looks.looks import Looks, look_grid
from sal_height.errors import Rejected
from sal_height.geometry.earth import height_of, sphere_point
from sal_height.geometry.frames import ApertureState
from sal_height.geometry.grid import Grid
from sal_height.geometry.trajectory import locate_at_elevation
from sal_height.imaging.pixels import slant_plane_grid
from sal_height.relief.cell_map import TILE, Relief
from sal_height.relief.heights import HeightField, Surface, height_field
from sal_height.relief.map import ReliefMap, fitting_cell_size
from sal_height.relief.position_error import pose_covariance, variance_at_place

Array = npt.NDArray[np.float64]

UNKNOWN_POSE = make_aperture()
COVARIANCE = np.diag([0.05, 0.04, 0.06, 2e-5, 1.5e-5, 3e-5]) ** 2
COVARIANCE[1, 3] = COVARIANCE[3, 1] = 0.3 * 0.04 * 2e-5
KNOWN_POSE = replace(make_aperture(angles=(0.03, -0.02, 0.1), velocity=(49.0, 5.0, -1.0)), covariance=COVARIANCE)


def field_at(
    east: npt.ArrayLike,
    north: npt.ArrayLike,
    height: npt.ArrayLike,
    sigma: npt.ArrayLike = 0.1,
    aperture: ApertureState = UNKNOWN_POSE,
) -> HeightField:
    """Scatterers in one row of pixels, whose own errors are those of their heights alone."""
    east, north, height, sigma = (
        np.atleast_2d(values).astype(float) for values in np.broadcast_arrays(east, north, height, sigma)
    )
    own = np.zeros((*height.shape, 3, 3))
    own[..., 2, 2] = sigma**2
    surface = Surface.seen_from(aperture, sphere_point(east, north, height), own, np.full(height.shape, 20.0))
    grid = Grid(np.zeros(3), np.array([0.0, -1.0, 0.0]), np.array([1.0, 0.0, 0.0]), 1.0, 1.0, *height.shape)
    return HeightField(grid, np.zeros(height.shape, np.uint8), (surface,))


def relief_of(*fields: HeightField, cell_size: float = 1.0) -> Relief:
    relief_map = ReliefMap(cell_size, 10_000_000)
    for field in fields:
        relief_map.add(field)
    relief = relief_map.relief()
    assert relief is not None
    return relief


def test_a_map_that_has_seen_nothing_is_none() -> None:
    relief_map = ReliefMap(1.0, 100)
    relief_map.add(field_at([0.5, 1.5], 0.5, np.nan))
    assert relief_map.relief() is None


def test_cells_are_at_multiples_of_their_size_and_nan_where_unseen() -> None:
    relief = relief_of(field_at([-5.0, 7.0], [-30_001.0, -29_999.0], [3.0, 5.0]), cell_size=2.0)
    assert (relief.east, relief.north, relief.cell_size) == (-5.0, -30_001.0, 2.0)
    nan = np.nan
    np.testing.assert_allclose(relief.height, [[3, nan, nan, nan, nan, nan, nan], [nan, nan, nan, nan, nan, nan, 5]])
    np.testing.assert_allclose(relief.sigma, np.where(np.isfinite(relief.height), 0.1, nan), rtol=1e-6)
    assert np.array_equal(relief.count, np.isfinite(relief.height))
    assert np.isnan(relief.disagreement).all()


def test_places_are_arc_distances_however_high_and_far() -> None:
    """At 100 km the plane's x is 4 m less than the arc, and 2 km of height move a point 31 m outwards in it."""
    relief = relief_of(field_at(100_000.25, -30_000.25, 2000.0), cell_size=0.5)
    assert (relief.east, relief.north) == (100_000.25, -30_000.25)


def test_pixels_and_dwells_are_weighted_by_inverse_variance() -> None:
    """Without a common part: 1 / sigma^2 add up, however the pixels come."""
    heights, sigmas = np.array([1.0, 1.2, 0.7, 1.3]), np.array([0.1, 0.2, 0.4, 0.3])
    weights = 1 / sigmas**2
    one = relief_of(field_at(0.5, 0.5, heights, sigmas))
    several = relief_of(*(field_at(0.5, 0.5, h, s) for h, s in zip(heights, sigmas, strict=True)))
    for relief, count in ((one, 1), (several, 4)):
        np.testing.assert_allclose(relief.height, weights @ heights / weights.sum(), rtol=1e-6)
        np.testing.assert_allclose(relief.sigma, 1 / np.sqrt(weights.sum()), rtol=1e-6)
        assert relief.count == count
    mean = weights @ heights / weights.sum()
    np.testing.assert_allclose(several.disagreement, np.sqrt(weights @ (heights - mean) ** 2 / 3), rtol=1e-6)


def test_the_order_of_dwells_does_not_matter() -> None:
    rng = np.random.default_rng(3)
    dwells = [
        field_at(*rng.uniform(-TILE, TILE, (2, 500)), rng.normal(2000, 1, 500), rng.uniform(0.1, 1, 500), pose)
        for pose in (UNKNOWN_POSE, KNOWN_POSE, *[replace(KNOWN_POSE, covariance=4 * COVARIANCE)] * 4)
    ]
    forth, back = relief_of(*dwells, cell_size=16.0), relief_of(*dwells[::-1], cell_size=16.0)
    assert forth.count.max() == 6
    for name in ("height", "sigma", "disagreement"):
        np.testing.assert_allclose(getattr(forth, name), getattr(back, name), rtol=1e-6)


def test_the_common_part_is_not_averaged_away_within_a_dwell_nor_among_dwells() -> None:
    """Pixels of one variance: own / n + common, whatever the number of dwells."""
    east, north, pixels, dwells, own = -500.5, -3500.5, 400, 5, 0.3
    field = field_at(np.full(pixels, east), north, 2.0, own, KNOWN_POSE)
    unknown_slope = np.full(2, np.nan)
    common = float(variance_at_place(pose_covariance(sphere_point(east, north, 2.0), KNOWN_POSE), unknown_slope))
    for count in (1, dwells):
        relief = relief_of(*[field] * count)
        np.testing.assert_allclose(relief.sigma, np.sqrt(own**2 / pixels / count + common), rtol=1e-5)
    assert common > 20 * own**2 / pixels


@pytest.mark.parametrize("sigma", [0.01, 0.5, 10.0])
def test_an_error_that_all_share_makes_sigma_greater_and_moves_no_height(sigma: float) -> None:
    rng = np.random.default_rng(12)
    dwells = [
        field_at(*rng.uniform(0, 12, (2, 500)), rng.normal(0, 0.3, 500), rng.uniform(0.01, 0.3, 500)) for _ in range(3)
    ]
    exact, shared = relief_of(*dwells), relief_of(*(with_shared_error(dwell, sigma) for dwell in dwells))
    for layer in ("height", "count"):
        assert np.array_equal(getattr(shared, layer), getattr(exact, layer), equal_nan=True)
    np.testing.assert_allclose(shared.sigma, np.hypot(exact.sigma, sigma), rtol=1e-6)


def with_shared_error(field: HeightField, sigma: float) -> HeightField:
    """A dwell all of whose heights err alike by `sigma`, m."""
    common = np.zeros((*field.grid.shape, 3, 3))
    common[..., 2, 2] = sigma**2
    return replace(field, surfaces=tuple(replace(one, common_covariance=common) for one in field.surfaces))


def plane_field(
    slope: tuple[float, float], sigma: float, rng: np.random.Generator, spacing: float = 0.23
) -> HeightField:
    """Points of a plane through (0, 0, 5), off along circles at 45 degrees by `sigma` (m) both sideways and upwards."""
    east, north = (spacing * (index - 29.7) for index in np.indices((60, 60))[::-1])
    circle = np.array([0.0, -1.0, 1.0])
    error = sigma * rng.standard_normal((60, 60, 1)) * circle
    plane = np.stack([east, north, 5 + slope[0] * east + slope[1] * north], axis=-1) + error
    own = np.broadcast_to(sigma**2 * np.outer(circle, circle), (60, 60, 3, 3))
    surface = Surface.seen_from(UNKNOWN_POSE, sphere_point(*np.moveaxis(plane, -1, 0)), own, np.full((60, 60), 20.0))
    grid = Grid(np.zeros(3), np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0]), spacing, spacing, 60, 60)
    return HeightField(grid, np.zeros((60, 60), np.uint8), (surface,))


@pytest.mark.parametrize("slope", [(0.0, 0.0), (0.1, 0.84), (0.3, -0.84)], ids=["level", "towards", "away"])
def test_heights_are_those_of_the_centres_of_cells_with_their_sigmas(slope: tuple[float, float]) -> None:
    """Twenty dwells, 13 x 13 inner cells of a pixel each or so: the share has a standard error of .8 %, 3 allowed."""
    rng, errors = np.random.default_rng(11), []
    for _ in range(20):
        relief = relief_of(plane_field(slope, 0.02, rng), cell_size=0.5)
        north, east = np.mgrid[: relief.height.shape[0], : relief.height.shape[1]] * 0.5
        ground = 5 + slope[0] * (east + relief.east) + slope[1] * (north + relief.north)
        errors.append(((relief.height - ground) / relief.sigma)[7:-7, 7:-7])
    share = np.mean(np.abs(errors) < 1)
    assert np.all(np.isfinite(errors))
    assert abs(share - 0.683) < 0.03


def test_where_the_slope_is_not_known_the_distance_to_the_centre_makes_sigma_greater() -> None:
    """A single pixel a quarter of a metre from the centre of its cell, on ground that may be as steep as 45 degrees."""
    relief = relief_of(field_at(0.75, 0.5, 3.0, 0.1))
    assert relief.height == 3.0
    np.testing.assert_allclose(relief.sigma, np.hypot(0.1, 0.25), rtol=1e-6)


def test_a_cell_that_holds_a_step_has_a_sigma_of_the_step() -> None:
    """Half of the pixels 12 cm above the others, each known to 1 cm; without them 1 cm / sqrt(20)."""
    height = np.where(np.arange(20) < 10, 0.0, 0.12)
    np.testing.assert_allclose(relief_of(field_at(np.full(20, 0.5), 0.5, height, 0.01)).sigma, 0.06, rtol=0.01)
    level = relief_of(field_at(np.full(20, 0.5), 0.5, 0.0, 0.01))
    np.testing.assert_allclose(level.sigma, 0.01 / np.sqrt(20), rtol=1e-6)


def test_weaker_scatterers_enter_only_if_they_are_all_but_certain() -> None:
    """A car's roof beside the road: of three pixels the first holds two scatterers, the second perhaps, the third one.

    An extended surface is no second scatterer.
    """
    road = field_at([0.5, 1.5, 2.5], 0.5, 0.0)
    roof = field_at([10.5, 11.5, 12.5], 0.5, 1.5)
    probability = np.array([[[0, 0.004, 0.99, 0.006, 0], [0, 0.1, 0.9, 0, 0], [0, 0, 0.2, 0, 0.8]]])
    both = replace(road, surfaces=(road.first, roof.first), order_probability=probability)
    relief = relief_of(both)
    np.testing.assert_array_equal(np.flatnonzero(relief.count), [0, 1, 2, 10])
    assert relief.height[0, 10] == 1.5
    unstated = relief_of(replace(both, order_probability=None))
    assert unstated.count.sum() == 3


def simulated_dwell(true: ApertureState, known: ApertureState, rng: np.random.Generator) -> HeightField:
    """Heights of level ground seen from `true`, by one who thinks to be at `known`.

    Range, Doppler and the elevation in the body are measured, the latter two of them with errors of the sigmas that
    are told.
    """
    shape, looks, sigma = (24, 18), 4, 2e-6
    grid = slant_plane_grid(make_sensor(), known, 5000.0, *shape, 1.188)
    row, col = np.meshgrid(*(np.arange(n, dtype=float) for n in shape), indexing="ij")
    sight = grid.points(row, col) - known.position
    slant_range = np.linalg.norm(sight, axis=-1) + grid.row_spacing / np.sqrt(12 * looks) * rng.standard_normal(shape)
    elevation = level_elevation(slant_range, sight @ known.direction, true) + sigma * rng.standard_normal(shape)
    estimate = ElevationEstimate.of_one(
        elevation, np.full(shape, sigma), np.full(shape, 50.0), np.full(shape, Validity.OK, np.uint8)
    )
    centres = replace(Looks.of(np.zeros((*shape, 2, 2)), looks), row=row, col=col)
    return height_field(estimate, centres, grid, look_grid(grid, *blocks(1, 1)), known, 1)


def level_elevation(slant_range: Array, along: Array, aperture: ApertureState) -> Array:
    """Elevation (rad) at which the circles of range and Doppler meet the sphere, by Newton's method."""
    elevation = np.full(slant_range.shape, np.pi / 4)

    def height(elevation: Array) -> Array:
        return height_of(locate_at_elevation(elevation, slant_range, along, aperture, 1))

    for _ in range(6):
        slope = (height(elevation + 1e-6) - height(elevation - 1e-6)) / 2e-6
        elevation = elevation - height(elevation) / slope
    assert np.abs(height(elevation)).max() < 1e-6
    return elevation


def astray(aperture: ApertureState, rng: np.random.Generator) -> ApertureState:
    """The aperture as a navigation with its covariance has it."""
    error = rng.multivariate_normal(np.zeros(6), aperture.covariance)
    return replace(
        aperture,
        position=aperture.position + error[:3],
        rotation=Rotation.from_rotvec(error[3:]).as_matrix() @ aperture.rotation,
    )


@pytest.mark.parametrize("alike", few(1, [False, True]))
def test_overlapping_dwells_agree_within_their_sigmas(alike: bool) -> None:
    """Errors of two dwells over their sigma have the mean square 1; so have differences, if poses err independently.

    If poses err alike, that of the map of both dwells is 1. Else it is less, as no map can tell: g^2 + (1 - g)^2 with
    the weight g of one dwell, which is at most 0.83 where the cell has one pixel of one and five of the other.

    One cell of each of 300 pairs counts, for the others share its pose: the mean of 300 squares has a standard error of
    8 %, 4 of them are allowed.
    """
    rng, trials = np.random.default_rng(5), 300
    each: list[float] = []
    errors, differences, spreads = [], [], []
    for _ in range(trials):
        first = astray(KNOWN_POSE, rng)
        poses = first, first if alike else astray(KNOWN_POSE, rng)
        fields = [simulated_dwell(KNOWN_POSE, pose, rng) for pose in poses]
        one, other, both = (
            middle_cell(relief_of(*chosen, cell_size=0.5)) for chosen in (fields[:1], fields[1:], fields)
        )
        each += [one[0] / one[1], other[0] / other[1]]
        differences.append((one[0] - other[0]) / np.hypot(one[1], other[1]))
        errors.append(both[0] / both[1])
        spreads.append(both[2])
    limit = 4 * np.sqrt(2 / trials)
    for values in (each, errors) if alike else (each, differences, spreads):
        assert abs(np.mean(np.square(values)) - 1) < limit
    for values in (differences, spreads) if alike else (errors,):
        assert np.mean(np.square(values)) < (1 - limit if alike else 0.83)


def middle_cell(relief: Relief) -> tuple[float, float, float]:
    """Height, sigma and disagreement of the cell with the least sigma of those that all dwells have seen."""
    by_all = np.where(relief.count == relief.count.max(), relief.sigma, np.nan)
    best = np.unravel_index(np.nanargmin(by_all), relief.sigma.shape)
    return tuple(float(layer[best]) for layer in (relief.height, relief.sigma, relief.disagreement))


def test_dwells_that_do_not_agree_show() -> None:
    """What moved up by 1 m between dwells of sigma 0.1 m, in one of two cells."""
    relief = relief_of(field_at([0.5, 1.5], 0.5, [2.0, 2.0]), field_at([0.5, 1.5], 0.5, [2.0, 3.0]))
    np.testing.assert_allclose(relief.disagreement, [[0.0, 1 / (np.sqrt(2) * 0.1)]], rtol=1e-6)


def test_levels_in_a_cell_are_a_spread_however_many_dwells_there_are() -> None:
    """Mixtures of two levels, of 0.3 m (rms) where each is known to 1 cm; the cell beside it is level."""
    rng, dwells = np.random.default_rng(9), 50
    fields = [
        field_at([0.5, 9.5], 0.5, [rng.normal(2, 0.3), rng.normal(2, 0.01)], 0.01, KNOWN_POSE) for _ in range(dwells)
    ]
    relief = relief_of(*fields)
    pose = relief_of(fields[0]).sigma[0, [0, -1]]
    assert relief.sigma[0, 0] == pytest.approx(0.3, rel=4 * np.sqrt(1 / (2 * dwells)))
    assert relief.sigma[0, -1] <= pose[1]


def test_a_step_that_each_dwell_sees_is_a_spread() -> None:
    """Two pixels of a cell, 1 m apart in height: half of that, of one dwell and of fifty."""
    both = field_at([0.5, 0.5], 0.5, [2.0, 3.0], 0.01)
    for dwells in (1, 50):
        assert relief_of(*[both] * dwells).sigma.item() == pytest.approx(0.5, rel=0.01)


def test_an_offset_that_a_dwell_has_in_all_cells_is_no_structure() -> None:
    rng, cells = np.random.default_rng(10), np.arange(40)
    dwells = [
        field_at(cells + 0.5, 0.5, 2 + offset + rng.normal(0, 0.01, len(cells)), 0.01) for offset in rng.normal(0, 1, 9)
    ]
    assert np.median(relief_of(*dwells).sigma) == pytest.approx(0.01 / 3, rel=1e-5)
    few = [field_at(cells[:9] + 0.5, 0.5, 2 + offset, 0.01) for offset in rng.normal(0, 1, 9)]
    assert np.median(relief_of(*few).sigma) > 0.5, "too few cells to tell an offset from structure"


def test_many_dwells_keep_all_digits() -> None:
    """Of 3000 m, 1 cm: chi-square neither cancels nor drifts; its degrees of freedom tell its standard deviation."""
    rng = np.random.default_rng(8)
    relief_map, dwells = ReliefMap(1.0, 100), 2000
    for height in rng.normal(3000.0, 0.01, dwells):
        relief_map.add(field_at(0.5, 0.5, height, 0.01))
    relief = relief_map.relief()
    assert relief is not None
    assert relief.count == dwells
    assert abs(relief.height.item() - 3000) < 4 * 0.01 / np.sqrt(dwells) + 3000 * 2**-24
    assert abs(relief.disagreement.item() ** 2 - 1) < 4 * np.sqrt(2 / (dwells - 1))


def test_the_map_grows_over_tiles_without_a_seam() -> None:
    """A plane across nine tiles, seen by strips that cut them anywhere."""
    east, north = (g.ravel() for g in np.meshgrid(np.arange(-300, 400) + 0.5, np.arange(-290, 310) + 0.5))
    height = 100 + 0.25 * east - 0.125 * north
    strips = [field_at(east[part], north[part], height[part]) for part in np.array_split(np.arange(len(east)), 7)]
    relief = relief_of(*strips)
    assert (relief.east, relief.north, relief.height.shape) == (-299.5, -289.5, (600, 700))
    np.testing.assert_allclose(relief.height, height.reshape(600, 700), rtol=1e-6)
    assert np.array_equal(relief.count, np.ones((600, 700)))


def test_what_would_make_the_map_too_large_is_refused_and_leaves_it_as_it_is() -> None:
    relief_map = ReliefMap(1.0, 1000)
    relief_map.add(field_at([0.5, 30.5], [0.5, 30.5], [1.0, 2.0]))
    before = relief_map.relief()
    with refused(Rejected, "31 x 41 cells of 1 m", "1000", reason="map full"):
        relief_map.add(field_at([0.5, 40.5], [0.5, 30.5], [9.0, 9.0]))
    after = relief_map.relief()
    assert before is not None
    assert after is not None
    for name in ("height", "sigma", "count"):
        np.testing.assert_array_equal(getattr(before, name), getattr(after, name))
    relief_map.add(field_at([0.5, 30.5], [0.5, 31.5], [1.0, 2.0]))  # 32 x 31 are allowed


def test_pixels_without_height_or_place_or_sigma_are_left_out() -> None:
    field = field_at([0.5, 0.5, 0.5, 0.5], 0.5, [1.0, np.nan, 5.0, 6.0], [0.1, 0.1, np.inf, 0.1])
    field.first.positions[0, 3, 1] = np.nan
    assert relief_of(field).height == 1.0


@pytest.mark.parametrize(
    ("row_spacing", "col_spacing", "size"),
    [(0.05, 0.02, 0.1), (0.1, 0.2, 0.2), (0.1, 0.201, 0.5), (0.01, 0.21, 0.5), (1.2, 0.1, 2.0)],
)
def test_a_pixel_fits_into_the_cell_that_is_chosen(row_spacing: float, col_spacing: float, size: float) -> None:
    """In the slant plane at 45 degrees a row is the square root of 2 longer on the ground."""
    sight = np.array([0.0, -1.0, -1.0]) / np.sqrt(2)
    origin = UNKNOWN_POSE.position + 5000 * sight
    grid = Grid(origin, sight, np.array([1.0, 0.0, 0.0]), row_spacing, col_spacing, 1, 1)
    assert fitting_cell_size(grid, UNKNOWN_POSE) == pytest.approx(size, rel=1e-12)
    level = replace(grid, row_direction=np.array([0.0, -1.0, 0.0]), row_spacing=row_spacing * np.sqrt(2))
    assert fitting_cell_size(level, UNKNOWN_POSE) == pytest.approx(size, rel=1e-12)


def test_a_grid_seen_from_above_is_refused() -> None:
    grid = Grid(np.zeros(3), np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0]), 1.0, 1.0, 1, 1)
    with refused(Rejected, "from the side"):
        fitting_cell_size(grid, UNKNOWN_POSE)
