"""Node navigation: makes platform/odometry of positions, velocities and attitudes that come on topics of their own."""

from __future__ import annotations

import functools
from typing import Any, ClassVar

from rclpy.qos import QoSProfile, ReliabilityPolicy

from sal_height import messages
from sal_height.bag.sensor_topics import MAP_ORIGIN
from sal_height.errors import UserError
from sal_height.geometry import Navigation, Origin
from sal_height.messages.types import Imu, NavSatFix, Odometry, PoseStamped, TwistStamped
from sal_height.nodes.parameters import FrameParameters, OriginParameters
from sal_height.nodes.program import run_node
from sal_height.nodes.role import Topics
from sal_height.nodes.stage import LATCHED_QOS, ODOMETRY_QOS, ORIGIN, Stage, StageParameters
from sal_height.settings import setting

INSTRUMENT_QOS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Instruments: a best-effort subscription receives from any publisher."""


class Parameters(FrameParameters, OriginParameters, StageParameters):
    """Parameters of the node."""

    position: str = setting(
        "pose",
        "where position and attitude come from: pose is topic platform/pose; fix is the position on platform/fix and "
        "the attitude on platform/imu",
        choices=("pose", "fix"),
        read_only=True,
    )
    velocity: str = setting(
        "twist",
        "where the velocity comes from: twist is topic platform/twist, positions are differences of positions",
        choices=("twist", "positions"),
        read_only=True,
    )
    longest_gap_s: float = setting(
        0.5,
        "longest time between two samples of a topic",
        unit="s",
        minimum=1e-3,
        maximum=60.0,
        read_only=True,
    )


class NavigationNode(Stage):
    """Merges what instruments of the platform measure into its odometry, one sample for each attitude.

    An attitude waits for the next position and velocity, so that odometry comes that much later. Odometry is in the
    axes of ROS, whatever those of the instruments are. Where the origin of map is known, it is published too.
    """

    parameters = Parameters
    inputs: ClassVar[Topics] = {
        "platform/pose": "position and attitude, geometry_msgs/PoseStamped (position: pose)",
        "platform/fix": "satellite fix, sensor_msgs/NavSatFix (position: fix)",
        "platform/imu": "attitude against east, north and up, sensor_msgs/Imu (position: fix)",
        "platform/twist": "velocity in map or body axes, geometry_msgs/TwistStamped (velocity: twist)",
    }
    outputs: ClassVar[Topics] = {"platform/odometry": "state of the platform, nav_msgs/Odometry", **ORIGIN}

    def __init__(self, **node_arguments: Any) -> None:
        """Make the node; `node_arguments` go to rclpy's Node.

        Raises:
            UserError: a parameter has a value that is not allowed.
        """
        super().__init__("navigation", **node_arguments)
        now: Parameters = self.current_parameters()
        self._frames = now.frames
        has_twist, has_fix = now.velocity == "twist", now.position == "fix"
        if has_fix and now.origin is None:
            super().destroy_node()
            raise UserError(
                "Node navigation must know where on the earth to lay the map that fixes are placed in (position is "
                "fix); set origin_latitude_deg, origin_longitude_deg and origin_height_m to a place in the scene."
            )
        self._merge = functools.partial(
            Navigation,
            now.longest_gap_s,
            velocity_is_measured=has_twist,
            local_to=now.origin if has_fix else None,
        )
        self._navigation = self._merge()
        self._odometry = self.offer(Odometry, "platform/odometry", ODOMETRY_QOS)
        map_origin = self.offer(NavSatFix, MAP_ORIGIN, LATCHED_QOS)
        if now.origin is not None:
            stamp = messages.to_stamp(self.get_clock().now().nanoseconds)
            map_origin.publish(messages.origin_to_message(now.origin, stamp, now.map_frame))
        if has_fix and now.origin is not None:
            on_fix = functools.partial(self._on_fix, origin=now.origin)
            self.listen(NavSatFix, "platform/fix", on_fix, INSTRUMENT_QOS)
            self.listen(Imu, "platform/imu", self._on_imu, INSTRUMENT_QOS)
        else:
            self.listen(PoseStamped, "platform/pose", self._on_pose, INSTRUMENT_QOS)
        if has_twist:
            self.listen(TwistStamped, "platform/twist", self._on_twist, INSTRUMENT_QOS)

    def _on_pose(self, message: PoseStamped) -> None:
        position, attitude = messages.read_pose(message, self._frames)
        self._navigation.add_position(position)
        self._navigation.add_attitude(attitude)
        self._publish()

    def _on_fix(self, message: NavSatFix, origin: Origin) -> None:
        self._navigation.add_position(messages.read_fix(message, origin))
        self._publish()

    def _on_imu(self, message: Imu) -> None:
        self._navigation.add_attitude(messages.read_attitude(message, self._frames))
        self._publish()

    def _on_twist(self, message: TwistStamped) -> None:
        velocity, in_body = messages.read_twist(message, self._frames)
        self._navigation.add_velocity(velocity, in_body=in_body)
        self._publish()

    def forget(self) -> None:
        """Forget the samples so far."""
        self._navigation = self._merge()

    def _publish(self) -> None:
        states, declined = self._navigation.take()
        if not self.is_active:
            return
        for reason in declined:
            self.ignore(reason.reason, reason)
        for state in states:
            stamp = messages.to_stamp(state.stamp_ns)
            self._odometry.publish(messages.state_to_message(state, stamp, self._frames))


def main() -> int:
    """Console script."""
    return run_node(NavigationNode)


if __name__ == "__main__":
    raise SystemExit(main())
