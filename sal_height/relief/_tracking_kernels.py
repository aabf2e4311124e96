"""Compiled loops of the tracking: of single columns, side by side, and of rows as the state of one process.

The state of a row of n cells are their deviations from the mean, and the mean m itself: n + 1 numbers. From row to row
deviations fall by phi and gain the process noise that keeps their covariance as it is; m stays. The cells of a row are
measured one after the other, each a Kalman update by a single number, which costs no more than the square of n.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from sal_height.elevation import Validity
from sal_height.numeric import F64, U8, Bool, compiled, compiled_with_nan, inlined, squared

Heights = npt.NDArray[np.floating[Any]]

OK, INTERPOLATED = int(Validity.OK), int(Validity.INTERPOLATED)
OUTSIDE_ARRAY, LOW_CNR = int(Validity.OUTSIDE_ARRAY), int(Validity.LOW_CNR)

LEAST_SIGMA = 1e-100  # m; the precision 1 / sigma^2 of anything greater is finite


@compiled_with_nan
def filter_columns(
    height: Heights,
    sigma: Heights,
    prior: tuple[float, float],
    step: tuple[float, float],
    gate: float,
    state: F64,
    variance: F64,
    outlier: Bool,
) -> None:
    """Fill state (m, less the mean), variance (m^2) and outlier of each cell by the Kalman filter down the rows.

    Args:
        height: measured, m, shape (rows, cols), like all arrays.
        sigma: its standard deviation, m.
        prior: mean (m) and variance (m^2) of the relief.
        step: correlation from row to row, and variance of the process noise, m^2 (`ReliefPrior.step`).
        gate: standard deviations beyond which a measurement is an outlier.
        state: to be filled.
        variance: to be filled.
        outlier: to be filled.
    """
    (mean, relief_variance), (phi, noise) = prior, step
    rows, cols = height.shape
    predicted, spread = np.zeros(cols), np.full(cols, relief_variance)
    innovations, weights = np.empty(cols), np.empty(cols)
    for i in range(rows):
        for c in range(cols):
            deviation, error = np.float64(height[i, c]) - mean, np.float64(sigma[i, c])
            measured = (abs(deviation) < np.inf) & (error < np.inf) & (error > LEAST_SIGMA)
            innovations[c] = deviation - predicted[c] if measured else 0.0
            weights[c] = 1 / squared(error) if measured else 0.0
        for c in range(cols):  # a loop of its own, which is compiled to vector instructions
            innovation, weight = innovations[c], weights[c]
            outlier[i, c] = squared(innovation) * weight > squared(gate) * (1 + spread[c] * weight)
            weight = 0.0 if outlier[i, c] else weight
            variance[i, c] = spread[c] / (1 + spread[c] * weight)
            state[i, c] = predicted[c] + variance[i, c] * weight * innovation
            predicted[c] = phi * state[i, c]
            spread[c] = squared(phi) * variance[i, c] + noise


@compiled
def smooth_columns(step: tuple[float, float], state: F64, variance: F64) -> None:
    """Turn filtered states and variances into smoothed ones, from the last row to the first; `step` as above."""
    phi, noise = step
    rows, cols = state.shape
    for i in range(rows - 2, -1, -1):
        for c in range(cols):
            predicted = phi**2 * variance[i, c] + noise
            back = phi * variance[i, c] / predicted
            state[i, c] += back * (state[i + 1, c] - phi * state[i, c])
            variance[i, c] += back**2 * (variance[i + 1, c] - predicted)


@inlined
def _row_covariance(variances: tuple[float, float], beside: float, size: int) -> F64:
    """Covariance of the state of a row before any measurement, m^2, shape (size + 1, size + 1)."""
    covariance = np.zeros((size + 1, size + 1))
    for j in range(size):
        shared = variances[0]
        for k in range(j, size):
            covariance[j, k] = covariance[k, j] = shared
            shared *= beside
    covariance[size, size] = variances[1]
    return covariance


@inlined
def _predict_row(phi: float, covariance: F64, state: F64, spread: F64) -> None:
    """Turn state and covariance `spread` of a row into the prediction of the next; `covariance` as above."""
    size = len(state) - 1
    for j in range(size):
        state[j] *= phi
        for k in range(size):
            spread[j, k] = covariance[j, k] + squared(phi) * (spread[j, k] - covariance[j, k])
        spread[j, size] *= phi
        spread[size, j] *= phi


@inlined
def _take_back_row(phi: float, score: F64, information: F64) -> None:
    """Turn what a row and those after it say of its state into what they say of that of the row before."""
    size = len(score) - 1
    for j in range(size):
        score[j] *= phi
        for k in range(size):
            information[j, k] *= squared(phi)
        information[j, size] *= phi
        information[size, j] *= phi


@inlined
def _update(gain: float, shrink: float, column: F64, state: F64, spread: F64) -> None:
    """Add `gain` times the column to the state, and take `shrink` times its square from the covariance `spread`."""
    for j in range(len(state)):
        state[j] += gain * column[j]
        scaled = shrink * column[j]
        for k in range(len(state)):
            spread[j, k] -= scaled * column[k]


@compiled
def likelihoods(
    deviation: F64, precision: F64, variances: F64, steps: F64, outliers: tuple[float, float], found: F64
) -> None:
    """Fill the likelihood of each measurement given those before it, under each of some priors.

    Args:
        deviation: of windows, as in `MeasuredHeights.deviations`, m, shape (windows, rows, size).
        precision: 1/m^2, same shape; 0: not measured.
        variances: of the relief, and of its mean, m^2, shape (priors, 2).
        steps: correlation from row to row, and from column to column, shape (priors, 2).
        outliers: their share, and the density of their heights, 1/m.
        found: to be filled, 1/m, shape (priors, windows, rows, size); 1 where not measured.
    """
    (share, density), (windows, rows, size) = outliers, deviation.shape
    column = np.empty(size + 1)
    for prior in range(len(found)):
        phi = steps[prior, 0]
        covariance = _row_covariance((variances[prior, 0], variances[prior, 1]), steps[prior, 1], size)
        for w in range(windows):
            state, spread = np.zeros(size + 1), covariance.copy()
            for i in range(rows):
                if i > 0:
                    _predict_row(phi, covariance, state, spread)
                for c in range(size):
                    found[prior, w, i, c] = 1.0
                    if precision[w, i, c] > 0:
                        for k in range(size + 1):
                            column[k] = spread[c, k] + spread[size, k]
                        innovation = deviation[w, i, c] - state[c] - state[size]
                        variance = max(column[c] + column[size], 0.0) + 1 / precision[w, i, c]
                        near = (1 - share) * np.exp(-(innovation**2) / (2 * variance)) / np.sqrt(2 * np.pi * variance)
                        likelihood = near + share * density
                        inlier = near / likelihood
                        found[prior, w, i, c] = likelihood
                        shrink = inlier / variance * (1 - (1 - inlier) * innovation**2 / variance)
                        _update(inlier * innovation / variance, shrink, column, state, spread)


@compiled
def add_slopes(likelihoods: F64, distance: float, rise: F64, information: F64) -> None:
    """Add up the slopes of the log-likelihood of each measurement along two axes, and their products.

    Args:
        likelihoods: of each measurement, a distance above and below the place along the first axis, and along the
            second, shape (4, measurements).
        distance: of these from the place.
        rise: zeros, shape (2,); sums of the slopes, to be filled.
        information: zeros, shape (2, 2); sums of their products, to be filled.
    """
    for i in range(likelihoods.shape[1]):
        first = np.log(likelihoods[0, i] / likelihoods[1, i]) / (2 * distance)
        second = np.log(likelihoods[2, i] / likelihoods[3, i]) / (2 * distance)
        rise[0] += first
        rise[1] += second
        information[0, 0] += first * first
        information[0, 1] += first * second
        information[1, 1] += second * second
    information[1, 0] = information[0, 1]


@compiled
def filter_rows(
    deviation: F64,
    precision: F64,
    variances: tuple[float, float],
    steps: tuple[float, float],
    columns: F64,
    state: F64,
    variance: F64,
) -> None:
    """Fill what is predicted of each height by the cells before it, with x the state and P its covariance there.

    Args:
        deviation: of a window, m, shape (rows, size).
        precision: 1/m^2, same shape; 0: not measured.
        variances: of the relief, and of its mean, m^2.
        steps: correlation from row to row, and from column to column.
        columns: covariances P H^T of the state with the height H x, to be filled, m^2, shape (rows, size, size + 1).
        state: H x less the mean of the prior, to be filled, m, shape (rows, size).
        variance: H P H^T, to be filled, m^2, shape (rows, size).
    """
    (phi, beside), (rows, size) = steps, deviation.shape
    covariance = _row_covariance(variances, beside, size)
    mean, spread = np.zeros(size + 1), covariance.copy()
    for i in range(rows):
        if i > 0:
            _predict_row(phi, covariance, mean, spread)
        for c in range(size):
            column = columns[i, c]
            for k in range(size + 1):
                column[k] = spread[c, k] + spread[size, k]
            state[i, c], variance[i, c] = mean[c] + mean[size], max(column[c] + column[size], 0.0)
            weight = precision[i, c] / (1 + precision[i, c] * variance[i, c])
            if weight > 0:
                _update(weight * (deviation[i, c] - state[i, c]), weight, column, mean, spread)


@compiled
def smooth_rows(deviation: F64, precision: F64, phi: float, columns: F64, state: F64, variance: F64) -> None:
    """Turn what `filter_rows` predicts into mean and variance of each height given all measurements of the window.

    Back from the last cell to the first run the adjoint variables of Bryson and Frazier (1963; Bierman, IEEE Trans.
    Automatic Control 18, 1973): a smoothed height is H (x + P score), its variance H (P - P information P) H^T. No
    matrix is inverted, so that neither a relief of hardly any variance nor one whose correlation has no end needs care.

    Args:
        deviation: as in `filter_rows`.
        precision: as in `filter_rows`.
        phi: correlation from row to row.
        columns: as filled by `filter_rows`.
        state: as filled by `filter_rows`; to be turned.
        variance: as filled by `filter_rows`; to be turned.
    """
    rows, size = deviation.shape
    score, information, seen = np.zeros(size + 1), np.zeros((size + 1, size + 1)), np.empty(size + 1)
    for i in range(rows - 1, -1, -1):
        for c in range(size - 1, -1, -1):
            column, own = columns[i, c], variance[i, c]
            left = 1 / (1 + precision[i, c] * own)
            weight = precision[i, c] * left
            gain = weight * (deviation[i, c] - state[i, c])
            step, square = 0.0, 0.0
            for j in range(size + 1):
                seen[j] = 0.0
                for k in range(size + 1):
                    seen[j] += information[j, k] * column[k]
                square += seen[j] * column[j]
                step += score[j] * column[j]
            state[i, c] += own * gain + left * step
            variance[i, c] = left * max(own - left * square, 0.0)
            for j in (c, size):
                score[j] += gain - weight * step
                for k in range(size + 1):
                    information[j, k] -= weight * seen[k]
                    information[k, j] -= weight * seen[k]
            for j in (c, size):
                for k in (c, size):
                    information[j, k] += weight + weight**2 * square
        _take_back_row(phi, score, information)


@compiled_with_nan
def mark_company(height: F64, variance: F64, outlier: Bool, same: float, least: int, company: Bool) -> None:
    """Mark the outliers of `tracked.in_company`.

    Args:
        height: m, shape (rows, cols), like all arrays.
        variance: of the heights, m^2.
        outlier: which pixels are outliers.
        same: standard deviations of their difference up to which two heights count as the same.
        least: number of outliers of the same height that must be around one.
        company: to be filled.
    """
    rows, cols = outlier.shape
    for i in range(rows):
        for j in range(cols):
            count = 0
            if outlier[i, j]:
                for row in range(max(i - 1, 0), min(i + 2, rows)):
                    for col in range(max(j - 1, 0), min(j + 2, cols)):
                        if outlier[row, col] and (row != i or col != j):
                            limit = squared(same) * (variance[row, col] + variance[i, j])
                            count += squared(height[row, col] - height[i, j]) <= limit
            company[i, j] = count >= least if outlier[i, j] else False


@compiled
def mark_between(tracked: Bool, measured: Bool, between: Bool) -> None:
    """Mark the pixels of which the next measured ones before and after them in their column exist and were tracked.

    Args:
        tracked: shape (rows, cols), like all arrays.
        measured: which pixels are measured; one of them counts as the next to itself.
        between: to be filled.
    """
    rows, cols = tracked.shape
    for c in range(cols):
        last = False
        for i in range(rows):
            if measured[i, c]:
                last = tracked[i, c]
            between[i, c] = last
        last = False
        for i in range(rows - 1, -1, -1):
            if measured[i, c]:
                last = tracked[i, c]
            between[i, c] &= last


@compiled_with_nan
def judge_pixels(
    validity: U8,
    measured: Bool,
    positions: F64,
    outlier: Bool,
    step: Bool,
    unknown: Bool,
    judged: U8,
    kept: Bool,
    shown: Bool,
) -> None:
    """Decide for each pixel of `tracked.tracked_field` what it shows, and its validity.

    Args:
        validity: of the measured heights, shape (rows, cols), like all arrays without another shape.
        measured: which pixels have a measured height.
        positions: tracked ones, m, shape (rows, cols, 3).
        outlier: which measurements the gate has rejected.
        step: which of them are ground beyond a step.
        unknown: which pixels may be interpolated.
        judged: validity, to be filled.
        kept: which pixels stay as measured, to be filled.
        shown: which pixels show the tracked height, to be filled.
    """
    rows, cols = validity.shape
    whole, tracked, between = np.empty((3, rows, cols), np.bool_)
    located = np.isfinite(positions[..., 0] + positions[..., 1] + positions[..., 2])
    for i in range(rows):
        for j in range(cols):
            whole[i, j] = validity[i, j] == OK or validity[i, j] == INTERPOLATED
            kept[i, j] = measured[i, j] and (not whole[i, j] or step[i, j])
            tracked[i, j] = located[i, j] and measured[i, j] and not outlier[i, j] and not kept[i, j]
    mark_between(tracked, measured, between)
    for i in range(rows):
        for j in range(cols):
            filled = located[i, j] and unknown[i, j] and between[i, j]
            shown[i, j] = tracked[i, j] or filled
            judged[i, j] = validity[i, j]
            if kept[i, j]:
                continue
            if tracked[i, j]:
                judged[i, j] = OK
            elif filled:
                judged[i, j] = INTERPOLATED
            elif measured[i, j] and not outlier[i, j]:
                judged[i, j] = OUTSIDE_ARRAY
            elif outlier[i, j] and whole[i, j] and not step[i, j]:
                judged[i, j] = LOW_CNR


@compiled_with_nan
def fill_sights(
    antenna: F64, positions: F64, measured: Bool, origin: F64, steps: F64, sights: F64, ranges: F64
) -> None:
    """Fill the lines of sight to the pixels of an image, and their lengths.

    Args:
        antenna: its position, m, shape (3,).
        positions: of what was measured, m, shape (rows, cols, 3).
        measured: which pixels are measured, shape (rows, cols); the others are seen at their centres.
        origin: of the grid, m, shape (3,).
        steps: from row to row and from column to column, m, shape (2, 3).
        sights: to be filled, m, shape (rows, cols, 3).
        ranges: to be filled, m, shape (rows, cols).
    """
    rows, cols = measured.shape
    for i in range(rows):
        for j in range(cols):
            square = 0.0
            for axis in range(3):
                centre = origin[axis] + i * steps[0, axis] + j * steps[1, axis]
                place = positions[i, j, axis] if measured[i, j] else centre
                sights[i, j, axis] = place - antenna[axis]
                square += squared(sights[i, j, axis])
            ranges[i, j] = np.sqrt(square)
