"""A single receiver whose beam follows a point: what files tell of a sensor that state no antenna."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from sal_height.geometry import PlatformState
from sal_height.numeric import F64, I64
from sal_height.sensor import Sensor

MOST_PIXELS = 4095
"""Greatest number of rows and columns of an image."""


def side_of(antenna: F64, velocity: F64, point: F64) -> int:
    """The side to which a point lies: +1 right of the flight, -1 left; all of shape (3,), in map."""
    return -1 if np.cross(velocity, point - antenna)[2] > 0 else 1


def boresight_to(antenna: F64, point: F64) -> float:
    """Angle of a point from the nadir of an antenna, rad; both in map, m, shape (3,)."""
    east, north, up = point - antenna
    return float(np.arctan2(np.hypot(east, north), -up))


def states_towards(stamps_ns: I64, antenna: F64, velocity: F64, points: F64, look_side: int) -> list[PlatformState]:
    """Level states whose side is turned to a point.

    Args:
        stamps_ns: times, ns since 1970, shape (n,).
        antenna: positions in map, m, shape (n, 3).
        velocity: in map, m/s, shape (n, 3).
        points: to which the beam points, in map, m, shape (n, 3) or (3,).
        look_side: +1 right, -1 left.
    """
    east, north, _ = np.moveaxis(points - antenna, -1, 0)
    yaw = np.arctan2(north, east) + look_side * np.pi / 2
    orientation = Rotation.from_euler("z", yaw[:, None]).as_quat()
    return [
        PlatformState(int(stamp), position, attitude, speed, np.zeros((6, 6)))
        for stamp, position, attitude, speed in zip(stamps_ns, antenna, orientation, velocity, strict=True)
    ]


def focusing(sensor: Sensor, antenna: F64, range_: float, side_m: float, widest_m: float) -> dict[str, dict[str, Any]]:
    """Parameters that focus a square of level ground on pixels no farther apart than the aperture resolves.

    The resolution along the flight is wavelength * range / (2 * aperture length).

    Args:
        sensor: wavelength.
        antenna: positions at the pulses, m, shape (pulses, 3).
        range_: slant range of the middle, m.
        side_m: of the square, m; it is smaller if that needs more than MOST_PIXELS pixels.
        widest_m: greatest spacing of pixels, m.
    """
    length = float(np.linalg.norm(np.diff(antenna, axis=0), axis=-1).sum())
    spacing = min(widest_m, sensor.wavelength * range_ / (2 * length))
    pixels = min(2 * round(side_m / 2 / spacing) + 1, MOST_PIXELS)
    image = {"image_plane": "ground", "rows": pixels, "cols": pixels, "ground_spacing_m": spacing}
    return {"sar_compression": image | {"range_window": "rectangular", "azimuth_window": "rectangular"}}
