"""Assembling dwells from the messages of their channels, in whatever order these come."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Generic, NamedTuple, TypeVar

from sal_height.errors import Rejected
from sal_height.sensor import Sensor

Item = TypeVar("Item")

FINISHED_KEPT = 64
"""Dwells remembered after they were handed over or dropped, so that their stragglers are known as late."""

LONGEST_TICK_S = 0.2
"""Longest time that one tick of the waiting clock may count: two periods of its timer."""


class Key(NamedTuple):
    """What distinguishes dwells: a sensor that starts anew may count them from 0 again."""

    config_hash: str
    number: int
    stamp_ns: int


@dataclass
class Dwell(Generic[Item]):
    """The messages of one dwell that have come so far.

    Attributes:
        key: config_hash of the sensor, dwell number and stamp.
        sensor: that the messages were made with.
        began: time at which the first message came, s of a steady clock.
        channels: number of messages that make it whole.
        items: messages by channel.
        size: bytes that they hold.
    """

    key: Key
    sensor: Sensor
    began: float
    channels: int
    items: dict[int, Item] = field(default_factory=dict)
    size: int = 0

    @property
    def messages(self) -> list[Item]:
        """The messages in the order of channels."""
        return [self.items[channel] for channel in sorted(self.items)]

    @property
    def is_whole(self) -> bool:
        """Whether the messages of all channels have come."""
        return len(self.items) == self.channels

    @property
    def absent(self) -> list[int]:
        """The channels of which no message has come."""
        return sorted(set(range(self.channels)) - set(self.items))


class DwellAssembler(Generic[Item]):
    """The unfinished dwells of all sensors, oldest first."""

    def __init__(self, channels: Callable[[Sensor], int] = attrgetter("detector_count")) -> None:
        """Begin without dwells; `channels`: number of messages that make a dwell of a sensor whole."""
        self._channels = channels
        self._dwells: dict[Key, Dwell[Item]] = {}
        self._finished: deque[Key] = deque(maxlen=FINISHED_KEPT)
        self._latest_ns: dict[str, int] = {}
        self._size = 0

    def add(self, key: Key, sensor: Sensor, channel: int, item: Item, now: float, size: int = 0) -> Dwell[Item]:
        """Take a message of `size` bytes in, and return its dwell.

        Raises:
            Rejected: "duplicate" (this channel has come already) or "late" (the dwell has been finished or dropped).
        """
        dwell = self._dwells.get(key)
        if dwell is None:
            if key in self._finished:
                raise Rejected(
                    "late", f"Dwell {key.number}, channel {channel}: the dwell was finished or dropped before."
                )
            dwell = self._dwells[key] = Dwell(key, sensor, now, self._channels(sensor))
        if channel in dwell.items:
            raise Rejected("duplicate", f"Dwell {key.number}, channel {channel}: the same message came twice.")
        dwell.items[channel] = item
        dwell.size += size
        self._size += size
        self._latest_ns[key.config_hash] = key.stamp_ns
        return dwell

    def __contains__(self, dwell: Dwell[Item]) -> bool:
        """Whether a dwell is unfinished."""
        return dwell.key in self._dwells

    def held(self) -> list[Dwell[Item]]:
        """All unfinished dwells, in the order in which they began."""
        return list(self._dwells.values())

    def surplus(self, capacity: int, capacity_bytes: float) -> list[Dwell[Item]]:
        """The oldest dwells that are too many, or whose messages take too much memory; one may always stay."""
        if not self.is_crowded(capacity, capacity_bytes):
            return []
        dwells, excess = self.held(), self._size
        for count, dwell in enumerate(dwells[:-1]):
            if len(dwells) - count <= capacity and excess <= capacity_bytes:
                return dwells[:count]
            excess -= dwell.size
        return dwells[:-1]

    def is_crowded(self, capacity: int, capacity_bytes: float) -> bool:
        """Whether the dwells are too many, or their messages take too much memory."""
        return len(self._dwells) > capacity or self._size > capacity_bytes

    def is_passed(self, dwell: Dwell[Item], seconds: float) -> bool:
        """Whether the last message of the same sensor is stamped more than so many seconds after the dwell, or before.

        Before: the dwell has a wrong stamp, which would never be passed otherwise.
        """
        return abs(self._latest_ns[dwell.key.config_hash] - dwell.key.stamp_ns) > seconds * 1e9

    def take(self, dwell: Dwell[Item]) -> None:
        """Remove a dwell; what comes of it afterwards is late."""
        del self._dwells[dwell.key]
        self._size -= dwell.size
        self._finished.append(dwell.key)

    def forget_finished(self, config_hash: str) -> None:
        """Accept dwells of a sensor again that were finished before: it has started anew."""
        self._finished = deque((k for k in self._finished if k.config_hash != config_hash), FINISHED_KEPT)
        self._latest_ns.pop(config_hash, None)
        self._latest_ns |= {key.config_hash: key.stamp_ns for key in self._dwells if key.config_hash == config_hash}


class WaitingClock:
    """How long a node has been waiting without anything to do.

    It is moved on by the ticks of a timer of the node, each for a fraction of a second at most, and starts from 0
    whenever there is work. So, unlike the clock on the wall, it does not run while a slow or loaded machine keeps the
    node from its messages.
    """

    def __init__(self) -> None:
        self.waited_s = 0.0
        self._last: float | None = None

    def restart(self) -> None:
        """A message has come."""
        self.waited_s = 0.0

    def tick(self, now: float, busy: bool) -> None:
        """Move on to the time `now` of a steady clock, s; `busy`: the node is working or has work before it."""
        step = 0.0 if self._last is None else min(now - self._last, LONGEST_TICK_S)
        self._last = now
        self.waited_s = 0.0 if busy else self.waited_s + step
