"""Counts of the messages of one recorded topic: received, written, left out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from sal_height.nodes.accounts.account import ON_THE_WAY

QUEUE_FULL, NOT_WRITTEN = "queue full", "not written"
"""Reasons for which received messages are not in the bag: too much waited for the disk; the disk refused them."""


@dataclass
class TopicCounts:
    """Counts of one topic; received = written + left out for other reasons than ON_THE_WAY, once nothing waits.

    Attributes:
        received: number of received messages.
        written: number of messages that are in the bag.
        left_out: number of messages that are not, by reason.
        latched: True if the last message is kept for later subscribers; it may replace one that nobody has read yet,
            which is no loss.
    """

    latched: bool = False
    received: int = 0
    written: int = 0
    left_out: Counter[str] = field(default_factory=Counter)
    _number: int = 0

    def receive(self, number: int | None, publishers: Callable[[], int]) -> None:
        """Count a message, and those before it that were lost.

        Args:
            number: number that its publisher has given it, one more than to its last one; None: not known.
            publishers: function that counts the topic's publishers. Several number each for itself: gaps say nothing.
        """
        self.received += 1
        if number is None:
            return
        missed = number - self._number - 1 if self._number else 0  # what was published before the first one is no loss
        if missed > 0 and not self.latched and publishers() == 1:
            self.left_out[ON_THE_WAY] += missed
        self._number = number

    @property
    def missed(self) -> int:
        """Messages that the publisher has numbered up to the last one, and that have not arrived; since its start."""
        return max(0, self._number - self.received)

    def as_json(self) -> dict[str, Any]:
        """The counts as the bag states them."""
        return {"received": self.received, "written": self.written, "left_out": dict(self.left_out)}
