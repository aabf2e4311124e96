"""Axes that navigation systems use, and those of ROS (REP 103): aviation has z pointing down."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sal_height.geometry.mounting import Mounting
from sal_height.geometry.quaternion import quaternion_of, rotation_matrix
from sal_height.geometry.trajectory import PlatformState
from sal_height.numeric import F64

MAP_AXES = {
    "enu": np.eye(3),
    "ned": np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
}
"""Axes x, y, z of positions by name: east, north, up or north, east, down. The matrix makes vectors in ENU of those in
them."""

BODY_AXES = {"flu": np.eye(3), "frd": np.diag([1.0, -1.0, -1.0])}
"""Axes x, y, z of a platform by name: forward, left, up or forward, right, down. The matrix makes vectors in FLU of
those in them."""


@dataclass(frozen=True)
class Axes:
    """The axes in which a navigation system states positions, and attitudes of the platform.

    Attributes:
        map: axes of positions, a name in MAP_AXES.
        body: axes of the platform, a name in BODY_AXES.
    """

    map: str = "enu"
    body: str = "flu"

    @property
    def are_of_ros(self) -> bool:
        """True if they are those of REP 103, which the whole project uses."""
        return self == ROS_AXES

    def vector(self, in_map: F64) -> F64:
        """A vector in map, as east, north and up."""
        return MAP_AXES[self.map] @ in_map

    def body_vector(self, in_body: F64) -> F64:
        """A vector in axes of the platform, as forward, left and up."""
        return BODY_AXES[self.body] @ in_body

    def attitude(self, orientation: F64) -> F64:
        """The quaternion (x, y, z, w) of the same attitude, turning forward, left, up into east, north, up."""
        if self.are_of_ros:
            return orientation
        return np.array(quaternion_of(MAP_AXES[self.map] @ rotation_matrix(orientation) @ BODY_AXES[self.body].T))

    def covariance(self, in_map: F64) -> F64:
        """The covariance (3, 3) of a vector in map, or of small turns about its axes, for east, north and up."""
        return MAP_AXES[self.map] @ in_map @ MAP_AXES[self.map].T

    def state(self, state: PlatformState) -> PlatformState:
        """A state of the platform in these axes, in those of ROS."""
        if self.are_of_ros:
            return state
        both, body = np.kron(np.eye(2), MAP_AXES[self.map]), BODY_AXES[self.body]
        return replace(
            state,
            position=self.vector(state.position),
            orientation=self.attitude(state.orientation),
            velocity=self.vector(state.velocity),
            covariance=both @ state.covariance @ both.T,
            velocity_covariance=body @ state.velocity_covariance @ body.T,
        )

    def mounting(self, mounting: Mounting) -> Mounting:
        """A mounting whose sensor frame has the same axes as the platform, in those of ROS."""
        if self.body == ROS_AXES.body:
            return mounting
        turn = BODY_AXES[self.body]
        return replace(
            mounting,
            lever_arm=tuple((turn @ mounting.lever_arm).tolist()),
            rotation=quaternion_of(turn @ rotation_matrix(mounting.rotation) @ turn.T),
        )


ROS_AXES = Axes()
"""East, north, up and forward, left, up."""
