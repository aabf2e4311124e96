"""Events of a recorded flight between its dwells: changed parameters of nodes, and received calibrations.

The provenance of heights, or of images, says with which parameters and calibration their dwell was processed. Of dwells
without them, the order of the bag decides: what was recorded before the last frame of a dwell was in effect for it.
"""

from __future__ import annotations

import heapq
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeVar

from sal_height.bag.described import IMAGES, PARAMETER_EVENTS
from sal_height.bag.namespace import NamespacedReader
from sal_height.bag.played import DwellPart, part_of
from sal_height.bag.reader import BagMessage, BagReader, LogTimes
from sal_height.bag.topics import FRAME_TYPE
from sal_height.engine.adjuster import POSE_ERROR
from sal_height.engine.compression import HEARD
from sal_height.engine.mountings import mounting_in
from sal_height.engine.provenance import LEFT_OUT
from sal_height.engine.registry import STAGES
from sal_height.engine.results import DwellKey
from sal_height.errors import UserError
from sal_height.geometry import Mounting
from sal_height.graph.catalogue import HEIGHTS, SETTABLE
from sal_height.messages.parameters import value_of
from sal_height.messages.products import provenance_of
from sal_height.renamed import with_new_names
from sal_height.runs.chain.as_flown import NOTHING_FLOWN, FlownDwells, flown_in
from sal_height.settings import settings_of


def products_of(reader: BagReader) -> list[str]:
    """Topics of a bag whose messages have a provenance: heights, or else images."""
    heights = [topic for prefix in HEIGHTS.values() if (topic := f"/{prefix}/height") in reader.topics]
    return heights or [topic for topic in [f"/{IMAGES}"] if topic in reader.topics]


class Said(NamedTuple):
    """A node published that parameters have these values.

    Attributes:
        time_ns: time when it was recorded, ns since the epoch.
        node: name of the node, without its namespace.
        values: values by name.
        is_change: True if they had other values before; else the values were requested, or the node has just started.
    """

    time_ns: int
    node: str
    values: dict[str, Any]
    is_change: bool


class ReceivedCalibration(NamedTuple):
    """A calibration that was received, with the time, ns."""

    time_ns: int
    calibration: str


