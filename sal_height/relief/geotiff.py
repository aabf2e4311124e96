"""A relief map as a GeoTIFF that any GIS places on the earth."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sal_height.errors import UserError
from sal_height.io import write_whole
from sal_height.relief.map import Relief

BANDS = {
    "height": "height at the cell's centre, above the sphere of 6371008.8 m that touches the earth at the origin, m",
    "sigma": "standard deviation of the height at that place, m",
    "disagreement": "spread of the dwells' heights over that expected from sigma (Birge ratio)",
    "count": "number of height images that saw the cell",
}
"""Bands in their order, layers of `Relief`, and how the file describes them."""

KIND = {"kind": "what the height rests on: 0 measured, 1 interpolated, 2 shadow, 3 unseen"}
"""Another band, of a map that says so."""

PLACED = "+proj=aeqd +lat_0={!r} +lon_0={!r} +datum=WGS84 +units=m +no_defs"
"""Coordinate system about a known origin (latitude, longitude in degrees): azimuthal equidistant on the ellipsoid."""

UNPLACED = (
    'LOCAL_CS["map axes, origin unknown",LOCAL_DATUM["origin of the map",32767],UNIT["metre",1],'
    'AXIS["East",EAST],AXIS["North",NORTH]]'
)
"""Engineering coordinate system (OGC WKT 1) of a map whose origin is not known."""


def check_geotiff(path: Path) -> None:
    """Check, before a map is made, that it can be written to `path`.

    Raises:
        UserError: rasterio is not installed, the folder does not exist, or `path` is a folder.
    """
    _rasterio(path)
    if path.is_dir():
        raise UserError(f"File {path} cannot be written: it is a folder.")
    if not path.parent.is_dir():
        raise UserError(f"File {path} cannot be written: folder {path.parent} does not exist.")


def write_geotiff(path: Path, relief: Relief, origin: tuple[float, float] | None, tags: Mapping[str, str]) -> None:
    """Write a relief map with north up, one float32 band for each layer, NaN where nothing was seen.

    The map's coordinates are arc distances east and north of its origin, hence those of the azimuthal equidistant
    projection about it. On the WGS-84 ellipsoid a cell 10 km from the origin then lies within 1 cm of where local ENU
    axes place it; heights, which refer to a sphere, differ from ellipsoidal ones by up to 5 cm there. The file appears
    under its name when it is complete, in place of one that was there.

    Args:
        path: of the file.
        relief: the map.
        origin: latitude and longitude of the map's origin, degrees; None: not known, the file has local coordinates.
        tags: metadata of the file.

    Raises:
        UserError: rasterio is not installed, or the file cannot be written.
    """
    rasterio = _rasterio(path)
    bands = BANDS if relief.kind is None else BANDS | KIND
    rows, cols = relief.height.shape
    west = relief.east - relief.cell_size / 2
    north = relief.north + (rows - 0.5) * relief.cell_size
    with rasterio.MemoryFile() as memory:  # written there first, where the disk cannot cut it short
        with memory.open(
            driver="GTiff",
            width=cols,
            height=rows,
            count=len(bands),
            dtype="float32",
            nodata=np.nan,
            crs=PLACED.format(*origin) if origin else UNPLACED,
            transform=rasterio.Affine(relief.cell_size, 0.0, west, 0.0, -relief.cell_size, north),
            compress="deflate",
            predictor=3,
            zlevel=1,
            interleave="band",
            tiled=True,
            bigtiff="if_safer",
        ) as file:
            file.update_tags(**tags)
            for band, (layer, description) in enumerate(bands.items(), start=1):
                file.write(getattr(relief, layer)[::-1].astype(np.float32), band)
                file.set_band_description(band, layer)
                file.update_tags(band, description=description)
        write_whole(path, memory.getbuffer())


def _rasterio(path: Path) -> Any:
    """Return the package, which is an extra.

    Raises:
        UserError: it is not installed.
    """
    try:
        import rasterio.io  # noqa: PLC0415 (an extra)
    except ImportError as error:
        raise UserError(f"Writing {path} needs rasterio; install it with: pip install 'sal_height[dem]'.") from error
    return rasterio
