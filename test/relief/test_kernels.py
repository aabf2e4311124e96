"""Compiled loops against the same formulas and recursions in NumPy."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from sal_height.relief import _kernels as kernels

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
        known = np.isfinite(values) & np.isfinite(errors) & (errors > kernels.LEAST_SIGMA)
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
    kernels.filter_columns(height, sigma, PRIOR, STEP, GATE, state, variance, outlier)
    expected = filter_rows(height, sigma)
    assert 0 < np.mean(expected[2]) < 0.5
    np.testing.assert_array_equal(outlier, expected[2])
    np.testing.assert_allclose(state, expected[0], atol=1e-12)
    np.testing.assert_allclose(variance, expected[1], rtol=1e-12)


def test_smoother() -> None:
    states, variances, _ = filter_rows(*measured())
    state, variance = states.copy(), variances.copy()
    kernels.smooth_columns(STEP, state, variance)
    for i in range(len(states) - 2, -1, -1):
        predicted = STEP[0] ** 2 * variances[i] + STEP[1]
        back = STEP[0] * variances[i] / predicted
        states[i] += back * (states[i + 1] - STEP[0] * states[i])
        variances[i] += back**2 * (variances[i + 1] - predicted)
    np.testing.assert_allclose(state, states, atol=1e-12)
    np.testing.assert_allclose(variance, variances, rtol=1e-12)


def test_log_likelihood() -> None:
    """An innovation is normal or, with the probability `share`, an outlier; the filter weighs it by the former."""
    rng = np.random.default_rng(2)
    deviation, precision = rng.standard_normal((30, 4)), rng.uniform(0.2, 3.0, (30, 4))
    precision[rng.random(precision.shape) < 0.2] = 0.0
    share, density, total = 0.1, 0.05, 0.0
    state, spread = np.zeros(4), np.full(4, PRIOR[1])
    for values, weights in zip(deviation, precision, strict=True):
        seen = weights > 0
        variance = spread + 1 / np.where(seen, weights, 1.0)
        innovation, gain = values - state, spread / variance
        near = (1 - share) * np.exp(-(innovation**2) / (2 * variance)) / np.sqrt(2 * np.pi * variance)
        likelihood = near + share * density
        total += float(np.sum(np.log(likelihood), where=seen))
        inlier = np.where(seen, near / likelihood, 0.0)
        state = STEP[0] * (state + inlier * gain * innovation)
        spread = spread + inlier * gain * ((1 - inlier) * gain * innovation**2 - spread)
        spread = STEP[0] ** 2 * spread + STEP[1]
    found = kernels.log_likelihood(deviation, precision, PRIOR[1], STEP, share, density)
    assert found == pytest.approx(total, rel=1e-12)


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
