"""A row of the benchmark: something measured beside its target, and how times are measured."""

from __future__ import annotations

import operator
import os
import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, TypeVar

Size = TypeVar("Size")

QUICK = "SAL_HEIGHT_QUICK_BENCHMARKS"
"""Environment variable that, if set, shrinks all sizes: to test that benchmarks run, not to measure anything."""

_COMPARISONS: dict[str, Callable[[float, float], object]] = {"<=": operator.le, ">=": operator.ge}


def sized(full: Size, quick: Size) -> Size:
    """Choose the size of a benchmark: `full` to measure, `quick` to test that it runs."""
    return quick if os.environ.get(QUICK) else full


REPEATS = sized(9, 1)
"""Number of times that everything is timed; the median counts."""


@dataclass(frozen=True)
class Row:
    """A number and its target.

    Attributes:
        name: name of the measured quantity.
        value: the number.
        unit: unit of value and target; "1" for a ratio.
        target: "<= number" or ">= number".
        reference: reference or conditions of the measurement.
        details: numbers behind it, by name, for pages and pictures that are made of the results.
    """

    name: str
    value: float
    unit: str
    target: str
    reference: str
    details: Mapping[str, Any] = field(default_factory=dict)

    @property
    def ok(self) -> bool:
        """True if the value meets the target; NaN does not."""
        comparison, limit = self.target.split()
        return bool(_COMPARISONS[comparison](self.value, float(limit)))

    def as_json(self) -> dict[str, object]:
        """The row as bench.json has it: numbers of Python, not of NumPy, which the module json refuses."""
        return {**asdict(self), "value": float(self.value), "ok": self.ok}


def medians(*functions: Callable[[], object], repeats: int = REPEATS) -> list[float]:
    """Median times (s) of some functions, measured in turn, so that other load of the machine affects all alike."""
    for function in functions:
        function()
    times = [[_time(function) for function in functions] for _ in range(repeats)]
    return [statistics.median(column) for column in zip(*times, strict=True)]


def _time(function: Callable[[], object]) -> float:
    start = time.perf_counter()
    function()
    return time.perf_counter() - start


def load() -> str:
    """The load of the machine now, for the reference of a row."""
    return f"load {os.getloadavg()[0]:.1f} of {os.cpu_count()} processors"
