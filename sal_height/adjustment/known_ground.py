"""Ground that is known beforehand: targets that stand out, and an elevation model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from sal_height.adjustment.equations import Equation, Form
from sal_height.adjustment.matching import REFERENCE, GriddedSurface, Points
from sal_height.numeric import F64

Heights = Callable[[F64, F64], F64]
"""Heights (m) at arc distances east and north (m), NaN where they are unknown."""


@dataclass(frozen=True)
class Target:
    """A point target at a known position.

    Attributes:
        east: distance east along the sphere, m.
        north: distance north along the sphere, m.
        height: height over the sphere, m.
        sigma: standard deviation of each coordinate, m.
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
        """Estimates the displacement of a dwell from its image of the target.

        Args:
            points: points of the dwell, as published.
            form: displacement of the dwell.
            expected: prior value of that displacement, m, shape (3,).
            reach: greatest difference from it, m, shape (3,).

        Returns:
            None: the target is not in the image, or does not stand out.
        """
        off = points.place - self.place - expected
        near = np.flatnonzero(np.all(np.abs(off) <= reach, axis=1))
        if not near.size:
            return None
        power = 10 ** (points.cnr_db / 10)
        brightest = near[np.argmax(power[near])]
        # Pixels up to 2.5 spacings apart show the same target.
        apart = np.linalg.norm(points.place[near, :2] - points.place[brightest, :2], axis=1) > 2.5 * points.spacing
        others = power[near[apart]].max() if apart.any() else 0.0
        # 6 dB brighter than all else where it may be, and than half of the image.
        if power[brightest] < 10 ** (6.0 / 10) * max(others, float(np.median(power))):
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
        heights: function that returns the heights of the ground.
        sigma: standard deviation of each height, and of a constant offset of the model per axis, m.
    """

    heights: Heights
    sigma: float

    def around(self, points: Points, reach: F64) -> GriddedSurface | None:
        """The surface around points, up to `reach` (m, shape (3,)) farther; None: all of it is unknown."""
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
    """All known ground."""

    targets: tuple[Target, ...] = ()
    terrain: Terrain | None = None

    @property
    def ground_sigma(self) -> float:
        """Standard deviation of a constant offset of the elevation model per axis, m."""
        return self.terrain.sigma if self.terrain else 0.0

    def without_terrain(self) -> References:
        """The targets alone."""
        return replace(self, terrain=None)


UNKNOWN_GROUND = References()
