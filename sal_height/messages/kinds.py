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
from sal_height.engine.frames import USUAL, Frames, PlacedOrigin
from sal_height.engine.height_items import Heights
from sal_height.engine.image_items import ChannelImage, Images
from sal_height.engine.mapper import PlacedRelief
from sal_height.engine.movers import ImageMovers
from sal_height.engine.navigation import Attitude, Fix, Pose, Twist
from sal_height.engine.stage import Port
from sal_height.engine.static_frames import StaticTransform
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
    image_to_message,
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


# Frames, images and heights


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
    return [SHIPPED.serialize(image_to_message(image), shared=True) for image in images.channels()]


def read_heights(cdr: bytes, _: Any = None) -> list[Heights]:
    """The heights of a HeightImage.

    Raises:
        Rejected: its provenance or the covariance of its pose cannot be used.
    """
    return [heights_of(deserialize(cdr, "sal_height_msgs/msg/HeightImage", shared=True))]


def write_heights(heights: Heights, _: Any = None) -> list[bytes]:
    """The serialized HeightImage of heights."""
    return [SHIPPED.serialize(heights_to_message(heights), shared=True)]


# Other items than those of dwells


def read_sensor(cdr: bytes, _: Any = None) -> list[Sensor]:
    """The sensor of a SensorInfo; UserError if it cannot be used."""
    return [sensor_from_message(deserialize(cdr, "sal_height_msgs/msg/SensorInfo"))]


def write_sensor(sensor: Sensor, _: Any = None) -> list[bytes]:
    """The serialized SensorInfo of a sensor, without a stamp."""
    return [SHIPPED.serialize(sensor_to_message(sensor, types.Time()))]


def read_calibration(cdr: bytes, _: Any = None) -> list[StatedCalibration]:
    """The calibration of a Calibration; UserError if it cannot be used."""
    message = deserialize(cdr, "sal_height_msgs/msg/Calibration")
    calibration = calibration_from_message(message)
    return [StatedCalibration(calibration, to_ns(message.header.stamp), tuple(message.undetermined))]


def write_calibration(stated: StatedCalibration, _: Any = None) -> list[bytes]:
    """The serialized Calibration."""
    message = calibration_to_message(stated.calibration, to_stamp(stated.stamp_ns), stated.undetermined)
    return [SHIPPED.serialize(message)]


def read_state(cdr: bytes, settings: Any) -> list[PlatformState]:
    """The platform state of an Odometry; Rejected if it cannot be used."""
    return [state_from_message(deserialize(cdr, "nav_msgs/msg/Odometry"), frames_of(settings))]


def write_state(state: PlatformState, settings: Any) -> list[bytes]:
    """The serialized Odometry of a platform state."""
    return [SHIPPED.serialize(state_to_message(state, to_stamp(state.stamp_ns), frames_of(settings)))]


def read_transforms(cdr: bytes, _: Any = None) -> list[StaticTransform]:
    """The transforms of a TFMessage."""
    message = deserialize(cdr, "tf2_msgs/msg/TFMessage")
    return [
        StaticTransform(
            one.header.frame_id,
            one.child_frame_id,
            np.array(numbers_of(one.transform.translation)),
            np.array((*numbers_of(one.transform.rotation), one.transform.rotation.w)),
        )
        for one in message.transforms
    ]


def read_placed_origin(cdr: bytes, settings: Any) -> list[PlacedOrigin]:
    """The origin of a NavSatFix; Rejected if it cannot be used."""
    message = deserialize(cdr, "sensor_msgs/msg/NavSatFix")
    map_frame = frames_of(settings).map
    return [PlacedOrigin(read_origin(message, map_frame), to_ns(message.header.stamp), map_frame)]


def write_placed_origin(placed: PlacedOrigin, _: Any = None) -> list[bytes]:
    """The serialized NavSatFix of an origin."""
    return [SHIPPED.serialize(origin_to_message(placed.origin, to_stamp(placed.stamp_ns), placed.map_frame))]


def read_pose_sample(cdr: bytes, settings: Any) -> list[Pose]:
    """Position and attitude of a PoseStamped; Rejected if it cannot be used."""
    return [Pose(*read_pose(deserialize(cdr, "geometry_msgs/msg/PoseStamped"), frames_of(settings)))]


