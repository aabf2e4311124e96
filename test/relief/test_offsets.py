"""Shared errors of dwells: how far the stated part averages out in both maps, and data that contradict a statement."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from helpers import few

from sal_height.elevation import Validity
from sal_height.errors import UserError
from sal_height.geometry import ApertureState, Grid, height_of, sphere_point
from sal_height.numeric import F64
from sal_height.relief import GroundMap, HeightField, ReliefMap, SharedError, Surface, fine_cell_size, stated_course
from sal_height.relief.cell_map import CellMap, Relief
from sal_height.relief.offsets import LASTING, LEAST_SHARED, OffsetTest

APERTURE = ApertureState(np.array([0.0, 1000.0, 1000.0]), np.array([50.0, 0, 0]), np.eye(3), 0.1, np.zeros((6, 6)))
GRID = Grid(np.zeros(3), np.array([0.0, -1.0, 0.0]), np.array([1.0, 0.0, 0.0]), 0.09, 0.09, 12, 12)
COURSE, LASTS, OWN = SharedError(0.3, 10.0), 0.4, 0.001
"""Course of the shared error, standard deviation of its part that lasts, and of errors of pixels, m."""

MAPS: dict[str, Callable[[SharedError], CellMap]] = {
    "relief": lambda shared: ReliefMap(0.2, 10_000, shared),
    "ground": lambda shared: GroundMap(fine_cell_size(GRID), 0.09, 100_000, shared=shared),
}


def correlation_of(times: F64, course: SharedError) -> F64:
    """Correlation of the varying errors of dwells at some times, s, shape (dwells, dwells)."""
    return np.asarray(np.exp(-np.abs(times[:, None] - times) / course.correlation))


def varying_offsets(times: F64, course: SharedError, rng: np.random.Generator) -> F64:
    """Varying errors of dwells at some times, s, by the root of their whole covariance, m."""
    root = np.linalg.cholesky(correlation_of(times, course) + 1e-12 * np.eye(len(times)))
    return course.varying * root @ rng.standard_normal(len(times))


def dwell_of(lift: float, rng: np.random.Generator) -> HeightField:
    """Level ground seen from the north, `lift` m too high, with a shared error that is stated."""
    shape = GRID.shape
    east, north = np.meshgrid(0.09 * np.arange(shape[1]) + 0.02, 0.09 * np.arange(shape[0]) + 0.02)
    positions = sphere_point(east, north, lift + OWN * rng.standard_normal(shape))
    own, common = np.zeros((2, *shape, 3, 3))
    own[..., 2, 2], common[..., 2, 2] = OWN**2, COURSE.varying**2 + LASTS**2
    sigma = np.sqrt(own + common)[..., 2, 2]
    surface = Surface(
        height_of(positions), sigma, np.full(shape, 20.0), positions, np.zeros(shape), own, common_covariance=common
    )
    return HeightField(GRID, np.full(shape, Validity.OK, np.uint8), (surface,))


def relief_of(made: CellMap, times: F64, lifts: F64, rng: np.random.Generator) -> Relief:
    for time, lift in zip(times, lifts, strict=True):
        made.add(dwell_of(lift, rng), APERTURE, time)
    relief = made.relief()
    assert relief is not None
    return relief


TIMES = np.array([0.0, 1.0, 3.0, 20.0, 21.0, 60.0, 75.0, 76.0])


@pytest.mark.parametrize("kind", MAPS)
def test_sigma_is_that_of_the_mean_of_a_process_of_the_stated_correlation(kind: str) -> None:
    """All dwells have one weight: the mean of the part that varies has the mean of the whole correlation matrix."""
    rng = np.random.default_rng(1)
    relief = relief_of(MAPS[kind](COURSE), TIMES, varying_offsets(TIMES, COURSE, rng), rng)
    varying = COURSE.varying**2 * correlation_of(TIMES, COURSE).mean()
    by_all = relief.count == len(TIMES)
    assert np.median(relief.sigma[by_all]) == pytest.approx(np.sqrt(LASTS**2 + varying), rel=0.003)


OUT_OF_ORDER = {
    "one stamped ahead": np.array([*range(20), 200.0, *range(20, 30)]),
    "late ones": np.array([*range(20), 200.0, *range(5, 15)]),
    "two sensors": np.ravel([(time, time - 20.5) for time in 2.0 * np.arange(20)]),
}
"""Times of dwells in the order of their arrival, s."""


@pytest.mark.parametrize("kind", MAPS)
@pytest.mark.parametrize("order", OUT_OF_ORDER)
def test_dwells_out_of_order_have_no_sigma_below_that_of_their_mean(kind: str, order: str) -> None:
    """A dwell has more in common with those around its time than with the latest one."""
    rng, times = np.random.default_rng(9), OUT_OF_ORDER[order]
    relief = relief_of(MAPS[kind](COURSE), 1.7e9 + times, varying_offsets(times, COURSE, rng), rng)
    found = np.median(relief.sigma[relief.count == len(times)])
    varying = COURSE.varying**2 * correlation_of(times, COURSE).mean()
    assert np.sqrt(LASTS**2 + 0.99 * varying) < found < 0.99 * np.hypot(LASTS, COURSE.varying)


def test_neighbours_that_are_swapped_make_little_difference() -> None:
    """By half a correlation time; the variance of the varying part is at most 1.3 times that of their mean."""
    rng, times = np.random.default_rng(10), np.ravel([(time + 5.0, time) for time in 10.0 * np.arange(20)])
    relief = relief_of(ReliefMap(0.2, 10_000, COURSE), times, varying_offsets(times, COURSE, rng), rng)
    found = np.median(relief.sigma[relief.count == len(times)])
    varying = COURSE.varying**2 * correlation_of(times, COURSE).mean()
    assert np.sqrt(LASTS**2 + 0.99 * varying) < found < np.sqrt(LASTS**2 + 1.3 * varying)


@pytest.mark.parametrize("kind", MAPS)
def test_without_a_statement_the_shared_error_stays(kind: str) -> None:
    rng = np.random.default_rng(2)
    relief = relief_of(MAPS[kind](LASTING), TIMES, np.zeros(len(TIMES)), rng)
    assert np.nanmedian(relief.sigma) == pytest.approx(np.hypot(LASTS, COURSE.varying), rel=0.003)


@pytest.mark.parametrize("kind", MAPS)
def test_no_more_averages_out_than_there_is(kind: str) -> None:
    """More varying error is stated than the messages have in common: the rest is 0, not less."""
    rng, course = np.random.default_rng(3), SharedError(100.0, 1e-3)
    relief = relief_of(MAPS[kind](course), TIMES[:2], np.array([-50.0, 50.0]) * 2, rng)
    assert np.nanmax(relief.count) >= 1
    assert np.isfinite(relief.sigma[np.isfinite(relief.height)]).all()


def test_errors_of_the_map_have_the_sigma_that_it_publishes() -> None:
    """Of 400 flights of eight dwells: the mean square of errors over sigma is 1; its standard error is 7 %."""
    rng, flights = np.random.default_rng(4), 400
    scores = []
    for _ in range(flights):
        lifts = LASTS * rng.standard_normal() + varying_offsets(TIMES, COURSE, rng)
        relief = relief_of(ReliefMap(0.2, 10_000, COURSE), TIMES, lifts, rng)
        scores.append(float(relief.height[2, 2] / relief.sigma[2, 2]))
    assert abs(np.mean(np.square(scores)) - 1) < 4 * np.sqrt(2 / flights)


@pytest.mark.parametrize("kind", MAPS)
def test_offsets_that_last_contradict_the_statement_and_average_out_no_more(kind: str) -> None:
    """Twelve dwells over a minute, all off alike: independent ones would differ by 0.3 m."""
    rng, times = np.random.default_rng(5), 5.0 * np.arange(12.0)
    made = MAPS[kind](COURSE)
    relief = relief_of(made, times, np.full(len(times), 0.7), rng)
    assert made.contradiction is not None
    assert "varying_offset_m = 0.3 and offset_correlation_s = 10" in made.contradiction
    assert np.nanmedian(relief.sigma) == pytest.approx(np.hypot(LASTS, COURSE.varying), rel=0.003)


def found_after(truth: SharedError, interval: float, dwells: int, rng: np.random.Generator) -> int | None:
    """Number of dwells after which offsets that have the course `truth` contradict COURSE; None: they do not."""
    test, cells = OffsetTest(COURSE), np.arange(2 * LEAST_SHARED)
    times = interval * np.arange(float(dwells))
    lifts = LASTS * rng.standard_normal() + varying_offsets(times, truth, rng)
    for number, (time, lift) in enumerate(zip(times, lifts, strict=True), start=1):
        test.add(cells, lift + OWN * rng.standard_normal(len(cells)), time)
        if test.contradiction:
            return number
    return None


@pytest.mark.parametrize("interval", few(1, [2.0, 0.1, 30.0]))
def test_a_right_statement_is_not_contradicted(interval: float) -> None:
    """200 flights of 60 dwells, tested after each: 1e-6 and less than 60 times that are expected."""
    rng = np.random.default_rng(6)
    assert {found_after(COURSE, interval, 60, rng) for _ in range(200)} == {None}


@pytest.mark.parametrize(
    "truth", [SharedError(0.0, 10.0), SharedError(0.3, 100.0), SharedError(0.1, 10.0)], ids=["none", "slow", "small"]
)
def test_a_wrong_statement_is_contradicted_within_100_dwells(truth: SharedError) -> None:
    rng = np.random.default_rng(7)
    found = [found_after(truth, 2.0, 100, rng) for _ in range(20)]
    assert None not in found


def test_a_chain_ends_where_dwells_share_too_few_cells() -> None:
    """Dwells that see other ground by pairs: the differences within pairs count, those between pairs do not."""
    test, rng = OffsetTest(COURSE), np.random.default_rng(8)
    for pair in range(30):
        cells = 1000 * pair + np.arange(2 * LEAST_SHARED)
        for time in (0.0, 50.0):
            lift = 0.3 * rng.standard_normal() if pair < 25 else 0.0
            test.add(cells, np.full(len(cells), 100.0 * pair + lift), 100.0 * pair + time)
    assert test.contradiction is None
    few_cells = np.arange(LEAST_SHARED - 1)
    for time in range(200):
        test.add(few_cells, np.zeros(len(few_cells)), 1e4 + 50.0 * time)
    assert test.contradiction is None, "too few cells were compared"


@pytest.mark.parametrize(
    ("stated", "missing"), [((0.3, 0.0), "offset_correlation_s"), ((0.0, 9.0), "varying_offset_m")]
)
def test_half_of_a_statement_is_refused(stated: tuple[float, float], missing: str) -> None:
    with pytest.raises(UserError, match=f"without {missing}"):
        stated_course(*stated)


def test_nothing_stated_lasts() -> None:
    assert stated_course(0.0, 0.0) == LASTING
    assert stated_course(0.3, 10.0) == COURSE
