"""Quality of service: the profiles of rclpy, and the quality of each topic by its content."""

from __future__ import annotations

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy

from sal_height.bag import qos
from sal_height.bag.qos import Qos

INSTRUMENT_QOS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Instruments: a best-effort subscription receives from any publisher."""

TF_STATIC_QOS = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def to_profile(qos: Qos) -> QoSProfile:
    """The profile of rclpy for a quality of service."""
    return QoSProfile(
        history=HistoryPolicy[qos.history.upper()],
        depth=qos.depth,
        reliability=ReliabilityPolicy[qos.reliability.upper()],
        durability=DurabilityPolicy[qos.durability.upper()],
        deadline=Duration(nanoseconds=qos.deadline_ns),
        lifespan=Duration(nanoseconds=qos.lifespan_ns),
        liveliness=LivelinessPolicy[qos.liveliness.upper()],
        liveliness_lease_duration=Duration(nanoseconds=qos.liveliness_lease_ns),
        avoid_ros_namespace_conventions=qos.avoid_ros_namespace_conventions,
    )


def from_profile(profile: QoSProfile) -> Qos:
    """The quality of service that a profile of rclpy states."""
    return Qos(
        history=profile.history.short_key,
        depth=profile.depth,
        reliability=profile.reliability.short_key,
        durability=profile.durability.short_key,
        deadline_ns=profile.deadline.nanoseconds,
        lifespan_ns=profile.lifespan.nanoseconds,
        liveliness=profile.liveliness.short_key,
        liveliness_lease_ns=profile.liveliness_lease_duration.nanoseconds,
        avoid_ros_namespace_conventions=profile.avoid_ros_namespace_conventions,
    )


FRAMES_QOS, ODOMETRY_QOS, LATCHED_QOS = map(to_profile, (qos.FRAMES, qos.ODOMETRY, qos.LATCHED))
"""Phase histories and images, platform states and frames that move with them, and sensor info and the like."""
