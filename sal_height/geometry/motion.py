"""Uncertainty of a platform's path between two samples of its odometry."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sal_height.numeric import F64


@dataclass(frozen=True)
class Motion:
    """Accelerations of a platform that its odometry does not show: white noise, without a preferred direction.

    Attributes:
        acceleration: density of the acceleration of the position, m/s^2/sqrt(Hz).
        turning: density of the angular acceleration of the attitude, rad/s^2/sqrt(Hz).
        interval_s: longest time between two samples that is not a gap, s.
    """

    acceleration: float
    turning: float
    interval_s: float

    def covariance(self, since_s: float, until_s: float) -> F64:
        """Covariance of the pose inside a gap, in addition to that of the samples around it, shape (6, 6).

        With position and velocity known at both ends, the position deviates from the cubic by a variance of
        q a^3 b^3 / (3 T^3) in each direction; with only the attitude known, it deviates from the shortest turn by one
        of q a^2 b^2 / (3 T). These follow from the Green's functions of a beam that is clamped, and of one that is
        supported, at its ends. It is 0 without a gap.

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
"""A platform whose odometry has no gaps."""
