"""Mounting of a sensor on the platform: the position of its antenna and the direction of its axes in the body."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from sal_height.errors import UserError

FARTHEST_ARM = 1000.0  # m: no platform is larger, and millimetres given as metres are noticed


@dataclass(frozen=True)
class Mounting:
    """Position and direction of the sensor frame in base_link; the same content as sal_height_msgs/Mounting.

    Attributes:
        frame_id: name of the sensor frame; empty: "base_link".
        lever_arm: position of the antenna's phase centre in base_link axes, m.
        rotation: unit quaternion x, y, z, w that turns the axes of the sensor frame into those of base_link.

    Raises:
        UserError: a value that is not finite, a lever arm beyond FARTHEST_ARM, or a quaternion whose norm is not 1.
    """

    frame_id: str = "sensor"
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        if not np.all(np.abs(self.lever_arm) <= FARTHEST_ARM):
            raise UserError(
                f"The lever arm of the mounting is {self.lever_arm} m; each component must be finite and at most "
                f"{FARTHEST_ARM:g} m long."
            )
        if not 0.99 < math.hypot(*self.rotation) < 1.01:
            raise UserError(
                f"The rotation of the mounting is {self.rotation}; it must be a quaternion (x, y, z, w) of norm 1."
            )

    @property
    def is_identity(self) -> bool:
        """True if the sensor frame is base_link itself."""
        return not (any(self.lever_arm) or any(self.rotation[:3]))

    @property
    def axes(self) -> Rotation:
        """The rotation from the sensor frame to base_link."""
        return Rotation.from_quat(self.rotation)


AT_BASE_LINK = Mounting()  # the sensor frame is base_link: no lever arm, no rotation
