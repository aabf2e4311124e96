"""Products for viewers: pictures, and points relative to a frame near them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sal_height.engine.height_items import Heights
from sal_height.engine.mapper import PlacedRelief
from sal_height.geometry import sphere_point
from sal_height.messages import heights, relief
from sal_height.messages.kinds import header_of
from sal_height.messages.types import Image, PointCloud2, TransformStamped
from sal_height.numeric import F64


def height_picture(item: Heights) -> Image:
    """The heights of the first surface as a 32FC1 image, NaN where they are not valid."""
    header = header_of(item.key.stamp_ns, item.frame_id)
    return heights.float_picture(item.surfaces[0].height.reshape(item.grid.shape), header)


def height_points(item: Heights, name: str) -> tuple[TransformStamped, PointCloud2]:
    """The frame of that name near the pixels, and all scatterers as a cloud of points in it."""
    frame = heights.frame_near(item.grid.origin, header_of(item.key.stamp_ns, item.frame_id), name)
    return frame, heights.height_points(item.field, frame)


def relief_picture(item: PlacedRelief) -> Image:
    """The heights of a map as a 32FC1 image, with north up and NaN in cells that were not seen."""
    return heights.float_picture(item.relief.height[::-1], header_of(item.key.stamp_ns, item.frame_id))


def relief_points(item: PlacedRelief, name: str) -> tuple[TransformStamped, PointCloud2]:
    """The frame of that name at the south-western corner of a map at its height 0, and its cells as points in it."""

    def place(east: npt.ArrayLike, north: npt.ArrayLike, height: npt.ArrayLike) -> F64:
        if item.projection is None:
            return sphere_point(east, north, height)
        return item.projection.positions(np.stack(np.broadcast_arrays(east, north, height), axis=-1))

    header = header_of(item.key.stamp_ns, item.frame_id)
    frame = heights.frame_near(place(item.relief.east, item.relief.north, 0.0), header, name)
    return frame, relief.relief_points(item.relief, place, frame)