def read_fix_sample(cdr: bytes, settings: Any) -> list[Fix]:
    """Position of a NavSatFix; Rejected if it cannot be used."""
    return [Fix(read_fix(deserialize(cdr, "sensor_msgs/msg/NavSatFix"), settings.origin))]


def read_attitude_sample(cdr: bytes, settings: Any) -> list[Attitude]:
    """Attitude of an Imu; Rejected if it cannot be used."""
    return [Attitude(read_attitude(deserialize(cdr, "sensor_msgs/msg/Imu"), frames_of(settings)))]


def read_twist_sample(cdr: bytes, settings: Any) -> list[Twist]:
    """Velocity of a TwistStamped; Rejected if it cannot be used."""
    return [Twist(*read_twist(deserialize(cdr, "geometry_msgs/msg/TwistStamped"), frames_of(settings)))]


def write_relief(placed: PlacedRelief, _: Any = None) -> list[bytes]:
    """The serialized ReliefMap of a map."""
    return [SHIPPED.serialize(relief_to_message(placed))]


def write_movers(found: ImageMovers, _: Any = None) -> list[bytes]:
    """The serialized PointCloud2 of the movers in a dwell."""
    return [SHIPPED.serialize(mover_points(found.looked.movers, header_of(found.key.stamp_ns, found.frame_id)))]


def write_mounting(placed: PlacedMounting, _: Any = None) -> list[bytes]:
    """The serialized PoseWithCovarianceStamped of a mounting."""
    message = mounting_to_pose(placed.mounting, placed.covariance, to_stamp(placed.stamp_ns), placed.body_frame)
    return [SHIPPED.serialize(message)]


def _air_reader(port: str) -> Read:
    def read(cdr: bytes, _: Any = None) -> list[AirSample]:
        return [read_air(port, deserialize(cdr, AIR[port].type_name))]

    return read


def _nothing_reads(_cdr: bytes, _: Any = None) -> list[Any]:
    raise NotImplementedError("no stage takes these messages")


def _nothing_writes(_item: Any, _: Any = None) -> list[bytes]:
    raise NotImplementedError("no stage makes these messages")


KINDS: Mapping[type, Kind] = {
    Sensor: Kind("sal_height_msgs/msg/SensorInfo", read_sensor, write_sensor, "sensor info"),
    Frame: Kind("sal_height_msgs/msg/ChannelFrame", read_frame, write_frame),
    Images: Kind("sal_height_msgs/msg/ComplexImage", read_image, write_images),
    Heights: Kind("sal_height_msgs/msg/HeightImage", read_heights, write_heights),
    StatedCalibration: Kind("sal_height_msgs/msg/Calibration", read_calibration, write_calibration, topics.CALIBRATION),
    PlatformState: Kind("nav_msgs/msg/Odometry", read_state, write_state, "odometry"),
    StaticTransform: Kind("tf2_msgs/msg/TFMessage", read_transforms, _nothing_writes, "transform"),
    PlacedOrigin: Kind("sensor_msgs/msg/NavSatFix", read_placed_origin, write_placed_origin),
    Pose: Kind("geometry_msgs/msg/PoseStamped", read_pose_sample, _nothing_writes),
    Fix: Kind("sensor_msgs/msg/NavSatFix", read_fix_sample, _nothing_writes),
    Attitude: Kind("sensor_msgs/msg/Imu", read_attitude_sample, _nothing_writes),
    Twist: Kind("geometry_msgs/msg/TwistStamped", read_twist_sample, _nothing_writes),
    PlacedRelief: Kind("sal_height_msgs/msg/ReliefMap", _nothing_reads, write_relief),
    ImageMovers: Kind("sensor_msgs/msg/PointCloud2", _nothing_reads, write_movers),
    PlacedMounting: Kind("geometry_msgs/msg/PoseWithCovarianceStamped", _nothing_reads, write_mounting),
}
"""Kinds by the class of their items."""

AIR_KINDS: Mapping[str, Kind] = {
    port: Kind(quantity.type_name, _air_reader(port), _nothing_writes, "air") for port, quantity in AIR.items()
}
"""Kinds of measurements of the air, by their port."""

OF_TOPICS: Mapping[str, Kind] = {
    topics.SENSOR_INFO: KINDS[Sensor],
    topics.PHASE_HISTORY: KINDS[Frame],
    topics.SLC: KINDS[Images],
    topics.ODOMETRY: KINDS[PlatformState],
    topics.CALIBRATION: KINDS[StatedCalibration],
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
