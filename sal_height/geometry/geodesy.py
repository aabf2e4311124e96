"""The origin of a map on the earth: geodetic coordinates on the WGS-84 ellipsoid, and axes of east, north and up.

Latitudes and longitudes are in rad, heights in m above the ellipsoid. Map coordinates are distances in space along the
axes of east, north and up at the origin (topocentric, EPSG method 9837), not along the ground.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from sal_height.errors import UserError
from sal_height.geometry.accuracy import is_unknown_position
from sal_height.geometry.frames import Mounting
from sal_height.geometry.motion import quaternion_of, rotation_matrix
from sal_height.geometry.trajectory import PlatformState
from sal_height.numeric import F64

MAP_AXES = {
    "enu": np.eye(3),
    "ned": np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
}
"""Axes x, y, z of positions by name: east, north, up or north, east, down. The matrix makes vectors in ENU of those in
them."""

BODY_AXES = {"flu": np.eye(3), "frd": np.diag([1.0, -1.0, -1.0])}
"""Axes x, y, z of a platform by name: forward, left, up or forward, right, down. The matrix makes vectors in FLU of
those in them."""

TOPOCENTRIC = (
    "+proj=pipeline +step +proj=cart +ellps=WGS84 "
    "+step +proj=topocentric +ellps=WGS84 +lat_0={latitude!r} +lon_0={longitude!r} +h_0={height!r}"
)
"""Pipeline of PROJ from geodetic to map coordinates; the origin is in degrees and m."""


@dataclass(frozen=True)
class Axes:
    """The axes in which a navigation system states positions, and attitudes of the platform.

    Attributes:
        map: axes of positions, a name in MAP_AXES.
        body: axes of the platform, a name in BODY_AXES.
    """

    map: str = "enu"
    body: str = "flu"

    @property
    def are_of_ros(self) -> bool:
        """True if they are those of REP 103, which the whole project uses."""
        return self == ROS_AXES

    def vector(self, in_map: F64) -> F64:
        """A vector in map, as east, north and up."""
        return MAP_AXES[self.map] @ in_map

    def body_vector(self, in_body: F64) -> F64:
        """A vector in axes of the platform, as forward, left and up."""
        return BODY_AXES[self.body] @ in_body

    def attitude(self, orientation: F64) -> F64:
        """The quaternion (x, y, z, w) of the same attitude, turning forward, left, up into east, north, up."""
        if self.are_of_ros:
            return orientation
        return np.array(quaternion_of(MAP_AXES[self.map] @ rotation_matrix(orientation) @ BODY_AXES[self.body].T))

    def covariance(self, in_map: F64) -> F64:
        """The covariance (3, 3) of a vector in map, or of small turns about its axes, for east, north and up."""
        return MAP_AXES[self.map] @ in_map @ MAP_AXES[self.map].T

    def state(self, state: PlatformState) -> PlatformState:
        """A state of the platform in these axes, in those of ROS."""
        if self.are_of_ros:
            return state
        both, body = np.kron(np.eye(2), MAP_AXES[self.map]), BODY_AXES[self.body]
        return replace(
            state,
            position=self.vector(state.position),
            orientation=self.attitude(state.orientation),
            velocity=self.vector(state.velocity),
            covariance=both @ state.covariance @ both.T,
            velocity_covariance=body @ state.velocity_covariance @ body.T,
        )

    def mounting(self, mounting: Mounting) -> Mounting:
        """A mounting whose sensor frame has the same axes as the platform, in those of ROS."""
        if self.body == ROS_AXES.body:
            return mounting
        turn = BODY_AXES[self.body]
        return replace(
            mounting,
            lever_arm=tuple((turn @ mounting.lever_arm).tolist()),
            rotation=quaternion_of(turn @ rotation_matrix(mounting.rotation) @ turn.T),
        )


LEVELS = ("unknown", "ellipsoid", "geoid")
"""Levels above which altitudes are: not known, the WGS-84 ellipsoid, or the geoid (mean sea level)."""

GEOID_SIGMA_M = 30.0
"""Standard deviation of an altitude whose level is not known, m: the height of the geoid above the ellipsoid is from
-107 to +85 m over the earth, about 30 m rms (EGM96)."""


@dataclass(frozen=True)
class Altitudes:
    """The level above which the altitudes of satellite fixes and tracks are.

    Attributes:
        above: name in LEVELS.
        geoid_height_m: height of the geoid above the ellipsoid where the flight is, m; for altitudes above the geoid.
    """

    above: str = "unknown"
    geoid_height_m: float = 0.0

    def __post_init__(self) -> None:
        if self.above == "geoid" and not self.geoid_height_m:
            raise UserError(
                "Altitudes are above the geoid (altitude_above), whose height above the ellipsoid is not given; state "
                "geoid_height_m, such as 47 in Bavaria."
            )
        if self.above != "geoid" and self.geoid_height_m:
            raise UserError(
                f"The height of the geoid is given (geoid_height_m {self.geoid_height_m:g}), and altitude_above is "
                f"{self.above}; state altitude_above: geoid, or leave geoid_height_m out."
            )

    @property
    def is_known(self) -> bool:
        """True if somebody states the level."""
        return self.above != "unknown"

    @property
    def offset_m(self) -> float:
        """Height of the level above the ellipsoid, m; 0 if it is not known."""
        return self.geoid_height_m if self.above == "geoid" else 0.0

    def added_to(self, covariance: F64) -> F64:
        """The covariance of a position (m^2, (3, 3)) with the error of a level that is not known, alike in all samples.

        A position of unknown accuracy keeps zeros along the ground, which say so.
        """
        if self.is_known:
            return covariance
        known = np.zeros((3, 3)) if is_unknown_position(covariance) else covariance
        return known + np.diag([0.0, 0.0, GEOID_SIGMA_M**2])


UNKNOWN_LEVEL = (
    "Nobody states whether altitudes are above the ellipsoid or the geoid (mean sea level); all heights may be off "
    f"together, by a standard deviation of {GEOID_SIGMA_M:g} m. State altitude_above, and geoid_height_m where it is "
    "the geoid."
)
"""Warning about altitudes of an unknown level."""

ROS_AXES = Axes()
"""East, north, up and forward, left, up."""


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
