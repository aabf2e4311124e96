"""How far a platform may have left the path between two samples of its odometry."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sal_height.numeric import F64


@dataclass(frozen=True)
class Motion:
    """Accelerations of a platform that its odometry does not show: white noise, without a preferred direction.

    Attributes:
        acceleration: of the position, m/s^2/sqrt(Hz).
        turning: of the attitude, rad/s^2/sqrt(Hz).
        interval_s: longest time between two samples that leaves nothing out, s: a longer one is a gap.
    """

    acceleration: float
    turning: float
    interval_s: float

    def covariance(self, since_s: float, until_s: float) -> F64:
        """Covariance of the pose inside a gap, beside that of the samples around it, shape (6, 6).

        With position and velocity known at both ends, the position leaves the cubic by a variance of
        q a^3 b^3 / (3 T^3) in each direction; with the attitude alone known, it leaves the shortest turn by one of
        q a^2 b^2 / (3 T). These follow from the Green's functions of a beam that is clamped, and of one that is
        supported, at its ends. It is 0 where there is no gap.

        Args:
            since_s: time a since the sample before, s.
            until_s: time b until the next one, s.
        """
        whole_s = since_s + until_s
        if whole_s <= self.interval_s:
            return np.zeros((6, 6))
        position = self.acceleration**2 * (since_s * until_s / whole_s) ** 3 / 3
        attitude = self.turning**2 * (since_s * until_s) ** 2 / (3 * whole_s)
        return np.diag([position] * 3 + [attitude] * 3)


STEADY = Motion(0.0, 0.0, float("inf"))
"""A platform whose odometry leaves nothing out."""
