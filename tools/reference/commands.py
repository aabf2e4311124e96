"""The page of the commands: the help of each."""

from __future__ import annotations

from collections.abc import Iterator
from io import StringIO

from cyclopts import App
from rich.console import Console

from sal_height.commands._program import program
from tools.reference.markdown import page

WIDTH = 80
"""Columns of the text, those of the examples and exit statuses in it."""

HEAD = """# Commands

`tools/reference` makes this page of what `sal-height COMMAND --help` prints; a test fails if it is out of date."""


def document() -> str:
    """The text of docs/reference/commands.md."""
    return page([HEAD, *(_section(path, root) for root in [program()] for path in ([], *_paths(root, [])))])


def _paths(app: App, path: list[str]) -> Iterator[list[str]]:
    """The names of all commands and of the commands in them, in the order of the help."""
    for name in app:
        if not name.startswith("-"):
            yield [*path, name]
            yield from _paths(app[name], [*path, name])


def _section(path: list[str], root: App) -> str:
    text = StringIO()
    root.help_print(path, console=Console(file=text, width=WIDTH, force_terminal=False, color_system=None))
    lines = [line.rstrip() for line in text.getvalue().strip("\n").splitlines()]
    return "\n".join([f"## {' '.join(['sal-height', *path])}", "", "```text", *lines, "```"])
