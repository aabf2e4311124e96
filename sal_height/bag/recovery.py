"""Report on a recovery of a bag: messages in the new bag, and parts of the old one that could not be read."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from sal_height.tables import aligned

UNKNOWN = "(unknown)"
"""Text in place of the topic of messages whose channel is no longer described."""


@dataclass(frozen=True)
class Gap:
    """A part of a file that could not be read.

    Attributes:
        file: file of the bag.
        offset: position of its first byte.
        size: size, bytes.
        reason: reason in words.
        lost: number of lost messages by topic, as far as the index of the chunk states it; else empty.
    """

    file: Path
    offset: int
    size: int
    reason: str
    lost: Mapping[str, int] = field(default_factory=dict, compare=False)

    def __str__(self) -> str:
        text = f"{self.size} bytes at byte {self.offset} of {self.file} could not be read: {self.reason}"
        counts = ", ".join(f"{count} messages on {topic}" for topic, count in sorted(self.lost.items()))
        return f"{text}; they contained {counts}." if counts else f"{text}."


@dataclass(frozen=True)
class Recovery:
    """Result of a recovery.

    Attributes:
        recovered: number of messages in the new bag by topic, topics without messages included.
        lost: number of messages that are known to be lost, by topic.
        gaps: parts of the files that could not be read.
    """

    recovered: Counter[str]
    lost: Counter[str]
    gaps: Sequence[Gap]

    @property
    def count(self) -> int:
        """Messages in the new bag."""
        return self.recovered.total()

    @property
    def is_whole(self) -> bool:
        """True if nothing is lost, as far as is known."""
        return not (self.gaps or self.lost)


def recovery_table(recovery: Recovery) -> str:
    """Messages recovered and lost, by topic, as lines of text."""
    topics = sorted({*recovery.recovered, *recovery.lost})
    rows = [[topic, str(recovery.recovered[topic]), str(recovery.lost[topic])] for topic in topics]
    return aligned([["topic", "recovered", "known lost"], *rows])
