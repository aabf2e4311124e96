"""The map of the ground: dwell after dwell it becomes what all dwells together give."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from sal_height.elevation import Validity
from sal_height.errors import Rejected
from sal_height.geometry import ApertureState, Grid, sphere_point
from sal_height.numeric import F64
from sal_height.relief import GroundEstimate, GroundKind, GroundMap, HeightField, Surface, fine_cell_size

SPACING, SIGMA, ROWS, COLS = 0.09, 0.01, 40, 12
APERTURE = ApertureState(np.array([0.0, 1000.0, 1000.0]), np.array([50.0, 0, 0]), np.eye(3), 0.1, np.zeros((6, 6)))


def dwell(number: int, rng: np.random.Generator, *, lift: float = 0.0) -> HeightField:
    """Level ground with a step of 0.4 m in its middle, seen from the north; dwells lie beside each other along east."""
    east, north = np.meshgrid((np.arange(COLS) + number * COLS) * SPACING + 0.02, np.arange(ROWS) * SPACING + 0.02)
    error = rng.normal(0.0, SIGMA, east.shape)
    height = np.where(north < SPACING * ROWS / 2, 0.4, 0.0) + lift + error
    positions = sphere_point(east, north - error, height)  # an error moves a point along its circle
    sigma = np.full(east.shape, SIGMA)
    surface = Surface.at(positions, height, sigma, np.full(east.shape, 20.0))
    grid = Grid(np.zeros(3), np.array([0.0, -1.0, 0.0]), np.array([1.0, 0.0, 0.0]), SPACING, SPACING, ROWS, COLS)
    return HeightField(grid, np.full(east.shape, Validity.OK, np.uint8), (surface,))


def mapped(fields: list[HeightField], max_cells: int = 100_000) -> GroundMap:
    ground = GroundMap(fine_cell_size(fields[0].grid), SPACING, max_cells)
    for field in fields:
        ground.add(field, APERTURE)
    return ground


def estimate_of(ground: GroundMap) -> GroundEstimate:
    found = ground.estimate()
    assert found is not None
    return found


def truth_of(found: GroundEstimate) -> F64:
    north = found.north + found.cell_size * np.arange(found.height.shape[0])
    return np.where(north < SPACING * ROWS / 2, 0.4, 0.0)[:, None]


@pytest.mark.parametrize("sigma", [0.01, 0.5, 10.0])
def test_an_error_that_all_share_makes_sigma_greater_and_changes_nothing_else(sigma: float) -> None:
    """Three dwells of the same ground with a gap, higher by 0, 0.3 and 0.6 m, and ghosts 3 m above it."""
    rng = np.random.default_rng(13)
    dwells = [with_gap(with_ghosts(dwell(0, rng, lift=lift), rng)) for lift in (0.0, 0.3, 0.6)]
    exact, shared = (mapped([with_shared_error(one, size) for one in dwells]) for size in (0.0, sigma))
    before, after = estimate_of(exact), estimate_of(shared)
    for name in ("height", "kind", "count"):
        assert np.array_equal(getattr(after, name), getattr(before, name), equal_nan=True)
    np.testing.assert_allclose(after.sigma, np.hypot(before.sigma, sigma), rtol=1e-9)
    assert len({*before.kind.ravel().tolist()}) >= 3


def test_dwells_that_err_by_metres_are_the_same_ground() -> None:
    """The second is 5 m higher, as with a boresight off by a milliradian: most cells are of both."""
    rng = np.random.default_rng(14)
    found = estimate_of(mapped([dwell(0, rng), dwell(0, rng, lift=5.0)]))
    measured = found.kind == GroundKind.MEASURED
    assert np.mean(np.abs(found.height - truth_of(found) - 2.5)[measured] < 0.1) > 0.9


@pytest.mark.parametrize("shared", [1, 2])
def test_a_roof_and_the_ground_beside_it_stay_apart_where_few_cells_are_seen_twice(shared: int) -> None:
    """One dwell saw a roof; another one saw the ground of its last columns, where the roof had hidden it, and more."""
    rng = np.random.default_rng(15)
    roof, ground = dwell(0, rng, lift=20.0), dwell(0, rng)
    beside = ground.surfaces[0].positions + np.array([(COLS - shared) * SPACING, 0.0, 0.0])
    ground = replace(ground, surfaces=(replace(ground.surfaces[0], positions=beside),))
    found = estimate_of(mapped([roof, ground]))
    off = np.abs(found.height - truth_of(found))
    assert not np.any((off > 5) & (off < 15))
    assert np.isfinite(found.height).sum() > 500


def test_a_dwell_that_states_that_all_of_its_error_is_shared_spoils_no_map() -> None:
    rng = np.random.default_rng(16)
    own, none = dwell(0, rng), with_shared_error(dwell(0, rng), 0.1)
    certain = replace(none.surfaces[0], own_covariance=np.zeros((*none.grid.shape, 3, 3)))
    found = estimate_of(mapped([own, replace(none, surfaces=(certain,))]))
    alone = estimate_of(mapped([own]))
    assert np.isfinite(found.height).sum() >= np.isfinite(alone.height).sum()
    assert np.nanmax(np.abs(found.height - truth_of(found))) < 0.5


def with_ghosts(field: HeightField, rng: np.random.Generator) -> HeightField:
    """A dwell with a second surface, of some pixels only."""
    first = field.surfaces[0]
    there = rng.uniform(size=field.grid.shape) < 0.05
    height = np.where(there, first.height + 3.0, np.nan)
    positions = first.positions + np.where(there, 3.0, np.nan)[..., None] * [0.0, -1.0, 1.0]
    validity = np.where(there, Validity.TWO_SCATTERERS, field.validity).astype(np.uint8)
    second = Surface.at(positions, height, np.where(there, SIGMA, np.nan), first.cnr_db)
    return replace(field, validity=validity, surfaces=(first, second))


def with_gap(field: HeightField) -> HeightField:
    """A dwell in which some rows have no signal."""
    there = np.ones(field.grid.shape, np.bool_)
    there[ROWS // 4 : ROWS // 4 + 6] = False
    validity = np.where(there, field.validity, Validity.NO_SIGNAL).astype(np.uint8)
    return replace(field, validity=validity, surfaces=tuple(one.where(there) for one in field.surfaces))


def with_shared_error(field: HeightField, sigma: float) -> HeightField:
    """A dwell whose heights err by SIGMA each along their circles, and all alike by `sigma`, m."""
    circle, common = np.array([0.0, -1.0, 1.0]), np.zeros((*field.grid.shape, 3, 3))
    common[..., 2, 2] = sigma**2
    surfaces = []
    for one in field.surfaces:
        own = one.sigma[..., None, None] ** 2 * np.outer(circle, circle)
        total = np.hypot(one.sigma, sigma)
        surfaces.append(replace(one, sigma=total, own_covariance=own, common_covariance=common))
    return replace(field, surfaces=tuple(surfaces))


@pytest.mark.parametrize("numbers", [range(5), (0, 20)], ids=["beside each other", "far apart"])
def test_the_live_estimate_is_that_of_all_dwells_at_once(numbers: Sequence[int]) -> None:
    """Five dwells are estimated together; two with 31 000 cells around them one by one."""
    rng = np.random.default_rng(1)
    ground = mapped([dwell(number, rng) for number in numbers])
    live = estimate_of(ground)
    heights, kinds = live.height.copy(), live.kind.copy()
    ground.settle()
    final = estimate_of(ground)
    assert np.mean(kinds == final.kind) > 0.99
    both = np.isfinite(heights) & np.isfinite(final.height)
    assert np.sum(both) > 600 * len(numbers)
    assert np.quantile(np.abs(heights - final.height)[both], 0.99) < 0.5 * SIGMA


def test_dwells_over_the_same_ground_average() -> None:
    rng = np.random.default_rng(2)
    one, four = (estimate_of(mapped([dwell(0, rng) for _ in range(count)])) for count in (1, 4))
    inner = np.s_[8:30, 4:-4]
    assert 0.45 < np.nanmedian(four.sigma[inner]) / np.nanmedian(one.sigma[inner]) < 0.7  # 1/2, and their disagreement
    assert np.nanmax(np.abs(four.height - truth_of(four))[inner]) < 0.03
    assert four.count.max() == 4


def test_what_dwells_have_in_common_does_not_average() -> None:
    """Three sigmas of common error are left of however many dwells."""
    rng, inner, common = np.random.default_rng(7), np.s_[8:30, 4:-4], 3 * SIGMA
    fields = [dwell(0, rng) for _ in range(4)]
    shared = [with_common(field, common) for field in fields]
    own, together = (estimate_of(mapped(each)).sigma[inner] for each in (fields, shared))
    np.testing.assert_allclose(together, np.hypot(own, common), rtol=0.03)


def with_common(field: HeightField, sigma: float) -> HeightField:
    """The same heights with an error (m) upwards that all pixels share."""
    common = np.zeros_like(field.first.own_covariance)
    common[..., 2, 2] = sigma**2
    return replace(field, surfaces=(replace(field.first, common_covariance=common),))


def test_the_step_is_kept() -> None:
    found = estimate_of(mapped([dwell(number, np.random.default_rng(3)) for number in range(3)]))
    north = found.north + found.cell_size * np.arange(found.height.shape[0])
    away = np.abs(north - SPACING * ROWS / 2) > SPACING
    assert np.nanmax(np.abs(found.height - truth_of(found))[away]) < 5 * SIGMA
    assert np.mean(found.kind == GroundKind.MEASURED) > 0.9


def test_a_refused_dwell_changes_nothing() -> None:
    rng = np.random.default_rng(4)
    ground = mapped([dwell(0, rng)], max_cells=3000)
    before = estimate_of(ground)
    with pytest.raises(Rejected, match="more than the 3000 that max_cells allows"):
        ground.add(dwell(5, rng), APERTURE)
    after = estimate_of(ground)
    assert after.height.shape == before.height.shape
    assert np.array_equal(after.height, before.height, equal_nan=True)


def test_without_any_dwell_there_is_no_map() -> None:
    ground = GroundMap(0.05, SPACING, 1000)
    ground.settle()
    assert ground.estimate() is None
    assert ground.relief() is None


def test_the_cell_size_suits_the_pixels() -> None:
    for spacing, cell_size in ((0.09, 0.05), (0.14, 0.1), (30.0, 20.0)):
        grid = Grid(np.zeros(3), np.array([0.0, -1.0, 0.0]), np.array([1.0, 0.0, 0.0]), spacing, spacing / 2, 4, 4)
        assert np.isclose(fine_cell_size(grid), cell_size)
