"""Frames of the platform and of its sensor for /tf and /tf_static (REP 105), from the messages that state them."""

from __future__ import annotations

from sal_height.engine.frames import BODY_FRAME
from sal_height.messages.types import (
    Header,
    Odometry,
    Point,
    SensorInfo,
    TFMessage,
    Transform,
    TransformStamped,
    Vector3,
)


def platform_transform(odometry: Odometry) -> TFMessage:
    """The platform in the map, as odometry states it: usually base_link in map."""
    pose = odometry.pose.pose
    place = Transform(translation=_vector(pose.position), rotation=pose.orientation)
    return TFMessage(
        transforms=[TransformStamped(header=odometry.header, child_frame_id=odometry.child_frame_id, transform=place)]
    )


def sensor_transform(info: SensorInfo) -> TFMessage:
    """The sensor on the platform (base_link), as its description states its mounting; empty if it has no frame."""
    mounting = info.mounting
    if mounting.frame_id in {"", BODY_FRAME}:
        return TFMessage()
    header = Header(stamp=info.header.stamp, frame_id=BODY_FRAME)
    place = Transform(translation=mounting.lever_arm, rotation=mounting.rotation)
    return TFMessage(transforms=[TransformStamped(header=header, child_frame_id=mounting.frame_id, transform=place)])


def _vector(point: Point) -> Vector3:
    return Vector3(x=point.x, y=point.y, z=point.z)
