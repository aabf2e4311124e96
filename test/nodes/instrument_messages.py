"""Messages as the instruments of a platform publish them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sal_height import messages
from sal_height.geometry import PlatformState, quaternion_of, rotation_matrix
from sal_height.messages.types import (
    Header,
    Imu,
    NavSatFix,
    NavSatStatus,
    Point,
    Pose,
    PoseStamped,
    Quaternion,
    Twist,
    TwistStamped,
    Vector3,
)


def in_aviation_axes(state: PlatformState) -> PlatformState:
    """The same state in north, east, down and forward, right, down, by the words."""
    ned, frd = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1.0]]), np.diag([1.0, -1.0, -1.0])
    attitude = np.array(quaternion_of(ned @ rotation_matrix(state.orientation) @ frd))
    return replace(state, position=ned @ state.position, velocity=ned @ state.velocity, orientation=attitude)


def pose_of(state: PlatformState, frame: str = "map") -> PoseStamped:
    orientation = Quaternion(**dict(zip("xyzw", state.orientation.tolist(), strict=True)))
    pose = Pose(position=Point(**dict(zip("xyz", state.position.tolist(), strict=True))), orientation=orientation)
    return PoseStamped(header=Header(stamp=messages.to_stamp(state.stamp_ns), frame_id=frame), pose=pose)


def twist_of(state: PlatformState, frame: str) -> TwistStamped:
    velocity = state.velocity if frame == "map" else rotation_matrix(state.orientation).T @ state.velocity
    twist = Twist(linear=Vector3(**dict(zip("xyz", velocity.tolist(), strict=True))))
    return TwistStamped(header=Header(stamp=messages.to_stamp(state.stamp_ns), frame_id=frame), twist=twist)


def fix_at(seconds: float, latitude_deg: float, longitude_deg: float = 11.3, status: int = 0) -> NavSatFix:
    stamp = messages.to_stamp(1_000_000_000_000 + round(seconds * 1e9))
    fix = NavSatFix(header=Header(stamp=stamp), latitude=latitude_deg, longitude=longitude_deg, altitude=3000.0)
    fix.status = NavSatStatus(status=status)
    fix.position_covariance_type = NavSatFix.COVARIANCE_TYPE_DIAGONAL_KNOWN
    fix.position_covariance = np.diag([1.0, 2.0, 9.0]).ravel()
    return fix


def imu_at(seconds: float, frame: str = "base_link", **orientation: float) -> Imu:
    stamp = messages.to_stamp(1_000_000_000_000 + round(seconds * 1e9))
    return Imu(header=Header(stamp=stamp, frame_id=frame), orientation=Quaternion(**{"w": 1.0, **orientation}))
