"""Lists of messages to play, with the times at which the sensor delivered them: a whole bag, or dwells; and clocks.

Odometry is delivered at its stamp, a frame after its last pulse. In a bag that is played as it is, a message without
such a time, as the description of a sensor or one on the air, follows its predecessor in the bag.
"""

from __future__ import annotations

import bisect
import heapq
import itertools
import math
import threading
import time
from collections import defaultdict
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from typing import NamedTuple, Self

from rclpy._rclpy_pybind11 import RCLError
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from sal_height import messages
from sal_height.bag.described import FRAMES
from sal_height.bag.played import DwellRange, Played, chosen, read_contents
from sal_height.bag.reader import BagMessage, BagReader
from sal_height.bag.topics import ODOMETRY_TYPE, SENSOR_TYPE, STAMP, STAMP_AT, stamp_ns_of
from sal_height.engine.stage import FOREVER_NS
from sal_height.errors import UserError
from sal_height.messages.types import ChannelFrame, Clock, Odometry
from sal_height.nodes.transport.message_types import class_of, publish
from sal_height.topics import ODOMETRY, SENSOR_INFO

CLOCK = "/clock"

PERIOD_S = 0.01
"""Time from one message on /clock to the next; the machine may be late by more than that again, and 40 in a second are
promised."""


SHORTEST_WAIT_S = 0.002
"""Shortest wait for a message: those that are due within it are published together, so that their subscribers wake once
for all of them."""


class PacedClock:
    """The time of a recorded sensor. It stands still until something is waited for; after a delay it catches up."""

    def __init__(self, first_ns: int = 0, rate: float = math.inf, began: float | None = None) -> None:
        """Set the clock.

        Args:
            first_ns: first time, ns of the sensor.
            rate: seconds of the sensor in a second; infinity: everything is due at once.
            began: start of the clock, s of the monotonic clock; None: the first wait.
        """
        self._origin_ns, self._rate, self._began = first_ns, rate, began
        self._limit_ns = first_ns
        self._ending = threading.Event()

    def wait_until(self, due_ns: int) -> bool:
        """Wait until a time of the sensor (ns); False if the node ends before."""
        if self._began is None:
            self._began = time.monotonic()
        self._limit_ns = max(self._limit_ns, due_ns)
        wait_s = self._began + (due_ns - self._origin_ns) * 1e-9 / self._rate - time.monotonic()
        return not (self._ending.wait(max(wait_s, SHORTEST_WAIT_S)) if wait_s > 0 else self._ending.is_set())

    def stand_still(self) -> None:
        """Stop the time at the last one that was waited for."""
        self._began, self._origin_ns = None, self._limit_ns

    def end(self) -> None:
        """End every wait; may be called twice."""
        self._ending.set()


class SimulatedClock(PacedClock):
    """The same time, published on /clock for nodes with use_sim_time.

    It never passes what is waited for before that has been played, so that no node reads a time at which it should have
    received more, and it lags behind that by its period at most.
    """

    def __init__(self, node: Node, first_ns: int, rate: float) -> None:
        """Publish the time `first_ns` (ns of the sensor) from now on; later it runs at the rate."""
        super().__init__(first_ns, rate)
        quality = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)  # of `ros2 bag play`; nodes ask for less
        self._publisher = node.create_publisher(class_of(Clock), CLOCK, quality)
        self._published_ns = first_ns
        self._lock = threading.Lock()
        self._publish(first_ns)
        self._thread = threading.Thread(target=self._run, name="clock", daemon=True)
        self._thread.start()

    def wait_until(self, due_ns: int) -> bool:
        """Wait until a time of the sensor (ns); False if the node ends before."""
        is_due = super().wait_until(due_ns)
        if is_due and due_ns - self._published_ns > PERIOD_S * self._rate * 1e9:  # the thread lags behind
            self._publish(due_ns)
        return is_due

    def stand_still(self) -> None:
        """Stop the time at the last one that was waited for, and publish it at once."""
        super().stand_still()
        self._publish(self._limit_ns)

    def end(self) -> None:
        """Publish no more time, and end every wait; may be called twice."""
        super().end()
        self._thread.join()

    def _run(self) -> None:
        while not self._ending.wait(PERIOD_S):
            limit_ns, began = self._limit_ns, self._began  # the limit first: it rises only once the time runs
            if began is not None:
                limit_ns = min(limit_ns, self._origin_ns + round((time.monotonic() - began) * self._rate * 1e9))
            self._publish(limit_ns)

    def _publish(self, time_ns: int) -> None:
        """Publish a time, but never an earlier one than before."""
        with self._lock, suppress(RCLError):  # the context may end meanwhile
            self._published_ns = max(self._published_ns, time_ns)
            publish(self._publisher, Clock(clock=messages.to_stamp(self._published_ns)))


