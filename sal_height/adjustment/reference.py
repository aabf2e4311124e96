"""What is known of the ground beforehand: targets that stand out, and an elevation model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from sal_height.adjustment.equations import Equation, Form
from sal_height.adjustment.matching import REFERENCE, GriddedSurface, Points
from sal_height.numeric import F64

TARGET_DB = 6.0
"""By which a target is brighter than all else where it may be."""

OVER_IMAGE_DB = 6.0
"""By which it is brighter than half of the image."""

EXTENT_SPACINGS = 2.5
"""Distance of pixels that show the same target, in spacings of pixels."""

Heights = Callable[[F64, F64], F64]
"""Heights (m) at arc distances east and north (m), NaN where they are not known."""


@dataclass(frozen=True)
class Target:
    """A point target whose place is known.

    Attributes:
        east: m.
        north: m.
        height: m.
        sigma: standard deviation of each of them, m.
    """

    east: float
    north: float
    height: float
    sigma: float = 0.01

    @property
    def place(self) -> F64:
        """East, north and height, m."""
        return np.array([self.east, self.north, self.height])

    def sighted(self, points: Points, form: Form, expected: F64, reach: F64) -> Equation | None:
        """What it tells of the displacement of a dwell; None: it is not in the image, or does not stand out.

        Args:
            points: of the dwell, as published.
            form: its displacement.
            expected: that displacement as it is known beforehand, m, shape (3,).
            reach: how far from that it may be, m, shape (3,).
        """
        off = points.place - self.place - expected
        near = np.flatnonzero(np.all(np.abs(off) <= reach, axis=1))
        if not near.size:
            return None
        power = 10 ** (points.cnr_db / 10)
        brightest = near[np.argmax(power[near])]
        extent = EXTENT_SPACINGS * points.spacing
        apart = np.linalg.norm(points.place[near, :2] - points.place[brightest, :2], axis=1) > extent
        others = power[near[apart]].max() if apart.any() else 0.0
        least = max(10 ** (TARGET_DB / 10) * others, 10 ** (OVER_IMAGE_DB / 10) * float(np.median(power)))
        if power[brightest] < least:
            return None
        same = near[~apart & (power[near] > power[brightest] / 4)]
        weight = power[same] / power[same].sum()
        shift = weight @ points.place[same] - self.place
        variance = np.array([points.spacing**2 / 12] * 2 + [float(weight @ points.sigma[same] ** 2)]) + self.sigma**2
        return form.equals(shift, np.diag(1 / variance))


@dataclass(frozen=True)
class Terrain:
    """An elevation model.

    Attributes:
        heights: of the ground.
        sigma: standard deviation of its heights, each by itself, and of all of it, each way, m.
    """

    heights: Heights
    sigma: float

    def around(self, points: Points, reach: F64) -> GriddedSurface | None:
        """Its heights where points may be, up to `reach` (m, shape (3,)) farther; None: it has none there."""
        step = points.spacing / 2
        low = points.place[:, :2].min(axis=0) - reach[:2]
        size = np.ceil((points.place[:, :2].max(axis=0) + reach[:2] - low) / step).astype(int) + 1
        east, north = (low[axis] + step * np.arange(size[axis]) for axis in range(2))
        height = self.heights(*np.meshgrid(east, north, indexing="ij"))
        if not np.isfinite(height).any():
            return None
        sigma = np.where(np.isfinite(height), self.sigma, np.nan)
        return GriddedSurface(low, step, height, sigma, np.full(height.shape, REFERENCE))


@dataclass(frozen=True)
class References:
    """All that is known of the ground."""

    targets: tuple[Target, ...] = ()
    terrain: Terrain | None = None

    @property
    def ground_sigma(self) -> float:
        """Standard deviation of what the elevation model lies off as a whole, each way, m."""
        return self.terrain.sigma if self.terrain else 0.0

    def without_terrain(self) -> References:
        """The targets alone."""
        return replace(self, terrain=None)


UNKNOWN_GROUND = References()
