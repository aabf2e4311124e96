"""Conversion of height images, and the images and point clouds that viewers show of them."""

from __future__ import annotations

import array
from collections.abc import Sequence

import numpy as np
from sal_height_msgs import msg as messages
from sensor_msgs.msg import Image, PointCloud2, PointField
from std_msgs.msg import Header

from sal_height.elevation import Validity
from sal_height.errors import Rejected, UserError
from sal_height.geometry import ApertureState, Grid, above_place
from sal_height.messages.basics import (
    MAP_FRAME,
    aperture_to_message,
    check_geometry,
    float_view,
    grid_from_message,
    grid_to_message,
    to_bytes,
    to_floats,
)
from sal_height.numeric import F32
from sal_height.relief import HeightField, Surface

LAYERS = ("height", "sigma", "cnr_db", "east", "north")
"""Names of the fields of a Surface message."""

USABLE = (Validity.OK, Validity.TWO_SCATTERERS, Validity.INTERPOLATED)
"""Validities of the pixels that have a height."""


def height_to_message(
    field: HeightField,
    aperture: ApertureState,
    looks: tuple[int, int],
    estimator: str,
    source: messages.ComplexImage | messages.HeightImage,
    provenance: messages.Provenance,
) -> messages.HeightImage:
    """Return the HeightImage of a field of heights, with the stamp and the dwell of its `source`."""
    image = messages.HeightImage(
        header=source.header,
        dwell=source.dwell,
        estimator=estimator,
        grid=grid_to_message(field.grid),
        aperture=aperture_to_message(aperture),
        range_looks=looks[0],
        azimuth_looks=looks[1],
        validity=to_bytes(field.validity),
        provenance=provenance,
    )
    image.surfaces = [_surface_to_message(surface, field.grid) for surface in (field.first, field.second) if surface]
    return image


def _surface_to_message(surface: Surface, grid: Grid) -> messages.Surface:
    offset = surface.positions - grid.origin
    values = (surface.height, surface.sigma, surface.cnr_db, offset[..., 0], offset[..., 1])
    return messages.Surface(**{name: to_floats(numbers) for name, numbers in zip(LAYERS, values, strict=True)})


def field_from_message(image: messages.HeightImage) -> HeightField:
    """Return the heights of the first surface of a HeightImage.

    A pixel that is usable by its validity but whose height, sigma, east or north is not finite, or whose sigma is not
    greater than 0, gets the validity MISSING_DATA; `bad_pixels` counts them.

    Raises:
        Rejected: the image cannot be used; the sentence names the field, its value and what is allowed.
    """
    where = f"HeightImage of dwell {image.dwell}"
    if image.header.frame_id != MAP_FRAME:
        raise Rejected("wrong frames", f"{where} is in {image.header.frame_id!r}; it must be in {MAP_FRAME!r}.")
    if not image.surfaces:
        raise Rejected("wrong size", f"{where} has no surface; it must have at least one.")
    grid, first = grid_from_message(image.grid), image.surfaces[0]
    count = grid.rows * grid.cols
    sizes = {"validity": len(image.validity)} | {f"surfaces[0].{name}": len(getattr(first, name)) for name in LAYERS}
    for name, size in sizes.items():
        if size != count or count == 0:
            raise Rejected(
                "wrong size",
                f"{where}: {name} has {size} entries, {grid.rows} x {grid.cols} pixels need {count} (at least 1).",
            )
    check_geometry(image.grid, image.aperture, where)
    height, sigma, cnr_db, east, north = (
        float_view(getattr(first, name), grid.shape).astype(np.float64) for name in LAYERS
    )
    validity = np.array(image.validity, dtype=np.uint8).reshape(grid.shape)
    usable = np.isin(validity, USABLE)
    sound = np.isfinite(height) & (sigma > 0) & np.isfinite(sigma + east + north)
    validity[usable & ~sound] = Validity.MISSING_DATA
    usable &= sound
    positions = above_place(grid.origin[0] + east, grid.origin[1] + north, height)
    positions[~usable] = np.nan
    height, sigma = (np.where(usable, values, np.nan) for values in (height, sigma))
    return HeightField(grid, validity, Surface(height, sigma, cnr_db, positions), None)


def bad_pixels(image: messages.HeightImage, field: HeightField) -> int:
    """Return the number of pixels that are usable by their validity in `image` but masked in `field`, made of it."""
    said = np.isin(np.array(image.validity, dtype=np.uint8), USABLE)
    return int(np.count_nonzero(said & ~np.isin(field.validity.ravel(), USABLE)))


def bad_pixel_warning(image: messages.HeightImage, count: int) -> UserError:
    """Return the warning that says how many pixels of a height image were masked."""
    return UserError(
        f"HeightImage of dwell {image.dwell}: {count} of {len(image.validity)} pixels are usable by their validity, "
        "but their height, sigma, east or north is not finite, or sigma is not greater than 0; they are left out."
    )


def height_picture(image: messages.HeightImage) -> Image:
    """Return the heights of the first surface as a 32FC1 image for image viewers, NaN where they are not valid."""
    return float_picture(float_view(image.surfaces[0].height, (image.grid.rows, image.grid.cols)), image.header)


def float_picture(values: F32, header: Header) -> Image:
    """Return an array (rows, cols) as a 32FC1 image."""
    rows, cols = values.shape
    data = array.array("B", values.tobytes())
    return Image(header=header, height=rows, width=cols, encoding="32FC1", step=4 * cols, data=data)


def height_points(field: HeightField, image: messages.HeightImage) -> PointCloud2:
    """Return all scatterers as a cloud of points x, y, z (m, map) with height, sigma (m) and cnr_db for viewers."""
    points = np.concatenate([_points(surface) for surface in (field.first, field.second) if surface])
    return point_cloud(points, ("x", "y", "z", "height", "sigma", "cnr_db"), image.header)


def point_cloud(points: F32, names: Sequence[str], header: Header) -> PointCloud2:
    """Return points of shape (points, fields) as a cloud whose fields have these `names`."""
    return PointCloud2(
        header=header,
        height=1,
        width=len(points),
        fields=[PointField(name=n, offset=4 * i, datatype=PointField.FLOAT32, count=1) for i, n in enumerate(names)],
        point_step=4 * len(names),
        row_step=4 * len(names) * len(points),
        data=array.array("B", points.tobytes()),
        is_dense=True,
    )


def _points(surface: Surface) -> F32:
    """Return position, height, sigma and CNR of the scatterers of a surface, shape (scatterers, 6)."""
    seen = np.isfinite(surface.height)
    columns = [*surface.positions[seen].T, surface.height[seen], surface.sigma[seen], surface.cnr_db[seen]]
    return np.ascontiguousarray(np.stack(columns, axis=-1), dtype=np.float32)