def restamped(cdr: bytes, shift_ns: int) -> bytes:
    """A serialized message whose first field is a header, with a later stamp (ns); the rest byte for byte."""
    stamp = STAMP.pack(*divmod(stamp_ns_of(cdr) + shift_ns, 1_000_000_000))
    whole = memoryview(cdr)
    return b"".join((whole[:STAMP_AT], stamp, whole[STAMP_AT + STAMP.size :]))


def delivered(reader: BagReader, topics: Collection[str], dwells: DwellRange, passes: int) -> Iterator[Played]:
    """The messages of chosen dwells, and the odometry around them, in the order of their delivery.

    The `log_time_ns` of each is the time of its delivery. In every further pass stamps are later by the period of what
    is played.

    Args:
        reader: reader of the bag.
        topics: topics that are played.
        dwells: dwells that are played.
        passes: number of passes.

    Raises:
        UserError: the bag is damaged.
    """
    dwells_ns, first_ns, last_ns = set[int](), FOREVER_NS, 0
    for one in _once(reader, topics, dwells):
        part = one.content.part
        stamps_ns = (one.recorded.log_time_ns, one.content.odometry_ns, part and part.dwell.stamp_ns)
        known_ns = [stamp_ns for stamp_ns in stamps_ns if stamp_ns is not None]
        first_ns, last_ns = min(first_ns, *known_ns), max(last_ns, *known_ns)
        if part:
            dwells_ns.add(part.dwell.stamp_ns)
        yield one
    period_ns = _period(sorted(dwells_ns), last_ns - first_ns)
    for number in range(1, passes):
        shift_ns = number * period_ns
        yield from read_contents(_later(one, shift_ns) for one in _once(reader, topics, dwells))


def _later(one: Played, shift_ns: int) -> BagMessage:
    """A message in a later pass: only with a stamp that its content is known to have does that change."""
    recorded = one.recorded._replace(log_time_ns=one.recorded.log_time_ns + shift_ns)
    if one.content.delivered_ns is None and one.content.air_ns is None:
        return recorded
    return recorded._replace(cdr=restamped(recorded.cdr, shift_ns))


def _once(reader: BagReader, topics: Collection[str], dwells: DwellRange) -> Iterator[Played]:
    """One pass. Odometry is merged with all else by time; a message without a time has that of one that is played."""
    odometry = [name for name in topics if reader.topics[name].type_name == ODOMETRY_TYPE]
    others = [name for name in topics if name not in odometry]
    streams = [_with_times(read_contents(reader.messages(names))) for names in (odometry, others) if names]
    merged = heapq.merge(*streams, key=lambda one: one.recorded.log_time_ns)
    return _with_times(chosen(merged, dwells))


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


class Playlist(NamedTuple):
    """Odometry, air and frames of whole dwells in memory, in the order of their delivery, and their sensor.

    The air is delivered at its stamp; its last state before the first dwell is delivered at the start, with the latest
    stamp that the dwell uses.

    Attributes:
        sensor_info: last description of the sensor, serialized.
        items: messages on topics without leading slash; the `log_time_ns` is the time of delivery.
        period_ns: time from the start of the list to the start of its repetition, ns.
        dwells: number of dwells.
    """

    sensor_info: bytes
    items: list[BagMessage]
    period_ns: int
    dwells: int

    @classmethod
    def of_bag(cls, reader: BagReader, most_bytes: float) -> Self:
        """Read a bag.

        Args:
            reader: reader of the bag.
            most_bytes: greatest size of its messages, bytes.

        Raises:
            UserError: it has no complete dwell, its messages take more, or one cannot be decoded.
        """
        info = b""
        odometry: dict[int, BagMessage] = {}
        air: dict[str, list[BagMessage]] = defaultdict(list)
        dwells: dict[int, list[BagMessage]] = defaultdict(list)
        for recorded, content in read_contents(_sensor_messages(reader, most_bytes)):
            if content.fault:
                raise UserError(
                    f"A message on topic {recorded.topic} of bag {reader.path} cannot be decoded: "
                    f"{content.fault.rstrip('.')}."
                )
            if recorded.type_name == SENSOR_TYPE:
                info = recorded.cdr
            elif content.odometry_ns is not None:
                odometry[content.odometry_ns] = recorded._replace(log_time_ns=content.odometry_ns)
            elif content.air_ns is not None:
                air[recorded.topic].append(recorded._replace(log_time_ns=content.air_ns))
            elif content.part:
                dwells[content.part.dwell.stamp_ns].append(recorded._replace(log_time_ns=content.part.end_ns))
        described = reader.decode(SENSOR_TYPE, info) if info else None
        channels = messages.sensor_from_message(described).detector_count if described else 0
        whole = {stamp: frames for stamp, frames in sorted(dwells.items()) if len(frames) == channels}
        around = _odometry_around(sorted(odometry), list(whole), [frames[0].log_time_ns for frames in whole.values()])
        if not around:
            raise UserError(
                f"Bag {reader.path} has no dwell with frames of all channels and odometry around its pulses."
            )
        items = [odometry[stamp] for stamp in around] + [frame for frames in whole.values() for frame in frames]
        for samples in air.values():
            items += _air_during(samples, min(whole), around[0], around[-1])
        items.sort(key=lambda item: item.log_time_ns)
        return cls(info, items, _period(list(whole), around[-1] - around[0]), len(whole))

    @property
    def size(self) -> int:
        """Bytes of all messages."""
        return sum(len(item.cdr) for item in self.items)

    @property
    def odometry(self) -> list[Odometry]:
        """The messages of the odometry."""
        return [messages.deserialize(item.cdr, Odometry) for item in self.items if item.topic == ODOMETRY]

    def frames(self) -> Iterator[list[ChannelFrame]]:
        """The frames of each dwell, in the order of channels."""
        dwells: dict[int, list[bytes]] = defaultdict(list)
        for item in self.items:
            if item.topic == FRAMES:
                dwells[stamp_ns_of(item.cdr)].append(item.cdr)
        for serialized in dwells.values():
            decoded = [messages.deserialize(cdr, ChannelFrame) for cdr in serialized]
            yield sorted(decoded, key=lambda frame: frame.channel)

    @property
    def dwell_rate_hz(self) -> float:
        """Dwells that the sensor delivers in a second."""
        return self.dwells * 1e9 / self.period_ns

    def passes(self, first_ns: int) -> Iterator[BagMessage]:
        """The messages of all passes, without end, the first delivered at a time (ns)."""
        for shift_ns in itertools.count(first_ns - self.items[0].log_time_ns, self.period_ns):
            for item in self.items:
                cdr, due_ns = restamped(item.cdr, shift_ns), item.log_time_ns + shift_ns
                yield item._replace(cdr=cdr, log_time_ns=due_ns)


