"""Kinds of items: conversion of the messages on a port to items of the engine and back.

For every kind of product, an item that is written and read again is equal in every field.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sal_height import topics
from sal_height.engine.adjuster import PlacedMounting
from sal_height.engine.air import AirSample
from sal_height.engine.calibrations import StatedCalibration
from sal_height.engine.frame_items import Frame
from sal_height.engine.frames import USUAL, Frames, PlacedOrigin, StaticTransform
from sal_height.engine.height_items import Heights
from sal_height.engine.image_items import ChannelImage, Images
from sal_height.engine.mapper import PlacedRelief
from sal_height.engine.movers import ImageMovers
from sal_height.engine.navigation import Attitude, Fix, Pose, Twist
from sal_height.engine.stage import Port
from sal_height.geometry import PlatformState
from sal_height.messages import types
from sal_height.messages.basics import header_of, numbers_of, to_ns, to_stamp
from sal_height.messages.codec import SHIPPED, deserialize
from sal_height.messages.frames import frame_to_message, received_frame, state_from_message, state_to_message
from sal_height.messages.navigation import (
    AIR,
    mounting_to_pose,
    origin_to_message,
    read_air,
    read_attitude,
    read_fix,
    read_origin,
    read_pose,
    read_twist,
)
from sal_height.messages.products import (
    heights_of,
    heights_to_message,
    images_to_messages,
    received_image,
    relief_to_message,
)
from sal_height.messages.sensors import (
    calibration_from_message,
    calibration_to_message,
    sensor_from_message,
    sensor_to_message,
)
from sal_height.messages.views import mover_points
from sal_height.sensor import Sensor

Read = Callable[[bytes, Any], Sequence[Any]]
Write = Callable[[Any, Any], Sequence[bytes]]


@dataclass(frozen=True)
class Kind:
    """Functions that read and write the messages on a port.

    Attributes:
        type_name: type of the messages, such as "nav_msgs/msg/Odometry".
        read: function that returns the items of a serialized message, by the settings of the stage that receives them.
            It raises UserError if the message cannot be used, RuntimeError if the bytes are not of its type.
        write: function that returns the serialized messages of an item.
        trouble: name under which messages that cannot be used are counted; empty: the reason of each.
    """

    type_name: str
    read: Read
    write: Write
    trouble: str = ""


def kind_of(port: Port) -> Kind:
    """The kind of the messages on a port."""
    return AIR_KINDS[port.name] if port.kind is AirSample else KINDS[port.kind]


def frames_of(settings: Any) -> Frames:
    """Names and axes of the frames of coordinates that the settings of a stage state."""
    found = getattr(settings, "frames", None)
    return found if isinstance(found, Frames) else Frames(getattr(settings, "map_frame", USUAL.map))


def read_frame(cdr: bytes, _: Any = None) -> list[Frame]:
    """The frame of a ChannelFrame."""
    return [received_frame(cdr)]


def write_frame(frame: Frame, _: Any = None) -> list[bytes]:
    """The serialized ChannelFrame of a frame."""
    return [SHIPPED.serialize(frame_to_message(frame))]


def read_image(cdr: bytes, _: Any = None) -> list[ChannelImage]:
    """The image of a ComplexImage; images of the same bytes of geometry or provenance share these.

    Raises:
        Rejected: its provenance or the covariance of its pose cannot be used.
    """
    return [received_image(cdr)]


def write_images(images: Images, _: Any = None) -> list[bytes]:
    """The serialized ComplexImage of each channel: those of a dwell differ in few fields."""
    return [SHIPPED.serialize(image, shared=True) for image in images_to_messages(images)]


def read_heights(cdr: bytes, _: Any = None) -> list[Heights]:
    """The heights of a HeightImage.

    Raises:
        Rejected: its provenance or the covariance of its pose cannot be used.
    """
    return [heights_of(deserialize(cdr, "sal_height_msgs/msg/HeightImage", shared=True))]


def write_heights(heights: Heights, _: Any = None) -> list[bytes]:
    """The serialized HeightImage of heights."""
    return [SHIPPED.serialize(heights_to_message(heights), shared=True)]


def read_transforms(cdr: bytes, _: Any = None) -> list[StaticTransform]:
    """The transforms of a TFMessage."""
    return [
        StaticTransform(
            one.header.frame_id,
            one.child_frame_id,
            np.array(numbers_of(one.transform.translation)),
            np.array((*numbers_of(one.transform.rotation), one.transform.rotation.w)),
        )
        for one in deserialize(cdr, "tf2_msgs/msg/TFMessage").transforms
    ]


def _kind(
    message_class: Any,
    item_of: Callable[[Any, Any], Any] | None = None,
    message_of: Callable[[Any, Any], Any] | None = None,
    trouble: str = "",
) -> Kind:
    """A kind of which each message has one item.

    Args:
        message_class: class of the messages.
        item_of: function from message and settings to the item; None: no stage takes the messages.
        message_of: function from item and settings to the message; None: no stage makes the items.
        trouble: name as of `Kind`.
    """

    def read(cdr: bytes, settings: Any = None) -> list[Any]:
        if item_of is None:
            raise NotImplementedError("no stage takes these messages")
        return [item_of(deserialize(cdr, message_class), settings)]

    def write(item: Any, settings: Any = None) -> list[bytes]:
        if message_of is None:
            raise NotImplementedError("no stage makes these messages")
        return [SHIPPED.serialize(message_of(item, settings))]

    return Kind(message_class.__msgtype__, read, write, trouble)


def _stated_calibration(message: types.Calibration, _: Any) -> StatedCalibration:
    stamp_ns = to_ns(message.header.stamp)
    return StatedCalibration(calibration_from_message(message), stamp_ns, tuple(message.undetermined))


def _calibration_message(stated: StatedCalibration, _: Any) -> types.Calibration:
    return calibration_to_message(stated.calibration, to_stamp(stated.stamp_ns), stated.undetermined)


def _placed_origin(message: types.NavSatFix, settings: Any) -> PlacedOrigin:
    map_frame = frames_of(settings).map
    return PlacedOrigin(read_origin(message, map_frame), to_ns(message.header.stamp), map_frame)


def _origin_message(placed: PlacedOrigin, _: Any) -> types.NavSatFix:
    return origin_to_message(placed.origin, to_stamp(placed.stamp_ns), placed.map_frame)


def _movers_message(found: ImageMovers, _: Any) -> types.PointCloud2:
    return mover_points(found.looked.movers, header_of(found.key.stamp_ns, found.frame_id))


def _mounting_message(placed: PlacedMounting, _: Any) -> types.PoseWithCovarianceStamped:
    return mounting_to_pose(placed.mounting, placed.covariance, to_stamp(placed.stamp_ns), placed.body_frame)


KINDS: Mapping[type, Kind] = {
    Sensor: _kind(
        types.SensorInfo,
        lambda message, _: sensor_from_message(message),
        lambda sensor, _: sensor_to_message(sensor, types.Time()),
        "sensor info",
    ),
    Frame: Kind(types.ChannelFrame.__msgtype__, read_frame, write_frame),
    Images: Kind(types.ComplexImage.__msgtype__, read_image, write_images),
    Heights: Kind(types.HeightImage.__msgtype__, read_heights, write_heights),
    StatedCalibration: _kind(types.Calibration, _stated_calibration, _calibration_message, topics.CALIBRATION),
    PlatformState: _kind(
        types.Odometry,
        lambda message, settings: state_from_message(message, frames_of(settings)),
        lambda state, settings: state_to_message(state, to_stamp(state.stamp_ns), frames_of(settings)),
        "odometry",
    ),
    StaticTransform: Kind(types.TFMessage.__msgtype__, read_transforms, _kind(types.TFMessage).write, "transform"),
    PlacedOrigin: _kind(types.NavSatFix, _placed_origin, _origin_message),
    Pose: _kind(types.PoseStamped, lambda message, settings: Pose(*read_pose(message, frames_of(settings)))),
    Fix: _kind(types.NavSatFix, lambda message, settings: Fix(read_fix(message, settings.origin, settings.altitudes))),
    Attitude: _kind(types.Imu, lambda message, settings: Attitude(read_attitude(message, frames_of(settings)))),
    Twist: _kind(types.TwistStamped, lambda message, settings: Twist(*read_twist(message, frames_of(settings)))),
    PlacedRelief: _kind(types.ReliefMap, message_of=lambda placed, _: relief_to_message(placed)),
    ImageMovers: _kind(types.PointCloud2, message_of=_movers_message),
    PlacedMounting: _kind(types.PoseWithCovarianceStamped, message_of=_mounting_message),
}
"""Kinds by the class of their items."""


def _air(port: str) -> Kind:
    return _kind(AIR[port].message_type, lambda message, _: read_air(port, message), trouble="air")


AIR_KINDS: Mapping[str, Kind] = {port: _air(port) for port in AIR}
"""Kinds of measurements of the air, by their port."""

OF_TOPICS: Mapping[str, Kind] = {
    topics.SENSOR_INFO: KINDS[Sensor],
    topics.PHASE_HISTORY: KINDS[Frame],
    topics.SLC: KINDS[Images],
    topics.ODOMETRY: KINDS[PlatformState],
    topics.CALIBRATION: KINDS[StatedCalibration],
    topics.MAP_ORIGIN: KINDS[PlacedOrigin],
    "/tf_static": KINDS[StaticTransform],
    **AIR_KINDS,
}
"""Kinds by the topics of a flight."""


def kind_of_topic(topic: str) -> Kind:
    """The kind of the messages on a topic of a flight.

    Args:
        topic: name of the topic without namespace; one of OF_TOPICS, or one that ends in /height.
    """
    return KINDS[Heights] if topic.endswith("/height") else OF_TOPICS[topic]
