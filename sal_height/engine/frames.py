"""Frames of coordinates: their names in headers, how their axes point, and the poses that static transforms state."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from sal_height.errors import UserError
from sal_height.geometry import ROS_AXES, Axes, Origin
from sal_height.numeric import F64

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


MOST_FRAMES = 1000
"""Greatest number of frames: no platform has more, and nobody can make the stage take all memory."""


class StaticTransform(NamedTuple):
    """Constant pose of a frame in another one.

    Attributes:
        parent: name of the frame that it is in.
        child: name of the frame.
        translation: position of its origin in the parent, m, shape (3,).
        quaternion: orientation of its axes in the parent, x, y, z, w, shape (4,).
    """

    parent: str
    child: str
    translation: F64
    quaternion: F64


class StaticFrames:
    """The frames that are fixed to each other, as far as they are known."""

    def __init__(self) -> None:
        self._placed: dict[str, tuple[str, RigidTransform]] = {}
        """Parent of each frame, and its pose there."""

    def add(self, transform: StaticTransform) -> None:
        """Keep the pose of a frame in its parent, in place of what was known of it.

        Raises:
            UserError: a frame without a name or in itself, numbers that are no transform, or too many frames.
        """
        parent, child, place, quaternion = transform
        if not (parent and child) or parent == child:
            raise UserError(f"The transform from {parent!r} to {child!r} must be between two frames with names.")
        if not np.all(np.isfinite(place)) or not 0.99 < np.linalg.norm(quaternion) < 1.01:
            raise UserError(
                f"The transform from {parent!r} to {child!r} has the translation {place} and the rotation "
                f"{quaternion}; they must be finite and a quaternion (x, y, z, w) of norm 1."
            )
        if child not in self._placed and len(self._placed) == MOST_FRAMES:
            raise UserError(f"There are more than {MOST_FRAMES} frames; {child!r} is left out.")
        self._placed[child] = parent, RigidTransform.from_components(place, Rotation.from_quat(quaternion))

    def place(self, frame: str, inside: str) -> RigidTransform | None:
        """Return the pose of a frame in another one; None if nothing joins the two."""
        ours, theirs = self._above(frame), self._above(inside)
        common = next((name for name in ours if name in theirs), None)
        return None if common is None else theirs[common].inv() * ours[common]

    def _above(self, frame: str) -> dict[str, RigidTransform]:
        """The frame and all that it is fixed to upwards, from near to far, with its place in each."""
        places = {frame: RigidTransform.identity()}
        while frame in self._placed:
            parent, place = self._placed[frame]
            if parent in places:  # they go round in a circle
                break
            places[parent] = place * places[frame]
            frame = parent
        return places
