"""A map in a coordinate reference system in metres, such as UTM: conversion of map coordinates to it."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Self

import numpy as np

from sal_height.errors import UserError
from sal_height.geometry.geodesy import Origin
from sal_height.numeric import F64

UTM = "utm"
"""Name that stands for the zone of UTM in which the origin of the map lies."""

WGS_84 = "EPSG:4979"
"""Latitude, longitude and height above the ellipsoid, in which origins are given."""


@dataclass(frozen=True, eq=False)
class Projection:
    """A coordinate reference system for a map with a known origin.

    Coordinates are easting, northing and height in m. Heights are above the ellipsoid of the system, or, if it is a
    compound one with a vertical part, above what that says.

    Attributes:
        origin: origin of the map.
        system: pyproj.CRS with three axes.
        name: name of the system by its authority (EPSG:32632).
    """

    origin: Origin
    system: Any
    name: str

    @classmethod
    def of(cls, name: str, origin: Origin) -> Self:
        """The system of a `name`: UTM, or anything that PROJ knows (EPSG:32632, EPSG:25832+7837, WKT).

        Raises:
            UserError: there is no such system, it is not one in metres that suits the position of the origin, it has no
                datum, or the grid of its geoid is not installed.
        """
        code = _utm_zone(origin) if name.lower() == UTM else name
        system = find_system(code)
        found = cls(origin, system if len(system.axis_info) > 2 else system.to_3d(), code)
        found._check()
        return found

    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]:
        """Function and arguments that make the projection in another process, where PROJ finds the operation again."""
        return type(self).of, (self.name, self.origin)

    @property
    def has_geoid(self) -> bool:
        """True if heights are not above the ellipsoid."""
        return bool(self.system.is_compound)

    @property
    def wkt1(self) -> str:
        """The system in well-known text of version 1 (OGC 01-009), in which heights above the ellipsoid are a part."""
        if self.has_geoid:
            return str(self.system.to_wkt("WKT1_GDAL"))
        flat = self.system.to_2d()
        return (
            f'COMPD_CS["{flat.name} + ellipsoidal height",{flat.to_wkt("WKT1_GDAL")},VERT_CS["ellipsoidal height",'
            'VERT_DATUM["ellipsoid",2002],UNIT["metre",1],AXIS["Up",UP]]]'
        )

    @cached_property
    def _operations(self) -> Any:
        """Operations of PROJ from longitude, latitude and height to coordinates, best first."""
        from pyproj.transformer import TransformerGroup  # noqa: PLC0415

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # says what `_lacking` says
            return TransformerGroup(WGS_84, self.system, always_xy=True)

    @cached_property
    def _transformer(self) -> Any:
        """The best operation that is available here and has a known error.

        Raises:
            UserError: no operation is available.
        """
        for transformer in self._operations.transformers:
            if transformer.accuracy >= 0:  # -1: a guess, such as that the height above the sea is that of the ellipsoid
                return transformer
        raise self._lacking()

    def _lacking(self) -> UserError:
        """Error that names the grids missing for the best operation."""
        operations = self._operations.unavailable_operations
        grids = dict.fromkeys(grid.short_name for operation in operations for grid in operation.grids)
        if not grids:
            return UserError(f"Coordinate reference system {self.name} has no known relation to WGS 84.")
        return UserError(
            f"Coordinate reference system {self.name} needs a grid that is not installed: {' or '.join(grids)}; fetch "
            "it with pyproj sync --file NAME, or use a system without it, such as utm, which has heights above the "
            "ellipsoid."
        )

    def coordinates(self, positions: F64) -> F64:
        """Easting, northing and height (m) of map positions (m), both of shape (..., 3); NaN where undefined."""
        latitude, longitude, height = self.origin.to_geodetic(positions)
        coordinates = np.stack(self._transformer.transform(longitude, latitude, height, radians=True), axis=-1)
        coordinates[~np.isfinite(coordinates)] = np.nan  # PROJ has infinity there
        return coordinates

    def geodetic(self, coordinates: F64) -> tuple[F64, F64, F64]:
        """Latitude, longitude (rad) and height (m) on WGS 84 of easting, northing and height (m), shape (..., 3)."""
        easting, northing, up = np.moveaxis(np.asarray(coordinates, dtype=np.float64), -1, 0)
        longitude, latitude, height = self._transformer.transform(
            easting, northing, up, direction="INVERSE", radians=True
        )
        return latitude, longitude, height

    def positions(self, coordinates: F64) -> F64:
        """Map positions (m) of easting, northing and height (m), both of shape (..., 3): undo `coordinates`."""
        return self.origin.to_map(*self.geodetic(coordinates))

    def _check(self) -> None:
        """Check that a metre is a metre at the origin.

        Raises:
            UserError: it is not, or a grid is missing.
        """
        if not self._operations.best_available:
            raise self._lacking()
        step = 100.0  # m: over it the axes of a projection turn by 1e-5 rad, as those of the earth
        here, *steps = self.coordinates(step * np.concatenate([np.zeros((1, 3)), np.eye(3)]))
        scale = (np.array(steps) - here).T / step
        # Slopes, cells and standard deviations of a map are those of its coordinates, whose metres may differ from
        # those on the ground by 0.01; in UTM it is 0.0004 to 0.001.
        distorted = np.abs(scale.T @ scale - np.eye(3)).max() > 2 * 0.01
        if self._is_outside() or not np.all(np.isfinite(scale)) or distorted:
            latitude, longitude = (math.degrees(angle) for angle in (self.origin.latitude, self.origin.longitude))
            raise UserError(
                f"Coordinate reference system {self.name} does not suit a map at latitude {latitude:.4f}, longitude "
                f"{longitude:.4f} degrees: it was made for another place, or its metres are not metres on the ground "
                "there; give one made for the place, such as utm."
            )
        if np.linalg.det(scale) < 0:
            raise UserError(
                f"Coordinate reference system {self.name} has axes that are not to the right and up; give another one."
            )

    def _is_outside(self) -> bool:
        """True if the origin is more than 6 degrees outside a stated area of use: beyond the next zone."""
        margin_deg = 6.0
        area = self.system.area_of_use
        if area is None:
            return False
        latitude, longitude = math.degrees(self.origin.latitude), math.degrees(self.origin.longitude)
        width = (area.east - area.west) % 360 or 360.0
        beyond = (longitude - area.west + margin_deg) % 360 > width + 2 * margin_deg
        return beyond or not area.south - margin_deg <= latitude <= area.north + margin_deg


def find_system(name: str) -> Any:
    """The coordinate reference system of a name, a pyproj.CRS.

    Raises:
        UserError: there is none, or it is not one in metres on the earth.
    """
    from pyproj import CRS  # noqa: PLC0415 (0.1 s; few programs need it)
    from pyproj.exceptions import CRSError  # noqa: PLC0415

    try:
        system = CRS.from_user_input(name)
    except CRSError as error:
        raise UserError(
            f"Coordinate reference system {name!r} is not known to PROJ; give utm or a code such as EPSG:32632."
        ) from error
    if fault := _fault(system):
        raise UserError(
            f"Coordinate reference system {name!r} {fault}; give utm or a code such as EPSG:32632, with "
            "EPSG:32632+5773 for heights above a geoid."
        )
    return system


@lru_cache(maxsize=16)
def _utm_zone(origin: Origin) -> str:
    """Code of the zone of UTM on WGS 84 in which an origin lies.

    Raises:
        UserError: UTM has none at the poles.
    """
    from pyproj.aoi import AreaOfInterest  # noqa: PLC0415
    from pyproj.database import query_utm_crs_info  # noqa: PLC0415

    latitude, longitude = math.degrees(origin.latitude), math.degrees(origin.longitude)
    area = AreaOfInterest(longitude, latitude, longitude, latitude)
    if not -80 <= latitude <= 84 or not (zones := query_utm_crs_info("WGS 84", area)):
        raise UserError(
            f"UTM has no zone at latitude {latitude:.4f} degrees; give another system, such as EPSG:5041 in the north "
            "or EPSG:5042 in the south."
        )
    return f"EPSG:{zones[0].code}"


def _fault(system: Any) -> str:
    """Fault that makes a system useless for a map, as the end of a message; empty: no fault."""
    if system.is_geographic:
        return "has angles for coordinates, a map needs metres"
    if not system.is_projected:
        return "is not a projection of the earth"
    if (system.datum is None and not system.is_compound) or "unknown" in str(system.geodetic_crs.datum).lower():
        return "has no datum, so that it states no position on the earth"
    if any(axis.unit_name != "metre" for axis in system.axis_info):
        units = ", ".join(dict.fromkeys(axis.unit_name for axis in system.axis_info))
        return f"has coordinates in {units}, a map needs metres"
    return ""
