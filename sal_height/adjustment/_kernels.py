"""Compiled loops of the comparison of images; `matching` says what they compute."""

from __future__ import annotations

import numpy as np

from sal_height.numeric import F64, I64, compiled_with_nan, squared


@compiled_with_nan
def _gather(place: F64, sigma: F64, shift: I64, height: F64, cell_sigma: F64, farthest: float, met: F64) -> int:
    """Fills `met` with the difference in height, 1 / its variance and the number of each point that meets the surface.

    A point meets it if the four cells around it have heights.
    """
    count = 0
    for point in range(len(place)):
        east, north = place[point, 0] - shift[0], place[point, 1] - shift[1]
        first, second = int(np.floor(east)), int(np.floor(north))
        if 0 <= first < height.shape[0] - 1 and 0 <= second < height.shape[1] - 1:
            east -= first
            north -= second
            west_side = (1 - north) * height[first, second] + north * height[first, second + 1]
            east_side = (1 - north) * height[first + 1, second] + north * height[first + 1, second + 1]
            difference = place[point, 2] - (1 - east) * west_side - east * east_side
            if abs(difference) <= farthest:
                met[0, count] = difference
                met[1, count] = 1 / (squared(sigma[point]) + squared(cell_sigma[first, second]))
                met[2, count] = point
                count += 1
    return count


@compiled_with_nan
def _robust_mean(differences: F64, weights: F64) -> tuple[float, float]:
    """Mean of the differences about their median that are of the same surface, and the sum of their weights."""
    found, total = float(np.median(differences)), 0.0
    for _ in range(4):
        before, total, weighed = found, 0.0, 0.0
        for number in range(len(differences)):
            if squared(differences[number] - found) * weights[number] < 9.0:  # within three standard deviations
                total += weights[number]
                weighed += differences[number] * weights[number]
        if total > 0:
            found = weighed / total
        if found == before:
            break
    return found, total


@compiled_with_nan
def _fill_density(bins: I64, kernel: F64, counts: F64, density: F64) -> None:
    """Fills `density` (1/m) at the bins of some points by the number in the bins around; elsewhere it is unchanged.

    `counts` is all 0 before and after.
    """
    half = len(kernel) // 2
    for middle in bins:
        counts[middle] += 1.0
        density[middle] = -1.0
    for middle in bins:
        if density[middle] < 0:
            density[middle] = 0.0
            for tap in range(len(kernel)):
                density[middle] += kernel[tap] * counts[middle + tap - half] / len(bins)
    for middle in bins:
        counts[middle] = 0.0


@compiled_with_nan
def compare_shifts(
    place: F64,
    sigma: F64,
    bins: I64,
    kernel: F64,
    cells: I64,
    height: F64,
    cell_sigma: F64,
    numbers: F64,
    likelihood: F64,
    up: F64,
) -> None:
    """Compares points with a surface for some horizontal shifts.

    Args:
        place: points, in cells of the surface east and north, and their height, m, shape (points, 3).
        sigma: standard deviation of the heights, m, shape (points,).
        bins: number of the bin of each height, half of the kernel or more, shape (points,).
        kernel: density of heights (1/m) that a point adds to the bins around its own, of odd length.
        cells: shifts in cells, shape (shifts, 2).
        height: height of the surface, m, NaN where it is unknown, shape (east, north).
        cell_sigma: standard deviation of that, m, same shape.
        numbers: greatest difference in height at which points meet, m, the fraction of outliers, and the least number
            of points.
        likelihood: filled with the contribution of each point to the log likelihood, NaN where it does not meet the
            surface, shape (1, shifts, points), or (2, shifts, points): by the density of all heights, and by that of
            the points that meet.
        up: filled with the shift in height, and the sum of the weights of the points that fit, 1/m^2; NaN and 0 where
            too few points meet; shape (shifts, 2).
    """
    farthest, outliers, least = numbers[0], numbers[1], numbers[2]
    met, met_bins = np.empty((3, len(place))), np.empty(len(place), np.int64)
    density, counts = np.empty((2, bins.max() + len(kernel))), np.zeros(bins.max() + len(kernel))
    _fill_density(bins, kernel, counts, density[0])
    likelihood[:] = np.nan
    for shift in range(len(cells)):
        count = _gather(place, sigma, cells[shift], height, cell_sigma, farthest, met)
        up[shift, 0], up[shift, 1] = np.nan, 0.0
        if count < least:
            continue
        differences, weights = met[0, :count], met[1, :count]
        found, total = _robust_mean(differences, weights)
        up[shift, 0], up[shift, 1] = found, total
        if len(likelihood) > 1:
            for number in range(count):
                met_bins[number] = bins[int(met[2, number])]
            _fill_density(met_bins[:count], kernel, counts, density[1])
        for number in range(count):
            point = int(met[2, number])
            off = squared(differences[number] - found) * weights[number] / 2
            fits = np.exp(-off) * np.sqrt(weights[number] / (2 * np.pi))
            for kind in range(len(likelihood)):
                likelihood[kind, shift, point] = np.log((1 - outliers) * fits / density[kind, bins[point]] + outliers)


@compiled_with_nan
def average_over_shifts(likelihood: F64, usual: F64) -> None:
    """Fills `usual`, shape (points,), with the mean contribution of each point over all shifts, 0 without any."""
    for point in range(likelihood.shape[1]):
        total, count = 0.0, 0
        for shift in range(likelihood.shape[0]):
            if not np.isnan(likelihood[shift, point]):
                total += likelihood[shift, point]
                count += 1
        usual[point] = total / max(1, count)


@compiled_with_nan
def sum_over_points(likelihood: F64, usual: F64, score: F64) -> None:
    """Fills `score`, shape (shifts,), with the sum of the contributions of points to a shift less their means."""
    for shift in range(likelihood.shape[0]):
        score[shift] = 0.0
        for point in range(likelihood.shape[1]):
            if not np.isnan(likelihood[shift, point]):
                score[shift] += likelihood[shift, point] - usual[point]
