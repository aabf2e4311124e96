"""A relief map as a Cloud-Optimized GeoTIFF that any GIS places on the earth."""

from __future__ import annotations

import struct
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from sal_height.errors import UserError
from sal_height.extras import import_extra
from sal_height.geometry import WGS_84, Projection
from sal_height.io import write_whole
from sal_height.relief.cell_map import Relief

BANDS = {
    "height": "height at the cell's centre, above {datum}, m",
    "sigma": "standard deviation of the height at that position, m",
    "disagreement": "spread of the dwells' heights over that expected from sigma (Birge ratio)",
    "count": "number of height images that saw the cell",
}
"""Bands in their order, layers of `Relief`, and how the file describes them."""

KIND = {"kind": "what the height rests on: 0 measured, 1 interpolated, 2 shadow, 3 unseen"}
"""Another band, of a map that says so."""

UNITS = {"height": "m", "sigma": "m"}
"""Units of bands that have one."""

UNPLACED = (
    'LOCAL_CS["map axes, origin unknown",LOCAL_DATUM["origin of the map",32767],UNIT["metre",1],'
    'AXIS["East",EAST],AXIS["North",NORTH]]'
)
"""Engineering coordinate system (OGC WKT 1) of a map whose origin is not known."""

SPHERE = "the sphere of 6371008.8 m that touches the earth at the map's origin"
"""Reference surface of the heights of such a map."""

VERTICAL_KEY, MEAN_SEA_LEVEL = 4096, 5714
"""Key of GeoTIFF that has the code of the vertical system, and the code of EPSG:5714, which is replaced."""


def check_geotiff(path: Path) -> None:
    """Check, before a map is made, that it can be written to `path`.

    Raises:
        UserError: rasterio is not installed, the folder does not exist, or `path` is a folder.
    """
    import_extra("rasterio", f"Writing {path}", "dem")
    if path.is_dir():
        raise UserError(f"File {path} cannot be written: it is a folder.")
    if not path.parent.is_dir():
        raise UserError(f"File {path} cannot be written: folder {path.parent} does not exist.")


def write_geotiff(
    path: Path, relief: Relief, projection: Projection | None, stamp_ns: int, tags: Mapping[str, str]
) -> None:
    """Write a relief map with north up, one float32 band for each layer, NaN where nothing was seen.

    The file is a Cloud-Optimized GeoTIFF, whose overviews are every second cell of the level below them. It appears
    under its name when it is complete, in place of one that was there.

    Args:
        path: path of the file.
        relief: the map, in coordinates of the projection.
        projection: the coordinate reference system; None: the origin is not known, the file has local coordinates.
        stamp_ns: time of the last dwell in the map, ns since 1970.
        tags: metadata of the file.

    Raises:
        UserError: rasterio is not installed, or the file cannot be written.
    """
    rasterio = import_extra("rasterio", f"Writing {path}", "dem")
    from rasterio.shutil import copy  # noqa: PLC0415 (an extra)

    bands = BANDS if relief.kind is None else BANDS | KIND
    datum = _datum(projection)
    rows, cols = relief.height.shape
    west = relief.east - relief.cell_size / 2
    north = relief.north + (rows - 0.5) * relief.cell_size
    with rasterio.MemoryFile() as plain, rasterio.MemoryFile() as memory:  # where the disk cannot cut them short
        with plain.open(
            driver="GTiff",
            width=cols,
            height=rows,
            count=len(bands),
            dtype="float32",
            nodata=np.nan,
            crs=_system(projection),
            transform=rasterio.Affine(relief.cell_size, 0.0, west, 0.0, -relief.cell_size, north),
            interleave="band",
            bigtiff="if_safer",
        ) as file:
            date = time.strftime("%Y:%m:%d %H:%M:%S", time.gmtime(stamp_ns // 1_000_000_000))
            file.update_tags(**tags, VERTICAL_DATUM=datum, TIFFTAG_DATETIME=date)
            for band, (layer, description) in enumerate(bands.items(), start=1):
                file.write(getattr(relief, layer)[::-1].astype(np.float32), band)
                file.set_band_description(band, layer)
                file.set_band_unit(band, UNITS.get(layer, ""))
                file.update_tags(band, description=description.format(datum=datum))
        copy(
            plain.name,
            memory.name,
            driver="COG",
            compress="deflate",
            predictor="yes",
            level=1,
            num_threads="all_cpus",
            overview_resampling="nearest",
            bigtiff="if_safer",
        )
        written = bytearray(memory.getbuffer())
    if projection and _code_in_space(projection) == WGS_84:
        _state_ellipsoidal_heights(written)
    write_whole(path, bytes(written))


def _datum(projection: Projection | None) -> str:
    """Name of the surface to which heights refer."""
    if projection is None:
        return SPHERE
    if projection.has_geoid:
        vertical = projection.system.sub_crs_list[1]
        return f"{vertical.datum.name} ({vertical.name})"
    return f"the ellipsoid {projection.system.ellipsoid.name} ({_code_in_space(projection)})"


def _code_in_space(projection: Projection) -> str:
    """Code or name of the system of latitude, longitude and height on which a projection without a geoid rests."""
    if projection.has_geoid:
        return ""
    geodetic = projection.system.geodetic_crs.to_3d()
    return ":".join(geodetic.to_authority() or [geodetic.name])


def _system(projection: Projection | None) -> str:
    """The system of a projection as GDAL can write it."""
    if projection is None:
        return UNPLACED
    if projection.has_geoid:
        return str(projection.system.to_wkt())
    flat = projection.system.to_2d()
    if _code_in_space(projection) != WGS_84:
        return str(flat.to_wkt())
    return (
        f'COMPD_CS["{flat.name}",{flat.to_wkt("WKT1_GDAL")},VERT_CS["ellipsoidal height",'
        f'VERT_DATUM["ellipsoid",2005,AUTHORITY["EPSG","5100"]],UNIT["metre",1],AXIS["Up",UP],'
        f'AUTHORITY["EPSG","{MEAN_SEA_LEVEL}"]]]'
    )


def _state_ellipsoidal_heights(written: bytearray) -> None:
    """Replace, in a GeoTIFF, the code of heights above the sea by that of heights above the ellipsoid of WGS 84.

    The code is 4979 (OGC 19-008r4, 7.5.5). GDAL 3.10 reads it, but writes it only into a separate file next to the
    GeoTIFF. Codes of other ellipsoids it does not read either: the tags name those in words.
    """
    old = struct.pack("<4H", VERTICAL_KEY, 0, 1, MEAN_SEA_LEVEL)
    at = written.index(old)
    written[at : at + len(old)] = struct.pack("<4H", VERTICAL_KEY, 0, 1, int(WGS_84.removeprefix("EPSG:")))
