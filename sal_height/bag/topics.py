"""Topics and messages of a bag, in any storage."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import NamedTuple

from sal_height.bag.qos import Qos
from sal_height.messages.definition import Definition

FRAME_TYPE, IMAGE_TYPE, HEIGHT_TYPE, SENSOR_TYPE, CALIBRATION_TYPE, RELIEF_TYPE = (
    f"sal_height_msgs/msg/{name}"
    for name in ("ChannelFrame", "ComplexImage", "HeightImage", "SensorInfo", "Calibration", "ReliefMap")
)
ODOMETRY_TYPE = "nav_msgs/msg/Odometry"
FIX_TYPE = "sensor_msgs/msg/NavSatFix"


@dataclass(frozen=True)
class Topic:
    """A topic of a bag.

    count: number of messages. offered_qos: profile of every publisher at the time of recording, as far as known.
    definition: text and hash of the type as recorded, which may be older than the installed one.
    is_old: True if the type is of an older version of sal_height_msgs, which `type_name` and messages() make current.
    recorded_type: name of the type as recorded.
    """

    name: str
    type_name: str
    count: int
    offered_qos: tuple[Qos, ...]
    definition: Definition
    is_old: bool = False
    recorded_type: str = ""


class BagMessage(NamedTuple):
    """A serialized message and the times it was received and published, in nanoseconds."""

    topic: str
    type_name: str
    cdr: bytes
    log_time_ns: int
    publish_time_ns: int


STAMP = struct.Struct("<iI")
STAMP_AT = 4
"""Position of the stamp in a serialized message whose first field is a header: after the four bytes that name the
encoding (CDR, OMG DDS-XTypes 1.3, section 7.4.3; little endian in all ROS middlewares in use)."""


def stamp_ns_of(cdr: bytes) -> int:
    """The stamp of a serialized message whose first field is a header, ns."""
    seconds, nanoseconds = STAMP.unpack_from(cdr, STAMP_AT)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)
