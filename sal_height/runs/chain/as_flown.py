"""Dwells that nodes left out in flight, as far as the bag says: a replay leaves them out at the same nodes.

What is left out for the data is found again by the replay itself. What depends on the machine of the flight
(`OF_LOAD`) is imposed, as the messages on topic losses state it. Of bags without them, and of dwells that were lost on
their way, the recorded heights say which dwells a node has processed.
"""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from sal_height.bag.described import PARAMETER_EVENTS, sensors_of
from sal_height.bag.files import ACCOUNT
from sal_height.bag.namespace import NamespacedReader
from sal_height.bag.reader import BagReader, LogTimes
from sal_height.engine.registry import STAGES, takes_heights
from sal_height.engine.results import DwellKey
from sal_height.engine.stage import RESETS
from sal_height.errors import Rejected, UserError
from sal_height.graph.catalogue import HEIGHTS, NodeParameters, parameters_of
from sal_height.graph.plan import AsFlown
from sal_height.messages import to_ns
from sal_height.nodes.accounts.account import DIAGNOSTICS
from sal_height.topics import LOSSES
from sal_height.workers.pool import WORKER_ENDED

OF_LOAD = frozenset(
    {"overload", "queue full", "buffer full", "incomplete dwell", "inactive", "reset", "ended", "no sensor info"}
    | {WORKER_ENDED}
)
"""Reasons that depend on the machine and the time of the flight, not on the data."""

OF_ARRIVAL = frozenset({"odometry gap", "no air", "no mounting", "no calibration"})
"""Reasons that are of the data or of their arrival. A dwell that lacks nothing in the bag is left out for them, unless
the user sets parameters of the node, which may be meant to process it."""

OF_MESSAGES = frozenset({"late", "duplicate", RESETS})
"""Reasons that concern single messages of dwells which are processed or left out for another reason, or none."""

NOT_MADE = "not made in flight"
"""Reason for which a dwell is left out whose heights are not in the bag, where nothing says why."""

COMPRESSION = "sar_compression"


class FlownLoss(NamedTuple):
    """A dwell, or messages of it, that a node left out."""

    node: str
    dwell: DwellKey
    reason: str
    sentence: str
    messages: int = 0


@dataclass(frozen=True)
class FlownDwells:
    """Processing of the dwells of a bag in flight.

    Attributes:
        made: times when the heights of each dwell were recorded, ns, by topic with its leading slash.
        losses: dwells and messages that nodes left out.
        started: times at which nodes that had been started again were first noticed, ns, by node.
        unwritten: messages that the recorder has missed or left out, by topic.
        has_strips: True if a sensor of the bag is in stripmap, so that the compression keeps something between dwells.
    """

    made: Mapping[str, Mapping[DwellKey, int]] = field(default_factory=dict)
    losses: Sequence[FlownLoss] = ()
    started: Mapping[str, Sequence[int]] = field(default_factory=dict)
    unwritten: Mapping[str, int] = field(default_factory=dict)
    has_strips: bool = False


NOTHING_FLOWN = FlownDwells()


def flown_in(reader: BagReader, made: Mapping[str, Mapping[DwellKey, int]]) -> FlownDwells:
    """Find out how the dwells of a bag were processed, up to where it is damaged, if it is.

    Args:
        reader: reader of the bag.
        made: times when the heights of each dwell were recorded, ns, by topic.
    """
    sensors = sensors_of(reader)[0] if "/sensor_info" in reader.topics else {}
    has_strips = any(sensor.mode == "stripmap" for sensor in sensors.values())
    return FlownDwells(made, list(losses_in(reader)), _restarts_in(reader), _unwritten_in(reader), has_strips)


def as_flown(
    flown: FlownDwells,
    dwells: Mapping[DwellKey, LogTimes],
    stages: Sequence[str],
    values: NodeParameters,
    given: Iterable[str] = (),
) -> AsFlown:
    """The dwells that each stage of a replay leaves out.

    A stage has processed a dwell if its heights of it are in the bag, or heights that another stage made of these.

    Args:
        flown: processing of the dwells in flight.
        dwells: times when the frames of each dwell were recorded, in the order of the dwells.
        stages: names of the stages of the replay, in the order of the data.
        values: values of their parameters.
        given: names of the nodes of which the user sets parameters.
    """
    return _Plan(flown, dwells, stages, values, frozenset(given)).found()


