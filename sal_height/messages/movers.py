"""Movers as clouds of points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sal_height.messages.heights import point_cloud
from sal_height.messages.types import Header, PointCloud2, TransformStamped
from sal_height.movers import Mover

MOVER_FIELDS = (
    "x",
    "y",
    "z",
    "height",
    "sigma",
    "radial_velocity",
    "velocity_sigma",
    "ambiguity",
    "walk_velocity",
    "walk_sigma",
    "along_velocity",
    "along_sigma",
    "walks",
    "cnr_db",
    "likelihood_ratio",
)
"""Fields of the points, float32: position in map (m), height above the sphere with its standard deviation (m), and
the other fields of `movers.Mover` (m/s, NaN where not known; 0 or 1 for walks; dB)."""


def mover_points(movers: Sequence[Mover], header: Header) -> PointCloud2:
    """Movers as a cloud of points in the frame of `header`, that of the images, with the fields MOVER_FIELDS."""
    values = [
        (
            *one.position,
            one.height,
            one.sigma,
            one.radial_velocity,
            one.velocity_sigma,
            one.ambiguity,
            one.walk_velocity,
            one.walk_sigma,
            one.along_velocity,
            one.along_sigma,
            float(one.walks),
            one.cnr_db,
            one.likelihood_ratio,
        )
        for one in movers
    ]
    points = np.array(values, np.float32).reshape(-1, len(MOVER_FIELDS))
    return point_cloud(points, MOVER_FIELDS, TransformStamped(header=header, child_frame_id=header.frame_id))
