"""Record of the flight in a bag: its dwells, and what nodes and products state of their parameters."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

from sal_height.bag.described import IMAGES, PARAMETER_EVENTS
from sal_height.bag.namespace import NamespacedReader
from sal_height.bag.played import DwellPart, part_of
from sal_height.bag.reader import BagMessage, BagReader, LogTimes
from sal_height.bag.topics import FRAME_TYPE
from sal_height.engine.stage import DwellKey
from sal_height.errors import UserError
from sal_height.graph.catalogue import HEIGHTS
from sal_height.messages.parameters import value_of
from sal_height.messages.products import provenance_of
from sal_height.renamed import with_new_names


def products_of(reader: BagReader) -> list[str]:
    """Topics of a bag whose messages have a provenance: heights, or else images."""
    heights = [topic for prefix in HEIGHTS.values() if (topic := f"/{prefix}/height") in reader.topics]
    return heights or [topic for topic in [f"/{IMAGES}"] if topic in reader.topics]


def states_processing(reader: BagReader) -> bool:
    """True if a bag has anything that states how dwells were processed."""
    return bool(products_of(reader) or {"/calibration", PARAMETER_EVENTS} & reader.topics.keys())


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
    """

    def __init__(self, reader: BagReader, dwell_topics: Sequence[str] = ("/phase_history",)) -> None:
        """Read a bag up to its end, or up to where it is damaged, which is reported when it is played.

        Args:
            reader: reader of the bag.
            dwell_topics: topics with the frames that dwells are made of, or with their images or heights instead.
        """
        self.dwells: dict[DwellKey, LogTimes] = {}
        self.stages: dict[DwellKey, dict[str, Mapping[str, Any]]] = {}
        self.applied: dict[DwellKey, str] = {}
        self.sensors: dict[str, str] = {}
        self.said: list[Said] = []
        self.received: list[ReceivedCalibration] = []
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
