"""What is played of a bag in the order in which the sensor delivered it, with the times of that, once or several times.

Odometry is delivered at its stamp, a frame after its last pulse; what has no such time, as the description of a sensor
or a message on the air, follows what is before it in the bag.
"""

from __future__ import annotations

import heapq
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field

from sal_height.bag.played import Content, DwellRange, Played, chosen, read_contents
from sal_height.bag.reader import BagReader
from sal_height.bag.topics import ODOMETRY_TYPE
from sal_height.engine.stage import DwellKey
from sal_height.nodes.playing.playlist import restamped


@dataclass
class _Pass:
    """What has been played of a bag, from its begin to its end.

    Attributes:
        stamps_ns: first and last stamp of odometry, of dwells and of deliveries, by these names, ns.
        dwells: number of dwells.
    """

    stamps_ns: dict[str, tuple[int, int]] = field(default_factory=dict)
    dwells: int = 0
    _last: DwellKey | None = None

    def add(self, content: Content, due_ns: int) -> None:
        """Take note of a message."""
        self._note("deliveries", due_ns)
        if content.odometry_ns is not None:
            self._note("odometry", content.odometry_ns)
        if content.part and content.part.dwell != self._last:
            self._last = content.part.dwell
            self.dwells += 1
            self._note("dwells", content.part.dwell.stamp_ns)

    def _note(self, name: str, stamp_ns: int) -> None:
        first, last = self.stamps_ns.get(name, (stamp_ns, stamp_ns))
        self.stamps_ns[name] = min(first, stamp_ns), max(last, stamp_ns)

    @property
    def period_ns(self) -> int:
        """Time after which the bag may begin anew: a dwell after the last one, and after all else."""
        spans = {name: last - first for name, (first, last) in self.stamps_ns.items()}
        interval = spans.get("dwells", 0) // max(1, self.dwells - 1)
        return max(spans.get("dwells", 0) + interval, 1 + max(spans.values(), default=0))


def delivered(reader: BagReader, topics: Collection[str], dwells: DwellRange, passes: int) -> Iterator[Played]:
    """The messages of chosen dwells, and the odometry around them, in the order of their delivery.

    The `log_time_ns` of each is when it was delivered. After a pass stamps go on by the period of what is played.

    Args:
        reader: of the bag.
        topics: that are played.
        dwells: that are played.
        passes: how often.

    Raises:
        UserError: the bag is damaged.
    """
    first = _Pass()
    for one in _once(reader, topics, dwells):
        first.add(one.content, one.recorded.log_time_ns)
        yield one
    for number in range(1, passes):
        shift_ns = number * first.period_ns
        for recorded, content in _once(reader, topics, dwells):
            is_old = content.delivered_ns is None and content.air_ns is None
            cdr = recorded.cdr if is_old else restamped(recorded.cdr, shift_ns)
            later = recorded._replace(cdr=cdr, log_time_ns=recorded.log_time_ns + shift_ns)
            yield Played(later, content.later(shift_ns))


def _once(reader: BagReader, topics: Collection[str], dwells: DwellRange) -> Iterator[Played]:
    """One pass; what has no time of its own has that of a message that is played, too."""
    return _with_times(chosen(_merged(reader, topics), dwells))


def _merged(reader: BagReader, topics: Collection[str]) -> Iterator[Played]:
    """The messages of topics in the order of their delivery, as far as those of a topic are in it."""
    odometry = [name for name in topics if reader.topics[name].type_name == ODOMETRY_TYPE]
    others = [name for name in topics if name not in odometry]
    streams = [_with_times(read_contents(reader.messages(names))) for names in (odometry, others) if names]
    return heapq.merge(*streams, key=lambda one: one.recorded.log_time_ns)


def _with_times(items: Iterator[Played]) -> Iterator[Played]:
    """Messages with the times of their delivery, which never run back."""
    due_ns: int | None = None
    early: list[Played] = []  # for which there is no time yet
    for item in items:
        delivered_ns = item.content.delivered_ns
        if delivered_ns is not None:
            due_ns = delivered_ns if due_ns is None else max(due_ns, delivered_ns)
        early.append(item)
        if due_ns is not None:
            yield from (Played(one.recorded._replace(log_time_ns=due_ns), one.content) for one in early)
            early.clear()
