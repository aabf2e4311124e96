"""Names of the frames of coordinates in headers, and how their axes point."""

from __future__ import annotations

from typing import NamedTuple

from sal_height.geometry import ROS_AXES, Axes, Origin

MAP_FRAME = "map"
"""Usual name of the frame of positions: x east, y north, z up (REP-103)."""

BODY_FRAME = "base_link"
"""Usual name of the frame of the platform: x forward, y left, z up (REP-103)."""


class Frames(NamedTuple):
    """Names of the frames of positions and of the platform in headers, and how their axes point."""

    map: str = MAP_FRAME
    body: str = BODY_FRAME
    axes: Axes = ROS_AXES


USUAL = Frames()


class PlacedOrigin(NamedTuple):
    """Position on the earth of the origin of the map frame.

    Attributes:
        origin: position of the origin.
        stamp_ns: stamp of the message that states it, ns.
        map_frame: name of the frame of the map.
    """

    origin: Origin
    stamp_ns: int
    map_frame: str
