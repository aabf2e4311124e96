"""Relief map: weights, sigmas that are true, dwells that disagree, growth, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from helpers import assert_one_sentence, blocks, make_aperture, make_sensor
from scipy.spatial.transform import Rotation

from sal_height.elevation.estimate import ElevationEstimate, Validity
from sal_height.elevation.looks import Looks, look_grid
from sal_height.errors import Rejected
from sal_height.geometry.earth import height_of, sphere_point
from sal_height.geometry.frames import ApertureState
from sal_height.geometry.grid import Grid
from sal_height.geometry.locate import locate_at_elevation
from sal_height.imaging.pixels import slant_plane_grid
from sal_height.relief.heights import HeightField, Surface, height_field, shared_variance
from sal_height.relief.map import TILE, Relief, ReliefMap, fitting_cell_size

Array = npt.NDArray[np.float64]

UNKNOWN_POSE = make_aperture()
COVARIANCE = np.diag([0.05, 0.04, 0.06, 2e-5, 1.5e-5, 3e-5]) ** 2
COVARIANCE[1, 3] = COVARIANCE[3, 1] = 0.3 * 0.04 * 2e-5
KNOWN_POSE = replace(make_aperture(angles=(0.03, -0.02, 0.1), velocity=(49.0, 5.0, -1.0)), covariance=COVARIANCE)


def surface_at(east: npt.ArrayLike, north: npt.ArrayLike, height: npt.ArrayLike, sigma: npt.ArrayLike = 0.1) -> Surface:
    """Scatterers in one row of pixels."""
    east, north, height, sigma = (
        np.atleast_2d(values).astype(float) for values in np.broadcast_arrays(east, north, height, sigma)
    )
    return Surface.at(sphere_point(east, north, height), height, sigma, np.full(height.shape, 20.0))


def relief_of(*surfaces: Surface, aperture: ApertureState = UNKNOWN_POSE, cell_size: float = 1.0) -> Relief:
    relief_map = ReliefMap(cell_size, 10_000_000)
    for surface in surfaces:
        relief_map.add(surface, aperture)
    relief = relief_map.relief()
    assert relief is not None
    return relief


def test_a_map_that_has_seen_nothing_is_none() -> None:
    relief_map = ReliefMap(1.0, 100)
    relief_map.add(surface_at([0.5, 1.5], 0.5, np.nan), KNOWN_POSE)
    assert relief_map.relief() is None


def test_cells_are_at_multiples_of_their_size_and_nan_where_unseen() -> None:
    relief = relief_of(surface_at([-4.9, 7.0], [-30_000.1, -29_999.0], [3.0, 5.0]), cell_size=2.0)
    assert (relief.east, relief.north, relief.cell_size) == (-5.0, -30_001.0, 2.0)
    nan = np.nan
    np.testing.assert_allclose(relief.height, [[3, nan, nan, nan, nan, nan, nan], [nan, nan, nan, nan, nan, nan, 5]])
    np.testing.assert_allclose(relief.sigma, np.where(np.isfinite(relief.height), 0.1, nan), rtol=1e-6)
    assert np.array_equal(relief.count, np.isfinite(relief.height))
    assert np.isnan(relief.disagreement).all()


def test_places_are_arc_distances_however_high_and_far() -> None:
    """At 100 km the plane's x is 4 m less than the arc, and 2 km of height move a point 31 m outwards in it."""
    relief = relief_of(surface_at(100_000.25, -30_000.25, 2000.0), cell_size=0.5)
    assert (relief.east, relief.north) == (100_000.25, -30_000.25)


def test_pixels_and_dwells_are_weighted_by_inverse_variance() -> None:
    """Without a common part: 1 / sigma^2 add up, however the pixels come."""
    heights, sigmas = np.array([1.0, 2.0, 4.0, 9.0]), np.array([0.1, 0.2, 0.4, 0.3])
    weights = 1 / sigmas**2
    one = relief_of(surface_at(0.5, 0.5, heights, sigmas))
    several = relief_of(*(surface_at(0.5, 0.5, h, s) for h, s in zip(heights, sigmas, strict=True)))
    for relief, count in ((one, 1), (several, 4)):
        np.testing.assert_allclose(relief.height, weights @ heights / weights.sum(), rtol=1e-6)
        np.testing.assert_allclose(relief.sigma, 1 / np.sqrt(weights.sum()), rtol=1e-6)
        assert relief.count == count
    mean = weights @ heights / weights.sum()
    np.testing.assert_allclose(several.disagreement, np.sqrt(weights @ (heights - mean) ** 2 / 3), rtol=1e-6)


