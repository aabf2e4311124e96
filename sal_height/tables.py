"""Tables as lines of text."""

from __future__ import annotations

import math
from collections.abc import Sequence

ABSENT = "-"
"""Stands for a number that does not exist, such as the bias of an estimator without valid pixels."""


def aligned(rows: Sequence[Sequence[str]]) -> str:
    """Rows of texts as lines with columns two spaces apart, the first aligned left and the others right."""
    widths = [max(len(text) for text in column) for column in zip(*rows, strict=True)]
    return "\n".join(
        "  ".join([row[0].ljust(widths[0]), *(t.rjust(w) for t, w in zip(row[1:], widths[1:], strict=True))])
        for row in rows
    )


def counted(count: int, noun: str) -> str:
    """A number of things, such as "1 dwell" or "2 dwells"."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def with_prefix(value: float, unit: str) -> tuple[str, str]:
    """A number with four significant digits, and its unit with the SI prefix by which it is from 1 to 1000.

    Args:
        value: number in `unit`.
        unit: unit without a prefix, such as "W".
    """
    rounded = float(f"{value:.4g}")
    thousands = math.floor(math.log10(abs(rounded)) / 3) if rounded and math.isfinite(rounded) else 0
    thousands = min(max(thousands, -4), 4)
    prefix = ("p", "n", "µ", "m", "", "k", "M", "G", "T")[thousands + 4]
    return f"{rounded / 1000.0**thousands:.4g}", f"{prefix}{unit}"


def number_text(value: float | None, form: str, scale: float = 1.0) -> str:
    """A number times `scale` in this format; ABSENT for None."""
    return ABSENT if value is None else format(scale * value, form)