def repeated_losses(unmade: Mapping[str, Collection[DwellKey]], replayed: BagReader) -> Counter[tuple[str, str]]:
    """Messages that a replay dropped of dwells that the node did not process in flight either, by node and reason.

    Args:
        unmade: dwells that nodes did not process in flight, by node.
        replayed: bag of the replay.
    """
    counts: Counter[tuple[str, str]] = Counter()
    for one in losses_in(replayed):
        if one.messages and one.dwell in unmade.get(one.node, ()):
            counts[one.node, one.reason] += one.messages
    return counts


class _Plan:
    """Finds, stage by stage in the order of the data, which dwells are left out."""

    def __init__(
        self,
        flown: FlownDwells,
        dwells: Mapping[DwellKey, LogTimes],
        stages: Sequence[str],
        values: NodeParameters,
        given: frozenset[str],
    ) -> None:
        self._flown, self._dwells, self._stages, self._given = flown, dwells, stages, given
        self._source = {
            name: f"/{parameters_of(name, values.get(name, {})).estimator}/height"
            for name in stages
            if takes_heights(STAGES[name])
        }
        self._lost = {(one.node, one.dwell): one for one in flown.losses if one.reason not in OF_MESSAGES}
        self._processed = {name: self._shown_by_heights(name) for name in stages}
        """Dwells that each stage has processed, as recorded heights show."""
        self._left_out: dict[str, dict[DwellKey, Rejected]] = {name: {} for name in stages}
        self._lost_before: dict[str, set[DwellKey]] = {}
        self._unrecorded: dict[str, set[DwellKey]] = {}

    def found(self) -> AsFlown:
        """All that is found."""
        for name in self._stages:
            self._lost_before[name] = self._lost_upstream(name)
            self._judge(name)
        return AsFlown(
            {name: dwells for name, dwells in self._left_out.items() if dwells},
            {name: restarts for name in self._stages if (restarts := list(self._restarts(name)))},
            {name: frozenset(self._unmade(name)) for name in self._stages},
            {prefix: frozenset(dwells) for prefix, dwells in self._unrecorded.items() if dwells},
            {name: frozenset(dwells) for name, dwells in self._lost_before.items()},
        )

    def _judge(self, name: str) -> None:
        """Find the dwells that a stage leaves out, and those whose heights were made and not recorded."""
        topic = _topic_of(name)
        made, processed = self._made(topic), self._processed[name]
        unexplained: list[DwellKey] = []
        for dwell in self._dwells:
            loss = self._lost.get((name, dwell))
            if dwell in processed or dwell in self._lost_before[name]:
                continue
            if loss is None:
                if made:
                    unexplained.append(dwell)
            elif loss.reason in OF_LOAD or (loss.reason in OF_ARRIVAL and name not in self._given):
                self._left_out[name][dwell] = Rejected(loss.reason, loss.sentence)
        missed_by_recorder = 0 < len(unexplained) <= self._flown.unwritten.get(topic, 0)
        if not missed_by_recorder:
            self._left_out[name].update((dwell, _not_made(dwell, topic)) for dwell in unexplained)
        if made:
            lacking = {*processed, *(unexplained if missed_by_recorder else ())} - made.keys()
            self._unrecorded[HEIGHTS[name]] = lacking

    def _made(self, topic: str) -> Mapping[DwellKey, int]:
        return self._flown.made.get(topic, {})

    def _shown_by_heights(self, name: str) -> frozenset[DwellKey]:
        """Dwells of which a stage has heights in the bag, or another stage that needs its heights."""
        topic = _topic_of(name)
        users = [other for other, source in self._source.items() if source == topic]
        topics = self._flown.made if name == COMPRESSION else [topic, *map(_topic_of, users)]
        return frozenset(dwell for one in topics for dwell in self._made(one))

    def _lost_upstream(self, name: str) -> set[DwellKey]:
        """Dwells that did not get as far as a stage."""
        if name == COMPRESSION:
            return set()
        if name not in self._source:
            return self._lost_at(COMPRESSION)
        source = self._source[name]
        maker = next((one for one in self._stages if _topic_of(one) == source), None)
        if maker is not None:
            return self._lost_before[maker] | self._lost_at(maker)
        return set(self._dwells) - self._made(source).keys()

    def _lost_at(self, name: str) -> set[DwellKey]:
        """Dwells that a stage has left out for whatever reason."""
        lost = {dwell for node, dwell in self._lost if node == name}
        return lost.union(self._left_out.get(name, ())) - self._processed.get(name, frozenset())

    def _unmade(self, name: str) -> set[DwellKey]:
        """Dwells that a stage did not process, as far as losses or recorded heights show it."""
        made = self._flown.made if name == COMPRESSION else self._made(_topic_of(name))
        return self._lost_at(name).union(set(self._dwells) - self._processed[name] if made else ())

    def _restarts(self, name: str) -> Iterator[DwellKey]:
        """First dwells of a stage after each of its resets and further starts, if it keeps something of dwells."""
        if STAGES[name].is_parallel and not (name == COMPRESSION and self._flown.has_strips):
            return
        absent = self._lost_before[name].union(self._left_out[name])
        arriving = [dwell for dwell in self._dwells if dwell not in absent]
        for one in self._flown.losses:
            if (one.node, one.reason) == (name, RESETS):
                since = [dwell for dwell in arriving if dwell.stamp_ns >= one.dwell.stamp_ns]
                if since:
                    yield min(since, key=lambda dwell: (dwell != one.dwell, dwell.stamp_ns))
        with_worker = [
            self._dwells[dwell].first_ns
            for (node, dwell), one in self._lost.items()
            if node == name and one.reason == WORKER_ENDED and dwell in self._dwells
        ]
        times: Mapping[DwellKey, int] = self._made(_topic_of(name)) or self._made(self._source.get(name, ""))
        if not times:
            times = {dwell: frames.first_ns for dwell, frames in self._dwells.items()}
        in_order = sorted((time_ns, order, dwell) for order, (dwell, time_ns) in enumerate(times.items()))
        for started_ns in [*self._flown.started.get(name, ()), *with_worker]:
            later = (dwell for time_ns, _, dwell in in_order if time_ns >= started_ns)
            if first := next((dwell for dwell in later if dwell not in self._left_out[name]), None):
                yield first


