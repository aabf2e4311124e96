"""The spread of heights within cells that no number of dwells averages away."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from sal_height.numeric import F64
from sal_height.relief.structure import CHANCE, structure_variance


def misfit_of(heights: F64, variance: F64) -> F64:
    """Misfit of the heights of dwells, shape (dwells, rows, cols), and of their variances."""
    weight = 1 / variance
    total = weight.sum(axis=0)
    mean = (weight * heights).sum(axis=0) / total
    freedom = np.full(mean.shape, len(heights) - 1.0)
    chi_square = (weight * (heights - mean) ** 2).sum(axis=0)
    return np.stack([chi_square, freedom, total - (weight**2).sum(axis=0) / total], axis=-1).astype(np.float32)


@pytest.mark.parametrize("dwells", [2, 5, 50])
def test_level_cells_seldom_have_structure(dwells: int) -> None:
    """Each cell has it with the probability CHANCE, and so have nine together, of which cells share some."""
    rng = np.random.default_rng(1)
    variance = rng.uniform(0.5, 2.0, (dwells, 200, 200))
    found = structure_variance(misfit_of(np.sqrt(variance) * rng.standard_normal(variance.shape), variance))
    share = np.mean(found > 0)
    assert CHANCE < share < 2 * CHANCE + 0.003


@pytest.mark.parametrize("dwells", [10, 50])
def test_structure_of_one_cell_is_found_as_large_as_it_is(dwells: int) -> None:
    """Cells far from each other, each of 3 units where dwells err by 1: on average, and with what chance leaves."""
    rng, tau = np.random.default_rng(2), 3.0
    heights = rng.standard_normal((dwells, 90, 90))
    heights[:, 1::3, 1::3] += tau * rng.standard_normal((dwells, 30, 30))
    found = structure_variance(misfit_of(heights, np.ones(heights.shape)))[1::3, 1::3]
    expected = (1 + tau**2) * np.sqrt(2 / (dwells - 1) / found.size)  # standard error of the mean
    assert np.mean(found) == pytest.approx(tau**2, abs=4 * expected)


def test_two_dwells_show_structure_that_many_cells_have() -> None:
    """One degree of freedom leaves most cells open, nine do not."""
    rng, tau = np.random.default_rng(3), 3.0
    heights = np.sqrt(1 + tau**2) * rng.standard_normal((2, 100, 100))
    found = structure_variance(misfit_of(heights, np.ones(heights.shape)))[1:-1, 1:-1]
    unseen = chi2.cdf(chi2.isf(CHANCE, 9) / (1 + tau**2), 9)  # by nine cells together
    assert np.mean(found == 0) <= unseen + 4 * np.sqrt(9 * unseen / found.size)


def test_cells_that_fewer_than_two_dwells_have_seen_have_none() -> None:
    assert not structure_variance(np.zeros((4, 5, 3), np.float32)).any()
