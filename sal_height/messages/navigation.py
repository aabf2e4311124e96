"""Conversion of the messages of instruments (PoseStamped, TwistStamped, NavSatFix, Imu, air), mountings and origins.

Each function that reads a message checks it. All but `read_air` raise Rejected if a frame is another one than stated, a
value is not finite, or a quaternion has not the norm 1. A covariance that is not finite is not stated.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from sal_height.engine.air import AirSample
from sal_height.engine.frames import Frames
from sal_height.errors import Rejected
from sal_height.geometry import Altitudes, Mounting, Origin, Sample
from sal_height.imaging import CorrectionSettings
from sal_height.messages.basics import check_finite, check_rotation, to_ns, vector_of
from sal_height.messages.types import (
    FluidPressure,
    Header,
    Imu,
    NavSatFix,
    Point,
    PoseStamped,
    PoseWithCovarianceStamped,
    Quaternion,
    RelativeHumidity,
    Temperature,
    Time,
    TwistStamped,
)
from sal_height.numeric import F64
from sal_height.settings import settings_of

FARTHEST_FROM_ORIGIN = 200_000.0
"""Greatest distance of a platform from the origin of its map, m."""

LOWEST_ORIGIN, HIGHEST_ORIGIN = -1000.0, 10_000.0
"""Heights above the ellipsoid that the origin of a map may have, m."""

UNKNOWN = np.zeros((3, 3))
"""Covariance that is not stated."""


def read_pose(message: PoseStamped, frames: Frames) -> tuple[Sample, Sample]:
    """Position and attitude of the body in map, in the axes of ROS."""
    _check_frame("Pose", message.header.frame_id, (frames.map,))
    stamp_ns, position = to_ns(message.header.stamp), vector_of(message.pose.position)
    check_finite(position, "Pose")
    attitude = frames.axes.attitude(_attitude("Pose", message.pose.orientation))
    return Sample(stamp_ns, frames.axes.vector(position), UNKNOWN), Sample(stamp_ns, attitude, UNKNOWN)


def read_twist(message: TwistStamped, frames: Frames) -> tuple[Sample, bool]:
    """Velocity in the axes of ROS, and True if they are those of the body, False if those of map."""
    _check_frame("Twist", message.header.frame_id, (frames.map, frames.body))
    velocity = vector_of(message.twist.linear)
    check_finite(velocity, "Twist")
    in_body = message.header.frame_id == frames.body
    velocity = frames.axes.body_vector(velocity) if in_body else frames.axes.vector(velocity)
    return Sample(to_ns(message.header.stamp), velocity, UNKNOWN), in_body


def mounting_to_pose(mounting: Mounting, covariance: F64, stamp: Time, body_frame: str) -> PoseWithCovarianceStamped:
    """The pose of the sensor in the axes of the platform.

    Args:
        mounting: mounting of the sensor.
        covariance: covariance of its lever arm (m^2) and rotation (rad^2) in the axes of base_link, shape (6, 6).
        stamp: stamp of the dwell with which it was estimated.
        body_frame: name of the platform's frame.
    """
    message = PoseWithCovarianceStamped(header=Header(stamp=stamp, frame_id=body_frame))
    message.pose.pose.position = Point(**dict(zip("xyz", mounting.lever_arm, strict=True)))
    message.pose.pose.orientation = Quaternion(**dict(zip("xyzw", mounting.rotation, strict=True)))
    message.pose.covariance = covariance.ravel()
    return message


def origin_to_message(origin: Origin, stamp: Time, map_frame: str) -> NavSatFix:
    """The message with the position of the map frame's origin on the earth."""
    return NavSatFix(
        header=Header(stamp=stamp, frame_id=map_frame),
        latitude=math.degrees(origin.latitude),
        longitude=math.degrees(origin.longitude),
        altitude=origin.height,
    )


def read_origin(message: NavSatFix, map_frame: str) -> Origin:
    """Origin of the map frame; its altitude is that above the ellipsoid.

    Raises:
        Rejected: also if the position is impossible, or that of an empty message.
    """
    _check_frame("The origin", message.header.frame_id, (map_frame,))
    check_finite((message.latitude, message.longitude, message.altitude), "The origin")
    if abs(message.latitude) > 90 or abs(message.longitude) > 360:
        raise Rejected(
            "wrong origin",
            f"The origin of {map_frame} has latitude {message.latitude:g} and longitude {message.longitude:g}; they "
            "must be from -90 to 90 and from -180 to 180 degrees.",
        )
    if not (message.latitude or message.longitude):
        raise Rejected(
            "wrong origin",
            f"The origin of {map_frame} has latitude and longitude 0, a place at sea that stands for one nobody has "
            "filled in; give the place of the scene.",
        )
    if not LOWEST_ORIGIN <= message.altitude <= HIGHEST_ORIGIN:
        raise Rejected(
            "wrong origin",
            f"The origin of {map_frame} is {message.altitude:g} m above the ellipsoid; allowed are {LOWEST_ORIGIN:g} "
            f"to {HIGHEST_ORIGIN:g} m, the heights of ground.",
        )
    return Origin(math.radians(message.latitude), math.radians(message.longitude), message.altitude)


