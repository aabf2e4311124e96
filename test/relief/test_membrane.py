"""The membrane against the exact posterior of its Gaussian field, on level ground, slopes and steps."""

from __future__ import annotations

import numpy as np
import pytest

from sal_height.numeric import F64
from sal_height.relief.membrane import FREEDOM, fitted_membrane

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
    ratio = membrane.sigma[MIDDLE] / np.sqrt(averaged)[MIDDLE]
    assert ratio.min() > 0.97
    assert ratio.mean() < 1.08


@pytest.mark.parametrize("spacing", [1.0, 1.8, 2.5])
def test_sigma_on_level_ground_is_not_too_small_and_little_too_large(spacing: float) -> None:
    rng, sigma, cells = np.random.default_rng(2), 0.012, 160
    lattice = np.floor(np.arange(spacing / 2, cells, spacing)).astype(int)
    measured = np.full((cells, cells), np.nan)
    measured[np.ix_(lattice, lattice)] = rng.normal(0.0, sigma, (len(lattice), len(lattice)))
    membrane = fitted_membrane(measured, np.full(measured.shape, sigma), spacing, GATE)
    z = (membrane.height / membrane.sigma)[MIDDLE]
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
    z = error / membrane.sigma[MIDDLE]
    assert 0.8 < np.sqrt(np.mean(z**2)) < 1.06


def test_rough_ground_has_a_greater_sigma() -> None:
    rng, sigma = np.random.default_rng(5), 0.012
    truth = rng.normal(0.0, 3 * sigma, (80, 80))
    membrane = fitted_membrane(truth + rng.normal(0.0, sigma, truth.shape), np.full(truth.shape, sigma), 1.0, GATE)
    level = fitted_membrane(rng.normal(0.0, sigma, truth.shape), np.full(truth.shape, sigma), 1.0, GATE)
    assert membrane.sigma.mean() > 1.3 * level.sigma.mean()


def test_sigma_grows_into_a_gap() -> None:
    sigma = np.full((9, 41), 0.01)
    measured = np.zeros(sigma.shape)
    measured[:, 14:27] = np.nan
    membrane = fitted_membrane(measured, sigma, 1.0, GATE)
    into_gap = membrane.sigma[4, 14:21]
    assert (np.diff(into_gap) > 0).all()
    assert into_gap[-1] > 0.02
    assert not membrane.covered[4, 20]
