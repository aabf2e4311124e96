"""Copies of a bag: of a range of time or of dwells that can be replayed by itself, or with the messages of today."""

from __future__ import annotations

import json
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml

from sal_height.bag.described import PARAMETER_EVENT_TYPE, DwellFrames, SensorTopics, after, read_dwells, sensors_in
from sal_height.bag.files import ACCOUNT, PARAMETERS, parameters_file
from sal_height.bag.played import MARGIN_NS
from sal_height.bag.reader import BagMessage, BagReader, Topic
from sal_height.bag.topics import CALIBRATION_TYPE, FRAME_TYPE, HEIGHT_TYPE, IMAGE_TYPE, SENSOR_TYPE, stamp_ns_of
from sal_height.bag.versions import PACKAGE
from sal_height.bag.writer import BagWriter, Packing, kept_by_publishers
from sal_height.errors import UserError
from sal_height.messages import AIR_LATENCY_NS, AIR_TYPES, serialize
from sal_height.messages.definition import Definition, known_definition
from sal_height.messages.types import ParameterEvent

STAMPS_FROM_S = 100_000_000
"""Seconds from which on a number is a time since 1970, and not since the start of the bag (three years)."""

OF_DWELLS = {FRAME_TYPE, IMAGE_TYPE, HEIGHT_TYPE}
"""Types of messages that belong to a dwell, and have its stamp."""

LATCHED = {SENSOR_TYPE: 1, CALIBRATION_TYPE: 1, "tf2_msgs/msg/TFMessage": 100}
"""Number of kept messages of latched types, if the bag does not state it; of transforms on tf_static only."""


@dataclass(frozen=True)
class Range:
    """Range of time or of dwells that is kept of a bag.

    Attributes:
        begin_ns: earliest reception of messages, ns; None: start of the bag.
        end_ns: latest reception of messages, ns; None: end of the bag.
        dwells: numbers of the first and the last dwell; None: all in that time.
    """

    begin_ns: int | None = None
    end_ns: int | None = None
    dwells: tuple[int, int] | None = None

    def keeps(self, dwell: DwellFrames) -> bool:
        """True if all frames of a dwell are in the range."""
        return (
            (self.begin_ns is None or dwell.first_log_ns >= self.begin_ns)
            and (self.end_ns is None or dwell.last_log_ns <= self.end_ns)
            and (self.dwells is None or self.dwells[0] <= dwell.number <= self.dwells[1])
        )


@dataclass(frozen=True)
class KeptMessages:
    """Content of the new bag: messages by topic, and dwells by topic of their frames."""

    counts: Counter[str]
    dwells: Mapping[str, int]


def cut(path: Path, out_directory: Path, kept: Range) -> KeptMessages:
    """Write the part of a bag that is in a range to a new one.

    Messages are byte for byte those of the bag, with their times, in one file. Of a dwell all messages are kept, or
    none: it is kept if all its frames are in the range. Odometry is kept from a second before the kept dwells to a
    second after, and so is the air, with the last message that they used. Of earlier latched messages the last ones are
    kept, at the start of the new bag; so are the parameters of nodes, those of a node in one event.

    Args:
        path: path of the bag.
        out_directory: folder of the new bag.
        kept: range that is kept.

    Raises:
        UserError: the bag is damaged or not complete, the folder is not empty, or no dwell is in the range.
    """
    reader = BagReader(path)
    plans = [_plan_sensor(reader, sensor, kept) for sensor in sensors_in(reader.topics)]
    if (plans or kept.dwells) and not any(plan.dwells for plan in plans):
        raise UserError(f"Bag {path} has no dwell whose frames are all in the range; it has {_described(plans)}.")
    window = _Window(reader, kept, plans)
    counts = Counter[str]()
    try:
        with BagWriter(out_directory, kept_custom_data(reader), kept_packing(reader)) as bag:
            for topic in reader.topics.values():
                bag.add_topic(topic.name, topic.recorded_type, topic.offered_qos, topic.definition)
            for message in window.messages():
                bag.write(message.topic, message.cdr, message.log_time_ns, message.publish_time_ns)
                counts[message.topic] += 1
    except OSError as error:
        raise UserError(f"Bag {out_directory} cannot be written: {error}.") from error
    return KeptMessages(counts, {plan.topics.frames: len(plan.dwells) for plan in plans})


class _Span(NamedTuple):
    """Messages that are kept of a topic: first and last stamp, and reception of the first message, ns."""

    begin_ns: int
    end_ns: int
    log_ns: int


