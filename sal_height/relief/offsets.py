"""Height errors that all pixels of a dwell share: how far they average out over dwells, and whether the data agree.

A boresight errs in the same way in all dwells of a flight, the position of the platform in a way that changes. No
message says how fast. Where nobody states it, all of the shared error lasts, and no number of dwells reduces it. Where
it is stated, the part that varies is a stationary process whose correlation falls to 1 / e in a time T (Gauss-Markov of
first order, Gelb, Applied Optimal Estimation, 1974, section 3.8), and the mean over dwells has less of it.

The data cannot replace such a statement: what lasts is not in the differences of dwells. They can contradict it:
offsets that differ by less than stated do not average out as stated either (`OffsetTest`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtr

from sal_height.errors import UserError
from sal_height.numeric import F64, I64
from sal_height.relief.slope import median

LEAST_SHARED = 30
"""Least number of cells that two dwells share from which the difference of their common errors is found."""

CHANCE = 1e-6
"""Probability with which a dwell contradicts what is stated rightly; it is tested after each dwell of a flight."""


@dataclass(frozen=True)
class SharedError:
    """Course of the height error that all pixels of a dwell share.

    Attributes:
        varying: standard deviation of the part that changes in flight, m; 0: all of it lasts.
        correlation: time in which the correlation of that part falls to 1 / e, s.
    """

    varying: float = 0.0
    correlation: float = math.inf

    def correlation_after(self, elapsed: F64 | float) -> F64:
        """Correlation of two errors `elapsed` s after each other; 1 where the order of dwells is not that of time."""
        return np.asarray(np.exp(-np.maximum(elapsed, 0.0) / self.correlation))

    def averaged(self, variance: F64, fraction: F64) -> F64:
        """Variance of a mean over dwells, m^2.

        Args:
            variance: variance of the shared error of one dwell, m^2.
            fraction: variance of the mean of the part that varies over that of one dwell, as `mean_fraction`.
        """
        return variance - np.minimum(self.varying**2, variance) * (1 - fraction)


LASTING = SharedError()
"""All of the shared error lasts."""


def stated_course(varying: float, correlation: float) -> SharedError:
    """The course of the shared error by two parameters, of which 0 is not stated.

    Raises:
        UserError: only one of them is stated.
    """
    if bool(varying) != bool(correlation):
        stated, missing = ("varying_offset_m", "offset_correlation_s")[:: 1 if varying else -1]
        raise UserError(
            f"Parameter {stated} is stated without {missing}; state both, or neither: the shared error of dwells "
            "averages out only as far as the part of it that varies is known together with its correlation time."
        )
    return SharedError(varying, correlation) if varying else LASTING


SINGLE = np.diag([0.0, 1.0])
"""Products of the whitened offset and of a whitened constant in a chain of one dwell, whose offset counts as 0."""


class OffsetTest:
    """Offsets of successive dwells against the stated course of the shared error.

    The offset of a dwell is the median rise of its heights above those of the dwell before, in the cells that both have
    seen, added up over a chain of dwells. With the correlation r from one dwell to the next, innovations
    (x_n - r x_(n-1)) / sqrt(1 - r^2) are independent, and so, without their mean, is the chi-square of their squares
    over the stated variance. Errors of the medians make it greater: a small one contradicts the statement.
    """

    def __init__(self, course: SharedError) -> None:
        """A test without dwells."""
        self._course = course
        self._before: tuple[I64, F64, float] | None = None
        self._ended = np.zeros(2)  # chi-square and degrees of freedom of the chains before
        self._offset = 0.0
        self._dwells = 1
        self._products = SINGLE

    def add(self, cells: I64, heights: F64, time: float) -> None:
        """Enter a dwell.

        Args:
            cells: number of each cell that it has seen, each once, shape (cells,).
            heights: height in each cell, m, shape (cells,).
            time: time of the dwell, s.
        """
        before, self._before = self._before, (cells, heights, time)
        if before is None:
            return
        _, now, then = np.intersect1d(cells, before[0], assume_unique=True, return_indices=True)
        correlation = float(self._course.correlation_after(time - before[2]))
        if len(now) < LEAST_SHARED or correlation == 1:
            self._ended += self._chain()
            self._offset, self._dwells, self._products = 0.0, 1, SINGLE
            return
        offset = self._offset + median(heights[now] - before[1][then])
        spread = math.sqrt(1 - correlation**2)
        whitened = np.array([(offset - correlation * self._offset), 1 - correlation]) / spread
        self._products = self._products + np.outer(whitened, whitened)
        self._offset, self._dwells = offset, self._dwells + 1

    @property
    def contradiction(self) -> str | None:
        """Message on offsets that differ by less than stated; None: the data do not contradict it."""
        chi_square, freedom = (self._ended + self._chain()).tolist()
        if freedom == 0 or chdtr(freedom, chi_square) > CHANCE:
            return None
        return (
            f"Heights of successive dwells differ by {math.sqrt(chi_square / freedom):.2g} of the offsets that "
            f"varying_offset_m = {self._course.varying:g} and offset_correlation_s = {self._course.correlation:g} "
            "state: their shared errors are smaller, or last longer. The map does not let them average out; correct "
            "the two parameters."
        )

    def _chain(self) -> F64:
        """Chi-square of the chain about its mean, and degrees of freedom."""
        (offsets, both), (_, constant) = self._products.tolist()
        return np.array([(offsets - both**2 / constant) / self._course.varying**2, self._dwells - 1])
