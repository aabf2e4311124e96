"""Conversion of relief maps, and the images and point clouds that viewers show of them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sal_height.messages.basics import to_bytes, to_floats, vector_of
from sal_height.messages.heights import float_picture, frame_near, point_cloud
from sal_height.messages.types import (
    HeightImage,
    Image,
    PointCloud2,
    Provenance,
    ReliefLayer,
    ReliefMap,
    TransformStamped,
)
from sal_height.numeric import F64
from sal_height.relief import Relief

Place = Callable[..., F64]
"""Makes positions in the map frame, m, of two coordinates of a map and heights, m, as `geometry.sphere_point`."""


def relief_to_message(
    relief: Relief, layer: str, images: int, last: HeightImage, provenance: Provenance, crs: str = ""
) -> ReliefMap:
    """Return the ReliefMap that has one layer.

    Args:
        relief: the map.
        layer: name of the layer, a constant of ReliefLayer.
        images: number of height images that are in it.
        last: the last of them, from which stamp, frame, dwell and estimator are taken.
        provenance: how it was made.
        crs: coordinate reference system of the map; empty: local coordinates.
    """
    rows, cols = relief.height.shape
    return ReliefMap(
        header=last.header,
        crs=crs,
        dwell=last.dwell,
        images=images,
        estimator=last.estimator,
        origin_east=relief.east,
        origin_north=relief.north,
        cell_size=relief.cell_size,
        rows=rows,
        cols=cols,
        layers=[
            ReliefLayer(
                name=layer,
                height=to_floats(relief.height),
                sigma=to_floats(relief.sigma),
                disagreement=to_floats(relief.disagreement),
                kind=None if relief.kind is None else to_bytes(relief.kind),
                count=relief.count.ravel(),
            )
        ],
        provenance=provenance,
    )


def relief_picture(relief: Relief, last: HeightImage) -> Image:
    """Return the heights as a 32FC1 image for image viewers, with north up and NaN in cells that were not seen."""
    return float_picture(relief.height[::-1], last.header)


def relief_frame(relief: Relief, place: Place, last: HeightImage, name: str) -> TransformStamped:
    """Return a frame called `name` at the south-western corner of a map, at its height 0."""
    return frame_near(place(relief.east, relief.north, 0.0), last.header, name)


RELIEF_POINT_FIELDS = ("x", "y", "z", "height", "sigma")
"""Fields of the points of a map: place in the frame of the cloud, height and its standard deviation, m."""


def relief_points(relief: Relief, place: Place, frame: TransformStamped) -> PointCloud2:
    """Return the cells that were seen as a cloud in `frame` for viewers, with the fields RELIEF_POINT_FIELDS."""
    row, col = np.nonzero(relief.count)
    height, sigma = (layer[row, col].astype(np.float64) for layer in (relief.height, relief.sigma))
    east, north = relief.east + relief.cell_size * col, relief.north + relief.cell_size * row
    places = place(east, north, height) - vector_of(frame.transform.translation)
    points = np.column_stack([places, height, sigma]).astype(np.float32)
    return point_cloud(points, RELIEF_POINT_FIELDS, frame)
