"""Tables as lines of text."""

from __future__ import annotations

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


def number_text(value: float | None, form: str, scale: float = 1.0) -> str:
    """A number times `scale` in this format; ABSENT for None."""
    return ABSENT if value is None else format(scale * value, form)
