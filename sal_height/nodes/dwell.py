"""Assembling dwells: the frames of all detectors of a dwell, whatever order they come in."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from sal_height.errors import Rejected

Item = TypeVar("Item")
Key = tuple[int, int]
"""Dwell number and stamp in ns: a sensor that starts anew may count dwells from 0 again."""


@dataclass
class Dwell(Generic[Item]):
    """The frames of one dwell that have come so far.

    Attributes:
        key: dwell number and stamp.
        began: time of the first frame, s.
        items: frames by detector.
    """

    key: Key
    began: float
    items: dict[int, Item] = field(default_factory=dict)

    @property
    def messages(self) -> list[Item]:
        """The frames in the order of detectors."""
        return [self.items[detector] for detector in sorted(self.items)]


class DwellAssembler(Generic[Item]):
    """Bounded buffer of unfinished dwells. Times are seconds of any steady clock."""

    def __init__(self, capacity: int, timeout: float) -> None:
        """Hold up to `capacity` dwells, none longer than `timeout` seconds."""
        self.capacity = capacity
        self.timeout = timeout
        self._dwells: dict[Key, Dwell[Item]] = {}
        self._finished: deque[Key] = deque(maxlen=4 * capacity)

    def add(self, key: Key, detector: int, item: Item, now: float) -> None:
        """Take a frame in.

        Raises:
            Rejected: "duplicate" (this detector has come already) or "late" (the dwell has been finished or dropped).
        """
        if key in self._finished:
            raise Rejected("late", f"Dwell {key[0]}, detector {detector}: the dwell was finished or dropped before.")
        dwell = self._dwells.setdefault(key, Dwell(key, now))
        if detector in dwell.items:
            raise Rejected("duplicate", f"Dwell {key[0]}, detector {detector}: the same frame came twice.")
        dwell.items[detector] = item

    def complete(self, detectors: int) -> list[Dwell[Item]]:
        """Dwells of which all detectors have come, oldest first; they stay until taken."""
        return [dwell for dwell in self._dwells.values() if len(dwell.items) == detectors]

    def take(self, dwell: Dwell[Item]) -> list[Item]:
        """Remove a dwell; its frames in the order of detectors."""
        del self._dwells[dwell.key]
        self._finished.append(dwell.key)
        return dwell.messages

    def overdue(self, now: float) -> list[Dwell[Item]]:
        """Dwells that have waited longer than the timeout, and the oldest beyond the capacity; they stay."""
        dwells = list(self._dwells.values())
        surplus = max(0, len(dwells) - self.capacity)
        return dwells[:surplus] + [dwell for dwell in dwells[surplus:] if now - dwell.began > self.timeout]

    def forget_finished(self) -> None:
        """Accept dwells again that were finished before: the stream has started anew."""
        self._finished.clear()