@dataclass(frozen=True)
class _SensorPlan:
    """Messages that are kept of a sensor: its dwells, and the stamps of odometry and air around them by topic."""

    topics: SensorTopics
    all_dwells: Sequence[DwellFrames]
    dwells: Sequence[DwellFrames]
    spans: Mapping[str, _Span]

    @property
    def stamps(self) -> frozenset[int]:
        """Stamps of the kept dwells."""
        return frozenset(dwell.stamp_ns for dwell in self.dwells)


def time_of(reader: BagReader, seconds: Decimal) -> int:
    """A time in a bag, ns: seconds from its start, or since 1970 if there are STAMPS_FROM_S or more."""
    nanoseconds = int(seconds * 1_000_000_000)
    return nanoseconds if seconds >= STAMPS_FROM_S else reader.begin_ns + nanoseconds


def _plan_sensor(reader: BagReader, topics: SensorTopics, kept: Range) -> _SensorPlan:
    found = list(read_dwells(reader, topics))
    dwells = [dwell for dwell in found if kept.keeps(dwell)]
    spans: dict[str, _Span] = {}
    if dwells:
        first_ns, last_ns = min(dwell.stamp_ns for dwell in dwells), max(dwell.last_pulse_ns for dwell in dwells)
        needed = {topics.odometry: first_ns}
        air = [name for name, topic in reader.topics.items() if topic.type_name in AIR_TYPES]
        needed |= dict.fromkeys(air, first_ns - AIR_LATENCY_NS)
        found_spans = {name: _span(reader, name, need_ns, last_ns) for name, need_ns in needed.items()}
        spans = {name: span for name, span in found_spans.items() if span}
    return _SensorPlan(topics, found, dwells, spans)


def _span(reader: BagReader, topic: str, first_ns: int, last_ns: int) -> _Span | None:
    """Samples that are kept of a topic around two times, ns; None: no samples.

    It is from a margin before to a margin after, and at least from the last sample before to the first one after.
    """
    samples = [(stamp_ns_of(m.cdr), m.log_time_ns) for m in reader.recorded_messages([topic])]
    stamps = np.array(sorted(stamp for stamp, _ in samples), dtype=np.int64)
    before, behind = stamps[stamps <= first_ns], stamps[stamps >= last_ns]
    begin_ns = min(first_ns - MARGIN_NS, int(before[-1]) if before.size else first_ns)
    end_ns = max(last_ns + MARGIN_NS, int(behind[0]) if behind.size else last_ns)
    logs = [log_ns for stamp, log_ns in samples if begin_ns <= stamp <= end_ns]
    return _Span(begin_ns, end_ns, min(logs)) if logs else None


def _described(plans: Sequence[_SensorPlan]) -> str:
    """The dwells of sensors, in words."""
    numbers = [dwell.number for plan in plans for dwell in plan.all_dwells]
    return f"{len(numbers)} dwells, with numbers from {min(numbers)} to {max(numbers)}" if numbers else "none at all"


class _Window:
    """The messages of a bag that are kept."""

    def __init__(self, reader: BagReader, kept: Range, plans: Sequence[_SensorPlan]) -> None:
        self._reader = reader
        dwells = [dwell for plan in plans for dwell in plan.dwells]
        by_number = kept.dwells is not None
        first_ns = min((dwell.first_log_ns for dwell in dwells), default=0) if by_number else 0
        last_ns = max((dwell.last_log_ns for dwell in dwells), default=2**63) if by_number else 2**63
        self._begin_ns = max(first_ns, kept.begin_ns or 0)
        self._end_ns = last_ns if kept.end_ns is None else min(last_ns, kept.end_ns)
        spans = [(name, span) for plan in plans for name, span in plan.spans.items()]
        self._first_ns = min([self._begin_ns, *(span.log_ns for _, span in spans)])
        """Reception of the first kept message, to which earlier latched messages are moved, ns."""
        self._spans: dict[str, list[_Span]] = {}
        for name, span in spans:
            self._spans.setdefault(name, []).append(span)
        of_dwells = [name for name, topic in reader.topics.items() if topic.type_name in OF_DWELLS]
        self._stamps = {name: _stamps_for(name, plans) for name in of_dwells}
        self._latched = {
            name: deque[BagMessage](maxlen=count)
            for name, topic in reader.topics.items()
            if (count := kept_count(topic))
        }
        self._parameters: dict[str, tuple[ParameterEvent, BagMessage]] = {}

    def messages(self) -> Iterator[BagMessage]:
        """The messages that are kept, in the order of their reception; first those that were latched before."""
        waiting: list[BagMessage] = []
        is_begun = False
        for message in self._reader.recorded_messages():
            if not is_begun and message.log_time_ns >= self._begin_ns:
                is_begun = True
                yield from self._earlier_messages()
                yield from waiting
            if self._keeps(message):
                if is_begun:
                    yield message
                else:
                    waiting.append(message)  # odometry or air
            elif not is_begun:
                self._remember(message)
        if not is_begun:
            yield from self._earlier_messages()
            yield from waiting

    def _keeps(self, message: BagMessage) -> bool:
        if message.topic in self._stamps:
            return stamp_ns_of(message.cdr) in self._stamps[message.topic]
        if spans := self._spans.get(message.topic):
            stamp_ns = stamp_ns_of(message.cdr)
            if any(span.begin_ns <= stamp_ns <= span.end_ns for span in spans):
                return True
        return self._begin_ns <= message.log_time_ns <= self._end_ns

    def _remember(self, message: BagMessage) -> None:
        """Keep a message from before the range, if it is latched or has parameters."""
        if message.topic in self._latched:
            self._latched[message.topic].append(message)
        elif message.type_name == PARAMETER_EVENT_TYPE:
            event = self._reader.decode(message.type_name, message.cdr)
            known = self._parameters.get(event.node)
            merged = after(known[0], event) if known else event
            cdr = serialize(merged) if known else message.cdr
            self._parameters[event.node] = merged, message._replace(cdr=cdr)

    def _earlier_messages(self) -> Iterator[BagMessage]:
        """The last latched messages and parameters before the range."""
        latched = [message for queue in self._latched.values() for message in queue]
        for message in (*latched, *(message for _, message in self._parameters.values())):
            yield message._replace(log_time_ns=self._first_ns)


