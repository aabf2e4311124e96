"""Differences of the values of one field from the golden ones, over all messages of a topic."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sal_height.io import or_null
from sal_height.numeric import F64, I64

EDGES: F64 = np.concatenate([[0.0], 10.0 ** (np.arange(-20 * 20, 20 * 20 + 1) / 20), [np.inf]])
"""Limits of the bins of differences for quantiles, twenty per decade."""


class WorstValue(NamedTuple):
    """A value and the golden one: the dwell (or number) of their message, and their position in the field."""

    dwell: int
    position: int
    golden: str
    made: str


@dataclass
class FieldDifference:
    """Differences of the values of a field from the golden ones.

    Attributes:
        values: number of values compared.
        different: number of values that are not the same; NaN is the same as NaN.
        outside: number of values beyond the tolerance.
        nan_changes: number of values that are NaN on one side only.
        unmatched: number of values without a counterpart, since a field has another number of values.
        greatest: greatest difference of two finite numbers; NaN if none were compared.
        worst: value that is farthest beyond its tolerance, or nearest to it.
    """

    values: int = 0
    different: int = 0
    outside: int = 0
    nan_changes: int = 0
    unmatched: int = 0
    greatest: float = float("nan")
    worst: WorstValue | None = None
    _farthest: float = -np.inf
    _squares: float = 0.0
    _classes: I64 = field(default_factory=lambda: np.zeros(len(EDGES), np.int64))

    @property
    def rms(self) -> float:
        """Root mean square of the differences of finite numbers; NaN if there are none."""
        count = self._classes.sum()
        return float(np.sqrt(self._squares / count)) if count else float("nan")

    def quantile(self, share: float) -> float:
        """Difference that a fraction `share` of the values does not exceed, up to 12 % too great; NaN if empty."""
        counts = np.cumsum(self._classes)
        if not counts[-1]:
            return float("nan")
        limit = EDGES[int(np.searchsorted(counts, share * counts[-1]))]
        return float(min(limit, self.greatest))

    def add(self, golden: NDArray[Any], made: NDArray[Any], allowed: F64, dwell: int) -> int:
        """Add the values of a message.

        Args:
            golden: expected values, shape (n,).
            made: values to judge, shape (m,).
            allowed: greatest differences that are within the tolerance, shape (n,).
            dwell: dwell of the message, or its number.

        Returns:
            The number of values beyond the tolerance.
        """
        self.values += max(golden.size, made.size)
        if golden.size != made.size or (golden.dtype.kind == "U") != (made.dtype.kind == "U"):
            return self._add_unmatched(golden, made, dwell)
        same = np.asarray(golden == made)
        if golden.dtype.kind == "U":
            excess = np.where(same, -np.inf, np.inf)
        else:
            nan = np.isnan(golden), np.isnan(made)
            self.nan_changes += int(np.count_nonzero(nan[0] != nan[1]))
            same |= nan[0] & nan[1]
            excess = np.where(same, -allowed, self._measure(golden, made) - allowed)
            excess[np.isnan(excess)] = np.inf
            excess[nan[0] & nan[1]] = -np.inf
        outside = int(np.count_nonzero(~same & ~(excess <= 0)))
        self.different += int(np.count_nonzero(~same))
        self.outside += outside
        if not same.all():
            changed = np.where(same, -np.inf, excess)
            self._note(float(changed.max()), int(changed.argmax()), golden, made, dwell)
        return outside

    def as_json(self) -> dict[str, Any]:
        """Entry of a report."""
        return {
            "values": self.values,
            "different": self.different,
            "outside": self.outside,
            "nan_changes": self.nan_changes,
            "unmatched": self.unmatched,
            "greatest": or_null(self.greatest),
            "rms": or_null(self.rms),
            **{f"p{round(100 * share)}": or_null(self.quantile(share)) for share in (0.5, 0.95, 0.99)},
            "worst": self.worst and self.worst._asdict(),
        }

    def _add_unmatched(self, golden: NDArray[Any], made: NDArray[Any], dwell: int) -> int:
        count = max(golden.size, made.size)
        self.unmatched += count
        self.different += count
        self.outside += count
        self._note(np.inf, 0, np.array([f"{golden.size} values"]), np.array([f"{made.size} values"]), dwell)
        return count

    def _measure(self, golden: NDArray[Any], made: NDArray[Any]) -> F64:
        """Differences of numbers, entered where both are finite; NaN or infinite where one is not."""
        if golden.dtype.kind in "iub" and made.dtype.kind in "iub":  # beyond 2**53 float64 would lose digits
            difference = np.abs(golden.astype(np.int64) - made.astype(np.int64)).astype(np.float64)
        else:
            wide = np.complex128 if "c" in (golden.dtype.kind, made.dtype.kind) else np.float64
            with np.errstate(invalid="ignore"):
                difference = np.abs(golden.astype(wide) - made.astype(wide))
        finite = difference[np.isfinite(difference)]
        if finite.size:
            self.greatest = float(np.fmax(self.greatest, finite.max()))
            self._squares += float(np.sum(finite**2))
            self._classes += np.bincount(np.searchsorted(EDGES, finite), minlength=len(EDGES))
        return difference

    def _note(self, excess: float, index: int, golden: NDArray[Any], made: NDArray[Any], dwell: int) -> None:
        if excess > self._farthest:
            self._farthest = excess
            self.worst = WorstValue(dwell, index, str(golden[index]), str(made[index]))