class FlightRecord:
    """Dwells, parameters and calibrations of a bag.

    Attributes:
        dwells: times when the first and the last frame of each dwell were recorded, in the order of the first frames.
        stages: parameters in the provenance of each dwell's products, by node.
        applied: identity of the calibration in the provenance of each dwell's products; empty: none but the sensor's.
        sensors: the config_hash of the sensor of each calibration in the bag, by identity.
        said: parameters that nodes published, in the order of the bag.
        received: calibrations that were received, in the order of the bag.
        made: times when the products of each dwell were recorded, ns, by topic.
    """

    def __init__(self, reader: BagReader, dwell_topics: Sequence[str] = ("/phase_history",)) -> None:
        """Read a bag up to its end, or up to where it is damaged, which is reported when it is played."""
        self.dwells: dict[DwellKey, LogTimes] = {}
        self.stages: dict[DwellKey, dict[str, Mapping[str, Any]]] = {}
        self.applied: dict[DwellKey, str] = {}
        self.sensors: dict[str, str] = {}
        self.said: list[Said] = []
        self.received: list[ReceivedCalibration] = []
        self.made: dict[str, dict[DwellKey, int]] = {}
        self._reader = reader
        self._own: set[str] = set()
        self._dwell_topics = dwell_topics
        readers: dict[str, Callable[[BagMessage], None]] = {
            **dict.fromkeys([*dwell_topics, *products_of(reader)], self._read_product),
            "/sensor_info": self._read_sensor,
            "/calibration": self._read_calibration,
            PARAMETER_EVENTS: self._read_event,
        }
        known = reader.topics
        frames = [topic for topic in dwell_topics if topic in known and known[topic].type_name == FRAME_TYPE]
        for log_time_ns, part in heapq.merge(*map(reader.frame_parts, frames), key=lambda one: one.log_time_ns):
            self._read_dwell(part, log_time_ns)
        self._read([topic for topic in readers if topic in known and topic not in frames], readers)
        self.applied = {dwell: "" if name in self._own else name for dwell, name in self.applied.items()}

    def _read(self, topics: list[str], readers: Mapping[str, Callable[[BagMessage], None]]) -> None:
        with suppress(UserError):
            for recorded in self._reader.messages(topics):
                with suppress(UserError, RuntimeError):  # an invalid message
                    readers[recorded.topic](recorded)

    def _read_dwell(self, part: DwellPart, log_time_ns: int) -> None:
        first_ns, _ = self.dwells.get(part.dwell, (log_time_ns, 0))
        self.dwells[part.dwell] = LogTimes(first_ns, log_time_ns)

    def _read_product(self, recorded: BagMessage) -> None:
        part = part_of(recorded)
        if part is None:
            return
        if recorded.topic in self._dwell_topics:
            self._read_dwell(part, recorded.log_time_ns)
        if part.provenance is not None:
            self.made.setdefault(recorded.topic, {})[part.dwell] = recorded.log_time_ns
            stages = provenance_of(part.provenance).stages
            renamed = {node: with_new_names(values) for node, values in stages.items()}
            self.stages.setdefault(part.dwell, {}).update(renamed)
            self.applied[part.dwell] = part.provenance.calibration_id

    def _read_sensor(self, recorded: BagMessage) -> None:
        self._own.add(self._reader.decode(recorded.type_name, recorded.cdr).calibration_id)

    def _read_calibration(self, recorded: BagMessage) -> None:
        calibration = self._reader.decode(recorded.type_name, recorded.cdr)
        self.sensors[calibration.id] = calibration.config_hash
        self.received.append(ReceivedCalibration(recorded.log_time_ns, calibration.id))

    def _read_event(self, recorded: BagMessage) -> None:
        event = self._reader.decode(recorded.type_name, recorded.cdr)
        if isinstance(self._reader, NamespacedReader) and not self._reader.contains(event.node):
            return
        node = event.node.rpartition("/")[2]
        for parameters, is_change in ((event.new_parameters, False), (event.changed_parameters, True)):
            values = with_new_names({one.name: value_of(one.value) for one in parameters})
            if values:
                self.said.append(Said(recorded.log_time_ns, node, values, is_change))


PROVENANCE, EVENT, MESSAGE = "provenance", "parameter event", "order of the bag"
"""Sources of the values and calibrations that were in effect for a dwell."""

NO_SETTINGS = {"use_sim_time", "start_type_description_service", LEFT_OUT, POSE_ERROR}
"""Names in addition to the parameters of our nodes: those that rclpy gives to every node, and what provenance adds."""

OF_MACHINE = frozenset({"autostart", "latency_budget_s"})
"""Parameters of all nodes that suited the machine of the flight; none changes heights. `recorded_parameters` says why a
replay does not repeat them."""

NO_FILE = "", HEARD
"""Values of parameters that name files which are no paths."""

Recorded = TypeVar("Recorded", Said, ReceivedCalibration)


class Parameter(NamedTuple):
    """A parameter of a node."""

    node: str
    name: str


class Value(NamedTuple):
    """A value of a parameter, and how it is known."""

    value: Any
    source: str


class Change(NamedTuple):
    """A parameter has another value from a dwell on."""

    dwell: DwellKey
    parameter: Parameter
    value: Any
    source: str


class Applied(NamedTuple):
    """A calibration is applied from a dwell on."""

    dwell: DwellKey
    calibration: str
    source: str


