"""Content of a bag that describes its flight: sensors, dwells by their frames, parameter events, and the origin."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from sal_height import messages
from sal_height.bag.reader import BagReader
from sal_height.bag.topics import FIX_TYPE, FRAME_TYPE, SENSOR_TYPE, Topic
from sal_height.engine.dwells import CONTRADICTION
from sal_height.engine.frame_items import Frame
from sal_height.engine.results import DwellKey
from sal_height.errors import UserError
from sal_height.geometry import Origin
from sal_height.messages.types import ParameterEvent
from sal_height.sensor import Sensor
from sal_height.topics import MAP_ORIGIN, ODOMETRY, PHASE_HISTORY, SENSOR_INFO, SLC

FRAMES, IMAGES = PHASE_HISTORY, SLC
"""Topics with the samples of dwells, and with their images."""

PARAMETER_EVENTS, PARAMETER_EVENT_TYPE = "/parameter_events", "rcl_interfaces/msg/ParameterEvent"

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class SensorTopics:
    """Names of the topics of one sensor, also of those that the bag does not have.

    Attributes:
        namespace: namespace that they share, with a slash at both ends; ``/`` without one.
    """

    namespace: str

    @property
    def frames(self) -> str:
        """Topic of its frames."""
        return self.namespace + FRAMES

    @property
    def sensor_info(self) -> str:
        """Topic of its description."""
        return self.namespace + SENSOR_INFO

    @property
    def odometry(self) -> str:
        """Topic of the platform's odometry."""
        return self.namespace + ODOMETRY

    @property
    def images(self) -> str:
        """Topic of its focused images, with which a replay may start."""
        return self.namespace + IMAGES

    @property
    def names(self) -> list[str]:
        """The topics that the whole chain needs."""
        return [self.sensor_info, self.odometry, self.frames]


def sensors_in(topics: Mapping[str, Topic]) -> list[SensorTopics]:
    """The sensors whose frames or descriptions are among the topics of a bag, by name."""
    found = set()
    for suffix, type_name in ((FRAMES, FRAME_TYPE), (SENSOR_INFO, SENSOR_TYPE)):
        for name, topic in topics.items():
            if topic.type_name == type_name and name.endswith(f"/{suffix}"):
                found.add(SensorTopics(name.removesuffix(suffix)))
    return sorted(found, key=lambda sensor: sensor.namespace)


def after(known: ParameterEvent | None, event: ParameterEvent) -> ParameterEvent:
    """All parameters of a node after an event, as an event of new parameters; `known`: the parameters before."""
    values = {parameter.name: parameter for parameter in (known.new_parameters if known else ())}
    values |= {parameter.name: parameter for parameter in (*event.new_parameters, *event.changed_parameters)}
    for parameter in event.deleted_parameters:
        values.pop(parameter.name, None)
    return ParameterEvent(node=event.node, stamp=event.stamp, new_parameters=list(values.values()))


def origin_of(reader: BagReader) -> Origin | None:
    """Position of the map's origin on the earth, by topic map_origin; None: not stated."""
    topic = f"/{MAP_ORIGIN}"
    if topic not in reader.topics or reader.topics[topic].type_name != FIX_TYPE:
        return None
    for recorded in reader.messages([topic]):
        try:
            message = reader.decode(recorded.type_name, recorded.cdr)
            return messages.read_origin(message, message.header.frame_id)
        except (UserError, RuntimeError) as error:
            _LOG.warning("Bag %s: a message on %s is not used. %s", reader.path, topic, error)
    return None


def sensors_of(reader: BagReader) -> tuple[dict[str, Sensor], list[UserError]]:
    """The sensors that a bag describes, by their config_hash, and the reasons why other descriptions are not used."""
    sensors: dict[str, Sensor] = {}
    refused = []
    for recorded in reader.messages([f"/{SENSOR_INFO}"]):
        try:
            sensor = messages.sensor_from_message(reader.decode(recorded.type_name, recorded.cdr))
        except UserError as error:
            refused.append(error)
            continue
        if sensors.setdefault(sensor.config_hash, sensor).digest != sensor.digest:
            refused.append(UserError(CONTRADICTION.format(sensor.config_hash)))
    return sensors, refused


@dataclass
class DwellFrames:
    """A dwell in a bag: the frames of equal sensor, number and stamp.

    Attributes:
        config_hash: config_hash of its sensor.
        number: number of the dwell.
        stamp_ns: time of its first pulse, ns.
        last_pulse_ns: time of its last pulse, ns.
        channels: number of frames of each channel.
        first_log_ns: reception of the first of its frames, ns.
        last_log_ns: reception of the last of its frames, ns.
    """

    config_hash: str
    number: int
    stamp_ns: int
    last_pulse_ns: int
    channels: Counter[int] = field(default_factory=Counter)
    first_log_ns: int = 0
    last_log_ns: int = 0

    def absent(self, detectors: int) -> list[int]:
        """Channels without a frame."""
        return sorted(set(range(detectors)) - set(self.channels))

    @property
    def doubled(self) -> list[int]:
        """Channels with several frames."""
        return sorted(channel for channel, count in self.channels.items() if count > 1)


