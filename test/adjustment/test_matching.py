"""Images of the same ground are found beside each other, as well as stated; level ground tells the height alone."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from helpers import few
from scipy.ndimage import map_coordinates

from sal_height.adjustment._kernels import average_over_shifts, compare_shifts, sum_over_points
from sal_height.adjustment.matching import LEAST_INFORMATION, MOST_CONTRIBUTIONS, Match, Points, match

SPACING = 0.1
REACH = np.array([0.6, 0.6, 0.5])


def steps(east: np.ndarray, north: np.ndarray) -> np.ndarray:
    """A pavement with two boxes on it."""
    height = np.where(north > 1.5, 0.12, 0.0)
    height = np.where((np.abs(east) < 1.1) & (np.abs(north) < 0.9), 1.4, height)
    return np.where((np.abs(east - 2.2) < 0.4) & (np.abs(north + 1.6) < 0.5), 0.7, height)


def slope(east: np.ndarray, north: np.ndarray) -> np.ndarray:
    return 0.3 * east - 0.2 * north


def level(east: np.ndarray, north: np.ndarray) -> np.ndarray:
    return np.zeros_like(east + north)


def seen(ground: object, shift: np.ndarray, rng: np.random.Generator, wild: float = 0.0, half: float = 3.0) -> Points:
    """A dwell of a ground that lies off by a shift, with noise of 2 cm and a share of wild heights."""
    axis = np.arange(-half, half, SPACING)
    east, north = (values.ravel() + rng.uniform(-0.3, 0.3, values.size) * SPACING for values in np.meshgrid(axis, axis))
    height = ground(east, north) + 0.02 * rng.standard_normal(east.size)  # type: ignore[operator]
    off = rng.uniform(size=east.size) < wild
    height[off] += rng.uniform(-3, 3, off.sum())
    place = np.column_stack([east, north, height]) + shift
    return Points(place, np.full(east.size, 0.02), np.zeros(east.size), np.zeros(east.size, int), SPACING).connected


def found(ground: object, seed: int, wild: float = 0.0) -> tuple[Match, np.ndarray]:
    """A match of two dwells, and the true shift."""
    rng = np.random.default_rng(seed)
    shift = rng.uniform(-1, 1, 3) * [0.4, 0.4, 0.3]
    one, other = seen(ground, shift, rng, wild), seen(ground, np.zeros(3), rng, wild)
    matched = match(one, other.surface, REACH)
    assert matched is not None
    return matched, shift


@pytest.mark.parametrize(("wild", "most"), [(0.0, 0.05), (0.15, 0.05)])
def test_shift_over_steps_is_found_as_well_as_stated(wild: float, most: float) -> None:
    """12 pairs: within half a pixel, with wild heights, too; squares over what is stated have a mean below 1.7."""
    off, over = [], []
    for seed in range(12):
        matched, shift = found(steps, seed, wild)
        error = matched.shift - shift
        off.append(error)
        over.append(error @ matched.information @ error / 3)
    rms = np.sqrt(np.mean(np.square(off), axis=0))
    assert np.all(rms < [most, most, 0.004]), rms
    assert np.mean(over) < 1.7


def test_a_slope_tells_one_direction_and_the_height_no_more() -> None:
    """Along a contour nothing is known, and what the slope hides is not claimed."""
    matched, shift = found(slope, 3)
    contour = np.array([0.2, 0.3, 0.0]) / np.hypot(0.2, 0.3)
    assert contour @ matched.information @ contour < 1 / 0.3**2
    normal = np.array([-0.3, 0.2, 1.0])
    assert normal @ (matched.shift - shift) == pytest.approx(0.0, abs=0.01)


def test_level_ground_tells_the_height_alone() -> None:
    matched, shift = found(level, 4)
    assert matched.shift[2] == pytest.approx(shift[2], abs=0.004)
    assert np.all(np.diag(matched.information)[:2] < 1 / 0.3**2)
    assert matched.information[2, 2] > 1 / 0.01**2


def test_what_stands_alone_is_left_out() -> None:
    rng = np.random.default_rng(8)
    axis = np.arange(-1.0, 1.0, SPACING)
    east, north = (values.ravel() for values in np.meshgrid(axis, axis))
    height = 0.02 * rng.standard_normal(east.size)
    alone = np.array([25, 180, 333])
    height[alone] = [3.0, -2.0, 0.8]
    place = np.column_stack([east, north, height])
    points = Points(place, np.full(east.size, 0.02), np.zeros(east.size), np.zeros(east.size, int), SPACING)
    np.testing.assert_array_equal(points.connected.place, np.delete(place, alone, axis=0))


@pytest.mark.parametrize("ground", few(1, [slope, level]))
def test_wild_heights_are_no_shape(ground: object) -> None:
    """12 pairs with 15 % of wild heights, on ground that has none to tell a shift by."""
    over = []
    for seed in range(12):
        matched, shift = found(ground, seed, 0.15)
        error = matched.shift - shift
        over.append(error @ matched.information @ error / 3)
    assert np.mean(over) < 1.7


def test_images_that_do_not_overlap_do_not_match() -> None:
    rng = np.random.default_rng(5)
    one, other = seen(steps, np.array([30.0, 0, 0]), rng), seen(steps, np.zeros(3), rng)
    assert match(one, other.surface, REACH) is None
    high = seen(steps, np.array([0.0, 0.0, 8.0]), rng)
    assert match(high, other.surface, REACH) is None


@pytest.mark.parametrize("ground", [steps, slope])
def test_a_match_that_must_be_sure_says_no_more_than_twice_what_others_say(ground: object) -> None:
    """Of 6 pairs: standard deviations are the half at least, also along the contour of a slope."""
    for seed in range(6):
        rng = np.random.default_rng(seed)
        one, other = seen(ground, np.zeros(3), rng), seen(ground, np.zeros(3), rng)
        by_all, by_either = (
            np.minimum(np.linalg.inv(found.information).diagonal(), REACH**2 / 3)
            for kinds in (1, 2)
            if (found := match(one, other.surface, REACH, kinds))
        )
        shares = np.sqrt(by_either / by_all)
        assert np.all(shares > 0.5), shares


def test_few_points_and_points_on_a_line_do_no_harm() -> None:
    rng = np.random.default_rng(9)
    whole = seen(steps, np.zeros(3), rng)
    for place in (whole.place[:0], whole.place[:5], np.column_stack([np.arange(40) * 0.1, np.zeros(40), np.zeros(40)])):
        some = Points(place, np.full(len(place), 0.02), np.zeros(len(place)), np.zeros(len(place), int), SPACING)
        assert len(some.connected.place) <= len(place)
        assert match(some, whole.surface, REACH) is None or len(place) == 40
        if len(place) and (found_there := match(whole, some.surface, REACH)):
            assert abs(found_there.shift[2]) < 0.05


def test_a_wide_search_over_level_ground_stays_small() -> None:
    """Of 40 000 shifts all are likely: none is searched finely, and the result says that it does not know."""
    rng = np.random.default_rng(10)
    one, other = seen(level, np.zeros(3), rng), seen(level, np.zeros(3), rng)
    matched = match(one.thinned(300), other.surface, np.array([10.0, 10.0, 1.0]))
    assert matched is not None
    assert np.all(np.diag(matched.information)[:2] < 1.0)


@pytest.mark.parametrize("kinds", [1, 2])
def test_a_far_search_takes_bounded_memory(kinds: int) -> None:
    """Of 3600 points over 40 m to each side: thinned to MOST_CONTRIBUTIONS, and the shift is found all the same."""
    rng, shift = np.random.default_rng(5), np.array([12.3, -9.1, 0.2])
    one, other = seen(steps, shift, rng), seen(steps, np.zeros(3), rng)
    tracemalloc.start()
    matched = match(one, other.surface, np.array([40.0, 40.0, 0.5]), kinds)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 1.6 * 8 * MOST_CONTRIBUTIONS
    assert matched is not None
    np.testing.assert_allclose(matched.shift, shift, atol=0.1)


def test_dwells_that_met_have_their_shares() -> None:
    rng = np.random.default_rng(6)
    one = seen(steps, np.zeros(3), rng).numbered(7)
    halves = seen(steps, np.zeros(3), rng)
    surface = Points(
        halves.place, halves.sigma, halves.cnr_db, np.where(halves.place[:, 0] < 1.5, 2, 4), SPACING
    ).surface
    matched = match(one, surface, REACH)
    assert matched is not None
    first, second = matched.dwells
    assert first == {7: 1.0}
    assert second[2] == pytest.approx(0.75, abs=0.03)
    assert sum(second.values()) == pytest.approx(1.0)


def test_the_loop_is_what_its_description_says() -> None:
    rng = np.random.default_rng(7)
    one, other = seen(steps, np.zeros(3), rng, 0.1, 1.5), seen(steps, np.zeros(3), rng, 0.1, 1.5)
    surface, sigma = other.surface, np.hypot(one.sigma, one.roughness)
    place = np.column_stack([(one.place[:, :2] - surface.origin) / surface.step, one.place[:, 2]])
    cells = np.array([[0, 0], [3, -2], [-40, 11], [900, 0]])
    said, up = np.empty((2, 4, len(place))), np.empty((4, 2))
    bins, kernel = one.binned
    compare_shifts(place, sigma, bins, kernel, cells, surface.height, surface.sigma, np.array([2.0, 0.2, 1]), said, up)
    for told, (mean, weights), shift in zip(said.swapaxes(0, 1), up, cells, strict=True):
        at = place[:, :2] - shift
        there = map_coordinates(surface.height, at.T, order=1, mode="constant", cval=np.nan)
        cell = np.floor(at).astype(int)
        met = np.all((cell >= 0) & (cell < np.array(surface.height.shape) - 1), axis=1) & np.isfinite(there)
        east, north = np.where(met[:, None], cell, 0).T
        difference = place[:, 2] - there
        met &= np.abs(difference) <= 2.0
        np.testing.assert_array_equal(np.isfinite(told), [met, met])
        if not met.any():
            assert np.isnan(mean)
            continue
        difference, variance = difference[met], (sigma**2 + surface.sigma[east, north] ** 2)[met]
        expected = np.median(difference)
        for _ in range(4):
            fits = (difference - expected) ** 2 < 9 * variance
            expected = np.sum(difference[fits] / variance[fits]) / np.sum(1 / variance[fits])
        normal = np.exp(-((difference - expected) ** 2) / (2 * variance)) / np.sqrt(2 * np.pi * variance)
        for said_there, others in zip(told, (bins, bins[met]), strict=True):
            taps = bins[met][:, None] - others + len(kernel) // 2
            near = (taps >= 0) & (taps < len(kernel))
            density = np.where(near, kernel[np.clip(taps, 0, len(kernel) - 1)], 0.0).mean(axis=1)
            np.testing.assert_allclose(said_there[met], np.log(0.8 * normal / density + 0.2), rtol=1e-9)
        np.testing.assert_allclose([mean, weights], [expected, np.sum(1 / variance[fits])], rtol=1e-10)
    usual, score, said = np.empty(len(place)), np.empty(4), said[0]
    average_over_shifts(said, usual)
    sum_over_points(said, usual, score)
    expected = np.nan_to_num(np.nansum(said, axis=0) / np.maximum(1, np.isfinite(said).sum(axis=0)))
    np.testing.assert_allclose(usual, expected, rtol=1e-12)
    np.testing.assert_allclose(score, np.nansum(said - expected, axis=1), rtol=1e-9)


def test_what_a_match_says_of_place_and_of_height_is_all_that_it_says() -> None:
    """Of the place whatever the height is; of the height about the most likely ones, a plane over the places."""
    root = np.random.default_rng(3).standard_normal((3, 3))
    found = Match(np.arange(3.0), root @ root.T + np.eye(3), ({0: 1.0}, {1: 1.0}), 1.0)
    place, height = found.of_place(), found.of_height()
    np.testing.assert_allclose(place.information + height.information, found.information, atol=3 * LEAST_INFORMATION)
    covariance = np.linalg.inv(found.information)
    np.testing.assert_allclose(np.linalg.inv(place.information[:2, :2]), covariance[:2, :2], rtol=1e-4)
    np.testing.assert_allclose(place.information[2], 0.0, atol=2 * LEAST_INFORMATION)
    np.testing.assert_array_equal(place.shift, height.shift)
