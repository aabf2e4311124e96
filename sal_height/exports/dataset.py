"""Heights as labelled arrays (xarray), with names and units of the CF conventions, in netCDF and Zarr."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import sal_height
from sal_height.errors import UserError
from sal_height.exports.heights import DwellHeights, RecordedHeights
from sal_height.extras import import_extra
from sal_height.geometry import Origin
from sal_height.io import check_new_folder, unfinished, writing
from sal_height.relief import LAYERS, labelled_heights

CONVENTIONS = "CF-1.11"

BATCH = 64
"""Number of dwells in memory at a time while files are written."""


def open_heights(bag: Path | str, topic: str = "", *, origin: Origin | None = None, crs: str = "utm") -> Any:
    """The heights of a bag as an xarray.Dataset, all in memory.

    Variables have the dimensions dwell, surface (strongest first), row and col; a surface that a pixel lacks is NaN.
    Coordinates x and y are easting and northing of each surface where the origin of the map is known, else distances
    along the sphere of the map; time is that of a dwell's first pulse.

    Args:
        bag: folder or file.
        topic: topic of the heights; empty: /ml/height, or the first in the bag.
        origin: origin of the map frame on the earth; None: that in the bag, if any.
        crs: name of the coordinate reference system; "local": none.

    Raises:
        UserError: the package xarray is not installed, the bag has no such heights, or their grids differ in size.
    """
    heights = RecordedHeights.of_bag(Path(bag), topic, origin, crs)
    return _joined(heights, "reading")


def write_netcdf(heights: RecordedHeights, path: Path) -> int:
    """Write the heights of a bag as netCDF 4; returns the number of dwells.

    Raises:
        UserError: a package is not installed, grids differ in size, or the file cannot be written.
    """
    dataset = _joined(heights, "netcdf")
    arrays = [name for name, variable in dataset.variables.items() if variable.ndim > 1]
    encoding = {name: {"zlib": True, "complevel": 1} for name in arrays}
    with unfinished(path) as partial:
        dataset.to_netcdf(partial, engine="h5netcdf", encoding=encoding, unlimited_dims=["dwell"])
    return int(dataset.sizes["dwell"])


def write_zarr(heights: RecordedHeights, path: Path) -> int:
    """Write the heights of a bag to a new folder as Zarr, some dwells at a time; returns the number of dwells.

    Raises:
        UserError: a package is not installed, grids differ in size, or the folder exists or cannot be written.
    """
    _xarray(heights)
    check_new_folder(path)
    partial, count = path.with_name(f".{path.name}.part"), 0
    with writing(path):
        try:
            for batch in _batches(heights, "zarr"):
                how = {"append_dim": "dwell"} if count else {"mode": "w"}
                batch.to_zarr(partial, consolidated=False, **how)
                count += batch.sizes["dwell"]
            if path.is_dir():
                path.rmdir()
            partial.replace(path)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
    return count


def _joined(heights: RecordedHeights, task: str) -> Any:
    """The dataset of all dwells.

    Raises:
        UserError: an error of `_batches`, or a package is not installed.
    """
    xarray = _xarray(heights)
    batches = list(_batches(heights, task))
    return xarray.concat(batches, "dwell", data_vars="minimal", coords="minimal", compat="override", join="exact")


def _batches(heights: RecordedHeights, task: str) -> Iterator[Any]:
    """Datasets of some dwells each.

    Raises:
        UserError: there is no dwell, or their grids differ in size.
    """
    batch: list[DwellHeights] = []
    shape: tuple[int, ...] = ()
    surfaces = 0
    for dwell in heights.dwells(task):
        shape = shape or dwell.field.validity.shape
        surfaces = surfaces or len(dwell.field.surfaces)
        if dwell.field.validity.shape != shape or len(dwell.field.surfaces) != surfaces:
            raise UserError(
                f"Topic {heights.topic} of bag {heights.reader.path} has images of {len(dwell.field.surfaces)} "
                f"surfaces of {dwell.field.validity.shape} pixels at dwell {dwell.dwell}, and of {surfaces} of {shape} "
                "before; arrays need one size; cut the bag with sal-height bag cut --dwells."
            )
        batch.append(dwell)
        if len(batch) == BATCH:
            yield _dataset_of(heights, batch)
            batch = []
    if batch:
        yield _dataset_of(heights, batch)
    elif not shape:
        raise UserError(f"Topic {heights.topic} of bag {heights.reader.path} has no readable image.")


def _dataset_of(heights: RecordedHeights, dwells: list[DwellHeights]) -> Any:
    """The dataset of some dwells."""
    xarray = _xarray(heights)
    layers, places = labelled_heights([one.field for one in dwells], heights.projection)
    if heights.projection is not None:
        layers["crs"] = ((), np.int32(0), heights.projection.system.to_cf())
        for name in LAYERS:
            layers[name][2]["grid_mapping"] = "crs"
    stamps = np.array([one.stamp_ns for one in dwells], dtype="datetime64[ns]")
    axes = {
        "dwell": ("dwell", np.array([one.dwell for one in dwells], np.uint32), {"long_name": "number of the dwell"}),
        "time": ("dwell", stamps, {"standard_name": "time", "long_name": "first pulse of the dwell"}),
    }
    attributes = {
        "Conventions": CONVENTIONS,
        "title": "Heights of the surfaces in each pixel",
        "source": f"sal_height {sal_height.__version__}",
        **heights.facts,
    }
    return xarray.Dataset(layers, {**axes, **places}, attributes)


def _xarray(heights: RecordedHeights) -> Any:
    """Return the package, which is an extra.

    Raises:
        UserError: it or what it needs for files is not installed.
    """
    doing = f"Making arrays of bag {heights.reader.path}"
    _, _, xarray = (import_extra(name, doing) for name in ("h5netcdf", "zarr", "xarray"))
    return xarray
