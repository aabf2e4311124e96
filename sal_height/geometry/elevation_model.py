"""Elevation models: files (GeoTIFF and .npz), and their grids in a coordinate reference system and in the map."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import map_coordinates

from sal_height.errors import UserError
from sal_height.extras import import_extra
from sal_height.geometry.earth import EARTH_RADIUS, sphere_coordinates, sphere_point
from sal_height.geometry.geodesy import Origin
from sal_height.geometry.projection import Projection
from sal_height.numeric import F64, bilinear

LOWEST, HIGHEST = -12000.0, 9000.0  # m, elevations that occur on Earth

NO_DATA = (-9999.0, -32768.0)  # elevations that usually mean no data where a file does not declare it


@dataclass(frozen=True, eq=False)
class ElevationModel:
    """Heights of the ground on nodes around the map origin, bilinear between them.

    Attributes:
        name: name in messages.
        east: arc distances of the nodes from the map origin, increasing, shape (n_east,), m.
        north: arc distances of the nodes, increasing, shape (n_north,), m.
        height: heights above the sphere, shape (n_north, n_east), m.
        origin: geodetic position of the map origin; None if the file does not state it.
    """

    name: str
    east: F64
    north: F64
    height: F64
    origin: Origin | None = None

    def heights(self, east: npt.ArrayLike, north: npt.ArrayLike) -> F64:
        """Height (m) of the ground at arc distances `east`, `north` (m); NaN outside the model."""
        return bilinear(self.north, self.east, self.height, north, east)


@dataclass(frozen=True, eq=False)
class ElevationGrid:
    """Elevations in cells of a coordinate reference system, north up.

    Attributes:
        name: name in messages.
        elevation: elevations of the cells' centres, the northernmost row first, shape (rows, cols), m.
        west: outer edge of the first column, in units of the system, as the next three.
        north: outer edge of the first row.
        width: width of a cell.
        height: height of a cell.
        system: pyproj.CRS with three axes, geographic or projected.
    """

    name: str
    elevation: F64
    west: float
    north: float
    width: float
    height: float
    system: Any

    def model(self) -> ElevationModel:
        """The model around a map origin in its middle, on nodes as far apart as the cells are in the middle.

        Every node has the height of the model at its position, bilinear between cells: positions are those of PROJ,
        heights above the sphere of the map follow from those above the ellipsoid, or the geoid if the system states it.
        Where north of the system is not that of the map, nodes outside the model are left out.

        Raises:
            UserError: the system has no known relation to WGS 84, or needs a grid that is not installed.
        """
        projection = self._projection()
        rows, cols = self.elevation.shape
        dx, dy = self._spacing(projection)
        east, north = (np.arange(cols) - (cols - 1) / 2) * dx, (np.arange(rows) - (rows - 1) / 2) * dy
        level = float(self.elevation.mean())
        # PROJ gives positions at 33 knots along each side; between them coordinates are cubic, to 1 mm in 200 km.
        few_east, few_north = (np.linspace(axis[0], axis[-1], 33) for axis in (east, north))
        positions = self._in_cells(projection.coordinates(sphere_point(*np.meshgrid(few_east, few_north), level)))
        row, col, up = (RectBivariateSpline(few_north, few_east, values)(north, east) for values in positions)
        south_end, north_end, west_end, east_end = _inside(row, col, self.elevation.shape)
        kept = np.ix_(range(south_end, north_end), range(west_end, east_end))
        height = map_coordinates(self.elevation, [row[kept], col[kept]], order=1, mode="nearest") + level - up[kept]
        return ElevationModel(self.name, east[west_end:east_end], north[south_end:north_end], height, projection.origin)

    def _projection(self) -> Projection:
        """The system with its map origin on the ellipsoid below the middle of the model."""
        rows, cols = self.elevation.shape
        found = Projection(Origin(0.0, 0.0, 0.0), self.system, self.system.name)
        middle = np.array([self.west + cols / 2 * self.width, self.north - rows / 2 * self.height, 0.0])
        latitude, longitude, _ = (float(value) for value in found.geodetic(middle * self._units))
        if not np.isfinite([latitude, longitude]).all():
            raise UserError(f"Elevation model {self.name} is outside the area of its coordinate reference system.")
        return replace(found, origin=Origin(latitude, longitude, 0.0))

    @property
    def _units(self) -> F64:
        """Factors from units of the system to rad; 1 for lengths, which PROJ uses as they are."""
        if not self.system.is_geographic:
            return np.ones(3)
        return np.array([*(axis.unit_conversion_factor for axis in self.system.axis_info[:2]), 1.0])

    def _spacing(self, projection: Projection) -> tuple[float, float]:
        """Distance of the centres of cells eastwards and northwards in the middle of the model, m."""
        rows, cols = self.elevation.shape
        middle = np.array([self.west + cols / 2 * self.width, self.north - rows / 2 * self.height, 0.0])
        steps = middle + np.array([[0, 0, 0], [self.width, 0, 0], [0, self.height, 0]])
        east, north, _ = sphere_coordinates(projection.positions(steps * self._units))
        dx, dy = np.hypot(east[1:] - east[0], north[1:] - north[0]).tolist()
        return dx, dy

    def _in_cells(self, coordinates: F64) -> tuple[F64, F64, F64]:
        """Row and column of positions in the model, from 0 at the first cell's centre, and their heights, m."""
        x, y, up = np.moveaxis(coordinates / self._units, -1, 0)
        vertical = self.system.axis_info[2].unit_conversion_factor
        return (self.north - y) / self.height - 0.5, (x - self.west) / self.width - 0.5, up * vertical