def read_fix(message: NavSatFix, origin: Origin, altitudes: Altitudes) -> Sample:
    """Position in a map with this origin, of altitudes above a level.

    Raises:
        Rejected: also if there is no fix, or it is far from the origin.
    """
    if message.status.status < 0:
        raise Rejected("no satellite fix", "NavSatFix says that it has no fix (status.status < 0).")
    check_finite((message.latitude, message.longitude, message.altitude), "NavSatFix")
    if abs(message.latitude) > 90:
        raise Rejected("no satellite fix", f"NavSatFix has latitude {message.latitude:g}; it must be from -90 to 90.")
    height = message.altitude + altitudes.offset_m
    position = origin.to_map(math.radians(message.latitude), math.radians(message.longitude), height)
    if (distance := math.hypot(*position)) > FARTHEST_FROM_ORIGIN:
        raise Rejected(
            "far from the origin",
            f"NavSatFix is {distance / 1e3:.0f} km from the origin of map, {FARTHEST_FROM_ORIGIN / 1e3:.0f} are "
            "allowed; set origin_latitude_deg, origin_longitude_deg and origin_height_m to a position in the scene.",
        )
    known = message.position_covariance_type != NavSatFix.COVARIANCE_TYPE_UNKNOWN
    covariance = _covariance(message.position_covariance) if known else UNKNOWN
    return Sample(to_ns(message.header.stamp), position, altitudes.added_to(covariance))


def read_attitude(message: Imu, frames: Frames) -> Sample:
    """Attitude of the body against local east, north and up (REP 145), or against local north, east and down."""
    _check_frame("Imu", message.header.frame_id, (frames.body,))
    if message.orientation_covariance[0] < 0:
        raise Rejected("no attitude", "Imu says that it has no orientation (orientation_covariance[0] < 0).")
    attitude, covariance = _attitude("Imu", message.orientation), _covariance(message.orientation_covariance)
    stamp_ns = to_ns(message.header.stamp)
    return Sample(stamp_ns, frames.axes.attitude(attitude), frames.axes.covariance(covariance))


def _attitude(what: str, orientation: Quaternion) -> F64:
    quaternion = orientation.x, orientation.y, orientation.z, orientation.w
    check_rotation(quaternion, what)
    return np.array(quaternion) / math.hypot(*quaternion)


def _covariance(numbers: Sequence[float]) -> F64:
    """The covariance that is stated; UNKNOWN if it is not finite."""
    covariance = np.array(numbers, dtype=np.float64).reshape(3, 3)
    return covariance if np.all(np.isfinite(covariance)) else UNKNOWN


def _check_frame(what: str, frame: str, allowed: tuple[str, ...]) -> None:
    if frame not in allowed:
        names = " or ".join(repr(name) for name in allowed)
        raise Rejected(
            "wrong frames",
            f"{what} has frame_id {frame!r}; it must be {names}. Parameters map_frame and body_frame set these names.",
        )


class AirQuantity(NamedTuple):
    """A quantity of the air, as messages and parameters have it.

    Attributes:
        message_type: class of its messages.
        field: name of the field of the message.
        unit: unit of the field, after a space; empty: none.
        parameter: name of the parameter of the same quantity.
        offset: number to add to the field for the unit of the parameter.
    """

    message_type: type[Any]
    field: str
    unit: str
    parameter: str
    offset: float = 0.0

    @property
    def type_name(self) -> str:
        """Name of the type of its messages."""
        return str(self.message_type.__msgtype__)


AIR: Mapping[str, AirQuantity] = {
    "air/pressure": AirQuantity(FluidPressure, "fluid_pressure", " Pa", "air_pressure_pa"),
    "air/temperature": AirQuantity(Temperature, "temperature", " degrees Celsius", "air_temperature_k", 273.15),
    "air/humidity": AirQuantity(RelativeHumidity, "relative_humidity", "", "air_humidity"),
}
"""The quantities by their topic."""

AIR_TYPES = {quantity.type_name for quantity in AIR.values()}


def air_to_messages(values: Mapping[str, float], stamp: Time) -> dict[str, Any]:
    """Messages on the air, by topic.

    Args:
        values: values of all quantities, by the names of their parameters.
        stamp: time of the measurement.
    """
    return {
        topic: one.message_type(header=Header(stamp=stamp), **{one.field: values[one.parameter] - one.offset})
        for topic, one in AIR.items()
    }


def read_air(topic: str, message: Any) -> AirSample:
    """A measurement of the quantity that is published on a topic of `AIR`.

    Raises:
        Rejected: the value is not one that the parameter of the quantity allows.
    """
    quantity = AIR[topic]
    value, limits = float(getattr(message, quantity.field)), settings_of(CorrectionSettings)[quantity.parameter]
    low, high = (float(limit or 0.0) - quantity.offset for limit in (limits.minimum, limits.maximum))
    if not low <= value <= high:
        raise Rejected(
            "wrong air",
            f"{quantity.message_type.__name__} on {topic} has {quantity.field} {value:g}; it must be from {low:g} to "
            f"{high:g}{quantity.unit}.",
        )
    return AirSample(to_ns(message.header.stamp), value + quantity.offset)
