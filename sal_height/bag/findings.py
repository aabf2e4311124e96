"""Findings of `sal-height bag check`: a message, and its remedy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from sal_height.errors import UserError

NAMED = 3
"""Cases that a sentence names; of more it says how many."""


@dataclass(frozen=True)
class Finding:
    """Something that is wrong with a bag.

    Attributes:
        severity: error: messages are lost to readers, or cannot be processed; warning: less than that.
        sentence: fault, and its position.
        fix: remedy.
    """

    severity: Literal["error", "warning"]
    sentence: str
    fix: str

    def __str__(self) -> str:
        return f"{self.severity}: {self.sentence} {self.fix}"


def error(sentence: str, fix: str) -> Finding:
    """A finding because of which messages are lost, or cannot be processed."""
    return Finding("error", sentence, fix)


def warning(sentence: str, fix: str) -> Finding:
    """A finding because of which less is lost than messages."""
    return Finding("warning", sentence, fix)


def of_refusal(refusal: UserError, fix: str) -> Finding:
    """An error that readers refuse the bag for, with another fix than they name after the last semicolon."""
    sentence, found, _ = str(refusal).rpartition("; ")
    return error(f"{sentence}." if found else str(refusal), fix)


def recovery(path: Path) -> str:
    """The fix of what is damaged."""
    return f"Recover what is whole with 'sal-height bag recover {path} --out DIR'."


def some(cases: Sequence[object]) -> str:
    """The first few of several cases."""
    named = "; ".join(map(str, cases[:NAMED]))
    return f"{named}; and {len(cases) - NAMED} more" if len(cases) > NAMED else named
