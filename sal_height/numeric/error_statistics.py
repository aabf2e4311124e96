"""Statistics of errors and of their predicted standard deviations: the one definition of all reports and benchmarks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sal_height.numeric.arrays import F64, Bool

QUANTILES = (0.16, 0.84)
"""Quantiles between which s68 is half the width; those of one standard deviation are 0.1587 and 0.8413, 0.6 % wider."""

MEDIAN_ERROR = float(np.sqrt(np.pi / 2))
"""Standard error of a median of many normal numbers over that of their mean."""


@dataclass(frozen=True)
class ErrorStatistics:
    """Statistics of a sample of errors; all but the count are NaN for an empty sample.

    Attributes:
        count: number of errors.
        bias: mean error, in the unit of the errors (m of height, in all reports).
        rms: root mean square error about zero, same unit.
        deviation: root mean square error about the bias, same unit.
        median: median error, same unit.
        s68: half the width between the QUANTILES of the errors, same unit: about the standard deviation of a normal
            distribution of the same width, but insensitive to outliers.
        sigma: mean predicted standard deviation, same unit.
        within_1_sigma: fraction of errors smaller than their predicted standard deviation (normal errors: 0.683).
        within_2_sigma: fraction smaller than twice that (normal errors: 0.954).
        beyond_5_sigma: fraction greater than five times that (normal errors: 6e-7).
    """

    count: int
    bias: float
    rms: float
    deviation: float
    median: float
    s68: float
    sigma: float
    within_1_sigma: float
    within_2_sigma: float
    beyond_5_sigma: float

    def in_metres(self, keys: Sequence[str]) -> dict[str, float | None]:
        """Entries of a report on errors in m, by key: `bias_m` is `bias`. None for an empty sample: JSON has no NaN."""
        values = {key: getattr(self, key.removesuffix("_m")) for key in keys}
        return {key: value if math.isfinite(value) else None for key, value in values.items()}


def error_statistics(errors: F64, sigmas: F64) -> ErrorStatistics:
    """Statistics of errors.

    Args:
        errors: finite differences estimate - truth, shape (n,), any unit.
        sigmas: predicted standard deviations of the errors, shape (n,), same unit.
    """
    size = np.abs(errors)
    return ErrorStatistics(
        count=errors.size,
        bias=mean_of(errors),
        rms=float(root_mean_square(errors)) if errors.size else math.nan,
        deviation=float(np.std(errors)) if errors.size else math.nan,
        median=float(np.quantile(errors, 0.5)) if errors.size else math.nan,
        s68=half_width(errors) if errors.size else math.nan,
        sigma=mean_of(sigmas),
        within_1_sigma=mean_of(size < sigmas),
        within_2_sigma=mean_of(size < 2 * sigmas),
        beyond_5_sigma=mean_of(size > 5 * sigmas),
    )


def half_width(sample: F64, quantiles: tuple[float, float] = QUANTILES) -> float:
    """Half the width of a sample that is not empty between two of its quantiles, in its unit."""
    low, high = np.quantile(sample, quantiles)
    return float(high - low) / 2


def root_mean_square(values: F64, axis: int | None = None) -> F64:
    """Root mean square about zero along an axis, or of all values, in their unit."""
    return np.asarray(np.sqrt(np.mean(values**2, axis=axis)))


def mean_of(values: F64 | Bool) -> float:
    """Mean of values, or fraction of True among conditions; NaN if there are no values."""
    return float(np.mean(values)) if values.size else math.nan


def fraction_of(part: int, whole: int) -> float:
    """Fraction that a part is of a whole; NaN if the whole is empty."""
    return part / whole if whole else math.nan
