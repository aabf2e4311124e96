"""Vegetation above the ground of a scene: a random volume over ground, lit through its own extinction.

The volume has an even density of scatterers. Intensity falls as exp(-kappa s) along a path of length s inside it, so
that a scatterer returns exp(-2 kappa s) of its power, and so does the ground beneath (the random volume over ground of
Treuhaft and Siqueira, Radio Science 35, 2000).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sal_height.numeric import F64
from sal_height.simulation._terrain_kernels import rise_in_canopy

CANOPY_LAYERS = 24
"""Layers of scatterers from base to top: 4 in a beamwidth for a canopy of 6 beamwidths."""


@dataclass(frozen=True, eq=False)
class Canopy:
    """A volume of scatterers above the terrain, with gaps.

    Attributes:
        top: height above the terrain, m, on the nodes of the scene, shape (n_north, n_east); 0 in gaps.
        base: height above the terrain at which it starts, m; there is no canopy where `top` is lower.
        extinction: kappa of intensity, one way, 1/m.
        reflectivity: radar brightness per metre of height if nothing attenuated it, 1/m.
    """

    top: F64
    base: float
    extinction: float
    reflectivity: float

    @property
    def is_possible(self) -> bool:
        """True if all its numbers are finite and 0 or more."""
        numbers = np.concatenate([self.top.ravel(), [self.base, self.extinction, self.reflectivity]])
        return bool(np.all(np.isfinite(numbers) & (numbers >= 0)))

    def layers(self, top: F64) -> tuple[F64, F64]:
        """Heights above the terrain (m) and thickness (m) of the layers under `top` (m, shape (points,)).

        Both have the shape (CANOPY_LAYERS, points). In each layer one point in four stands for all, so that the
        thickness of the others is 0, as it is where there is no canopy.
        """
        layer, point = np.ogrid[:CANOPY_LAYERS, : len(top)]
        depth = np.maximum(top - self.base, 0.0)
        thinning = 4  # scatterers of the terrain per one of a layer, which has one in a resolution cell, not 2 x 2
        thickness = depth * thinning / CANOPY_LAYERS * ((layer + point) % thinning == 0)
        return self.base + (layer + 0.5) / CANOPY_LAYERS * depth, thickness

    def optical_depth(self, north: F64, east: F64, ground: F64, points: F64, sight: F64) -> F64:
        """Optical depth kappa s, one way, between points and the edge of the canopy, shape (points,).

        Args:
            north: arc distances of the scene's nodes, m; outside of them there is no canopy.
            east: arc distances east, m, likewise.
            ground: height of the terrain on the nodes, m, shape (n_north, n_east).
            points: arc distances east and north, and height, m, shape (3, points).
            sight: unit vectors from the points to the antenna, east, north and up, shape (3, points).
        """
        north, east, ground, top = (
            np.ascontiguousarray(values, dtype=np.float64) for values in (north, east, ground, self.top)
        )
        ceiling, inside = float(np.max(ground + top)), np.empty(points.shape[1])
        steps = 16  # equal in height; in a level canopy their sum is exact
        rise_in_canopy(north, east, ground, top, self.base, ceiling, points, sight[:2] / sight[2], steps, inside)
        return np.asarray(self.extinction * inside / sight[2])
