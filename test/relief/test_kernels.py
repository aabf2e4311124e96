"""Compiled loops against the same formulas and recursions in NumPy."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from scipy.ndimage import uniform_filter

from sal_height.relief import _kernels as kernels
from sal_height.relief import _map_kernels as map_kernels
from sal_height.relief import _tracking_kernels as tracking

Array = npt.NDArray[np.float64]

STEP = (0.9, 0.3)
PRIOR = (2.0, 1.5)
GATE = 2.0


def measured(dtype: str = "float64") -> tuple[Array, Array]:
    """Heights and sigmas, some of which are no measurements, of which each kind stands alone and together."""
    rng = np.random.default_rng(1)
    height, sigma = 2 + 2 * rng.standard_normal((40, 9)), np.exp(0.5 * rng.standard_normal((40, 9)))
    height[3, :3], height[7, 2], sigma[7, 2] = [np.nan, np.inf, -np.inf], np.nan, np.nan
    sigma[5, :5] = [np.nan, np.inf, 0.0, -1.0, 1e-200]
    return height.astype(dtype), sigma.astype(dtype)


def filter_rows(height: Array, sigma: Array) -> tuple[Array, Array, Array]:
    states, variances, outliers = [], [], []
    predicted, spread = np.zeros(height.shape[1]), np.full(height.shape[1], PRIOR[1])
    for values, errors in zip(height.astype(np.float64), sigma.astype(np.float64), strict=True):
        known = np.isfinite(values) & np.isfinite(errors) & (errors > tracking.LEAST_SIGMA)
        innovation = np.where(known, values - PRIOR[0] - predicted, 0.0)
        square = np.where(known, errors, np.inf) ** 2
        outlier = innovation**2 > GATE**2 * (spread + square)
        gain = np.where(outlier, 0.0, spread / (spread + square))
        states.append(predicted + gain * innovation)
        variances.append((1 - gain) * spread)
        outliers.append(outlier)
        predicted, spread = STEP[0] * states[-1], STEP[0] ** 2 * variances[-1] + STEP[1]
    return np.array(states), np.array(variances), np.array(outliers)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_filter(dtype: str) -> None:
    height, sigma = measured(dtype)
    state, variance, outlier = np.empty((40, 9)), np.empty((40, 9)), np.empty((40, 9), np.bool_)
    tracking.filter_columns(height, sigma, PRIOR, STEP, GATE, state, variance, outlier)
    expected = filter_rows(height, sigma)
    assert 0 < np.mean(expected[2]) < 0.5
    np.testing.assert_array_equal(outlier, expected[2])
    np.testing.assert_allclose(state, expected[0], atol=1e-12)
    np.testing.assert_allclose(variance, expected[1], rtol=1e-12)


def test_smoother() -> None:
    states, variances, _ = filter_rows(*measured())
    state, variance = states.copy(), variances.copy()
    tracking.smooth_columns(STEP, state, variance)
    for i in range(len(states) - 2, -1, -1):
        predicted = STEP[0] ** 2 * variances[i] + STEP[1]
        back = STEP[0] * variances[i] / predicted
        states[i] += back * (states[i + 1] - STEP[0] * states[i])
        variances[i] += back**2 * (variances[i + 1] - predicted)
    np.testing.assert_allclose(state, states, atol=1e-12)
    np.testing.assert_allclose(variance, variances, rtol=1e-12)


def test_likelihoods() -> None:
    """An innovation is normal or, with the probability `share`, an outlier; the filter weighs it by the former.

    The twin holds the covariance of all cells of a window and of their mean, and has no rows to predict.
    """
    rng = np.random.default_rng(2)
    shape, variances, steps, share, density = (2, 6, 4), (1.5, 3.0), (0.9, 0.7), 0.1, 0.05
    deviation, precision = 2 * rng.standard_normal(shape), rng.uniform(0.2, 3.0, shape)
    precision[rng.random(shape) < 0.2] = 0.0
    down, along = (
        step ** np.abs(np.subtract.outer(np.arange(n), np.arange(n))) for n, step in zip(shape[1:], steps, strict=True)
    )
    expected = np.zeros(shape)
    for window, heights in enumerate(deviation):
        state, spread = np.zeros(heights.size), variances[0] * np.kron(down, along) + variances[1]
        for cell, height in enumerate(heights.ravel()):
            weight = precision[window].flat[cell]
            if weight:
                innovation, variance = height - state[cell], spread[cell, cell] + 1 / weight
                near = (1 - share) * np.exp(-(innovation**2) / (2 * variance)) / np.sqrt(2 * np.pi * variance)
                inlier = near / (near + share * density)
                expected[window].flat[cell] = np.log(near + share * density)
                gain = spread[cell] / variance
                state = state + inlier * gain * innovation
                shrink = inlier * variance - inlier * (1 - inlier) * innovation**2
                spread = spread - shrink * np.outer(gain, gain)
    found = np.empty((2, *shape))
    others = np.array([[0.2, 1.0], variances]), np.array([[0.5, 0.6], steps])
    tracking.likelihoods(deviation, precision, *others, (share, density), found)
    np.testing.assert_allclose(np.log(found[1]), expected, atol=1e-12)


def test_slopes_are_differences_of_logarithms_and_add_up() -> None:
    likelihoods, rise, information = np.random.default_rng(5).uniform(0.1, 2.0, (4, 50)), np.zeros(2), np.zeros((2, 2))
    tracking.add_slopes(likelihoods, 0.05, rise, information)
    logs = np.log(likelihoods)
    slopes = (logs[::2] - logs[1::2]) / 0.1
    np.testing.assert_allclose(rise, slopes.sum(axis=1), rtol=1e-12)
    np.testing.assert_allclose(information, slopes @ slopes.T, rtol=1e-12)


def test_outliers_in_company_have_others_of_the_same_height_around_them() -> None:
    rng = np.random.default_rng(3)
    height, variance = 2 * rng.standard_normal((12, 9)), rng.uniform(0.05, 0.3, (12, 9))
    outlier, company = rng.random((12, 9)) < 0.6, np.empty((12, 9), np.bool_)
    tracking.mark_company(height, variance, outlier, 3.0, 3, company)
    expected = np.zeros((12, 9), np.bool_)
    for i, c in np.argwhere(outlier):
        around = np.s_[max(i - 1, 0) : i + 2, max(c - 1, 0) : c + 2]
        same = outlier & ((height - height[i, c]) ** 2 <= 9 * (variance + variance[i, c]))
        expected[i, c] = np.count_nonzero(same[around]) - 1 >= 3
    np.testing.assert_array_equal(company, expected)
    assert 10 < np.count_nonzero(company) < 50


def test_between_tracked_pixels() -> None:
    rng = np.random.default_rng(4)
    measured = rng.random((20, 30)) < 0.4
    tracked, between = measured & (rng.random((20, 30)) < 0.7), np.empty((20, 30), np.bool_)
    tracking.mark_between(tracked, measured, between)
    for i, c in np.ndindex(20, 30):
        before, after = np.flatnonzero(measured[: i + 1, c]), i + np.flatnonzero(measured[i:, c])
        both = before.size and after.size and tracked[before[-1], c] and tracked[after[0], c]
        assert between[i, c] == bool(both)


def test_variances_across_the_ground_are_those_of_a_product_of_matrices() -> None:
    rng = np.random.default_rng(6)
    root, slope = rng.standard_normal((50, 3, 3)), rng.standard_normal((50, 2))
    covariance, variance = root @ np.swapaxes(root, 1, 2), np.empty(50)
    slope[:20, 0] = np.nan
    kernels.variances_across(covariance, slope, 1.0, variance)
    normal = np.column_stack([-slope, np.ones(50)])
    np.testing.assert_allclose(variance[20:], np.einsum("ni,nij,nj->n", normal, covariance, normal)[20:], rtol=1e-12)
    horizontal = np.linalg.eigvalsh(covariance[:, :2, :2])[:, 1]
    bound = (np.sqrt(covariance[:, 2, 2]) + np.sqrt(horizontal)) ** 2
    np.testing.assert_allclose(variance[:20], bound[:20], rtol=1e-12)


def test_covariances_are_the_matrices_without_a_negative_eigenvalue() -> None:
    rng = np.random.default_rng(7)
    root = rng.standard_normal((400, 3, 3))
    matrices = root @ np.swapaxes(root, 1, 2)
    matrices[:, 0, 1] *= np.linspace(0, 3, 400)
    matrices[:, 1, 0] = matrices[:, 0, 1]
    matrices[0], matrices[1, 1, 1] = 0.0, np.nan
    found = np.empty(400, np.bool_)
    kernels.find_semidefinite(matrices, 1e-9, found)
    least = np.linalg.eigvalsh(np.nan_to_num(matrices))[:, 0]
    expected = (least >= -1e-12) & (np.arange(400) != 1)
    np.testing.assert_array_equal(found, expected)
    assert 100 < np.count_nonzero(found) < 300


def test_an_error_across_the_flight_alone_may_have_lost_its_variance_along_it() -> None:
    """Single precision rounds 1e-49 to 0, but not the covariance of 1e-25; one of 1e-9 is no rounding."""
    matrices = np.diag([0.0, 1.5e-4, 1.1e-4])[None].repeat(2, axis=0)
    matrices[0, 0, 1] = matrices[0, 1, 0] = -1.2e-25
    matrices[1, 0, 1] = matrices[1, 1, 0] = 1e-5 * 1.5e-4
    found = np.empty(2, np.bool_)
    kernels.find_semidefinite(matrices, 1e-5, found)
    assert found.tolist() == [True, False]


@pytest.mark.parametrize(("shape", "half"), [((20, 11), 1), ((20, 11), 4), ((3, 30), 5), ((1, 1), 2)])
def test_means_of_windows(shape: tuple[int, int], half: int) -> None:
    values, means = np.random.default_rng(3).standard_normal(shape), np.empty(shape)
    kernels.average_windows(values, half, means)
    np.testing.assert_allclose(means, uniform_filter(values, 2 * half + 1, mode="constant"), atol=1e-14)


def test_planes_of_windows() -> None:
    rng = np.random.default_rng(5)
    points, mean, half = rng.standard_normal((3, 12, 9)), rng.standard_normal((3, 12, 9)), 2
    seen, share = rng.uniform(size=(12, 9)) < 0.8, rng.uniform(0.3, 1.0, (12, 9))
    slope, steepness, off = np.full((12, 9, 2), np.nan), np.full((12, 9), np.nan), np.full((12, 9), np.nan)
    centred, means = np.concatenate([points, seen[None]]), np.concatenate([mean * share, share[None]])
    for part in (slice(0, 5), slice(5, 12)):
        kernels.fit_planes(centred, means, half, part, slope, steepness, off)
    row, col = np.arange(12), np.arange(9)
    down = mean[:, np.minimum(row + half, 11)] - mean[:, np.maximum(row - half, 0)]
    across = mean[..., np.minimum(col + half, 8)] - mean[..., np.maximum(col - half, 0)]
    steps = np.stack([down, across]).transpose(2, 3, 0, 1)
    expected = np.linalg.solve(steps[..., :2], steps[..., 2:])[..., 0]
    np.testing.assert_allclose(slope, expected, rtol=1e-9)
    squares = np.sum(steps[..., :2] ** 2, axis=(-1, -2))
    np.testing.assert_allclose(steepness, squares / np.linalg.det(steps[..., :2]) ** 2, rtol=1e-9)
    beside = points - mean
    height = beside[2] - np.einsum("ijk,kij->ij", expected, beside[:2])
    np.testing.assert_allclose(off, np.where(seen, height**2, 0), rtol=1e-9)


def test_a_pixel_without_a_plane_has_no_distance_from_it() -> None:
    """A window without points has no mean; what is not finite would stay in the sums that move along."""
    centred, means = np.ones((4, 5, 5)), np.ones((4, 5, 5))
    means[3, 2, 4], means[2, 2, 4] = 0.0, 1e-18
    slope, steepness, off = np.empty((5, 5, 2)), np.empty((5, 5)), np.empty((5, 5))
    kernels.fit_planes(centred, means, 1, slice(0, 5), slope, steepness, off)
    assert np.isfinite(off).all()


def test_points_are_centred_on_those_that_count() -> None:
    rng = np.random.default_rng(9)
    points, covariance = rng.standard_normal((3, 6, 5)), np.ones((6, 5, 3, 3))
    points[1, 2, 3], covariance[4, 1, 2, 2] = np.nan, np.inf
    seen = np.ones((6, 5), np.bool_)
    seen[2, 3] = seen[4, 1] = False
    centred = np.empty((4, 6, 5))
    kernels.centre_points(points, covariance, centred)
    means = points[:, seen].mean(axis=1)
    expected = np.where(seen, points - means[:, None, None], 0.0)
    np.testing.assert_allclose(centred, [*expected, seen], atol=1e-14)


def test_planes_are_judged_by_their_points() -> None:
    """Error of the slope from the variance across it; none where points are few, spread or do not count."""
    rng = np.random.default_rng(10)
    root, slope = rng.standard_normal((4, 5, 3, 3)), rng.standard_normal((4, 5, 2))
    covariance = root @ np.swapaxes(root, -1, -2)
    steepness, share, spread = rng.uniform(1, 2, (4, 5)), rng.uniform(0.3, 1, (4, 5)), np.zeros((4, 5))
    counts, error, half = np.ones((4, 5)), np.empty((4, 5)), 2
    normal = np.concatenate([-slope, np.ones((4, 5, 1))], axis=-1)
    variance = np.einsum("...i,...ij,...j", normal, covariance, normal)
    share[0, 0], counts[1, 1], spread[2, 2], steepness[3, 3] = 0.2, 0.0, 30 * variance[2, 2], np.inf
    kernels.judge_planes(covariance, slope, steepness, share, spread, half, (0.25, 6.25), counts, error)
    expected = np.sqrt(2 * variance / (25 * share) * steepness)
    expected[[0, 1, 2, 3], [0, 1, 2, 3]] = np.inf
    np.testing.assert_allclose(error, expected, rtol=1e-12)


def test_means_of_cells() -> None:
    rng = np.random.default_rng(6)
    cell, count, steepest = rng.integers(0, 7, 200), 7, 1.5
    place, slope, centre = rng.standard_normal((2, 200)), rng.standard_normal((2, 200)), rng.standard_normal((7, 2))
    height, error, own, common = rng.standard_normal(200), *rng.uniform(0.1, 1, (3, 200))
    error[rng.uniform(size=200) < 0.3] = np.nan
    sums = np.zeros((count, 12))
    map_kernels.average_cells(cell, place, height, slope, error, own, common, centre, steepest, sums)
    weight = 1 / own
    total = np.bincount(cell, weight)

    def mean(values: Array) -> Array:
        return np.bincount(cell, weight * values) / total

    slopes = [mean(axis) for axis in slope]
    distances = centre[cell].T - place
    at_centre = height + slopes[0][cell] * distances[0] + slopes[1][cell] * distances[1]
    unmoved = np.where(np.isnan(error), steepest * np.hypot(*distances), 0)
    spread = (at_centre - mean(at_centre)[cell]) ** 2
    values = (*distances, unmoved, own, weight * own / total[cell], np.sqrt(common), spread)
    expected = [total, *slopes, mean(at_centre), mean(np.nan_to_num(error)), *(mean(value) for value in values)]
    np.testing.assert_allclose(sums, np.transpose(expected), rtol=1e-9, atol=1e-12)


def test_cells_of_a_map() -> None:
    """Means, their errors, chi-square, misfit and count of measurements that came one after the other."""
    rng = np.random.default_rng(7)
    height, own, structure, common = rng.standard_normal((9, 5)), *rng.uniform(0.1, 2, (3, 9, 5))
    cells, weight = np.zeros((8, map_kernels.COLUMNS)), 1 / (own + structure)
    index = np.array([6, 0, 3, 2, 7])
    times, correlation = np.sort(rng.uniform(0, 9, 9)), 2.0
    for time, *measured in zip(times, height, own, structure, common, strict=True):
        map_kernels.update_cells(index, *measured, 0.0, time, correlation, cells)
    total, of_all = weight.sum(axis=0), 1 / (own + structure + common**2)
    mean, mean_of_all = (np.average(height, axis=0, weights=weights) for weights in (weight, of_all))
    chi_square, misfit = (
        np.sum(weights * (height - centre) ** 2, axis=0) for weights, centre in ((of_all, mean_of_all), (weight, mean))
    )
    common_of_mean, structure_of_mean = (np.average(values, axis=0, weights=weight) for values in (common, structure))
    numbers = [mean, total, common_of_mean, mean_of_all, of_all.sum(axis=0), chi_square, np.full(5, 9)]
    numbers += [misfit, np.sum(weight**2, axis=0), np.sum(weight**2 * own, axis=0), structure_of_mean]
    share, alike = weight / total, np.exp(-np.abs(times[:, None] - times) / correlation)
    numbers += [np.einsum("ic,jc,ij->c", share, share, alike), alike[-1] @ share, np.full(5, times[-1])]
    np.testing.assert_allclose(cells[index], np.stack(numbers, axis=-1))
    assert not cells[[1, 4, 5]].any()


def test_an_offset_of_all_measurements_is_no_misfit() -> None:
    height, ones = np.arange(4.0), np.ones(4)
    cells = np.zeros((4, map_kernels.COLUMNS))
    for offset in (0.0, 0.25):
        map_kernels.update_cells(np.arange(4), height + offset, ones, 0 * ones, ones, offset, 0.0, np.inf, cells)
    np.testing.assert_allclose(cells[:, 0], height + 0.125)
    assert not cells[:, 7].any()
    assert (cells[:, 5] > 0).all()


def test_mean_rises_are_those_of_the_joints_around() -> None:
    rng = np.random.default_rng(8)
    height, joined, reach = rng.standard_normal((12, 9)), rng.random((11, 9)) < 0.4, 2
    slope = np.empty_like(height)
    kernels.mean_rises(height, joined, reach, slope)
    expected = np.zeros_like(height)
    for i, c in np.ndindex(height.shape):
        around = np.s_[max(i - reach, 0) : i + reach, max(c - reach, 0) : c + reach + 1]
        rises = np.diff(height, axis=0)[around][joined[around]]
        expected[i, c] = rises.mean() if rises.size else 0.0
    np.testing.assert_allclose(slope, expected, atol=1e-12)


def test_bends_are_marked_on_all_cells_from_first_to_last() -> None:
    """A kink upwards in row 6 and one downwards in row 9, behind which two rows are not joined."""
    row = np.arange(16.0)
    height = np.clip(row - 6, 0, 3)[:, None] * np.ones(2)
    joined = np.ones((15, 2), dtype=np.bool_)
    joined[11] = False
    bend = np.zeros((2, 16, 2))
    kernels.mark_bends(height, np.full((16, 2), 0.5), joined, np.array([1, 2]), bend)
    expected = np.zeros((2, 16))
    for way, kink in ((0, 6), (1, 9)):
        for middle in range(kink - 1, kink + 2):
            for lag in (1, 2):
                size = abs(float(height[middle - lag, 0] - 2 * height[middle, 0] + height[middle + lag, 0]))
                if size > 0.5 and middle + lag <= 11:
                    there = np.s_[way, middle - lag : middle + lag + 1]
                    expected[there] = np.maximum(expected[there], size**2 - 0.25)
    np.testing.assert_allclose(bend, expected[..., None] * np.ones(2))


def test_lines_are_followed_from_cell_to_cell() -> None:
    walls = np.full((6, 30), -np.inf)
    walls[2, 12], walls[2, 25] = 5.0, 8.0
    place, height = np.array([[2.0, 4.0], [2.0, 4.0], [4.0, 4.0]]), np.array([0.0, 2.0, 0.0])
    direction, rise = np.tile([0.0, 1.0], (3, 1)), np.full(3, 0.5)
    found = np.empty((3, 2), np.int64)
    # The first line is at 4 m in column 12, and at 10.5 m in 25; the second at 6 m.
    assert kernels.follow_lines(place, height, direction, rise, walls, 1, found) == 1
    assert found[0].tolist() == [0, 2 * 30 + 12]
    assert kernels.follow_lines(place, height, direction, rise / 4, walls, 1, found[:2]) == 4  # two do not fit
