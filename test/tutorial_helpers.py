"""Pages of docs/ run as a reader runs them: block by block, in the order of the page, in the current folder."""

from __future__ import annotations

import math
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from sal_height.commands import main

DOCS = Path(__file__).parents[1] / "docs"

TOLERANCE = 0.05
"""How far a number in a page may be from the one that is printed, over the latter: processors round differently."""

ANYTHING = "…"


@dataclass(frozen=True)
class Block:
    """A block of a page.

    Attributes:
        language: empty: lines of a shell; text: what was printed since the last such block.
        content: lines between the fences.
    """

    language: str
    content: str

    @property
    def file(self) -> str:
        """Name of the file that the block is, by its first line, a comment of nothing but a name; empty: it is none."""
        found = re.match(r"# ([\w.]+\.(?:py|yaml))\n", self.content)
        return found[1] if found else ""

    @property
    def commands(self) -> Iterator[tuple[list[str], int]]:
        """Words of every command, and the exit status that a comment states, or 0."""
        for line in self.content.replace("\\\n", " ").splitlines():
            stated = re.search(r"# exit status (\d+)", line)
            if words := shlex.split(line, comments=True):
                yield words, int(stated[1]) if stated else 0


def blocks_of(page: Path) -> list[Block]:
    """The blocks of a page in their order."""
    text = page.read_text(encoding="utf-8")
    return [Block(*found) for found in re.findall(r"^```(\w*)\n(.*?)^```", text, re.DOTALL | re.MULTILINE)]


def run_page(page: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    """Run all blocks of a page in the current folder, and compare what they print with what the page shows.

    Blocks of Python share their names, as the cells of a notebook do; those that are files are written.

    Returns:
        The names that the blocks of Python have defined.
    """
    names: dict[str, Any] = {"__name__": "__main__"}
    printed = ""
    for block in blocks_of(page):
        if block.file:
            Path(block.file).write_text(block.content, encoding="utf-8")
        elif block.language == "python":
            exec(compile(block.content, str(page), "exec"), names)  # noqa: S102 (our own document)
        elif not block.language:
            for words, status in block.commands:
                printed += _run(words, status)
        printed += capsys.readouterr().out
        if block.language == "text":
            assert_printed(block.content, printed)
            printed = ""
    return names


def assert_printed(shown: str, printed: str) -> None:
    """Assert that all lines of a page were printed, in this order; … stands for the rest of a line, or for a word."""
    lines = iter(printed.splitlines())
    for line in shown.splitlines():
        if line.strip() not in ("", ANYTHING):
            assert any(_is_alike(line.split(), other.split()) for other in lines), f"{line}\nis not in\n{printed}"


def _run(words: list[str], status: int) -> str:
    """Run a command of a page, which must end with this status; what programs other than sal-height have printed."""
    if words[0] == "sal-height":
        assert main(words[1:]) == status, words
        return ""
    assert words[0] in ("pytest", "python"), words
    command = [sys.executable, *(["-m", "pytest"] if words[0] == "pytest" else []), *words[1:]]
    done = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603 (our own document)
    assert done.returncode == status, done.stdout + done.stderr
    return done.stdout


def _is_alike(shown: list[str], printed: list[str]) -> bool:
    if shown[-1] == ANYTHING:
        shown, printed = shown[:-1], printed[: len(shown) - 1]
    return len(shown) == len(printed) and all(map(_is_same_word, shown, printed))


def _is_same_word(shown: str, printed: str) -> bool:
    if shown in (printed, ANYTHING):
        return True
    try:
        return math.isclose(float(shown), float(printed), rel_tol=TOLERANCE)
    except ValueError:
        return False
