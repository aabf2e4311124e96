"""Positions and heights on the spherical earth that touches the origin of the map.

Map axes are ENU (x east, y north, z up) with the origin on a sphere of radius EARTH_RADIUS; heights are above that
sphere.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sal_height.geometry import _kernels as kernels
from sal_height.numeric import F64

EARTH_RADIUS = 6_371_008.8  # m, mean earth radius (IUGG)


def sphere_point(east: npt.ArrayLike, north: npt.ArrayLike, height: npt.ArrayLike) -> F64:
    """Return the map position (m) of arc distances `east`, `north` (m) along the sphere and `height` (m) above it.

    The projection is azimuthal equidistant: the great circle from the map's origin leaves it in the direction
    (east, north). The result has the shape (..., 3).
    """
    east, north, height = np.broadcast_arrays(east, north, height)
    angle = np.hypot(east, north) / EARTH_RADIUS
    scale = (1 + height / EARTH_RADIUS) * np.sinc(angle / np.pi)
    up = height * np.cos(angle) - 2 * EARTH_RADIUS * np.sin(angle / 2) ** 2
    return np.stack([scale * east, scale * north, up], axis=-1)


def sphere_coordinates(points: F64) -> tuple[F64, F64, F64]:
    """Return arc distances east and north (m) and height (m) of map positions, shape (..., 3): undo `sphere_point`."""
    points = np.asarray(points, dtype=np.float64)
    coordinates = np.empty((3, *points.shape[:-1]))
    kernels.fill_sphere_coordinates(_flat(points), EARTH_RADIUS, coordinates.reshape(3, -1))
    east, north, height = coordinates
    return east, north, height


def height_of(points: F64) -> F64:
    """Return the height (m) above the sphere of map positions of shape (..., 3), without cancellation.

    It is sqrt(x^2 + y^2 + (z + R)^2) - R, with the difference of the two large numbers taken analytically.
    """
    points = np.asarray(points, dtype=np.float64)
    heights = np.empty(points.shape[:-1])
    kernels.fill_heights(_flat(points), EARTH_RADIUS, heights.reshape(-1))
    found: F64 = heights[()]  # a number for a single point
    return found


def _flat(points: F64) -> F64:
    """Contiguous points for compiled loops, shape (n, 3)."""
    return np.ascontiguousarray(points.reshape(-1, 3))


def above_place(x: npt.ArrayLike, y: npt.ArrayLike, height: npt.ArrayLike) -> F64:
    """Return the map position (m) of the point at map coordinates `x`, `y` (m) and `height` (m) above the sphere.

    z = sqrt((R + h)^2 - x^2 - y^2) - R, without cancellation; shape (..., 3). NaN where the sphere of that height does
    not reach (x, y).
    """
    x, y, height = (np.asarray(value, dtype=np.float64) for value in (x, y, height))
    growth = height * (2 * EARTH_RADIUS + height) - x**2 - y**2
    place = np.empty((*growth.shape, 3))
    place[..., 0], place[..., 1] = x, y
    with np.errstate(invalid="ignore"):
        place[..., 2] = growth / (np.sqrt(EARTH_RADIUS**2 + growth) + EARTH_RADIUS)
    return place
