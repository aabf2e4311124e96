"""Height images, and pictures and points for viewers."""

from __future__ import annotations

import array
from collections.abc import Sequence

import numpy as np
from sal_height_msgs import msg as messages
from sensor_msgs.msg import Image, PointCloud2, PointField
from std_msgs.msg import Header

from sal_height.elevation import Validity
from sal_height.errors import Rejected
from sal_height.geometry import EARTH_RADIUS, ApertureState, above_place
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


def height_to_message(
    field: HeightField,
    aperture: ApertureState,
    looks: tuple[int, int],
    estimator: str,
    source: messages.ComplexImage | messages.HeightImage,
    provenance: messages.Provenance,
) -> messages.HeightImage:
    """HeightImage with the stamp and dwell of its `source`."""
    image = messages.HeightImage(
        header=source.header,
        dwell=source.dwell,
        estimator=estimator,
        grid=grid_to_message(field.grid),
        aperture=aperture_to_message(aperture),
        range_looks=looks[0],
        azimuth_looks=looks[1],
        earth_radius=EARTH_RADIUS,
        validity=to_bytes(field.validity),
        provenance=provenance,
    )
    for prefix, surface in (("", field.first), ("second_", field.second)):
        if surface:
            offset = surface.positions - field.grid.origin
            values = (surface.height, surface.sigma, surface.cnr_db, offset[..., 0], offset[..., 1])
            for name, numbers in zip(("height", "sigma", "cnr_db", "east", "north"), values, strict=True):
                setattr(image, prefix + name, to_floats(numbers))
    return image


def field_from_message(image: messages.HeightImage) -> HeightField:
    """The heights that a HeightImage holds, without second scatterers.

    Raises:
        Rejected: they cannot be used; the sentence names the field, the value and what is allowed.
    """
    where = f"HeightImage of dwell {image.dwell}"
    if image.header.frame_id != MAP_FRAME:
        raise Rejected("wrong frames", f"{where} is in {image.header.frame_id!r}; it must be in {MAP_FRAME!r} (ENU).")
    grid, names = grid_from_message(image.grid), ("height", "sigma", "cnr_db", "east", "north", "validity")
    count = grid.rows * grid.cols
    for name in names:
        if len(getattr(image, name)) != count or count == 0:
            raise Rejected(
                "wrong size",
                f"{where}: {name} has {len(getattr(image, name))} entries, {grid.rows} x {grid.cols} pixels need "
                f"{count} (at least 1).",
            )
    check_geometry(image.grid, image.aperture, where)
    if image.earth_radius != EARTH_RADIUS:
        raise Rejected(
            "wrong earth radius", f"{where}: earth_radius is {image.earth_radius:.10g} m; it must be {EARTH_RADIUS} m."
        )
    validity = np.array(image.validity, dtype=np.uint8).reshape(grid.shape)
    usable = np.isin(validity, (Validity.OK, Validity.TWO_SCATTERERS, Validity.INTERPOLATED))
    height, sigma, cnr_db, east, north = (
        float_view(getattr(image, name), grid.shape).astype(np.float64) for name in names[:-1]
    )
    if not np.all(np.isfinite(np.stack([height, sigma, east, north])[:, usable])):
        raise Rejected("not finite", f"{where}: a usable pixel's height, sigma, east or north is NaN or infinite.")
    if not np.all(sigma[usable] > 0):
        raise Rejected(
            "wrong sigma", f"{where}: a usable pixel's sigma is {sigma[usable].min():g} m; it must be greater than 0."
        )
    positions = above_place(grid.origin[0] + east, grid.origin[1] + north, height)
    positions[~usable] = np.nan
    height, sigma = (np.where(usable, values, np.nan) for values in (height, sigma))
    return HeightField(grid, validity, Surface(height, sigma, cnr_db, positions), None)


def height_picture(image: messages.HeightImage) -> Image:
    """The heights as a 32FC1 image, NaN where not valid: for any image viewer."""
    return float_picture(float_view(image.height, (image.grid.rows, image.grid.cols)), image.header)


def float_picture(values: F32, header: Header) -> Image:
    """An array (rows, cols) as a 32FC1 image."""
    rows, cols = values.shape
    data = array.array("B", values.tobytes())
    return Image(header=header, height=rows, width=cols, encoding="32FC1", step=4 * cols, data=data)


def height_points(field: HeightField, image: messages.HeightImage) -> PointCloud2:
    """All scatterers as points x, y, z in map with height, sigma and cnr_db: for any point-cloud viewer."""
    points = np.concatenate([_points(surface) for surface in (field.first, field.second) if surface])
    return point_cloud(points, ("x", "y", "z", "height", "sigma", "cnr_db"), image.header)


def point_cloud(points: F32, names: Sequence[str], header: Header) -> PointCloud2:
    """Points of shape (points, fields) whose fields have these `names`."""
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
    """Position, height, sigma and CNR of the scatterers of a surface, shape (scatterers, 6)."""
    seen = np.isfinite(surface.height)
    columns = [*surface.positions[seen].T, surface.height[seen], surface.sigma[seen], surface.cnr_db[seen]]
    return np.ascontiguousarray(np.stack(columns, axis=-1), dtype=np.float32)
