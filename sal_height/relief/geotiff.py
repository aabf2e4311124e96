"""A relief map as a GeoTIFF that any GIS places on the earth."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from sal_height.errors import UserError
from sal_height.geometry import EARTH_RADIUS
from sal_height.io import writing
from sal_height.relief.map import Relief

BANDS = {
    "height": "mean height above the sphere, m",
    "sigma": "standard deviation of the mean height, m",
    "disagreement": "of dwells, over what sigma lets expect",
    "count": "height images that saw the cell",
}
"""Bands in their order, layers of `Relief`, and how the file describes them."""


def check_geotiff(path: Path) -> None:
    """Make sure, before a map is made, that it can be written to `path`.

    Raises:
        UserError: there is no rasterio, the folder does not exist, or there is a folder of that name.
    """
    _rasterio(path)
    if path.is_dir():
        raise UserError(f"File {path} cannot be written: it is a folder.")
    if not path.parent.is_dir():
        raise UserError(f"File {path} cannot be written: folder {path.parent} does not exist.")


def write_geotiff(
    path: Path, relief: Relief, latitude_deg: float, longitude_deg: float, tags: Mapping[str, str]
) -> None:
    """Write a relief map with north up, one float32 band for each layer, NaN where nothing was seen.

    The coordinates are those of map, arc distances east and north: on a sphere of EARTH_RADIUS that is the azimuthal
    equidistant projection about the map's origin. The file appears under its name when it is whole, in the place of
    one that was there.

    Args:
        path: of the file.
        relief: the map.
        latitude_deg: of the map's origin, degrees.
        longitude_deg: of the map's origin, degrees.
        tags: metadata of the file.

    Raises:
        UserError: there is no rasterio, or the file cannot be written.
    """
    with _rasterio(path).MemoryFile() as memory:
        _fill(memory, relief, latitude_deg, longitude_deg, tags)
        with writing(path):
            _replace(path, memory.getbuffer())


def _fill(memory: Any, relief: Relief, latitude_deg: float, longitude_deg: float, tags: Mapping[str, str]) -> None:
    """Write the file into memory, where the disk cannot cut it short."""
    rows, cols = relief.height.shape
    west = relief.east - relief.cell_size / 2
    north = relief.north + (rows - 0.5) * relief.cell_size
    with memory.open(
        driver="GTiff",
        width=cols,
        height=rows,
        count=len(BANDS),
        dtype="float32",
        nodata=np.nan,
        crs=f"+proj=aeqd +lat_0={latitude_deg!r} +lon_0={longitude_deg!r} +R={EARTH_RADIUS!r} +units=m +no_defs",
        transform=_rasterio(Path()).Affine(relief.cell_size, 0.0, west, 0.0, -relief.cell_size, north),
        compress="deflate",
        predictor=3,
        zlevel=1,
        interleave="band",
        tiled=True,
        bigtiff="if_safer",
    ) as file:
        file.update_tags(**tags)
        for band, (layer, description) in enumerate(BANDS.items(), start=1):
            file.write(getattr(relief, layer)[::-1].astype(np.float32), band)
            file.set_band_description(band, layer)
            file.update_tags(band, description=description)


def _replace(path: Path, content: memoryview) -> None:
    """Put a whole file in the place of `path`, or leave that as it is."""
    part = path.with_name(f".{path.name}.part")
    try:
        with part.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except BaseException:
        with suppress(OSError):
            part.unlink()
        raise


def _rasterio(path: Path) -> Any:
    """The package, which is an extra.

    Raises:
        UserError: it is not installed.
    """
    try:
        import rasterio.io  # noqa: PLC0415 (an extra)
    except ImportError as error:
        raise UserError(f"Writing {path} needs rasterio; install it with: pip install 'sal_height[dem]'.") from error
    return rasterio
