"""Descriptions of the flight in a bag: its sensors, and the position of the map's origin on the earth."""

from __future__ import annotations

import logging

from sal_height import messages
from sal_height.bag.reader import BagReader
from sal_height.bag.topics import FIX_TYPE
from sal_height.engine.dwells import CONTRADICTION
from sal_height.errors import UserError
from sal_height.geometry import Origin
from sal_height.sensor import Sensor
from sal_height.topics import MAP_ORIGIN, SENSOR_INFO

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
