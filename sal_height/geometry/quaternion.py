"""Single rotations as quaternions x, y, z, w: in plain numbers, for one message or one aperture.

`scipy.spatial.transform.Rotation` does the same for many rotations at once, and needs 20 to 100 us for one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from sal_height.numeric import F64


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
