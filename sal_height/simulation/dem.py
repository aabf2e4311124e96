"""Terrain from elevation models in files: GeoTIFF and .npz."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sal_height.errors import UserError
from sal_height.geometry import EARTH_RADIUS
from sal_height.simulation.scene import Scene

LOWEST, HIGHEST = -12000.0, 9000.0
"""Elevations there are on Earth, m."""


NO_DATA = (-9999.0, -32768.0)
"""Elevations that stand for none where a file does not say so."""


def is_file(path: str) -> bool:
    """Whether a path names a file; one that no file can have (too long, a zero in it) does not."""
    try:
        return Path(path).is_file()
    except (OSError, ValueError):
        return False


def read_elevation_model(path: Path) -> Scene:
    """Terrain of uniform brightness from a GeoTIFF or an .npz file.

    Raises:
        UserError: another kind of file, or one that cannot be used.
    """
    if path.suffix.lower() in (".tif", ".tiff"):
        return _from_geotiff(path)
    if path.suffix.lower() == ".npz":
        return _from_npz(path)
    raise UserError(f"Scene {path} has the suffix {path.suffix!r}; allowed are .tif, .tiff and .npz.")


def _from_npz(path: Path) -> Scene:
    """An .npz with `elevation` (m, north row first) and the spacings `dx`, `dy`.

    Spacings are in metres, or in degrees if the latitudes `ymin` and `ymax` of the edges are given too.
    """
    try:
        with np.load(path) as dem:
            missing = [key for key in ("elevation", "dx", "dy") if key not in dem]
            elevation = _as_float(np.asarray(dem.get("elevation", np.nan)))
            numbers = {key: float(dem[key]) for key in ("dx", "dy", "ymin", "ymax") if key in dem}
    except Exception as error:  # numpy, zipfile, zlib and the tokenizer each have their own for a damaged file
        raise UserError(f"Scene {path} is not a readable .npz file: {_cause(error)}.") from error
    if missing:
        raise UserError(f"Scene {path} lacks {', '.join(missing)}; needed are elevation, dx and dy.")
    if {"ymin", "ymax"} <= set(numbers):
        latitude = (numbers["ymin"] + numbers["ymax"]) / 2
        return _from_degrees(path.stem, elevation, latitude, numbers["dx"], numbers["dy"])
    return _centred(path.stem, elevation, numbers["dx"], numbers["dy"])


def _from_geotiff(path: Path) -> Scene:
    """The first band of a GeoTIFF, north up, in degrees or in a projection whose unit is the metre."""
    try:
        import rasterio  # noqa: PLC0415 (an extra)
    except ImportError as error:
        raise UserError(f"Reading {path} needs rasterio; install it with: pip install 'sal_height[dem]'.") from error
    try:
        with rasterio.open(path) as dem:
            elevation = _as_float(dem.read(1, masked=True)).filled(np.nan)
            transform, crs = dem.transform, dem.crs
        geographic = crs is not None and crs.is_geographic
        unit = crs.linear_units_factor[1] if crs is not None and crs.is_projected else None
    except (rasterio.errors.RasterioError, rasterio.errors.CRSError) as error:
        raise UserError(f"Scene {path} is not a readable GeoTIFF: {_cause(error)}.") from error
    if crs is None or transform.b or transform.d or transform.a <= 0 or transform.e >= 0:
        raise UserError(
            f"Scene {path} must be north up with a coordinate reference system; reproject it with gdalwarp."
        )
    if geographic:
        latitude = transform.f + transform.e * elevation.shape[0] / 2
        return _from_degrees(path.stem, elevation, latitude, transform.a, -transform.e)
    if unit is None:
        raise UserError(
            f"Scene {path} has a coordinate reference system that is neither geographic nor projected; "
            "reproject it with gdalwarp."
        )
    return _centred(path.stem, elevation, transform.a * unit, -transform.e * unit)


def _cause(error: Exception) -> str:
    """What an error of a library says, as part of a sentence."""
    return " ".join(str(error.__cause__ or error).split()).rstrip(".") or type(error).__name__


def _as_float(elevation: Any) -> Any:
    """The array as float64; a complex one as it is, for `_centred` to refuse."""
    return elevation if np.iscomplexobj(elevation) else elevation.astype(np.float64)


def _from_degrees(name: str, elevation: npt.ArrayLike, latitude_deg: float, dx: float, dy: float) -> Scene:
    """Terrain from rows of constant latitude, spaced `dx` and `dy` degrees, the middle one at `latitude_deg`.

    That parallel keeps its length; over a few tens of kilometres the others are off by less than a cell.
    """
    if not abs(latitude_deg) < 90:
        raise UserError(f"Scene {name} has its middle at latitude {latitude_deg:.6g}; allowed is between -90 and 90.")
    metres = float(np.radians(1.0)) * EARTH_RADIUS
    return _centred(name, elevation, dx * metres * float(np.cos(np.radians(latitude_deg))), dy * metres)


def _centred(name: str, elevation: npt.ArrayLike, dx: float, dy: float) -> Scene:
    """Terrain of uniform brightness around the map origin, from rows that run north to south; holes are refused."""
    if np.iscomplexobj(elevation):
        raise UserError(f"Scene {name} has complex elevations; they must be real numbers.")
    elevation = np.asarray(elevation, dtype=np.float64)
    if not (0 < dx < np.inf and 0 < dy < np.inf):
        raise UserError(f"Scene {name} has cells of {dx:.6} x {dy:.6} m; both must be greater than 0 and finite.")
    if elevation.ndim != 2 or min(elevation.shape) < 2:
        raise UserError(f"Scene {name} has elevations of shape {elevation.shape}; 2 x 2 or more are needed.")
    if holes := int(np.count_nonzero(~np.isfinite(elevation))):
        raise UserError(
            f"Scene {name} has {holes} cells without elevation; fill them first, e.g. with gdal_fillnodata."
        )
    for value in NO_DATA:
        if cells := int(np.count_nonzero(elevation == value)):
            raise UserError(
                f"Scene {name} has {cells} cells of {value:g} m, which looks like undeclared no-data; "
                "declare it (NaN in an .npz, gdal_edit -a_nodata for a .tif) and fill the holes."
            )
    low, high = float(elevation.min()), float(elevation.max())
    if low < LOWEST or high > HIGHEST:
        raise UserError(
            f"Scene {name} has elevations from {low:.6g} to {high:.6g} m; allowed are {LOWEST:g} to {HIGHEST:g} m."
        )
    rows, cols = elevation.shape
    return Scene(
        name,
        east=(np.arange(cols) - (cols - 1) / 2) * dx,
        north=(np.arange(rows) - (rows - 1) / 2) * dy,
        height=elevation[::-1],
        brightness=np.ones(elevation.shape),
    )
