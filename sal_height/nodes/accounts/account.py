"""The account of a node: its message counts, as its messages on /progress and its status on /diagnostics carry them.

Nodes make both messages with `to_progress` and `to_diagnostics`, and programs that watch a graph read them with
`of_message` and `of_status`. NodeAccount describes the numbers; `messages.accounts` has their names on /diagnostics.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Self

from sal_height.messages import to_stamp
from sal_height.messages.accounts import COUNTED, EVENTS, MEASURED, READY, WHOLE, fields_of_numbers
from sal_height.messages.types import Count, DiagnosticArray, DiagnosticStatus, Header, KeyValue, NodeAccount

DIAGNOSTICS = "/diagnostics"
"""Topic of the accounts as the conventions have them, at regular times."""
PROGRESS = "/progress"
"""Topic of the accounts at regular times and after every piece of work, made only while somebody subscribes."""

DWELLS, CALIBRATIONS = "dwells", "calibrations"
"""Events that have fields of their own: dwells that a source has published, calibrations that a node has received."""

LAST_DROP = "last_drop"
"""Name of the warning of an account on /diagnostics."""
LOST_WITH_PROCESS = "lost with its process"
"""Reason for the loss of messages that waited when the process of a node ended."""
ON_THE_WAY = "lost on the way"
"""Reason for which published messages have not arrived: the middleware has lost them."""

STAGE, RECORDER, OTHER = "stage", "recorder", "other"
"""Kinds of accounts: of a node that processes messages, of a recorder, and of programs that are not ours."""

ALWAYS = {STAGE: {"in", "processed", "out", "waiting", "jobs"}, RECORDER: {"unwritten"}, OTHER: set[str]()}
"""Names of numbers that are there even if they are 0."""

OF_TOPICS = ("published_on", "subscribers", "missed", "recorded")
"""Fields whose counts are by topic; a topic is without its leading slash here, and with it in messages."""

STATE = {"kind", "level", "state", "hardware_id"}
"""Fields that NodeAccount does not have."""

SUMMED = ("received", "processed", "published", "dwells", "calibrations", "unwritten", "cpu_s")
SUMMED_BY_NAME = ("dropped", "ignored", EVENTS, "published_on", "recorded")
"""Fields that count from the start of the node's process; all others state its present state."""

QUEUE_FULL, NOT_WRITTEN = "queue full", "not written"
"""Reasons for which received messages are not in the bag: too much waited for the disk; the disk refused them."""