def _sensor_messages(reader: BagReader, most_bytes: float) -> Iterator[BagMessage]:
    """Messages of a sensor, on topics without leading slash.

    Raises:
        UserError: they take more memory, or have another definition.
    """
    names = {name: name.lstrip("/") for name in reader.topics}
    topics = [name for name, plain in names.items() if plain in {SENSOR_INFO, ODOMETRY, FRAMES, *messages.AIR}]
    for name in topics:
        reader.check_type(reader.topics[name].type_name)
    size = 0
    for recorded in reader.messages(topics):
        size += len(recorded.cdr)
        if size > most_bytes:
            raise UserError(
                f"Bag {reader.path} holds more than {most_bytes / 1e6:.0f} MB of dwells (max_memory_mb), which are "
                "played from memory; allow more, or record a shorter bag."
            )
        yield recorded._replace(topic=names[recorded.topic])


def _odometry_around(stamps: list[int], starts: Sequence[int], ends: Sequence[int]) -> list[int]:
    """The stamps from the last before the first pulse to the first after the last pulse; empty if one is absent."""
    if not starts:
        return []
    first, last = bisect.bisect_right(stamps, min(starts)) - 1, bisect.bisect_left(stamps, max(ends))
    return stamps[first : last + 1] if 0 <= first < last < len(stamps) else []


def _air_during(samples: list[BagMessage], dwell_ns: int, begin_ns: int, end_ns: int) -> list[BagMessage]:
    """Messages on a topic of the air from the start to the end, first the one that the first dwell needs.

    Args:
        samples: messages of the topic, delivered at their stamps.
        dwell_ns: stamp of the first dwell, ns.
        begin_ns: stamp of the first odometry, ns.
        end_ns: stamp of the last odometry, ns.
    """

    def stamp_of(sample: BagMessage) -> int:
        return sample.log_time_ns

    in_use_ns = dwell_ns - messages.AIR_LATENCY_NS
    used = max((one for one in samples if stamp_of(one) <= in_use_ns), key=stamp_of, default=min(samples, key=stamp_of))
    first = used._replace(log_time_ns=begin_ns, cdr=restamped(used.cdr, in_use_ns - stamp_of(used)))
    later = [one for one in samples if in_use_ns < stamp_of(one) <= end_ns]
    return [first, *(one._replace(log_time_ns=max(begin_ns, stamp_of(one))) for one in later)]


def _period(dwells: list[int], span_ns: int) -> int:
    """Time after which a list of messages may start again, ns: a dwell after the last one, and after all else.

    That is the longest time between dwells of the bag, as the platform turns between its passes.

    Args:
        dwells: stamps of the dwells, ascending, ns.
        span_ns: time between the first and the last stamp of all messages, ns.
    """
    interval = max((after - before for before, after in itertools.pairwise(dwells)), default=0)
    return max(dwells[-1] - dwells[0] + interval if dwells else 0, span_ns + 1)