def _inside(row: F64, col: F64, shape: tuple[int, int]) -> tuple[int, int, int, int]:
    """The first node from the south that is kept, the one after the last, and the same from the west.

    Nodes are left out on the side that reaches out farthest, until all are in cells of the model.

    Args:
        row: row in the model of each node, shape (north, east).
        col: column in the model of each node, same shape.
        shape: shape of the model.
    """
    beyond = np.maximum.reduce([-0.5 - row, row - shape[0] + 0.5, -0.5 - col, col - shape[1] + 0.5])
    ends = [0, len(row), 0, row.shape[1]]
    while ends[1] - ends[0] > 2 and ends[3] - ends[2] > 2:
        south, north, west, east = ends
        sides = (
            beyond[south, west:east],
            beyond[north - 1, west:east],
            beyond[south:north, west],
            beyond[south:north, east - 1],
        )
        worst = int(np.argmax([np.sum(side > 1e-6) / len(side) for side in sides]))
        if not (sides[worst] > 1e-6).any():
            break
        ends[worst] += -1 if worst % 2 else 1
    return ends[0], ends[1], ends[2], ends[3]


def read_elevation_model(path: Path) -> ElevationModel:
    """Read the heights of the ground around the map origin from a GeoTIFF or an .npz file.

    Rows run from north to south. A GeoTIFF states its position on the earth (`ElevationGrid`). Of an .npz only the size
    of cells is known; if it is in degrees, the parallel in the middle keeps its length.

    Raises:
        UserError: another kind of file, or one that cannot be used.
    """
    readers = {".tif": _read_geotiff, ".tiff": _read_geotiff, ".npz": _read_npz}
    if (suffix := path.suffix.lower()) not in readers:
        raise UserError(f"Elevation model {path} has the suffix {path.suffix!r}; allowed are .tif, .tiff and .npz.")
    return readers[suffix](path)


def _read_npz(path: Path) -> ElevationModel:
    """Read `elevation` (m) of an .npz, whose cells `dx`, `dy` are in metres, or in degrees.

    They are in degrees if the latitudes `ymin` and `ymax` of the edges are given too.
    """
    try:
        with np.load(path) as dem:
            missing = [key for key in ("elevation", "dx", "dy") if key not in dem]
            elevation = _as_float(np.asarray(dem.get("elevation", np.nan)))
            numbers = {key: float(dem[key]) for key in ("dx", "dy", "ymin", "ymax") if key in dem}
    except Exception as error:  # numpy, zipfile, zlib and the tokenizer each have their own error for a damaged file
        raise UserError(f"Elevation model {path} is not a readable .npz file: {_cause(error)}.") from error
    if missing:
        raise UserError(f"Elevation model {path} lacks {', '.join(missing)}; needed are elevation, dx and dy.")
    dx, dy = numbers["dx"], numbers["dy"]
    if {"ymin", "ymax"} <= numbers.keys():
        latitude = (numbers["ymin"] + numbers["ymax"]) / 2
        _check_latitude(path, latitude)
        metres = float(np.radians(1.0)) * EARTH_RADIUS
        dx, dy = dx * metres * float(np.cos(np.radians(latitude))), dy * metres
    _check_elevations(path, elevation, dx, dy)
    rows, cols = elevation.shape
    return ElevationModel(
        path.stem,
        east=(np.arange(cols) - (cols - 1) / 2) * dx,
        north=(np.arange(rows) - (rows - 1) / 2) * dy,
        height=elevation[::-1],
    )