def test_the_order_of_dwells_does_not_matter() -> None:
    rng = np.random.default_rng(3)
    dwells = [
        surface_at(*rng.uniform(-TILE, TILE, (2, 500)), rng.normal(2000, 1, 500), rng.uniform(0.1, 1, 500))
        for _ in range(6)
    ]
    forth, back = relief_of(*dwells, cell_size=16.0), relief_of(*dwells[::-1], cell_size=16.0)
    assert forth.count.max() == 6
    for name in ("height", "sigma", "disagreement"):
        np.testing.assert_allclose(getattr(forth, name), getattr(back, name), rtol=1e-6)


@pytest.mark.parametrize("sliding", [False, True], ids=["spotlight", "stripmap"])
@pytest.mark.parametrize("side", [1, -1], ids=["right", "left"])
def test_the_common_part_is_what_the_pose_adds_to_the_sigma_of_heights(side: int, sliding: bool) -> None:
    """Elevations and ranges without errors leave sigma nothing else."""
    aperture = replace(KNOWN_POSE, sliding=sliding)
    grid = replace(slant_plane_grid(make_sensor(look_side=side), aperture, 5000.0, 30, 20, 1.188), col_spacing=20.0)
    row, col = np.meshgrid(np.arange(30.0), np.arange(20.0), indexing="ij")
    elevation = np.full(row.shape, np.pi / 4 + 1e-3)
    certain = replace(Looks.of(np.zeros((30, 20, 2, 2)), 1e12), row=row, col=col)
    zero = np.zeros(row.shape)
    estimate = ElevationEstimate.of_one(elevation, zero, zero + 50, zero.astype(np.uint8))
    field = height_field(estimate, certain, grid, grid, aperture, side)
    common = shared_variance(field.first.positions.reshape(-1, 3), aperture)
    np.testing.assert_allclose(np.sqrt(common), field.first.sigma.ravel(), rtol=1e-5)
    assert 0.05 < field.first.sigma.min() < field.first.sigma.max() < 0.3


def test_the_common_part_is_not_averaged_away_within_a_dwell_but_among_dwells() -> None:
    """Pixels of one variance: (sigma^2 - c) / n + c; and the same again over the number of dwells."""
    east, north, pixels, dwells, own = -500.5, -3500.5, 400, 5, 0.3
    common = float(shared_variance(sphere_point([east], [north], [2.0]), KNOWN_POSE)[0])
    surface = surface_at(np.full(pixels, east), north, 2.0, np.sqrt(own**2 + common))
    for count in (1, dwells):
        relief = relief_of(*[surface] * count, aperture=KNOWN_POSE)
        np.testing.assert_allclose(relief.sigma, np.sqrt((own**2 / pixels + common) / count), rtol=1e-5)
    assert common > 20 * own**2 / pixels


def test_the_common_part_follows_the_ground() -> None:
    """Pixels without errors of their own, ten in each cell: only the common part is left, nine tenths of it computed.

    Once per square, it is right in each cell to some thousandths, as a square is a thousandth of the flight height.
    """
    index = np.arange(150) + 0.5
    east, north = (0.2 * g.ravel() for g in np.meshgrid(index - 75, index - 17_750))
    common = shared_variance(sphere_point(east, north, 0.0), KNOWN_POSE)
    pixels = surface_at(*(np.repeat(values, 10) for values in (east, north, np.zeros(len(east)), np.sqrt(common))))
    relief = relief_of(pixels, aperture=KNOWN_POSE, cell_size=0.2)
    np.testing.assert_allclose(relief.sigma**2, common.reshape(150, 150), rtol=1e-3)
    assert np.ptp(common) > 5e-3 * common.mean()


def simulated_dwell(true: ApertureState, known: ApertureState, rng: np.random.Generator) -> HeightField:
    """Heights of level ground seen from `true`, by one who thinks to be at `known`.

    Range, Doppler and the elevation in the body are measured, the latter two of them with errors of the sigmas that
    are told.
    """
    shape, looks, sigma = (12, 8), 4, 2e-5
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


