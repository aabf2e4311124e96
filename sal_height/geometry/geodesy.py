"""The place of a map on the earth: geodetic coordinates on the WGS-84 ellipsoid, and the axes of east, north and up.

Latitudes and longitudes are in rad, heights in m above the ellipsoid.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sal_height.numeric import F64

SEMI_MAJOR_AXIS = 6_378_137.0  # m, WGS 84 (NIMA TR8350.2, table 3.1)
FLATTENING = 1 / 298.257_223_563  # the same

_ECCENTRICITY_SQUARED = FLATTENING * (2 - FLATTENING)


def geocentric(latitude: float, longitude: float, height: float) -> F64:
    """Earth-centred, earth-fixed coordinates (m) of a place, shape (3,).

    x points to the equator at longitude 0, z to the north pole (Hofmann-Wellenhof et al., GNSS, 2008, eq. 8.3).
    """
    prime_vertical = SEMI_MAJOR_AXIS / np.sqrt(1 - _ECCENTRICITY_SQUARED * np.sin(latitude) ** 2)  # radius of curvature
    across = (prime_vertical + height) * np.cos(latitude)
    along = (prime_vertical * (1 - _ECCENTRICITY_SQUARED) + height) * np.sin(latitude)
    return np.array([across * np.cos(longitude), across * np.sin(longitude), along])


def local_axes(latitude: float, longitude: float) -> F64:
    """East, north and up at a place as rows of earth-centred, earth-fixed coordinates, shape (3, 3)."""
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
        latitude: rad.
        longitude: rad.
        height: m above the ellipsoid.
    """

    latitude: float
    longitude: float
    height: float

    @cached_property
    def _place(self) -> F64:
        return geocentric(self.latitude, self.longitude, self.height)

    @cached_property
    def _axes(self) -> F64:
        return local_axes(self.latitude, self.longitude)

    def to_map(self, latitude: float, longitude: float, height: float) -> F64:
        """Map coordinates (m) of a place, shape (3,): all distances are those in space."""
        return self._axes @ (geocentric(latitude, longitude, height) - self._place)

    def turn_at(self, position: F64) -> F64:
        """The matrix that turns vectors from east, north and up at a place into map axes, shape (3, 3).

        The latitude follows from that on the ellipsoid below (Bowring, Survey Review 23, 1976), to 1e-10 rad at heights
        of an aircraft.

        Args:
            position: the place in map, m, shape (3,).
        """
        x, y, z = self._place + position @ self._axes
        across, polar_axis = np.hypot(x, y), SEMI_MAJOR_AXIS * (1 - FLATTENING)
        parametric = np.arctan2(z * SEMI_MAJOR_AXIS, across * polar_axis)
        second = _ECCENTRICITY_SQUARED / (1 - _ECCENTRICITY_SQUARED)
        latitude = np.arctan2(
            z + second * polar_axis * np.sin(parametric) ** 3,
            across - _ECCENTRICITY_SQUARED * SEMI_MAJOR_AXIS * np.cos(parametric) ** 3,
        )
        return self._axes @ local_axes(float(latitude), float(np.arctan2(y, x))).T
