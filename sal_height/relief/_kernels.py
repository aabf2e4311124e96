"""Compiled loops of the membrane and of slopes; `_map_kernels` and `_tracking_kernels` have those of other modules."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sal_height.numeric import F64, Bool, Index, compiled, compiled_with_nan, squared

LEAST_PRECISION = 1e-12  # of a height that no measurement reaches, 1/m^2: its sigma is 1000 km


@compiled
def propagate(
    weight: F64,
    own: F64,
    stiffness: tuple[F64, F64],
    rise: tuple[F64, F64],
    sweeps: int,
    precision: F64,
    moment: F64,
) -> None:
    """Send messages along rows and columns, there and back, `sweeps` times; a cell sends on what it has just received.

    Args:
        weight: precision of each cell's own height, 1/m^2, shape (rows, cols).
        own: that times the height, 1/m.
        stiffness: between each cell and the next along rows, 1/m^2, shape (rows - 1, cols), and along columns, shape
            (rows, cols - 1).
        rise: expected height of the next less that of the cell, m, same shapes.
        sweeps: number of sweeps.
        precision: of the messages that each cell has received from the row before, the row after, the column before
            and the column after, shape (4, rows, cols); to be filled.
        moment: that times the height that they state; to be filled.
    """
    rows, cols = weight.shape
    down, across = stiffness
    lower, higher = rise
    for _ in range(sweeps):
        for i in range(rows - 1):
            for c in range(cols):
                total = weight[i, c] + precision[0, i, c] + precision[2, i, c] + precision[3, i, c]
                sent = own[i, c] + moment[0, i, c] + moment[2, i, c] + moment[3, i, c] + total * lower[i, c]
                passed = down[i, c] / (down[i, c] + total + LEAST_PRECISION)
                precision[0, i + 1, c], moment[0, i + 1, c] = passed * total, passed * sent
        for i in range(rows - 1, 0, -1):
            for c in range(cols):
                total = weight[i, c] + precision[1, i, c] + precision[2, i, c] + precision[3, i, c]
                sent = own[i, c] + moment[1, i, c] + moment[2, i, c] + moment[3, i, c] - total * lower[i - 1, c]
                passed = down[i - 1, c] / (down[i - 1, c] + total + LEAST_PRECISION)
                precision[1, i - 1, c], moment[1, i - 1, c] = passed * total, passed * sent
        for i in range(rows):
            for c in range(cols - 1):
                total = weight[i, c] + precision[0, i, c] + precision[1, i, c] + precision[2, i, c]
                sent = own[i, c] + moment[0, i, c] + moment[1, i, c] + moment[2, i, c] + total * higher[i, c]
                passed = across[i, c] / (across[i, c] + total + LEAST_PRECISION)
                precision[2, i, c + 1], moment[2, i, c + 1] = passed * total, passed * sent
            for c in range(cols - 1, 0, -1):
                total = weight[i, c] + precision[0, i, c] + precision[1, i, c] + precision[3, i, c]
                sent = own[i, c] + moment[0, i, c] + moment[1, i, c] + moment[3, i, c] - total * higher[i, c - 1]
                passed = across[i, c - 1] / (across[i, c - 1] + total + LEAST_PRECISION)
                precision[3, i, c - 1], moment[3, i, c - 1] = passed * total, passed * sent


@compiled_with_nan
def follow_lines(
    place: F64, height: F64, direction: F64, rise: F64, walls: F64, stride: int, found: npt.NDArray[np.int64]
) -> int:
    """Follow the lines of `visibility.blocking_cells`; returns the number of pairs, of which those that fit are filled.

    Args:
        place: row and column where each begins, shape (lines, 2).
        height: there, m, shape (lines,).
        direction: rows and columns that it goes on per cell of its way, shape (lines, 2).
        rise: m per cell of its way, shape (lines,).
        walls: height above which the surface of a cell is in the way, m, shape (rows, cols); -inf: never.
        stride: cells from one place of a line to the next.
        found: number of the line and flat number of the cell, to be filled, shape (pairs, 2).
    """
    rows, cols = walls.shape
    highest, count = walls.max(), 0
    for i in range(len(place)):
        way, level = stride, height[i] + stride * rise[i]
        while level < highest:
            row = int(np.rint(place[i, 0] + way * direction[i, 0]))
            col = int(np.rint(place[i, 1] + way * direction[i, 1]))
            if row < 0 or row >= rows or col < 0 or col >= cols:
                break
            if walls[row, col] > level:
                if count < len(found):
                    found[count, 0], found[count, 1] = i, row * cols + col
                count += 1
            way += stride
            level = height[i] + way * rise[i]
    return count


@compiled_with_nan
def mean_rises(height: F64, joined: Bool, reach: int, slope: F64) -> None:
    """Fill the mean rise to the next cell down a column, of the joined cells in the square of `reach` around each.

    Args:
        height: m, shape (rows, cols).
        joined: whether each cell and the next of the column are joined, shape (rows - 1, cols).
        reach: cells.
        slope: to be filled, m per cell, shape (rows, cols); 0 where there are no joined cells.
    """
    rows, cols = height.shape
    total, count = np.zeros((rows + 1, cols + 1)), np.zeros((rows + 1, cols + 1))  # of all cells before
    for i in range(rows):
        rises, joints = 0.0, 0.0
        for c in range(cols):
            if i + 1 < rows and joined[i, c]:
                rises += height[i + 1, c] - height[i, c]
                joints += 1
            total[i + 1, c + 1] = total[i, c + 1] + rises
            count[i + 1, c + 1] = count[i, c + 1] + joints
    for i in range(rows):
        first, last = max(i - reach, 0), min(i + reach, rows - 1)  # joints from row `first` to the one before `last`
        for c in range(cols):
            left, right = max(c - reach, 0), min(c + reach + 1, cols)
            number = count[last, right] - count[first, right] - count[last, left] + count[first, left]
            rise = total[last, right] - total[first, right] - total[last, left] + total[first, left]
            slope[i, c] = rise / number if number > 0 else 0.0


@compiled_with_nan
def mark_bends(height: F64, limit: F64, joined: Bool, lags: Index, bend: F64) -> None:
    """Mark the bends of columns of cells with their square beyond the limit's, the greatest one of each cell.

    The bend of three cells in a column, a - 2 b + c, whose outer two are a lag from the middle one, is marked on all
    cells from the first to the last; there is none across cells that are not joined.

    Args:
        height: m, shape (rows, cols).
        limit: of a bend that does not count, m, same shape.
        joined: whether each cell and the next of the column are joined, shape (rows - 1, cols).
        lags: in cells, increasing, shape (lags,).
        bend: of bends upwards and downwards, to be filled, m^2, shape (2, rows, cols).
    """
    rows, cols = height.shape
    for c in range(cols):
        for i in range(rows):
            above, below = 0, 0
            while above < lags[-1] and i - above > 0 and joined[i - above - 1, c]:
                above += 1
            while below < lags[-1] and i + below + 1 < rows and joined[i + below, c]:
                below += 1
            for lag in lags:
                if lag > min(above, below):
                    break
                found = height[i - lag, c] - 2 * height[i, c] + height[i + lag, c]
                square, way = squared(found) - squared(limit[i, c]), 0 if found > 0 else 1
                if square > 0:
                    for j in range(i - lag, i + lag + 1):
                        bend[way, j, c] = max(bend[way, j, c], square)


@compiled_with_nan
def variance_across(c: F64, east: float, north: float, steepest: float) -> float:
    """Variance at a place of `position_error.variance_at_place`, of one covariance `c` on ground of that slope."""
    if np.isfinite(east + north):
        level = c[0, 0] * squared(east) + 2 * c[0, 1] * east * north + c[1, 1] * squared(north)
        variance = c[2, 2] - 2 * (c[0, 2] * east + c[1, 2] * north) + level
    else:
        greatest = (c[0, 0] + c[1, 1]) / 2 + np.sqrt(squared((c[0, 0] - c[1, 1]) / 2) + squared(c[0, 1]))
        variance = squared(np.sqrt(c[2, 2]) + steepest * np.sqrt(greatest))
    return variance


@compiled_with_nan
def variances_across(covariance: F64, slope: F64, steepest: float, variance: F64) -> None:
    """Fill the variances at a place of `position_error.variance_at_place`.

    Args:
        covariance: m^2, shape (n, 3, 3).
        slope: m/m, shape (n, 2); NaN where it is not known.
        steepest: slope for which the bound is made where it is not known.
        variance: to be filled, m^2, shape (n,).
    """
    for i in range(len(variance)):
        variance[i] = variance_across(covariance[i], slope[i, 0], slope[i, 1], steepest)


@compiled_with_nan
def find_semidefinite(matrices: F64, rounding: float, found: Bool) -> None:
    """Mark the covariances of `Surface.is_possible`.

    An error that moves points across the flight alone has next to no variance along it, which float32 may round to 0
    where covariances with it are not 0: each variance may be larger by a millionth of the greatest deviation, squared.

    Args:
        matrices: symmetric, shape (n, 3, 3).
        rounding: of a principal minor, over the product of its variances.
        found: to be filled, shape (n,).
    """
    for i in range(len(found)):
        m = matrices[i]
        least = 1e-12 * (m[0, 0] + m[1, 1] + m[2, 2])
        a, b, c, ab, ac, bc = m[0, 0] + least, m[1, 1] + least, m[2, 2] + least, m[0, 1], m[0, 2], m[1, 2]
        alone = a >= 0 and b >= 0 and c >= 0 and a + b + c < np.inf
        limit = 1 + rounding
        pairs = squared(ab) <= limit * a * b and squared(ac) <= limit * a * c and squared(bc) <= limit * b * c
        whole = a * b * c + 2 * ab * ac * bc - a * squared(bc) - b * squared(ac) - c * squared(ab)
        found[i] = alone and pairs and whole >= -rounding * a * b * c


@compiled
def average_windows(values: F64, half: int, means: F64) -> None:
    """Fill the means over the square windows of half-width `half` around each pixel, by sums that move along.

    Args:
        values: shape (rows, cols); beyond the edge they count as 0.
        half: in pixels.
        means: to be filled, same shape.
    """
    rows, cols = values.shape
    column, share = np.zeros(cols), 1 / (2 * half + 1) ** 2
    for i in range(min(half, rows)):
        column += values[i]
    for i in range(rows):
        if i + half < rows:
            column += values[i + half]
        if i > half:
            column -= values[i - half - 1]
        total = 0.0
        for c in range(min(half, cols)):
            total += column[c]
        for c in range(cols):
            if c + half < cols:
                total += column[c + half]
            if c > half:
                total -= column[c - half - 1]
            means[i, c] = total * share


@compiled_with_nan
def centre_points(points: F64, covariance: F64, centred: F64) -> None:
    """Fill the points less their mean, and which of them count, as `slope.ground_slope` averages them.

    Args:
        points: m, shape (3, rows, cols); NaN where there is none.
        covariance: m^2, shape (rows, cols, 3, 3).
        centred: to be filled, shape (4, rows, cols): m, and 1 where a point counts; all 0 where it does not.
    """
    _, rows, cols = points.shape
    sums, count = np.zeros(3), 0
    for i in range(rows):
        for j in range(cols):
            place = points[0, i, j] + points[1, i, j] + points[2, i, j]
            seen = np.isfinite(place) and np.isfinite(covariance[i, j, 2, 2])
            centred[3, i, j] = 1.0 if seen else 0.0
            if seen:
                count += 1
                for axis in range(3):
                    sums[axis] += points[axis, i, j]
    for axis in range(3):
        mean = sums[axis] / max(count, 1)
        for i in range(rows):
            for j in range(cols):
                centred[axis, i, j] = points[axis, i, j] - mean if centred[3, i, j] > 0 else 0.0


@compiled_with_nan
def fit_planes(centred: F64, means: F64, half: int, part: slice, slope: F64, steepness: F64, off: F64) -> None:
    """Fill the slopes of the planes of `slope.ground_slope` in some rows, and how far pixels lie off them.

    The slope g fulfils step_up = g step_horizontal for the steps of the means down and across: Cramer's rule.

    Args:
        centred: filled by `centre_points`, shape (4, rows, cols).
        means: of that over windows, same shape; the last one is the share of points that count.
        half: half-width of the windows in pixels.
        part: rows to be filled.
        slope: to be filled, m/m, shape (rows, cols, 2).
        steepness: sum of the squares of both horizontal steps over their squared area, to be filled, 1/m^2, shape
            (rows, cols).
        off: squared distance in height from the plane through the mean, to be filled, m^2, shape (rows, cols); 0 where
            points do not count, or there is no plane.
    """
    _, rows, cols = means.shape
    down, across, beside = np.empty(3), np.empty(3), np.empty(3)
    for i in range(part.start, part.stop):
        below, above = max(i - half, 0), min(i + half, rows - 1)
        for j in range(cols):
            left, right = max(j - half, 0), min(j + half, cols - 1)
            for axis in range(3):
                mean, share = means[axis], means[3]
                down[axis] = mean[above, j] / share[above, j] - mean[below, j] / share[below, j]
                across[axis] = mean[i, right] / share[i, right] - mean[i, left] / share[i, left]
                beside[axis] = centred[axis, i, j] - mean[i, j] / share[i, j]
            area = down[0] * across[1] - down[1] * across[0]
            east = (down[2] * across[1] - down[1] * across[2]) / area
            north = (down[0] * across[2] - down[2] * across[0]) / area
            slope[i, j, 0], slope[i, j, 1] = east, north
            steps = squared(down[0]) + squared(down[1]) + squared(across[0]) + squared(across[1])
            steepness[i, j] = steps / squared(area)
            misfit = squared(beside[2] - east * beside[0] - north * beside[1])
            off[i, j] = misfit if centred[3, i, j] > 0 and misfit < np.inf else 0.0


@compiled_with_nan
def judge_planes(
    covariance: F64,
    slope: F64,
    steepness: F64,
    share: F64,
    spread: F64,
    half: int,
    limits: tuple[float, float],
    counts: F64,
    error: F64,
) -> None:
    """Fill the standard deviations of slopes, infinite where pixels lie on no plane, see `slope.ground_slope`.

    Args:
        covariance: of the pixels, m^2, shape (rows, cols, 3, 3).
        slope: as filled by `fit_planes`.
        steepness: as filled by `fit_planes`.
        share: of the points in each window that count, shape (rows, cols).
        spread: means of `off` over the windows, m^2, same shape.
        half: half-width of the windows in pixels.
        limits: least share, and greatest spread over the variance.
        counts: 1 where a pixel counts, else 0, same shape.
        error: to be filled, m/m, same shape.
    """
    rows, cols = share.shape
    (least, misfit), size = limits, squared(2 * half + 1)
    for i in range(rows):
        for j in range(cols):
            variance, count = (
                variance_across(covariance[i, j], slope[i, j, 0], slope[i, j, 1], 1.0),
                share[i, j] * size,
            )
            # Each of the two steps has twice the variance of a mean, at most.
            square = 2 * variance / count * steepness[i, j]
            even = spread[i, j] / share[i, j] * count / (count - 1) <= misfit * variance
            planar = counts[i, j] > 0 and share[i, j] >= least and even and square < np.inf
            error[i, j] = np.sqrt(square) if planar else np.inf
