"""A row of the benchmark: something measured, beside what it has to be."""

from __future__ import annotations

import operator
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

REPEATS = 9
"""Of everything that is timed; its median counts."""

_COMPARISONS: dict[str, Callable[[float, float], bool]] = {"<=": operator.le, ">=": operator.ge}


@dataclass(frozen=True)
class Row:
    """A number and its target.

    Attributes:
        name: what was measured.
        value: of it.
        unit: of value and target; "1" for a ratio.
        target: "<= number" or ">= number".
        reference: what it was measured against, or on.
    """

    name: str
    value: float
    unit: str
    target: str
    reference: str

    @property
    def ok(self) -> bool:
        """Whether the value meets the target; NaN does not."""
        comparison, limit = self.target.split()
        return _COMPARISONS[comparison](self.value, float(limit))

    def as_json(self) -> dict[str, object]:
        """The row as it is kept in bench.json."""
        names = ("name", "value", "unit", "target", "reference", "ok")
        return {name: getattr(self, name) for name in names}


def medians(*functions: Callable[[], object]) -> list[float]:
    """Median times (s) of some functions, measured in turn so that what else the machine does strikes all alike."""
    for function in functions:
        function()
    times = [[_time(function) for function in functions] for _ in range(REPEATS)]
    return [statistics.median(column) for column in zip(*times, strict=True)]


def _time(function: Callable[[], object]) -> float:
    start = time.perf_counter()
    function()
    return time.perf_counter() - start
