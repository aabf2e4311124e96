"""Structure of the ground within the cells of a map: a spread of heights that no number of dwells averages away.

Where two levels lie in a cell, each dwell measures a mixture of its own. The height of the cell then is within that
spread, however many dwells it is the mean of. What a dwell sees of it is in its own sigma (`map._averaged`); what
differs from dwell to dwell beyond their errors is found here.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.ndimage import convolve1d
from scipy.special import chdtri

from sal_height.numeric import F32, F64

CHANCE = 0.01
"""Probability with which a cell without structure is said to have some."""


def structure_variance(misfit: F32) -> F32:
    """Variance of the structure of cells, m^2, shape (rows, cols); 0 where the dwells agree within their errors.

    Heights of n dwells with the weights w and the weighted mean h have the misfit Q = sum w (h_i - h)^2, chi-square of
    n - 1 degrees of freedom if there is no structure. A greater one than CHANCE allows gives the variance

        (Q - (n - 1)) / (sum w - sum w^2 / sum w),

    which is right on average whatever the structure (DerSimonian & Laird, Controlled Clinical Trials 7, 177, 1986). It
    is found for a cell alone, which may contain a step, and for all of 3 x 3 cells around it together, which shows what
    few dwells leave open in one; the greater one counts.

    Args:
        misfit: Q, n - 1 and the denominator of each cell, 0 where fewer than two dwells have seen it, shape
            (rows, cols, 3).
    """
    around = misfit
    for axis in (0, 1):
        around = convolve1d(around, np.ones(3), axis=axis, mode="constant")
    return np.maximum(_excess(misfit), _excess(around))


def _excess(misfit: F32) -> F32:
    """Variance by the misfit of some cells together, where it is greater than CHANCE allows; else 0."""
    chi_square, freedom, scale = np.moveaxis(misfit, -1, 0)
    limit = _limits(int(freedom.max(initial=0)).bit_length())[freedom.astype(np.int64)]
    beyond = chi_square > limit
    return np.divide(chi_square - freedom, scale, out=np.zeros_like(chi_square), where=beyond)


@lru_cache(maxsize=4)
def _limits(bits: int) -> F64:
    """Chi-square that is exceeded with the probability CHANCE, by its degrees of freedom from 0 to 2^bits."""
    return np.r_[np.inf, chdtri(np.arange(1, 2**bits + 1), CHANCE)]
