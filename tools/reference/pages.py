"""The pages of the reference, and what makes the text of each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from tools.reference import commands, messages, parameters, presets, topics

DOCS = Path(__file__).parents[2] / "docs"

PAGES: Mapping[Path, Callable[[], str]] = {
    DOCS / "parameters.md": parameters.document,
    DOCS / "reference" / "commands.md": commands.document,
    DOCS / "reference" / "messages.md": messages.document,
    DOCS / "reference" / "presets.md": presets.document,
    DOCS / "reference" / "topics.md": topics.document,
}
"""The function that makes the text of each page of the reference."""
