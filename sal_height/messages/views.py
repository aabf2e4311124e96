"""Products for viewers: pictures, and clouds of points relative to a frame near them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from sal_height.engine.height_items import Heights
from sal_height.engine.mapper import PlacedRelief
from sal_height.geometry import sphere_point
from sal_height.messages.basics import header_of, vector_of, xyz
from sal_height.messages.types import Header, Image, PointCloud2, PointField, TransformStamped, Vector3
from sal_height.movers import Mover
from sal_height.numeric import F32, F64
from sal_height.relief import HeightField, Surface, folded

POINT_FIELDS = (
    *("x", "y", "z", "height", "sigma", "cnr_db", "spread", "surface"),
    *("cov_ee", "cov_en", "cov_eu", "cov_nn", "cov_nu", "cov_uu"),
)
"""Fields of the points of a height image: position in the frame of the cloud (m), the layers of Surface, the number of
the surface, strongest first, and the covariance of the position with that from the pose, m^2."""

RELIEF_POINT_FIELDS = ("x", "y", "z", "height", "sigma")
"""Fields of the points of a map: position in the frame of the cloud, height and its standard deviation, m."""

MOVER_FIELDS = (
    *("x", "y", "z", "height", "sigma", "radial_velocity", "velocity_sigma", "ambiguity"),
    *("walk_velocity", "walk_sigma", "along_velocity", "along_sigma", "walks", "cnr_db", "likelihood_ratio"),
)
"""Fields of the points, float32: position in map (m), height above the sphere with its standard deviation (m), and
the other fields of `movers.Mover` (m/s, NaN where not known; 0 or 1 for walks; dB)."""


def origin_frame(product: str, namespace: str = "/") -> str:
    """Name of the frame near the points of a product, such as "ml", of a node in a namespace."""
    return "_".join([*namespace.split("/"), product, "origin"]).strip("_")


def height_picture(item: Heights) -> Image:
    """The heights of the first surface as a 32FC1 image, NaN where they are not valid."""
    header = header_of(item.key.stamp_ns, item.frame_id)
    return float_picture(item.surfaces[0].height.reshape(item.grid.shape), header)


def height_points(item: Heights, name: str) -> tuple[TransformStamped, PointCloud2]:
    """The frame of that name near the pixels, and all scatterers as a cloud of points in it."""
    frame = frame_near(item.grid.origin, header_of(item.key.stamp_ns, item.frame_id), name)
    return frame, field_points(item.field, frame)


def relief_picture(item: PlacedRelief) -> Image:
    """The heights of a map as a 32FC1 image, with north up and NaN in cells that were not seen."""
    return float_picture(item.relief.height[::-1], header_of(item.key.stamp_ns, item.frame_id))


def relief_points(item: PlacedRelief, name: str) -> tuple[TransformStamped, PointCloud2]:
    """The frame of that name at the south-western corner of a map at its height 0, and its cells as points in it."""

    def place(east: npt.ArrayLike, north: npt.ArrayLike, height: npt.ArrayLike) -> F64:
        if item.projection is None:
            return sphere_point(east, north, height)
        return item.projection.positions(np.stack(np.broadcast_arrays(east, north, height), axis=-1))

    header = header_of(item.key.stamp_ns, item.frame_id)
    frame = frame_near(place(item.relief.east, item.relief.north, 0.0), header, name)
    relief = item.relief
    row, col = np.nonzero(relief.count)
    height, sigma = (layer[row, col].astype(np.float64) for layer in (relief.height, relief.sigma))
    east, north = relief.east + relief.cell_size * col, relief.north + relief.cell_size * row
    places = place(east, north, height) - vector_of(frame.transform.translation)
    points = np.column_stack([places, height, sigma]).astype(np.float32)
    return frame, _point_cloud(points, RELIEF_POINT_FIELDS, frame)


def mover_points(movers: Sequence[Mover], header: Header) -> PointCloud2:
    """Movers as a cloud of points in the frame of `header`, that of the images, with the fields MOVER_FIELDS."""
    values = [(*one.position, *(getattr(one, name) for name in MOVER_FIELDS[3:])) for one in movers]
    points = np.array(values, np.float32).reshape(-1, len(MOVER_FIELDS))
    return _point_cloud(points, MOVER_FIELDS, TransformStamped(header=header, child_frame_id=header.frame_id))


def float_picture(values: F32, header: Header) -> Image:
    """Return an array (rows, cols) as a 32FC1 image."""
    rows, cols = values.shape
    data = np.ascontiguousarray(values).reshape(-1).view(np.uint8)
    return Image(header=header, height=rows, width=cols, encoding="32FC1", step=4 * cols, data=data)


def frame_near(origin: F64, header: Header, name: str) -> TransformStamped:
    """Return a frame called `name` with the axes of the header's frame and its origin at `origin`, m.

    Points are published relative to a frame near them: single precision has 4 mm at 50 km.
    """
    near = TransformStamped(header=header, child_frame_id=name)
    near.transform.translation = Vector3(**xyz(origin))
    return near


def field_points(field: HeightField, frame: TransformStamped) -> PointCloud2:
    """Return all scatterers as a cloud of points in `frame` for viewers, with the fields POINT_FIELDS."""
    origin = vector_of(frame.transform.translation)
    points = np.concatenate([_points(surface, number, origin) for number, surface in enumerate(field.surfaces)])
    return _point_cloud(points, POINT_FIELDS, frame)


def _point_cloud(points: F32, names: Sequence[str], frame: TransformStamped) -> PointCloud2:
    """Return points of shape (points, fields) as a cloud in `frame` whose fields have these `names`."""
    return PointCloud2(
        header=Header(stamp=frame.header.stamp, frame_id=frame.child_frame_id),
        height=1,
        width=len(points),
        fields=[PointField(name=n, offset=4 * i, datatype=PointField.FLOAT32, count=1) for i, n in enumerate(names)],
        point_step=4 * len(names),
        row_step=4 * len(names) * len(points),
        data=points.reshape(-1).view(np.uint8),
        is_dense=True,
    )


def _points(surface: Surface, number: int, origin: F64) -> F32:
    """Return the scatterers of a surface as points relative to `origin`, shape (scatterers, POINT_FIELDS)."""
    seen = np.isfinite(surface.height)
    layers = (surface.height, surface.sigma, surface.cnr_db, surface.spread)
    columns = [*(surface.positions[seen] - origin).T, *(layer[seen] for layer in layers)]
    covariance = folded(surface.covariance[seen])
    which = np.full(len(covariance), number)
    return np.ascontiguousarray(np.column_stack([*columns, which, covariance]), dtype=np.float32)
