"""Statistics of a sample, each with its standard error."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sal_height.numeric import F64, Bool, half_width
from sal_height.theory import NORMAL_SHARES


class Measured(NamedTuple):
    """A statistic of a sample; NaN where the sample has none.

    Attributes:
        value: value of the statistic.
        standard_error: standard error of the value.
    """

    value: float
    standard_error: float


def mean(sample: F64) -> Measured:
    """Mean; its standard error is nominal where no variance exists."""
    return Measured(float(np.mean(sample)), float(np.std(sample) / np.sqrt(sample.size)))


def std(sample: F64) -> Measured:
    """Standard deviation; its standard error comes from the fourth moment."""
    deviation = sample - np.mean(sample)
    variance, fourth = np.mean(deviation**2), np.mean(deviation**4)
    with np.errstate(invalid="ignore"):
        error = np.sqrt((fourth - variance**2) / sample.size) / (2 * np.sqrt(variance))
    return Measured(float(np.sqrt(variance)), float(error))


def median(sample: F64) -> Measured:
    """Median; its standard error is 1 / (2 f sqrt(n)), with the density f at the median from the sample."""
    return Measured(float(np.median(sample)), float(_inverse_density(sample, 0.5) / 2 / np.sqrt(sample.size)))


def s68(sample: F64) -> Measured:
    """Half the width from 16 to 84 %: the standard deviation of a normal distribution as wide.

    The covariance of the quantiles of probabilities p < q is p (1 - q) / (n f_p f_q).
    """
    low, high = NORMAL_SHARES
    at_low, at_high = (_inverse_density(sample, p) for p in NORMAL_SHARES)
    variance = low * high * (at_low**2 + at_high**2) - 2 * low * (1 - high) * at_low * at_high
    return Measured(half_width(sample, NORMAL_SHARES), float(np.sqrt(variance / sample.size) / 2))


def share(chosen: Bool) -> Measured:
    """Fraction of the sample that is chosen; the standard error of 0 or 1 is that of one more of each kind."""
    smooth = (np.count_nonzero(chosen) + 1) / (chosen.size + 2)
    return Measured(float(np.mean(chosen)), float(np.sqrt(smooth * (1 - smooth) / chosen.size)))


def _inverse_density(sample: F64, probability: float) -> float:
    """1 / f at a quantile, from quantiles n^(-1/3) apart in probability (Hall and Sheather 1988)."""
    half = min(sample.size ** (-1 / 3) / 2, probability, 1 - probability)
    low, high = np.quantile(sample, (probability - half, probability + half))
    return float((high - low) / (2 * half))
