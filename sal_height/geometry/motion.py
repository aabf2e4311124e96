"""Uncertainty of a platform's path between two samples of its odometry, and single rotations as quaternions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sal_height.geometry.accuracy import AXES
from sal_height.numeric import F64

ASSUMED_ACCELERATION, ASSUMED_TURNING = 0.1, 0.01
"""Densities that are assumed of a platform in gusts, m/s^2/sqrt(Hz) and rad/s^2/sqrt(Hz)."""


def rotation_matrix(quaternion: Sequence[float] | F64) -> F64:
    """The matrix that turns as a quaternion of any norm but 0 does, shape (3, 3)."""
    x, y, z, w = quaternion
    twice = 2 / (x * x + y * y + z * z + w * w)
    return np.array(
        [
            [1 - twice * (y * y + z * z), twice * (x * y - z * w), twice * (x * z + y * w)],
            [twice * (x * y + z * w), 1 - twice * (x * x + z * z), twice * (y * z - x * w)],
            [twice * (x * z - y * w), twice * (y * z + x * w), 1 - twice * (x * x + y * y)],
        ]
    )


def quaternion_of(matrix: F64) -> tuple[float, float, float, float]:
    """The unit quaternion that turns as a rotation matrix does, by its greatest component (Shepperd, JGCD 1, 1978)."""
    m = matrix.tolist()
    trace = m[0][0] + m[1][1] + m[2][2]
    if trace >= max(m[0][0], m[1][1], m[2][2]):
        q = [m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1], 1 + trace]
    else:
        i = max(range(3), key=lambda axis: m[axis][axis])
        j, k = (i + 1) % 3, (i + 2) % 3
        q = [0.0, 0.0, 0.0, m[k][j] - m[j][k]]
        q[i], q[j], q[k] = 1 - trace + 2 * m[i][i], m[j][i] + m[i][j], m[k][i] + m[i][k]
    norm = math.hypot(*q)
    return q[0] / norm, q[1] / norm, q[2] / norm, q[3] / norm


def attitude_between(first: F64, second: F64, fraction: float) -> F64:
    """The quaternion at a `fraction` of the shorter arc from one to another (Shoemake, SIGGRAPH 1985)."""
    first, second = first / math.hypot(*first), second / math.hypot(*second)
    if first @ second < 0:
        second = -second
    angle = 2 * math.atan2(math.hypot(*(second - first)), math.hypot(*(second + first)))
    if angle < 1e-9:  # rad: the arc is its chord in float64
        return np.asarray((1 - fraction) * first + fraction * second)
    return np.asarray(
        (math.sin((1 - fraction) * angle) * first + math.sin(fraction * angle) * second) / math.sin(angle)
    )


@dataclass(frozen=True)
class Motion:
    """Accelerations of a platform that its odometry does not show: white noise, without a preferred direction.

    Attributes:
        acceleration: density of the acceleration of the position, m/s^2/sqrt(Hz); NOT_STATED: not known.
        turning: density of the angular acceleration of the attitude, rad/s^2/sqrt(Hz); NOT_STATED: not known.
        interval_s: longest time between two samples that is not a gap, s.
    """

    acceleration: float
    turning: float
    interval_s: float

    @property
    def with_assumed(self) -> Motion:
        """The motion that counts what is assumed as stated."""
        acceleration = ASSUMED_ACCELERATION if self.acceleration < 0 else self.acceleration
        return Motion(acceleration, ASSUMED_TURNING if self.turning < 0 else self.turning, self.interval_s)

    def variances(self, since_s: float, until_s: float) -> F64:
        """Variances of pose and velocity inside a gap, in addition to those of the samples around it, shape (AXES,).

        With position and velocity known at both ends, the position deviates from the cubic by a variance of
        q a^3 b^3 / (3 T^3) in each direction, and the velocity by one of q a b (1 - 3 a b / T^2) / T; with only the
        attitude known, it deviates from the shortest turn by one of q a^2 b^2 / (3 T). These follow from the Green's
        functions of a beam that is clamped, and of one that is supported, at its ends. They are 0 without a gap, and of
        what is not known.

        Args:
            since_s: time a since the sample before, s.
            until_s: time b until the next one, s.
        """
        whole_s = since_s + until_s
        if whole_s <= self.interval_s:
            return np.zeros(AXES)
        acceleration, turning, both = max(self.acceleration, 0.0) ** 2, max(self.turning, 0.0) ** 2, since_s * until_s
        position = acceleration * (both / whole_s) ** 3 / 3
        velocity = acceleration * both * (1 - 3 * both / whole_s**2) / whole_s
        attitude = turning * both**2 / (3 * whole_s)
        return np.repeat([position, attitude, velocity], 3)


STEADY = Motion(0.0, 0.0, float("inf"))
"""A platform whose odometry has no gaps."""
