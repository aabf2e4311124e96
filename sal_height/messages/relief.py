"""Conversion of relief maps, and the images and point clouds that viewers show of them."""

from __future__ import annotations

import array

import numpy as np
from geometry_msgs.msg import TransformStamped
from sal_height_msgs.msg import HeightImage, Provenance, ReliefMap
from sensor_msgs.msg import Image, PointCloud2

from sal_height.geometry import sphere_point
from sal_height.messages.basics import to_floats, vector_of
from sal_height.messages.heights import float_picture, frame_near, point_cloud
from sal_height.relief import Relief


def relief_to_message(relief: Relief, images: int, last: HeightImage, provenance: Provenance) -> ReliefMap:
    """Return the ReliefMap of `images` height images, with the stamp, dwell and estimator of the `last` one."""
    rows, cols = relief.height.shape
    return ReliefMap(
        header=last.header,
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


def relief_frame(relief: Relief, last: HeightImage, name: str) -> TransformStamped:
    """Return a frame called `name` at the south-western corner of a map, on the ground."""
    return frame_near(sphere_point(relief.east, relief.north, 0.0), last.header, name)


RELIEF_POINT_FIELDS = ("x", "y", "z", "height", "sigma")
"""Fields of the points of a map: place in the frame of the cloud, height and its standard deviation, m."""


def relief_points(relief: Relief, frame: TransformStamped) -> PointCloud2:
    """Return the cells that were seen as a cloud in `frame` for viewers, with the fields RELIEF_POINT_FIELDS."""
    row, col = np.nonzero(relief.count)
    height, sigma = (layer[row, col].astype(np.float64) for layer in (relief.height, relief.sigma))
    east, north = relief.east + relief.cell_size * col, relief.north + relief.cell_size * row
    places = sphere_point(east, north, height) - vector_of(frame.transform.translation)
    points = np.column_stack([places, height, sigma]).astype(np.float32)
    return point_cloud(points, RELIEF_POINT_FIELDS, frame)
