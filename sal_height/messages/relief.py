"""Conversion of relief maps, and the images and point clouds that viewers show of them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sal_height.engine.mapper import PlacedRelief
from sal_height.messages.basics import to_bytes, to_floats, to_stamp, vector_of
from sal_height.messages.heights import point_cloud
from sal_height.messages.products import provenance_to_message
from sal_height.messages.types import Header, PointCloud2, ReliefLayer, ReliefMap, TransformStamped
from sal_height.numeric import F64
from sal_height.relief import Relief

Place = Callable[..., F64]
"""Positions in the map frame, m, from two coordinates of a map and heights, m, as `geometry.sphere_point`."""


def relief_to_message(placed: PlacedRelief) -> ReliefMap:
    """Return the ReliefMap, of one layer, that describes a map."""
    relief = placed.relief
    rows, cols = relief.height.shape
    layer = ReliefLayer(
        name=placed.layer,
        height=to_floats(relief.height),
        sigma=to_floats(relief.sigma),
        disagreement=to_floats(relief.disagreement),
        kind=np.zeros(0, np.uint8) if relief.kind is None else to_bytes(relief.kind),
        count=relief.count.ravel(),
    )
    return ReliefMap(
        header=Header(stamp=to_stamp(placed.key.stamp_ns), frame_id=placed.frame_id),
        crs=placed.crs,
        dwell=placed.key.number,
        images=placed.images,
        estimator=placed.estimator,
        origin_east=relief.east,
        origin_north=relief.north,
        cell_size=relief.cell_size,
        rows=rows,
        cols=cols,
        layers=[layer],
        provenance=provenance_to_message(placed.provenance),
    )


RELIEF_POINT_FIELDS = ("x", "y", "z", "height", "sigma")
"""Fields of the points of a map: position in the frame of the cloud, height and its standard deviation, m."""


def relief_points(relief: Relief, place: Place, frame: TransformStamped) -> PointCloud2:
    """Return the cells that were seen as a cloud in `frame` for viewers, with the fields RELIEF_POINT_FIELDS."""
    row, col = np.nonzero(relief.count)
    height, sigma = (layer[row, col].astype(np.float64) for layer in (relief.height, relief.sigma))
    east, north = relief.east + relief.cell_size * col, relief.north + relief.cell_size * row
    places = place(east, north, height) - vector_of(frame.transform.translation)
    points = np.column_stack([places, height, sigma]).astype(np.float32)
    return point_cloud(points, RELIEF_POINT_FIELDS, frame)
