"""The page of the presets: their files."""

from __future__ import annotations

from pathlib import Path

from tools.reference.markdown import page

FOLDER = Path(__file__).parents[2] / "sal_height" / "presets"

HEAD = """# Presets that come with the program

`tools/reference` makes this page of the files in [`sal_height/presets`](../../sal_height/presets); a test fails if it
is out of date. [presets.md](../presets.md) says what each key means and which values are allowed. A key that is not
there has its default."""


def document() -> str:
    """The text of docs/reference/presets.md."""
    return page([HEAD, *(_section(path) for path in sorted(FOLDER.glob("*.yaml")))])


def _section(path: Path) -> str:
    return f"## {path.stem}\n\n```yaml\n{path.read_text(encoding='utf-8').strip()}\n```"