def _topic_of(name: str) -> str:
    """Topic of the heights of a stage; empty: it makes none."""
    return f"/{HEIGHTS[name]}/height" if name in HEIGHTS else ""


def _not_made(dwell: DwellKey, topic: str) -> Rejected:
    return Rejected(
        NOT_MADE, f"Dwell {dwell.number} is left out as in flight: the bag has no heights of it on {topic}."
    )


def losses_in(reader: BagReader) -> Iterator[FlownLoss]:
    """The dwells and messages on topic losses."""
    with suppress(UserError):  # damage is reported when the bag is played
        for message in _decoded(reader, f"/{LOSSES}"):
            if message.of_dwell and (node := _node_of(reader, message.node)):
                dwell = DwellKey(message.config_hash, message.dwell, to_ns(message.dwell_stamp))
                yield FlownLoss(node, dwell, message.reason, message.sentence, message.messages)


def _restarts_in(reader: BagReader) -> dict[str, list[int]]:
    """Times when a node first had another process than before, ns, by node.

    The recorders of `run` and `replay`, whose nodes are never started again, record no parameter events.
    """
    processes: dict[str, set[str]] = defaultdict(set)
    started: dict[str, list[int]] = defaultdict(list)
    if PARAMETER_EVENTS not in reader.topics or DIAGNOSTICS not in reader.topics:
        return started

    def read(time_ns: int, message: Any) -> None:
        for status in message.status:
            process = next((one.value for one in status.values if one.key == "pid"), "")
            node = _node_of(reader, status.name)
            if process and node and process not in processes[node]:
                if processes[node]:
                    started[node].append(time_ns)
                processes[node].add(process)

    with suppress(UserError):
        _read(reader, DIAGNOSTICS, read)
    return started


def _read(reader: BagReader, topic: str, read: Callable[[int, Any], None]) -> None:
    """Decode the messages of a topic that can be decoded, each with the time when it was recorded, ns."""
    for recorded in reader.messages([topic]):
        with suppress(RuntimeError):
            read(recorded.log_time_ns, reader.decode(recorded.type_name, recorded.cdr))


def _decoded(reader: BagReader, topic: str) -> Sequence[Any]:
    """The messages of a topic, as far as they can be decoded."""
    found: list[Any] = []
    if topic in reader.topics:
        _read(reader, topic, lambda _, message: found.append(message))
    return found


def _node_of(reader: BagReader, name: str) -> str:
    """Name of a node without its namespace; empty: it is not in the namespace that is read."""
    whole = f"/{name.lstrip('/')}"
    if isinstance(reader, NamespacedReader) and not reader.contains(whole):
        return ""
    return whole.rpartition("/")[2]


def _unwritten_in(reader: BagReader) -> Counter[str]:
    """Messages that are not in the bag, as its recorder states, by topic."""
    counts: Counter[str] = Counter()
    namespace = reader.namespace if isinstance(reader, NamespacedReader) else ""
    for index in reader.indexes:
        for topic, text in index.records.get(ACCOUNT, {}).items():
            with suppress(ValueError, KeyError, TypeError, AttributeError):
                counts[topic.removeprefix(namespace)] += sum(map(int, json.loads(text)["left_out"].values()))
    return counts