@dataclass(frozen=True)
class Timeline:
    """Events of a flight, in the order of its dwells.

    Attributes:
        dwells: times when the frames of each dwell were recorded, in the order of their first frames.
        start: values of parameters at the first dwell, as far as they are known, but for those `OF_MACHINE`.
        files: paths in the provenance, by the parameter that names the file; they are neither in `start` nor in
            `changes`, unless the node itself stated them.
        changes: changes of parameters, later on.
        calibrations: calibrations in the bag that were applied.
        missing: calibrations that were applied and are not in the bag.
        received: all calibrations in the bag, each with the dwell before which it was received.
        forgotten: parameters of that time that the nodes do not have today, and how they are known.
        mountings: mountings of sensors (config_hash) on the platform, where the flight had others than described.
        flown: what the bag says of which dwells were processed.
    """

    dwells: Mapping[DwellKey, LogTimes] = field(default_factory=dict)
    start: dict[Parameter, Value] = field(default_factory=dict)
    files: dict[Parameter, str] = field(default_factory=dict)
    changes: list[Change] = field(default_factory=list)
    calibrations: list[Applied] = field(default_factory=list)
    missing: list[Applied] = field(default_factory=list)
    received: list[Applied] = field(default_factory=list)
    forgotten: dict[Parameter, str] = field(default_factory=dict)
    mountings: dict[str, Mounting] = field(default_factory=dict)
    flown: FlownDwells = NOTHING_FLOWN


def timeline_of(reader: BagReader, dwell_topics: Sequence[str] = ("/phase_history",)) -> Timeline:
    """Read the events of the flight that a bag was recorded in, up to where the bag is damaged, if it is.

    Args:
        reader: reader of the bag.
        dwell_topics: topics with the frames that dwells are made of, or with their images or heights instead.

    Returns:
        The timeline; an empty one if nothing in the bag states how dwells were processed.
    """
    if not (products_of(reader) or {"/calibration", PARAMETER_EVENTS} & reader.topics.keys()):
        return Timeline()
    record = FlightRecord(reader, dwell_topics)
    timeline = Timeline(record.dwells, flown=flown_in(reader, record.made))
    parameters, calibrations = _Parameters(timeline), _Calibrations(timeline, record.sensors)
    said, received = deque(record.said), deque(record.received)
    for dwell, frames in record.dwells.items():
        for one in _until(frames.last_ns, said):
            parameters.receive(one)
        stages = record.stages.get(dwell, {})
        parameters.enter(dwell, stages)
        if (mounting := mounting_in(stages.get("sar_compression", {}))) is not None:
            timeline.mountings.setdefault(dwell.sensor, mounting)
        for message in _until(frames.last_ns, received):
            calibrations.receive(message)
        calibrations.enter(dwell, record.applied.get(dwell))
    for one in said:  # of nodes that were asked only after the last dwell
        parameters.receive(one)
    parameters.enter_late_reports()
    return timeline


def _until(time_ns: int, recorded: deque[Recorded]) -> Iterator[Recorded]:
    """Remove and yield the items recorded up to a time, ns."""
    while recorded and recorded[0].time_ns <= time_ns:
        yield recorded.popleft()


