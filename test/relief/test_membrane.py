"""The membrane against the exact posterior of its Gaussian field, on level ground, slopes and steps."""

from __future__ import annotations

import numpy as np
import pytest

from sal_height.numeric import F64
from sal_height.relief.membrane import FREEDOM, deviation, fitted_membrane

GATE = 3.0
MIDDLE = np.s_[8:-8, 8:-8]


def laplacian(shape: tuple[int, int]) -> F64:
    """Matrix of a grid's Laplacian, shape (cells, cells)."""

    def along(length: int) -> F64:
        differences = np.diff(np.eye(length), axis=0)
        return differences.T @ differences

    return np.kron(along(shape[0]), np.eye(shape[1])) + np.kron(np.eye(shape[0]), along(shape[1]))


def test_heights_and_sigma_are_those_of_the_exact_posterior() -> None:
    shape, sigma = (24, 20), 0.012
    measured = np.random.default_rng(1).normal(0.0, sigma, shape)
    membrane = fitted_membrane(measured, np.full(shape, sigma), 1.0, GATE)
    covariance = np.linalg.inv(np.eye(measured.size) / sigma**2 + laplacian(shape) / (FREEDOM * sigma) ** 2)
    mean = (covariance @ measured.ravel() / sigma**2).reshape(shape)
    averaged = (np.diag(covariance @ covariance) / sigma**2).reshape(shape)
    assert np.abs(membrane.height - mean).max() < 1e-5 * sigma
    # The estimate of the roughness adds a little on level ground, the tree takes 2 % away.
    ratio = deviation(membrane, 1.0)[MIDDLE] / np.sqrt(averaged)[MIDDLE]
    assert ratio.min() > 0.97
    assert ratio.mean() < 1.08


@pytest.mark.parametrize("spacing", [1.0, 1.8, 2.5])
def test_sigma_on_level_ground_is_not_too_small_and_little_too_large(spacing: float) -> None:
    rng, sigma, cells = np.random.default_rng(2), 0.012, 160
    lattice = np.floor(np.arange(spacing / 2, cells, spacing)).astype(int)
    measured = np.full((cells, cells), np.nan)
    measured[np.ix_(lattice, lattice)] = rng.normal(0.0, sigma, (len(lattice), len(lattice)))
    membrane = fitted_membrane(measured, np.full(measured.shape, sigma), spacing, GATE)
    z = (membrane.height / deviation(membrane, spacing))[MIDDLE]
    # Some 2000 independent heights: the standard error of the rms is 2 %.
    assert 0.75 < np.sqrt(np.mean(z**2)) < 1.06


def test_a_step_stays_where_it_is() -> None:
    rng, sigma = np.random.default_rng(3), 0.012
    truth = np.where(np.arange(60) < 30, 0.0, 0.27)[:, None] * np.ones(60)
    membrane = fitted_membrane(truth + rng.normal(0.0, sigma, truth.shape), np.full(truth.shape, sigma), 1.0, GATE)
    assert not membrane.joined[0][29].any()
    assert np.mean(membrane.joined[0]) > 0.98
    error = membrane.height - truth
    assert np.abs(error[28:32]).max() < 4 * sigma
    assert abs(error[28:30].mean()) < 0.2 * sigma  # 120 heights: the standard error is 0.06 sigma


def test_a_slope_has_no_bias_and_is_not_rough() -> None:
    rng, sigma = np.random.default_rng(4), 0.012
    rise = 0.2  # m per cell: a step, if the slope is not known
    truth = rise * np.arange(80)[:, None] * np.ones(80)
    slope = np.stack([np.full(truth.shape, rise), np.zeros(truth.shape)], axis=-1)
    measured = truth + rng.normal(0.0, sigma, truth.shape)
    assert not fitted_membrane(measured, np.full(truth.shape, sigma), 1.0, GATE).joined[0].any()
    membrane = fitted_membrane(measured, np.full(truth.shape, sigma), 1.0, GATE, slope)
    assert membrane.joined[0].all()
    error = (membrane.height - truth)[MIDDLE]
    assert abs(error.mean()) < 0.05 * sigma  # 4096 heights: the standard error is 0.015 sigma
    z = error / deviation(membrane, 1.0)[MIDDLE]
    assert 0.8 < np.sqrt(np.mean(z**2)) < 1.06


def test_rough_ground_has_a_greater_sigma() -> None:
    rng, sigma = np.random.default_rng(5), 0.012
    truth = rng.normal(0.0, 3 * sigma, (80, 80))
    membrane = fitted_membrane(truth + rng.normal(0.0, sigma, truth.shape), np.full(truth.shape, sigma), 1.0, GATE)
    level = fitted_membrane(rng.normal(0.0, sigma, truth.shape), np.full(truth.shape, sigma), 1.0, GATE)
    assert deviation(membrane, 1.0).mean() > 1.3 * deviation(level, 1.0).mean()


def test_sigma_grows_into_a_gap_as_far_as_the_ground_is_rough() -> None:
    """Walks of the prior's own step along rows and columns, and level ground: 30 gaps of 9 cells each."""
    rng, sigma, gap = np.random.default_rng(6), 0.01, 9
    shape, middle = (60, 30 * 2 * gap), np.arange(gap // 2, 30 * 2 * gap, 2 * gap)
    is_gap = np.arange(shape[1]) % (2 * gap) < gap
    stated = []
    for step in (0.0, FREEDOM * sigma):
        truth = np.cumsum(rng.normal(0.0, step, shape[1])) + np.cumsum(rng.normal(0.0, step, shape[0]))[:, None]
        measured = np.where(is_gap, np.nan, truth + rng.normal(0.0, sigma, shape))
        membrane = fitted_membrane(measured, np.full(shape, sigma), 1.0, GATE)
        stated_sigma = deviation(membrane, 1.0)
        z = ((membrane.height - truth) / stated_sigma)[8:-8, middle[1:-1]]
        # 28 gaps, whose rows share their error: the standard error of the rms is 13 % of it.
        assert np.sqrt(np.mean(z**2)) < 1.3
        assert step == 0 or np.sqrt(np.mean(z**2)) > 0.6
        stated.append(np.median(stated_sigma[8:-8, middle]))
        assert not membrane.covered[:, middle].any()
    assert stated[1] > 2 * stated[0]


def test_a_ramp_may_be_a_step_and_a_ridge_is_none() -> None:
    """A ramp of 0.15 m over 5 cells, on which a step would be 0.075 m off, and a ridge of the same slope."""
    rng, sigma = np.random.default_rng(7), 0.012
    row = np.arange(60)[:, None] * np.ones(60)
    ramp, ridge = np.clip((row - 27.5) * 0.03, 0.0, 0.15), 0.03 * np.abs(row - 29.5)
    level, on_ramp, on_ridge = (
        deviation(fitted_membrane(truth + rng.normal(0.0, sigma, truth.shape), 0 * row + sigma, 1.0, GATE), 1.0)
        for truth in (0 * row, ramp, ridge)
    )
    assert np.median(on_ramp[28:33]) > 0.015  # 5 sigma reach from the ramp to the step
    assert np.median(on_ramp[10:20]) < 1.3 * np.median(level)
    assert np.median(on_ridge[28:32]) < 1.3 * np.median(level)