@dataclass(frozen=True)
class Account:
    """Message counts of one node: the fields of NodeAccount.

    At any time received = processed + dropped + waiting.

    Attributes:
        unpublished: dwells that are processed and whose products follow later; None: all products follow at once.
        last_drop: warning that says why messages were last left out; empty if none were.
        kind: kind of the account, STAGE, RECORDER or OTHER.
        level: level of DiagnosticStatus; like the next two, it is set in accounts that nodes make of themselves only.
        state: reason for the level, in a few words.
        hardware_id: name of the sensor that the node works for; empty: none yet.
    """

    received: int = 0
    processed: int = 0
    published: int = 0
    waiting: int = 0
    jobs: int = 0
    ready: bool = False
    dwells: int = 0
    unpublished: int | None = None
    calibrations: int = 0
    dropped: Mapping[str, int] = field(default_factory=dict)
    ignored: Mapping[str, int] = field(default_factory=dict)
    dropped_last_minute: Mapping[str, int] = field(default_factory=dict)
    ignored_last_minute: Mapping[str, int] = field(default_factory=dict)
    events: Mapping[str, int] = field(default_factory=dict)
    published_on: Mapping[str, int] = field(default_factory=dict)
    subscribers: Mapping[str, int] = field(default_factory=dict)
    missed: Mapping[str, int] = field(default_factory=dict)
    recorded: Mapping[str, int] = field(default_factory=dict)
    unwritten: int = 0
    offered_hz: float = math.nan
    achieved_hz: float = math.nan
    latency_p50_ms: float = math.nan
    latency_p95_ms: float = math.nan
    cpu_s: float = 0.0
    memory_mb: float = 0.0
    pid: int = 0
    last_drop: str = ""
    kind: str = STAGE
    level: Any = DiagnosticStatus.OK
    state: str = ""
    hardware_id: str = ""

    @classmethod
    def of_status(cls, status: DiagnosticStatus) -> Self:
        """Read an account; values that are not finite numbers are left out."""
        numbers = {item.key: number for item in status.values if (number := _number(item.value)) is not None}
        sentences = [item.value for item in status.values if item.key == LAST_DROP]
        return cls.of_numbers(numbers, "".join(sentences))

    @classmethod
    def of_numbers(cls, numbers: Mapping[str, float], last_drop: str = "") -> Self:
        """The account that numbers by their names on /diagnostics state."""
        values = fields_of_numbers(numbers)
        for name in OF_TOPICS:
            values[name] = {key.removeprefix("/"): count for key, count in values.get(name, {}).items()}
        kind = STAGE if {"in", "waiting"} & numbers.keys() else RECORDER if "unwritten" in numbers else OTHER
        return cls(**values, last_drop=last_drop, kind=kind)

    @classmethod
    def of_message(cls, message: NodeAccount) -> Self:
        """Read an account; that of a recorder cannot be distinguished from others there."""
        values = {name: getattr(message, name) for name in _MESSAGE_FIELDS}
        for name in (*COUNTED.values(), EVENTS):
            counts = {one.name: one.count for one in values[name]}
            values[name] = {key.removeprefix("/"): n for key, n in counts.items()} if name in OF_TOPICS else counts
        return cls(**values)

    @property
    def numbers(self) -> dict[str, float]:
        """The numbers by their names on /diagnostics; those that are not known are left out."""
        numbers: dict[str, float] = {}
        of_all = ALWAYS[self.kind]
        for key, name in WHOLE.items():
            value = getattr(self, name)
            if key in of_all or value or (name == "unpublished" and value is not None):
                numbers[key] = value
        if self.kind == STAGE:
            numbers[READY] = int(self.ready)
        for name in MEASURED:
            value = getattr(self, name)
            if math.isfinite(value) and (value or name not in {"cpu_s", "memory_mb"}):
                numbers[name] = value
        for prefix, name in COUNTED.items():
            slash = "/" if name in OF_TOPICS else ""
            numbers |= {f"{prefix}{slash}{key}": count for key, count in sorted(getattr(self, name).items())}
        return numbers | dict(sorted(self.events.items()))

    def to_values(self) -> list[KeyValue]:
        """The account as values of a status."""
        texts = {**{key: str(number) for key, number in self.numbers.items()}, LAST_DROP: self.last_drop}
        return [KeyValue(key=key, value=text) for key, text in texts.items() if text]

    def to_progress(self, node: str, stamp_ns: int) -> NodeAccount:
        """The account as a message on /progress.

        Args:
            node: name of the node with its namespace, without leading slash.
            stamp_ns: time of the node's clock, ns.
        """
        values = {name: getattr(self, name) for name in _MESSAGE_FIELDS}
        values["unpublished"] = self.unpublished or 0
        for name in (*COUNTED.values(), EVENTS):
            slash = "/" if name in OF_TOPICS else ""
            values[name] = [Count(name=f"{slash}{key}", count=count) for key, count in values[name].items()]
        return NodeAccount(header=Header(stamp=to_stamp(stamp_ns)), node=node, **values)

    def to_diagnostics(self, node: str, stamp_ns: int) -> DiagnosticArray:
        """The account as a message on /diagnostics; arguments as for `to_progress`."""
        status = DiagnosticStatus(
            level=self.level, name=node, message=self.state, hardware_id=self.hardware_id, values=self.to_values()
        )
        return DiagnosticArray(header=Header(stamp=to_stamp(stamp_ns)), status=[status])

    def after(self, earlier: Account) -> Account:
        """This account, with the counts of an earlier process of the same node added.

        What waited when that one ended was lost with it.
        """
        sums: dict[str, Any] = {name: getattr(self, name) + getattr(earlier, name) for name in SUMMED}
        for name in SUMMED_BY_NAME:
            sums[name] = dict(Counter(getattr(earlier, name)) + Counter(getattr(self, name)))
        if earlier.waiting:
            lost = sums["dropped"].get(LOST_WITH_PROCESS, 0) + earlier.waiting
            sums["dropped"] = {**sums["dropped"], LOST_WITH_PROCESS: lost}
        return replace(self, **sums, last_drop=self.last_drop or earlier.last_drop)

    @property
    def lost_last_minute(self) -> dict[str, int]:
        """Messages that were left out or could not be used in the last minute, by reason."""
        return {**self.dropped_last_minute, **self.ignored_last_minute}

    def with_losses(self, count: int) -> Self:
        """This account, with messages that never arrived as received and dropped."""
        if not count:
            return self
        dropped = {**self.dropped, ON_THE_WAY: self.dropped.get(ON_THE_WAY, 0) + count}
        return replace(self, received=self.received + count, dropped=dropped)


_MESSAGE_FIELDS = tuple(one.name for one in fields(Account) if one.name not in STATE)


def _number(text: str) -> float | None:
    """The finite number that a text stands for, if any."""
    try:
        number = float(text)
    except ValueError:
        return None
    return number if math.isfinite(number) else None


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
    _publishers: int = 1

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
        if missed > 0 and not self.latched and self._is_of_one(publishers()):
            self.left_out[ON_THE_WAY] += missed
        self._number = number

    def _is_of_one(self, publishers: int) -> bool:
        """True if the messages are those of one publisher; none left: of as many as there were at the gap before."""
        self._publishers = publishers or self._publishers
        return self._publishers == 1

    @property
    def missed(self) -> int:
        """Messages that the publisher has numbered up to the last one, and that have not arrived; since its start."""
        return max(0, self._number - self.received)

    def as_json(self) -> dict[str, Any]:
        """The counts as the bag states them."""
        return {"received": self.received, "written": self.written, "left_out": dict(self.left_out)}
