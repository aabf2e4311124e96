"""Elevation models in files: GeoTIFF and .npz."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from sal_height.errors import UserError
from sal_height.extras import import_extra
from sal_height.geometry.earth import EARTH_RADIUS
from sal_height.geometry.elevation_grid import ElevationGrid, ElevationModel

LOWEST, HIGHEST = -12000.0, 9000.0  # m, elevations that occur on Earth
NO_DATA = (-9999.0, -32768.0)  # elevations that usually mean no data where a file does not declare it


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
