"""Findings of `sal-height bag check`: a message, and its remedy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from sal_height.errors import UserError

NAMED = 3
"""Number of cases that a finding names; of more it states the number."""


@dataclass(frozen=True)
class Finding:
    """A fault of a bag.

    Attributes:
        severity: error (messages are lost to readers, or cannot be processed) or warning (less than that).
        sentence: description of the fault, and its position.
        fix: remedy of the fault.
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
    """A finding that is less severe than lost messages."""
    return Finding("warning", sentence, fix)


def of_refusal(refusal: UserError, fix: str) -> Finding:
    """An error that readers refuse the bag for, with another fix than they name after the last semicolon."""
    sentence, found, _ = str(refusal).rpartition("; ")
    return error(f"{sentence}." if found else str(refusal), fix)


def recovery(path: Path) -> str:
    """The fix of damage."""
    return f"Recover what is whole with 'sal-height bag recover {path} --out DIR'."


def some(cases: Sequence[object]) -> str:
    """The first few of several cases."""
    named = "; ".join(map(str, cases[:NAMED]))
    return f"{named}; and {len(cases) - NAMED} more" if len(cases) > NAMED else named
