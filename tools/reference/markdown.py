"""Tables and plain text in Markdown."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence


def table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of cells that are Markdown already."""
    lines = [f"| {' | '.join(headings)} |", f"|{'---|' * len(headings)}", *(f"| {' | '.join(row)} |" for row in rows)]
    return "\n".join(line.replace("  ", " ") for line in lines)


def plain(text: str) -> str:
    """Text that Markdown shows as it stands, in a table, too."""
    return re.sub(r"[\\`*\[\]<>|]", r"\\\g<0>", text)


def page(sections: Iterable[str]) -> str:
    """The text of a page: sections with an empty line between them."""
    return "\n\n".join(section for section in sections if section) + "\n"