class _Parameters:
    """Follows the parameters of all nodes from dwell to dwell."""

    def __init__(self, timeline: Timeline) -> None:
        self._timeline, self._first = timeline, next(iter(timeline.dwells), None)
        self._now: dict[Parameter, Any] = {}
        self._said: dict[Parameter, tuple[Any, bool]] = {}
        """Published values that no product has shown yet, with True if the parameter had another one before."""
        self._stated: dict[str, Mapping[str, Any]] = {}

    def receive(self, said: Said) -> None:
        """Record what a node published."""
        for parameter, value in self._known(said.node, said.values, EVENT):
            self._said[parameter] = value, said.is_change

    def enter(self, dwell: DwellKey, stages: Mapping[str, Mapping[str, Any]]) -> None:
        """Go on to a dwell, with what the provenance of its products states, by node."""
        waiting = {parameter.node for parameter in self._said}
        for node, values in stages.items():
            if node in waiting or self._stated.get(node) != values:
                self._stated[node] = values
                for parameter, value in self._known(node, values, PROVENANCE):
                    said, is_change = self._said.get(parameter, (None, False))
                    if said == value:
                        del self._said[parameter]
                    self._set(dwell, parameter, Value(value, PROVENANCE), is_change and said == value)
        for parameter in [one for one in self._said if not self._is_stated(one, stages)]:
            value, is_change = self._said.pop(parameter)
            self._set(dwell, parameter, Value(value, EVENT), is_change)
            self._stated.pop(parameter.node, None)

    def _is_stated(self, parameter: Parameter, stages: Mapping[str, Mapping[str, Any]]) -> bool:
        """True if the provenance states a value of a parameter that is used."""
        return parameter.name in stages.get(parameter.node, {}) and parameter not in self._timeline.files

    def enter_late_reports(self) -> None:
        """Use values that nodes reported after the last dwell as those that they had all the time."""
        for parameter, (value, is_change) in self._said.items():
            if not is_change:
                self._timeline.start.setdefault(parameter, Value(value, EVENT))

    def _set(self, dwell: DwellKey, parameter: Parameter, value: Value, is_change: bool) -> None:
        """Record a value; the first one in a late report was in effect from the start."""
        if parameter not in self._now and (not is_change or dwell == self._first):
            self._timeline.start[parameter] = value
        elif parameter not in self._now or self._now[parameter] != value.value:
            self._timeline.changes.append(Change(dwell, parameter, *value))
        self._now[parameter] = value.value

    def _known(self, node: str, values: Mapping[str, Any], source: str) -> Iterator[tuple[Parameter, Any]]:
        """The values of parameters that can be set today; others are recorded as forgotten, and paths as files."""
        today = settings_of(STAGES[node].settings) if node in SETTABLE else {}
        for name, value in values.items():
            parameter = Parameter(node, name)
            if name in OF_MACHINE:
                continue
            if name in today and source == PROVENANCE and today[name].names_file and value not in NO_FILE:
                self._timeline.files.setdefault(parameter, str(value))
            elif name in today:
                yield parameter, _plain(value)
            elif "." not in name and name not in NO_SETTINGS and (node in SETTABLE or source == PROVENANCE):
                self._timeline.forgotten.setdefault(parameter, source)


DWELLS_OF_TRIAL = 2
"""Dwells with products, after a calibration, of which one names it unless it was refused. The first one may
have been complete before the node received it."""


class _Calibrations:
    """Follows the calibrations that were applied, from dwell to dwell; every sensor has its own."""

    def __init__(self, timeline: Timeline, sensors: Mapping[str, str]) -> None:
        self._timeline, self._sensors = timeline, sensors
        self._now: dict[str, str] = {}
        self._pending: dict[str, str] = {}
        self._without: Counter[str] = Counter()
        """Dwells of each sensor with products that do not name the calibration which it received last."""
        self._received: list[str] = []

    def receive(self, message: ReceivedCalibration) -> None:
        """Record a calibration that was received."""
        sensor = self._sensors[message.calibration]
        self._pending[sensor] = message.calibration
        self._without[sensor] = 0
        self._received.append(message.calibration)

    def enter(self, dwell: DwellKey, applied: str | None) -> None:
        """Go on to a dwell, with the calibration that its provenance names; None: it has no products."""
        self._timeline.received.extend(Applied(dwell, calibration, MESSAGE) for calibration in self._received)
        self._received.clear()
        if applied is None:
            pending, self._pending = self._pending, {}
            for calibration in pending.values():
                self._apply(Applied(dwell, calibration, MESSAGE))
            return
        self._without[dwell.sensor] += 1
        if self._pending.get(dwell.sensor) != applied and self._without[dwell.sensor] == DWELLS_OF_TRIAL:
            self._pending.pop(dwell.sensor, None)  # it was refused
        if applied in self._sensors:
            if self._pending.get(self._sensors[applied]) == applied:
                del self._pending[self._sensors[applied]]
            self._apply(Applied(dwell, applied, PROVENANCE))
        elif applied and applied not in {one.calibration for one in self._timeline.missing}:
            self._timeline.missing.append(Applied(dwell, applied, PROVENANCE))

    def _apply(self, applied: Applied) -> None:
        sensor = self._sensors[applied.calibration]
        if self._now.get(sensor) != applied.calibration:
            self._now[sensor] = applied.calibration
            self._timeline.calibrations.append(applied)


def _plain(value: Any) -> Any:
    """A value of a parameter as YAML has it: lists instead of arrays."""
    return list(value) if isinstance(value, Iterable) and not isinstance(value, str | bytes) else value
