"""What is read of the messages of instruments: PoseStamped, TwistStamped, NavSatFix and Imu.

Each function checks what it reads; all raise Rejected if a frame is another one than stated, a value is not finite, or
a quaternion has not the norm 1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from geometry_msgs.msg import PoseStamped, Quaternion, TwistStamped
from sensor_msgs.msg import Imu, NavSatFix

from sal_height.errors import Rejected
from sal_height.geometry import Origin, Sample
from sal_height.messages.basics import check_finite, check_rotation, to_ns, vector_of
from sal_height.numeric import F64

FARTHEST_FROM_ORIGIN = 200_000.0
"""Greatest distance of a platform from the origin of its map, m."""

UNKNOWN = np.zeros((3, 3))


def read_pose(message: PoseStamped, map_frame: str) -> tuple[Sample, Sample]:
    """Position and attitude of the body in `map_frame`."""
    _check_frame("Pose", message.header.frame_id, (map_frame,))
    stamp_ns, position = to_ns(message.header.stamp), vector_of(message.pose.position)
    check_finite(position, "Pose")
    return Sample(stamp_ns, position, UNKNOWN), Sample(stamp_ns, _attitude("Pose", message.pose.orientation), UNKNOWN)


def read_twist(message: TwistStamped, map_frame: str, body_frame: str) -> tuple[Sample, bool]:
    """Velocity, and whether it is in the axes of the body."""
    _check_frame("Twist", message.header.frame_id, (map_frame, body_frame))
    velocity = vector_of(message.twist.linear)
    check_finite(velocity, "Twist")
    return Sample(to_ns(message.header.stamp), velocity, UNKNOWN), message.header.frame_id == body_frame


def read_fix(message: NavSatFix, origin: Origin) -> Sample:
    """Position in a map with this origin.

    Raises:
        Rejected: also if there is no fix, or it is far from the origin.
    """
    if message.status.status < 0:
        raise Rejected("no satellite fix", "NavSatFix says that it has no fix (status.status < 0).")
    check_finite((message.latitude, message.longitude, message.altitude), "NavSatFix")
    if abs(message.latitude) > 90:
        raise Rejected("no satellite fix", f"NavSatFix has latitude {message.latitude:g}; it must be from -90 to 90.")
    position = origin.to_map(math.radians(message.latitude), math.radians(message.longitude), message.altitude)
    if (distance := math.hypot(*position)) > FARTHEST_FROM_ORIGIN:
        raise Rejected(
            "far from the origin",
            f"NavSatFix is {distance / 1e3:.0f} km from the origin of map, {FARTHEST_FROM_ORIGIN / 1e3:.0f} are "
            "allowed; set origin_latitude_deg, origin_longitude_deg and origin_height_m to a place in the scene.",
        )
    known = message.position_covariance_type != NavSatFix.COVARIANCE_TYPE_UNKNOWN
    covariance = _covariance("NavSatFix", message.position_covariance) if known else UNKNOWN
    return Sample(to_ns(message.header.stamp), position, covariance)


def read_attitude(message: Imu, body_frame: str) -> Sample:
    """Attitude of the body against east, north and up where it is (REP 145)."""
    _check_frame("Imu", message.header.frame_id, (body_frame,))
    if message.orientation_covariance[0] < 0:
        raise Rejected("no attitude", "Imu says that it has no orientation (orientation_covariance[0] < 0).")
    attitude, covariance = _attitude("Imu", message.orientation), _covariance("Imu", message.orientation_covariance)
    return Sample(to_ns(message.header.stamp), attitude, covariance)


def _attitude(what: str, orientation: Quaternion) -> F64:
    quaternion = orientation.x, orientation.y, orientation.z, orientation.w
    check_rotation(quaternion, what)
    return np.array(quaternion) / math.hypot(*quaternion)


def _covariance(what: str, numbers: Sequence[float]) -> F64:
    check_finite(numbers, what)
    return np.array(numbers, dtype=np.float64).reshape(3, 3)


def _check_frame(what: str, frame: str, allowed: tuple[str, ...]) -> None:
    if frame not in allowed:
        names = " or ".join(repr(name) for name in allowed)
        raise Rejected(
            "wrong frames",
            f"{what} has frame_id {frame!r}; it must be {names}. Parameters map_frame and body_frame set these names.",
        )
