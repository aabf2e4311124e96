"""Content of a bag that describes its flight: sensors and their topics, parameter events, and the origin of the map."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass

from sal_height import messages
from sal_height.bag.reader import BagReader
from sal_height.bag.topics import FIX_TYPE, FRAME_TYPE, SENSOR_TYPE, Topic
from sal_height.engine.dwells import CONTRADICTION
from sal_height.errors import UserError
from sal_height.geometry import Origin
from sal_height.messages.types import ParameterEvent
from sal_height.sensor import Sensor
from sal_height.topics import MAP_ORIGIN, ODOMETRY, PHASE_HISTORY, SENSOR_INFO, SLC

FRAMES, IMAGES = PHASE_HISTORY, SLC
"""Topics with the samples of dwells, and with their images."""


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


PARAMETER_EVENTS, PARAMETER_EVENT_TYPE = "/parameter_events", "rcl_interfaces/msg/ParameterEvent"


def after(known: ParameterEvent | None, event: ParameterEvent) -> ParameterEvent:
    """All parameters of a node after an event, as an event of new parameters; `known`: the parameters before."""
    values = {parameter.name: parameter for parameter in (known.new_parameters if known else ())}
    values |= {parameter.name: parameter for parameter in (*event.new_parameters, *event.changed_parameters)}
    for parameter in event.deleted_parameters:
        values.pop(parameter.name, None)
    return ParameterEvent(node=event.node, stamp=event.stamp, new_parameters=list(values.values()))


_LOG = logging.getLogger(__name__)


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