@dataclass(frozen=True)
class DwellFault:
    """Faults of a dwell.

    Attributes:
        number: number of the dwell.
        stamp_ns: time of its first pulse, ns.
        described: True if a message describes its sensor.
        absent: channels without a frame; empty if the sensor is not described.
        doubled: channels with several frames.
    """

    number: int
    stamp_ns: int
    described: bool
    absent: list[int]
    doubled: list[int]

    def __str__(self) -> str:
        name = f"dwell {self.number} at {self.stamp_ns * 1e-9:.3f} s"
        parts = [] if self.described else ["is of a sensor that no message describes"]
        named = (("lacks", self.absent), ("has twice", self.doubled))
        parts += [f"{what} {_listed(channels)}" for what, channels in named if channels]
        return f"{name} {' and '.join(parts)}"


@dataclass(frozen=True)
class DwellReport:
    """Topic of the frames of a sensor, number of its dwells, and the faults of those that are not whole."""

    topic: str
    dwells: int
    faults: list[DwellFault]

    def __str__(self) -> str:
        whole = self.dwells - len(self.faults)
        return "\n".join(
            [f"{self.topic}: {self.dwells} dwells, {whole} of them whole.", *map("  {}".format, self.faults)]
        )


class DwellList:
    """The dwells of a sensor, in the order in which they began."""

    def __init__(self) -> None:
        self._dwells: dict[DwellKey, DwellFrames] = {}

    def __iter__(self) -> Iterator[DwellFrames]:
        return iter(self._dwells.values())

    def __len__(self) -> int:
        return len(self._dwells)

    def add(self, cdr: bytes, log_time_ns: int) -> Frame:
        """Add a serialized frame, and return it.

        Raises:
            UserError: it cannot be decoded.
        """
        try:
            frame = messages.received_frame(cdr)
        except RuntimeError as error:
            raise UserError(f"A frame cannot be decoded: {error}.") from error
        times, key = frame.pulse_time, frame.key
        last_ns = frame.end_ns if times.size and 0 <= times[-1] < 1e6 else key.stamp_ns
        dwell = self._dwells.get(key)
        if dwell is None:
            dwell = DwellFrames(*key, last_ns, first_log_ns=log_time_ns, last_log_ns=log_time_ns)
            self._dwells[key] = dwell
        dwell.channels[frame.channel] += 1
        dwell.last_pulse_ns = max(dwell.last_pulse_ns, last_ns)
        dwell.first_log_ns = min(dwell.first_log_ns, log_time_ns)
        dwell.last_log_ns = max(dwell.last_log_ns, log_time_ns)
        return frame


def read_dwells(reader: BagReader, sensor: SensorTopics) -> DwellList:
    """Read the dwells of a sensor from all its frames.

    Raises:
        UserError: the bag is damaged, or a frame cannot be decoded.
    """
    found = DwellList()
    if sensor.frames in reader.topics and reader.topics[sensor.frames].type_name == FRAME_TYPE:
        for message in reader.messages([sensor.frames]):
            found.add(message.cdr, message.log_time_ns)
    return found


def detectors_by_hash(reader: BagReader, sensor: SensorTopics) -> Mapping[str, int]:
    """Number of detectors by config_hash, of all descriptions of a sensor in the bag.

    Raises:
        UserError: the bag is damaged, or a description cannot be decoded.
    """
    if sensor.sensor_info not in reader.topics:
        return {}
    described = (reader.decode(message.type_name, message.cdr) for message in reader.messages([sensor.sensor_info]))
    return {one.config_hash: len(one.beams.elevation_boresights) for one in described}


def dwell_report(reader: BagReader, sensor: SensorTopics) -> DwellReport:
    """Report the dwells of a sensor that are not whole; reads all its frames.

    Raises:
        UserError: the bag is damaged, or a message cannot be decoded.
    """
    detectors, dwells = detectors_by_hash(reader, sensor), read_dwells(reader, sensor)
    return DwellReport(sensor.frames, len(dwells), faults_of(dwells, detectors))


def faults_of(dwells: Iterable[DwellFrames], detectors: Mapping[str, int]) -> list[DwellFault]:
    """The faults of dwells, given the number of detectors by config_hash."""
    faults = []
    for dwell in dwells:
        count = detectors.get(dwell.config_hash)
        absent = [] if count is None else dwell.absent(count)
        if count is None or absent or dwell.doubled:
            faults.append(DwellFault(dwell.number, dwell.stamp_ns, count is not None, absent, dwell.doubled))
    return faults


def _listed(channels: list[int]) -> str:
    return f"channel{'s' if len(channels) > 1 else ''} {', '.join(map(str, channels))}"
