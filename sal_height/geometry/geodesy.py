"""The origin of a map on the earth: geodetic coordinates on the WGS-84 ellipsoid, and axes of east, north and up.

Latitudes and longitudes are in rad, heights in m above the ellipsoid. Map coordinates are distances in space along the
axes of east, north and up at the origin (topocentric, EPSG method 9837), not along the ground.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from sal_height.numeric import F64

TOPOCENTRIC = (
    "+proj=pipeline +step +proj=cart +ellps=WGS84 "
    "+step +proj=topocentric +ellps=WGS84 +lat_0={latitude!r} +lon_0={longitude!r} +h_0={height!r}"
)
"""Pipeline of PROJ from geodetic to map coordinates; the origin is in degrees and m."""


def local_axes(latitude: float, longitude: float) -> F64:
    """East, north and up at a position as rows of earth-centred, earth-fixed coordinates, shape (3, 3).

    x points to the equator at longitude 0, z to the north pole.
    """
    (sin_lat, cos_lat), (sin_lon, cos_lon) = ((np.sin(angle), np.cos(angle)) for angle in (latitude, longitude))
    return np.array(
        [
            [-sin_lon, cos_lon, 0.0],
            [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat],
            [cos_lat * cos_lon, cos_lat * sin_lon, sin_lat],
        ]
    )


@dataclass(frozen=True)
class Origin:
    """The origin of a map, whose axes are east, north and up there.

    Attributes:
        latitude: geodetic latitude, rad.
        longitude: longitude, rad.
        height: height above the ellipsoid, m.
    """

    latitude: float
    longitude: float
    height: float

    @cached_property
    def _topocentric(self) -> Any:
        from pyproj import Transformer  # noqa: PLC0415 (0.1 s; few programs need the geodetic position)

        latitude, longitude = np.degrees([self.latitude, self.longitude]).tolist()
        return Transformer.from_pipeline(
            TOPOCENTRIC.format(latitude=latitude, longitude=longitude, height=float(self.height))
        )

    def to_map(self, latitude: npt.ArrayLike, longitude: npt.ArrayLike, height: npt.ArrayLike) -> F64:
        """Map coordinates (m) of geodetic positions, shape (..., 3): all distances are those in space."""
        positions = np.broadcast_arrays(longitude, latitude, height)
        return np.stack(self._topocentric.transform(*positions, radians=True), axis=-1)

    @property
    def axes(self) -> F64:
        """East, north and up of the map as rows of earth-centred, earth-fixed coordinates, shape (3, 3)."""
        return local_axes(self.latitude, self.longitude)

    def from_space(self, positions: F64) -> F64:
        """Map coordinates (m) of earth-centred, earth-fixed ones (m), both of shape (..., 3)."""
        return (positions - self._in_space) @ self.axes.T

    @cached_property
    def _in_space(self) -> F64:
        """Earth-centred, earth-fixed coordinates of the origin, m."""
        from pyproj import Transformer  # noqa: PLC0415

        to_space = Transformer.from_pipeline("+proj=cart +ellps=WGS84")
        return np.array(to_space.transform(self.longitude, self.latitude, self.height, radians=True))

    def to_geodetic(self, positions: F64) -> tuple[F64, F64, F64]:
        """Latitude, longitude (rad) and height (m) of map positions (m), shape (..., 3): undo `to_map`."""
        east, north, up = np.moveaxis(np.asarray(positions, dtype=np.float64), -1, 0)
        longitude, latitude, height = self._topocentric.transform(east, north, up, direction="INVERSE", radians=True)
        return latitude, longitude, height

    def turn_at(self, position: F64) -> F64:
        """The matrix that turns vectors from east, north and up at a position into map axes, shape (3, 3).

        Args:
            position: position in map, shape (3,), m.
        """
        latitude, longitude, _ = self.to_geodetic(position)
        return self.axes @ local_axes(float(latitude), float(longitude)).T
