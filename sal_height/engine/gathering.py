"""Gathering dwells from the messages of their channels, in whatever order these arrive."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any, Generic, TypeVar

from sal_height.engine.results import DwellKey
from sal_height.errors import Rejected
from sal_height.sensor import Sensor

Item = TypeVar("Item")

FINISHED_KEPT = 64
"""Dwells remembered after they were processed or dropped, so that their stragglers are known as late."""


@dataclass
class Dwell(Generic[Item]):
    """The messages of one dwell that have arrived so far.

    Attributes:
        key: sensor, number and stamp.
        sensor: sensor that the messages were made with.
        began: time at which the first message arrived, s of the host's clock.
        channels: number of messages that make it whole.
        items: messages by channel.
        size: size of the messages, bytes.
        whole: item that is all messages at once; None: they arrive one by one.
    """

    key: DwellKey
    sensor: Sensor
    began: float
    channels: int
    items: dict[int, Item] = field(default_factory=dict)
    size: int = 0
    whole: Any = None

    @property
    def messages(self) -> list[Item]:
        """The messages in the order of channels."""
        return [self.items[channel] for channel in sorted(self.items)]

    @property
    def count(self) -> int:
        """Number of messages that have arrived."""
        return len(self.items) if self.whole is None else self.channels

    @property
    def is_whole(self) -> bool:
        """True if the messages of all channels have arrived."""
        return self.count == self.channels

    @property
    def absent(self) -> list[int]:
        """The channels of which no message has arrived."""
        return [] if self.is_whole else sorted(set(range(self.channels)) - set(self.items))

    @property
    def content(self) -> Any:
        """The item that is all messages; or the messages of all channels, with blank ones for those that are absent."""
        if self.whole is not None:
            return self.whole
        if not self.absent:
            return self.messages
        blanks: dict[int, Any] = {channel: self.messages[0].blank(channel) for channel in self.absent}  # type: ignore[attr-defined]
        items = {**self.items, **blanks}
        return [items[channel] for channel in sorted(items)]


class DwellAssembler(Generic[Item]):
    """The unfinished dwells of all sensors, oldest first."""

    def __init__(self, channels: Callable[[Sensor], int] = attrgetter("detector_count")) -> None:
        """Start without dwells; `channels`: number of messages that make a dwell of a sensor whole."""
        self._channels = channels
        self._dwells: dict[DwellKey, Dwell[Item]] = {}
        self._finished: deque[DwellKey] = deque(maxlen=FINISHED_KEPT)
        self._latest_ns: dict[str, int] = {}
        self._size = 0

    def add(self, key: DwellKey, sensor: Sensor, channel: int, item: Item, now: float, size: int = 0) -> Dwell[Item]:
        """Insert a message of `size` bytes, and return its dwell.

        Raises:
            Rejected: "duplicate" (this channel has arrived already) or "late" (the dwell has been finished or dropped).
        """
        dwell = self._dwells.get(key) or self._started(key, sensor, now, f"Dwell {key.number}, channel {channel}")
        if dwell.whole is not None or channel in dwell.items:
            raise Rejected("duplicate", f"Dwell {key.number}, channel {channel}: the same message was received twice.")
        dwell.items[channel] = item
        self._note(dwell, size)
        return dwell

    def add_whole(self, key: DwellKey, sensor: Sensor, item: Any, now: float, size: int = 0) -> Dwell[Item]:
        """Insert an item of `size` bytes that is all messages of a dwell, and return the dwell.

        Raises:
            Rejected: the reasons of `add`.
        """
        if key in self._dwells:
            raise Rejected("duplicate", f"Dwell {key.number}: messages of it were received before.")
        dwell = self._started(key, sensor, now, f"Dwell {key.number}")
        dwell.whole = item
        self._note(dwell, size)
        return dwell

    def _started(self, key: DwellKey, sensor: Sensor, now: float, where: str) -> Dwell[Item]:
        if key in self._finished:
            raise Rejected("late", f"{where}: the dwell was finished or dropped before.")
        dwell = self._dwells[key] = Dwell[Item](key, sensor, now, self._channels(sensor))
        return dwell

    def _note(self, dwell: Dwell[Item], size: int) -> None:
        """Count the bytes of a message, which is the latest of its sensor."""
        dwell.size += size
        self._size += size
        self._latest_ns[dwell.key.sensor] = dwell.key.stamp_ns

    def __contains__(self, dwell: Dwell[Item]) -> bool:
        """True if a dwell is unfinished."""
        return dwell.key in self._dwells

    def unfinished(self) -> list[Dwell[Item]]:
        """All unfinished dwells, in the order in which their first messages arrived."""
        return list(self._dwells.values())

    def surplus(self, capacity: int, capacity_bytes: float) -> list[Dwell[Item]]:
        """The oldest dwells that are too many, or whose messages take too much memory; one may always stay."""
        if not self.is_crowded(capacity, capacity_bytes):
            return []
        dwells, excess = self.unfinished(), self._size
        for count, dwell in enumerate(dwells[:-1]):
            if len(dwells) - count <= capacity and excess <= capacity_bytes:
                return dwells[:count]
            excess -= dwell.size
        return dwells[:-1]

    def is_crowded(self, capacity: int, capacity_bytes: float) -> bool:
        """True if the dwells are too many, or their messages take too much memory."""
        return len(self._dwells) > capacity or self._size > capacity_bytes

    def is_passed(self, dwell: Dwell[Item], seconds: float) -> bool:
        """True if the last message of the same sensor is stamped more than `seconds` after the dwell, or before.

        Before: the dwell has a wrong stamp, which would never be passed otherwise.
        """
        return abs(self._latest_ns[dwell.key.sensor] - dwell.key.stamp_ns) > seconds * 1e9

    def take(self, dwell: Dwell[Item]) -> None:
        """Remove a dwell; its messages that arrive afterwards are late."""
        del self._dwells[dwell.key]
        self._size -= dwell.size
        self._finished.append(dwell.key)

    def forget_finished(self, sensor: str) -> None:
        """Accept dwells of a sensor again that were finished before: it has started again."""
        self._finished = deque((key for key in self._finished if key.sensor != sensor), FINISHED_KEPT)
        self._latest_ns.pop(sensor, None)
        self._latest_ns |= {key.sensor: key.stamp_ns for key in self._dwells if key.sensor == sensor}


class WaitingClock:
    """Time for which a stage has been waiting without anything to do.

    It is moved on by the ticks of its host, each for a fraction of a second at most, and starts from 0 whenever there
    is work. So, unlike the clock on the wall, it does not run while a slow or loaded machine keeps the stage from its
    messages.
    """

    def __init__(self) -> None:
        self.waited_s = 0.0
        self._last: float | None = None

    def restart(self) -> None:
        """A message has arrived."""
        self.waited_s = 0.0

    def tick(self, now: float, busy: bool) -> None:
        """Move on to the time `now` of a steady clock, s; `busy`: there is work or work waits."""
        longest_tick_s = 0.2  # longest time that one tick of the waiting clock may count: two periods of its timer
        step = 0.0 if self._last is None else min(now - self._last, longest_tick_s)
        self._last = now
        self.waited_s = 0.0 if busy else self.waited_s + step