def _read_geotiff(path: Path) -> ElevationModel:
    """Read the first band of a GeoTIFF, north up, in angles or in a projection."""
    rasterio = import_extra("rasterio", f"Reading {path}", "dem")
    from pyproj import CRS  # noqa: PLC0415 (0.1 s)

    try:
        with rasterio.open(path) as dem:
            elevation = _as_float(dem.read(1, masked=True)).filled(np.nan)
            transform, system = dem.transform, dem.crs and CRS(dem.crs.to_wkt())
    except (rasterio.errors.RasterioError, rasterio.errors.CRSError) as error:
        raise UserError(f"Elevation model {path} is not a readable GeoTIFF: {_cause(error)}.") from error
    if system is None or transform.b or transform.d or transform.a <= 0 or transform.e >= 0:
        raise UserError(
            f"Elevation model {path} must be north up with a coordinate reference system; reproject it with gdalwarp."
        )
    if not (system.is_geographic or system.is_projected):
        raise UserError(
            f"Elevation model {path} has a coordinate reference system that is neither geographic nor projected; "
            "reproject it with gdalwarp."
        )
    if system.is_geographic:
        _check_latitude(path, transform.f + transform.e * elevation.shape[0] / 2)
    in_space = system if len(system.axis_info) > 2 else system.to_3d()
    if system.is_compound:
        elevation *= in_space.axis_info[2].unit_conversion_factor
    _check_elevations(path, elevation, transform.a, -transform.e)
    return ElevationGrid(path.stem, elevation, transform.c, transform.f, transform.a, -transform.e, in_space).model()


def _check_latitude(path: Path, latitude: float) -> None:
    """Check that the middle of a model (degrees) lies between the poles.

    Raises:
        UserError: it does not.
    """
    if not abs(latitude) < 90:
        raise UserError(
            f"Elevation model {path.stem} has its middle at latitude {latitude:.6g}; allowed is between -90 and 90."
        )


def _check_elevations(path: Path, elevation: Any, dx: float, dy: float) -> None:
    """Check that a terrain can be made of elevations (m) in cells of dx x dy.

    Raises:
        UserError: it cannot.
    """
    for fault in _faults(elevation, dx, dy):
        raise UserError(f"Elevation model {path.stem} has {fault}.")


def _cause(error: Exception) -> str:
    """Text of an error of a library, as part of a message."""
    return " ".join(str(error.__cause__ or error).split()).rstrip(".") or type(error).__name__


def _as_float(elevation: Any) -> Any:
    """The array as float64; a complex one as it is, for `_faults` to refuse."""
    return elevation if np.iscomplexobj(elevation) else elevation.astype(np.float64)


def _faults(elevation: Any, dx: float, dy: float) -> Iterator[str]:
    """Faults of elevations (m) in cells of dx x dy (m), each as the end of a message."""
    if np.iscomplexobj(elevation):
        yield "complex elevations; they must be real numbers"
    if not (0 < dx < np.inf and 0 < dy < np.inf):
        yield f"cells of {dx:.6} x {dy:.6} m; both must be greater than 0 and finite"
    if elevation.ndim != 2 or min(elevation.shape) < 2:
        yield f"elevations of shape {elevation.shape}; 2 x 2 or more are needed"
    if holes := int(np.count_nonzero(~np.isfinite(elevation))):
        yield f"{holes} cells without elevation; fill them first, e.g. with gdal_fillnodata"
    for value in NO_DATA:
        if cells := int(np.count_nonzero(elevation == value)):
            yield (
                f"{cells} cells of {value:g} m, which looks like undeclared no-data; declare it (NaN in an .npz, "
                "gdal_edit -a_nodata for a .tif) and fill the holes"
            )
    low, high = float(elevation.min()), float(elevation.max())
    if low < LOWEST or high > HIGHEST:
        yield f"elevations from {low:.6g} to {high:.6g} m; allowed are {LOWEST:g} to {HIGHEST:g} m"
