"""Compiled loops of the cells of a map: the pixels of a dwell, their means, and those of all dwells."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sal_height.numeric import F32, F64, Bool, Index, compiled_with_nan, squared
from sal_height.relief._kernels import variance_across


@compiled_with_nan
def gather_pixels(
    points: F64,
    own: F64,
    common: F64,
    there: Bool,
    slope: F64,
    slope_error: F64,
    steepest: float,
    pixels: F64,
    start: int,
) -> int:
    """Fill the columns of a table from `start` on with the pixels of a surface that enter a map; returns their end.

    Args:
        points: east, north and height, m, shape (3, rows, cols).
        own: covariance of their own errors, m^2, shape (rows, cols, 3, 3).
        common: covariance of the errors that they share, same shape; with 0 rows: there are none.
        there: which pixels may enter, shape (rows, cols).
        slope: of the ground, m/m, shape (rows, cols, 2); NaN where it is not known.
        slope_error: m/m, shape (rows, cols).
        steepest: slope where it is not known, m/m.
        pixels: to be filled, shape (8, n): east, north, height (m), slope towards east and north, 0 where it is not
            known, its standard deviation (m/m), and the variances of the height at the place, own and common (m^2).
        start: first column to be filled.
    """
    rows, cols = there.shape
    for i in range(rows):
        for j in range(cols):
            if not there[i, j]:
                continue
            east, north, shared = slope[i, j, 0], slope[i, j, 1], 0.0
            alone = variance_across(own[i, j], east, north, steepest)
            if len(common) > 0:
                shared = variance_across(common[i, j], east, north, steepest)
            place = points[0, i, j] + points[1, i, j] + points[2, i, j]
            if np.isfinite(place + alone + shared) and alone > 0:
                for axis in range(3):
                    pixels[axis, start] = points[axis, i, j]
                pixels[3, start], pixels[4, start] = (0.0, 0.0) if np.isnan(east + north) else (east, north)
                pixels[5, start], pixels[6, start], pixels[7, start] = slope_error[i, j], alone, shared
                start += 1
    return start


@compiled_with_nan
def average_cells(
    cell: Index,
    place: F64,
    height: F64,
    slope: F64,
    slope_error: F64,
    own: F64,
    common: F64,
    centre: F64,
    steepest: float,
    sums: F64,
) -> None:
    """Fill the means of the pixels in each cell with the weights w = 1 / own, see `map._averaged`.

    Args:
        cell: number of each pixel's cell, shape (pixels,).
        place: east and north, m, shape (2, pixels).
        height: m, shape (pixels,).
        slope: towards east and north, m/m, shape (2, pixels).
        slope_error: m/m, shape (pixels,); NaN where the slope is not known.
        own: variance, m^2, shape (pixels,).
        common: the part that all pixels share, m^2, shape (pixels,).
        centre: east and north of each cell, m, shape (cells, 2).
        steepest: slope where it is not known, m/m.
        sums: zeros, shape (cells, 12). To be filled with the sum of the weights; means of the slopes towards east and
            north; of the height at the centre; of the slope's error where it is known; of the distances east and north
            to the centre; of what `steepest` makes of the distance where the slope is not known; of own; of own times
            w over the sum of w; of the root of common; and of the squared distance from the mean height.
    """
    for i in range(len(cell)):
        total, weight = sums[cell[i]], 1 / own[i]
        total[0] += weight
        total[1] += weight * slope[0, i]
        total[2] += weight * slope[1, i]
    for number in range(len(sums)):
        sums[number, 1] /= sums[number, 0]
        sums[number, 2] /= sums[number, 0]
    for i in range(len(cell)):
        total, weight = sums[cell[i]], 1 / own[i]
        east, north = centre[cell[i], 0] - place[0, i], centre[cell[i], 1] - place[1, i]
        total[3] += weight * (height[i] + total[1] * east + total[2] * north)
        if np.isnan(slope_error[i]):
            total[7] += weight * (steepest * np.sqrt(squared(east) + squared(north)))
        else:
            total[4] += weight * slope_error[i]
        total[5] += weight * east
        total[6] += weight * north
        total[8] += weight * own[i]
        total[9] += squared(weight) * own[i]
        total[10] += weight * np.sqrt(common[i])
    for number in range(len(sums)):
        for k in range(3, 11):
            sums[number, k] /= sums[number, 0]
        sums[number, 9] /= sums[number, 0]
    for i in range(len(cell)):
        total, weight = sums[cell[i]], 1 / own[i]
        east, north = centre[cell[i], 0] - place[0, i], centre[cell[i], 1] - place[1, i]
        total[11] += weight * squared(height[i] + total[1] * east + total[2] * north - total[3]) / total[0]


COLUMNS = 14
"""Numbers of each cell of a map: those of `update_cells`."""


@compiled_with_nan
def update_cells(
    index: Index,
    height: F64,
    own: F64,
    structure: F64,
    common: F64,
    offset: float,
    time: float,
    correlation: float,
    cells: F64,
) -> None:
    """Update the numbers of cells with measurements of the weight w = 1 / (own + structure), see `map.ReliefMap`.

    Chi-square is that of the measurements about their mean of the weight v = 1 / (own + structure + common^2), as if
    common errors were independent; it grows by the squared difference from that mean so far, over the variance of the
    difference. That gives the sum of v (h - mean)^2 without the cancellation of large squares. The misfit is the same
    with the weights w, after the offset was subtracted from each difference.

    Of the error of a dwell before the latest one no more is known than its correlation r with that of the latest: its
    covariance with the mean is the greatest possible one, and at most that of the latest over r, as all weights are
    positive.

    Args:
        index: cell of each measurement, shape (measurements,).
        height: measured, m, shape (measurements,).
        own: variance of its independent errors, m^2, shape (measurements,).
        structure: variance of the heights within the cell, m^2, shape (measurements,).
        common: standard deviation of the error that all measurements share, m, shape (measurements,).
        offset: height of all measurements above the cells as they were, m.
        time: time of all measurements, s.
        correlation: time in which the correlation of what varies in the common errors falls to 1 / e, s.
        cells: of each cell mean height, sum of the weights w (1/m^2), mean of common (m), mean and sum of the weights
            v, chi-square, and count; misfit, sum of w^2, sum of w^2 own, and mean of structure; of the varying error of
            unit variance that of the mean, its covariance with that of the latest time, and that time, s; to be
            updated, shape (cells, COLUMNS).
    """
    for i in range(len(index)):
        cell = cells[index[i]]
        weight = 1 / (own[i] + structure[i])
        cell[7] += weight * cell[1] / (weight + cell[1]) * squared(height[i] - cell[0] - offset)
        cell[8] += squared(weight)
        cell[9] += squared(weight) * own[i]
        cell[1] += weight
        share = weight / cell[1]
        cell[0] += share * (height[i] - cell[0])
        cell[2] += share * (common[i] - cell[2])
        cell[10] += share * (structure[i] - cell[10])
        elapsed = time - cell[13] if cell[6] > 0 else 0.0
        alike = np.exp(-abs(elapsed) / correlation)
        with_mean = alike * cell[12]
        if elapsed >= 0:
            cell[12] = (1 - share) * with_mean + share
        else:
            with_mean += np.sqrt(max(cell[11] - squared(cell[12]), 0.0) * (1 - squared(alike)))
            with_mean = min(with_mean, cell[12] * np.exp(min(-elapsed / correlation, 99.0)))
            cell[12] = (1 - share) * cell[12] + share * alike
        cell[11] = squared(1 - share) * cell[11] + 2 * (1 - share) * share * with_mean + squared(share)
        cell[13] = max(time, cell[13]) if cell[6] > 0 else time
        weight = 1 / (own[i] + structure[i] + squared(common[i]))
        step = weight / (cell[4] + weight) * (height[i] - cell[3])
        cell[5] += squared(step) * cell[4] * (cell[4] + weight) / weight
        cell[3] += step
        cell[4] += weight
        cell[6] += 1


@compiled_with_nan
def read_cells(
    cells: F64,
    varying: float,
    height: F32,
    variance: F32,
    misfit: F32,
    disagreement: F32,
    count: npt.NDArray[np.uint32],
) -> None:
    """Fill the heights of cells that were seen, their variance, disagreement and count, as in `map.Relief`.

    Args:
        cells: filled by `update_cells`, shape (rows, cols, COLUMNS).
        varying: variance of the part of the common errors that varies, m^2.
        height: to be filled, m, shape (rows, cols), like all others.
        variance: to be filled, without what differs from dwell to dwell, m^2.
        misfit: to be filled as `structure_variance` has it where two dwells or more have seen the cell, shape
            (rows, cols, 3).
        disagreement: to be filled there, too.
        count: to be filled.
    """
    rows, cols, _ = cells.shape
    for i in range(rows):
        for j in range(cols):
            chi_square, dwells = cells[i, j, 5], cells[i, j, 6]
            if dwells > 0:
                weights = cells[i, j, 1]
                common = squared(cells[i, j, 2])
                common -= min(varying, common) * (1 - cells[i, j, 11])
                variance[i, j] = cells[i, j, 9] / squared(weights) + cells[i, j, 10] + common
                height[i, j] = cells[i, j, 0] if np.isfinite(variance[i, j]) else np.nan
                count[i, j] = np.uint32(dwells)
            if dwells > 1:
                disagreement[i, j] = np.sqrt(chi_square / (dwells - 1))
                misfit[i, j, 0] = cells[i, j, 7]
                misfit[i, j, 1] = dwells - 1
                misfit[i, j, 2] = weights - cells[i, j, 8] / weights