def test_overlapping_dwells_agree_within_their_sigmas() -> None:
    """68.3 % of the differences of two dwells within 1 combined sigma, and so for the map of both against the truth.

    One cell of each of 1500 pairs counts, for the others share its pose: the share has a standard error of 1.2 %.
    """
    rng = np.random.default_rng(5)
    trials, agree, right, chi_square = 1500, 0, 0, 0.0
    for _ in range(trials):
        fields = [simulated_dwell(KNOWN_POSE, astray(KNOWN_POSE, rng), rng) for _ in range(2)]
        one, other, both = (
            middle_cell(relief_of(*(field.first for field in chosen), aperture=KNOWN_POSE, cell_size=10.0))
            for chosen in (fields[:1], fields[1:], fields)
        )
        agree += abs(one[0] - other[0]) < np.hypot(one[1], other[1])
        right += abs(both[0]) < both[1]
        chi_square += both[2] ** 2 / trials
    assert abs(agree / trials - 0.683) < 0.03
    assert abs(right / trials - 0.683) < 0.03
    assert abs(chi_square - 1) < 4 * np.sqrt(2 / trials)


def middle_cell(relief: Relief) -> tuple[float, float, float]:
    """Height, sigma and disagreement of the only cell with most of the pixels: that with the least sigma."""
    best = np.unravel_index(np.nanargmin(relief.sigma), relief.sigma.shape)
    return tuple(float(layer[best]) for layer in (relief.height, relief.sigma, relief.disagreement))


def test_dwells_that_do_not_agree_show() -> None:
    """What moved up by 1 m between dwells of sigma 0.1 m, in one of two cells."""
    relief = relief_of(surface_at([0.5, 1.5], 0.5, [2.0, 2.0]), surface_at([0.5, 1.5], 0.5, [2.0, 3.0]))
    np.testing.assert_allclose(relief.disagreement, [[0.0, 1 / (np.sqrt(2) * 0.1)]], rtol=1e-6)


def test_many_dwells_keep_all_digits() -> None:
    """Of 3000 m, 1 cm: chi-square neither cancels nor drifts; its degrees of freedom tell its standard deviation."""
    rng = np.random.default_rng(8)
    relief_map, dwells = ReliefMap(1.0, 100), 2000
    for height in rng.normal(3000.0, 0.01, dwells):
        relief_map.add(surface_at(0.5, 0.5, height, 0.01), UNKNOWN_POSE)
    relief = relief_map.relief()
    assert relief is not None
    assert relief.count == dwells
    assert abs(relief.height.item() - 3000) < 4 * 0.01 / np.sqrt(dwells) + 3000 * 2**-24
    assert abs(relief.disagreement.item() ** 2 - 1) < 4 * np.sqrt(2 / (dwells - 1))


def test_the_map_grows_over_tiles_without_a_seam() -> None:
    """A plane across nine tiles, seen by strips that cut them anywhere."""
    east, north = (g.ravel() for g in np.meshgrid(np.arange(-300, 400) + 0.5, np.arange(-290, 310) + 0.5))
    height = 100 + 0.25 * east - 0.125 * north
    strips = [surface_at(east[part], north[part], height[part]) for part in np.array_split(np.arange(len(east)), 7)]
    relief = relief_of(*strips)
    assert (relief.east, relief.north, relief.height.shape) == (-299.5, -289.5, (600, 700))
    np.testing.assert_allclose(relief.height, height.reshape(600, 700), rtol=1e-6)
    assert np.array_equal(relief.count, np.ones((600, 700)))


def test_what_would_make_the_map_too_large_is_refused_and_leaves_it_as_it_is() -> None:
    relief_map = ReliefMap(1.0, 1000)
    relief_map.add(surface_at([0.5, 30.5], [0.5, 30.5], [1.0, 2.0]), UNKNOWN_POSE)
    before = relief_map.relief()
    with pytest.raises(Rejected) as refused:
        relief_map.add(surface_at([0.5, 40.5], [0.5, 30.5], [9.0, 9.0]), UNKNOWN_POSE)
    assert refused.value.reason == "map full"
    assert_one_sentence(str(refused.value), "31 x 41 cells of 1 m", "1000")
    after = relief_map.relief()
    assert before is not None
    assert after is not None
    for name in ("height", "sigma", "count"):
        np.testing.assert_array_equal(getattr(before, name), getattr(after, name))
    relief_map.add(surface_at([0.5, 30.5], [0.5, 31.5], [1.0, 2.0]), UNKNOWN_POSE)  # 32 x 31 are allowed


def test_pixels_without_height_or_place_are_left_out() -> None:
    surface = surface_at([0.5, 0.5, 0.5, 0.5], 0.5, [1.0, np.nan, 5.0, 6.0], [0.1, 0.1, np.inf, 0.1])
    surface.positions[0, 3, 1] = np.nan
    assert relief_of(surface).height == 1.0


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
    with pytest.raises(Rejected) as refused:
        fitting_cell_size(grid, UNKNOWN_POSE)
    assert_one_sentence(str(refused.value), "from the side")
