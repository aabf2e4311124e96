"""Single rotations as quaternions x, y, z, w: in plain numbers, as one message or one aperture needs them.

`scipy.spatial.transform.Rotation` does the same for many rotations at once; one takes it 20 to 100 us.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from sal_height.numeric import F64

STILL = 1e-9  # angle between attitudes, rad, below which the arc between them is its chord in float64


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


def attitude_between(first: F64, second: F64, share: float) -> F64:
    """The quaternion at a `share` of the way from one to another, along the shorter arc (Shoemake, SIGGRAPH 1985)."""
    first, second = first / math.hypot(*first), second / math.hypot(*second)
    if first @ second < 0:
        second = -second
    angle = 2 * math.atan2(math.hypot(*(second - first)), math.hypot(*(second + first)))
    if angle < STILL:
        return np.asarray((1 - share) * first + share * second)
    return np.asarray((math.sin((1 - share) * angle) * first + math.sin(share * angle) * second) / math.sin(angle))
