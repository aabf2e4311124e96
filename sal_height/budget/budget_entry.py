"""A number of a budget, and its table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from sal_height.tables import aligned


@dataclass(frozen=True)
class BudgetEntry:
    """A number of the budget.

    Attributes:
        group: heading.
        key: name in the JSON file, with its unit.
        title: name in words.
        value: number in `unit`.
        unit: unit as printed.
        remark: printed behind it; empty: none.
    """

    group: str
    key: str
    title: str
    value: float
    unit: str
    remark: str = ""


def budget_table(entries: Sequence[BudgetEntry]) -> str:
    """The numbers as lines of text, under their headings."""
    cells = [(f"  {one.title}", _number(one.value), f"{one.unit.ljust(4)} {one.remark}".rstrip()) for one in entries]
    width = max(len(unit) for *_, unit in cells)
    rows = aligned([(title, number, unit.ljust(width)) for title, number, unit in cells]).splitlines()
    lines: list[str] = []
    for group, members in groupby(zip(entries, rows, strict=True), key=lambda pair: pair[0].group):
        lines += [group, *(row.rstrip() for _, row in members)]
    return "\n".join(lines)


def _number(value: float) -> str:
    """A number with four digits that count, and without an exponent."""
    return np.format_float_positional(value, precision=4, unique=False, fractional=False, trim="-").rstrip(".")