def _stamps_for(topic: str, plans: Sequence[_SensorPlan]) -> frozenset[int]:
    """Stamps of the kept dwells of the sensor in whose namespace a topic is, the innermost one."""
    around = [plan for plan in plans if topic.startswith(plan.topics.namespace)]
    innermost = max(around, key=lambda plan: len(plan.topics.namespace), default=None)
    return innermost.stamps if innermost else frozenset()


def kept_count(topic: Topic) -> int:
    """Number of messages of a topic that late subscribers receive; 0 if it is not latched."""
    if topic.type_name in OF_DWELLS:
        return 0
    by_type = LATCHED.get(topic.type_name, 0)
    if topic.type_name == "tf2_msgs/msg/TFMessage" and not topic.name.endswith("tf_static"):
        by_type = 0
    return max(by_type, kept_by_publishers(topic.offered_qos) if topic.offered_qos else 0)


def upgrade(path: Path, out_directory: Path) -> Counter[str]:
    """Write the bag at `path` with its messages converted to those of today, in one file.

    Messages of other packages, and those of sal_height_msgs that have not changed, stay byte for byte, with their
    times; custom data stay, and parameters from a file next to an older bag are added to them.

    Returns:
        Number of upgraded messages by topic.

    Raises:
        UserError: the bag is damaged or not complete, or the folder is not empty.
    """
    reader = BagReader(path)
    made: Counter[str] = Counter()
    account = reader.indexes[-1].records.get(ACCOUNT) if reader.indexes else None
    try:
        with BagWriter(out_directory, kept_custom_data(reader), kept_packing(reader)) as bag:
            for topic in reader.topics.values():
                bag.add_topic(topic.name, topic.type_name, topic.offered_qos, _definition_of(topic))
            for message in reader.messages():
                bag.write(message.topic, message.cdr, message.log_time_ns, message.publish_time_ns)
                made[message.topic] += reader.topics[message.topic].is_old
            bag.close({ACCOUNT: account} if account else {})
    except OSError as error:
        raise UserError(f"Bag {out_directory} cannot be written: {error}.") from error
    return +made


def _definition_of(topic: Topic) -> Definition:
    """Today's definition of the messages of a topic; that in the bag if they are of another package."""
    if topic.is_old:
        return known_definition(topic.type_name)
    if not topic.type_name.startswith(PACKAGE):
        return topic.definition
    try:
        known = known_definition(topic.type_name)
    except UserError:  # a type that no longer exists
        return topic.definition
    return known if topic.definition.same_layout(known) else topic.definition


def kept_custom_data(reader: BagReader) -> dict[str, str]:
    """The custom data of a bag, with the parameters of an older one, which are in a file of their own next to it."""
    file = parameters_file(reader.path)
    if PARAMETERS in reader.custom_data or not file.is_file():
        return dict(reader.custom_data)
    try:
        values = json.dumps(yaml.safe_load(file.read_text(encoding="utf-8")) or {})
    except (OSError, ValueError, TypeError, yaml.YAMLError):  # a replay of the original refuses it
        return dict(reader.custom_data)
    return {**reader.custom_data, PARAMETERS: values}


def kept_packing(reader: BagReader) -> Packing:
    """One file, compressed as the first chunk of the bag is."""
    chunks = (chunk for index in reader.indexes for chunk in index.summary.chunk_indexes)
    first = next(chunks, None)
    return Packing((first.compression if first else "") or "none")
