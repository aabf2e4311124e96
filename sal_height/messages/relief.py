"""Conversion of relief maps, and the images and point clouds that viewers show of them."""

from __future__ import annotations

import array
from collections.abc import Callable

import numpy as np
from geometry_msgs.msg import TransformStamped
from sal_height_msgs.msg import HeightImage, Provenance, ReliefMap
from sensor_msgs.msg import Image, PointCloud2
from std_msgs.msg import Header

from sal_height.messages.basics import to_floats, vector_of
from sal_height.messages.heights import float_picture, frame_near, point_cloud
from sal_height.numeric import F64
from sal_height.relief import Relief

Place = Callable[..., F64]
"""Makes positions in the map frame, m, of two coordinates of a map and heights, m, as `geometry.sphere_point`."""


def relief_to_message(relief: Relief, system: str, images: int, last: HeightImage, provenance: Provenance) -> ReliefMap:
    """Return the ReliefMap of `images` height images, with the stamp, dwell and estimator of the `last` one.

    Its coordinates are those of a `system`: the map frame, or a coordinate reference system.
    """
    rows, cols = relief.height.shape
    return ReliefMap(
        header=Header(stamp=last.header.stamp, frame_id=system),
        dwell=last.dwell,
        images=images,
        estimator=last.estimator,
        origin_east=relief.east,
        origin_north=relief.north,
        cell_size=relief.cell_size,
        rows=rows,
        cols=cols,
        height=to_floats(relief.height),
        sigma=to_floats(relief.sigma),
        disagreement=to_floats(relief.disagreement),
        kind=array.array("B", b"" if relief.kind is None else relief.kind.tobytes()),
        count=array.array("I", relief.count.tobytes()),
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
