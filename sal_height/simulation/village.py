"""The scene of the preset `village`: houses, a bridge over a brook, parked cars and trees along a road."""

from __future__ import annotations

import numpy as np

from sal_height.numeric import F64
from sal_height.simulation.scene import Scene

SPACING = 0.1
"""Distance of the nodes, m."""

PLASTER, TILES, PAINT, LEAVES, ASPHALT, WATER = 1.2, 1.5, 2.0, 0.8, 0.6, 0.08
"""Radar brightness of surfaces, relative to the grass of the gardens."""


class _Ground:
    """Heights and brightness of a scene while things are put on it.

    Attributes:
        east: arc distances of the nodes from the map origin, m, shape (1, n_east).
        north: the same to the north, m, shape (n_north, 1).
        height: heights, m, shape (n_north, n_east).
        brightness: relative radar brightness, shape (n_north, n_east).
    """

    def __init__(self, length: float, width: float) -> None:
        self.east = np.arange(-length / 2, length / 2 + SPACING / 2, SPACING)[None, :]
        self.north = np.arange(-width / 2, width / 2 + SPACING / 2, SPACING)[:, None]
        self.height = np.zeros((self.north.size, self.east.size))
        self.brightness = np.ones_like(self.height)

    def put(self, height: F64, brightness: float) -> None:
        """Put a thing on the ground wherever its height is not NaN, and above what is there."""
        here = height > self.height
        self.height = np.where(here, height, self.height)
        self.brightness = np.where(here, brightness, self.brightness)

    def box(self, east: tuple[float, float], north: tuple[float, float], top: float, brightness: float) -> None:
        """Put a box on the ground, between these arc distances and up to this height, m."""
        inside = (self.east >= east[0]) & (self.east < east[1]) & (self.north >= north[0]) & (self.north < north[1])
        self.put(np.where(inside, top, np.nan), brightness)

    def house(self, middle: tuple[float, float], size: tuple[float, float], eaves: float, ridge: float) -> None:
        """Put a house with a gable roof on the ground; its ridge is along the longer side, both heights in m."""
        east, north = np.abs(self.east - middle[0]), np.abs(self.north - middle[1])
        inside = (east < size[0] / 2) & (north < size[1] / 2)
        across = east / (size[0] / 2) if size[1] > size[0] else north / (size[1] / 2)
        self.put(np.where(inside, ridge - (ridge - eaves) * across, np.nan), TILES)

    def car(self, west: float, south: float) -> None:
        """Put a car 4.2 m long on the ground, along the road: bonnet, cabin and boot."""
        self.box((west, west + 4.2), (south, south + 1.7), 0.85, PAINT)
        self.box((west + 1.0, west + 3.3), (south + 0.1, south + 1.6), 1.45, PAINT)

    def tree(self, east: float, north: float, radius: float, top: float, rng: np.random.Generator) -> None:
        """Put a tree on the ground: the upper half of its crown, uneven by 20 cm (rms)."""
        away = np.hypot(self.east - east, self.north - north) / radius
        crown = top - 0.5 * radius * (1 - np.sqrt(np.maximum(1 - away**2, 0.0))) * 2
        self.put(np.where(away < 1, crown + rng.normal(0.0, 0.2, crown.shape), np.nan), LEAVES)


def village() -> Scene:
    """A village seen from the north: houses, parked cars, trees, and a road that crosses a brook; nodes 10 cm.

    The road runs east; the brook comes from the north and flows 1.8 m below the gardens under a bridge with parapets.
    Heights are 0 to 6.2 m above the road.
    """
    rng = np.random.default_rng(7)
    ground = _Ground(length=90.0, width=64.0)
    east, north = ground.east, ground.north
    ground.height += 0.25 + 0.02 * np.maximum(-north - 4.0, 0.0)  # gardens, rising to the south
    bed = np.clip(np.abs(east - 4.0 - 0.8 * np.sin(north / 6.0)) - 1.5, 0.0, 1.5) / 1.5  # 0: water, 1: gardens
    ground.height = np.where(bed < 1, -1.8 + (ground.height + 1.8) * bed, ground.height)
    ground.brightness = np.where(bed == 0, WATER, ground.brightness)
    road = (np.abs(north - 1.0) < 2.75) & (east > -100.0)
    hump = 0.6 * np.exp(-(((east - 4.0) / 6.0) ** 2))  # of the bridge, m
    ground.height = np.where(road, hump, ground.height)
    ground.brightness = np.where(road, ASPHALT, ground.brightness)
    for south in (-1.75, 3.5):  # parapets
        inside = (np.abs(east - 4.0) < 5.0) & (north >= south - 0.15) & (north < south + 0.15)
        ground.put(np.where(inside, hump + 0.9, np.nan), PLASTER)
    for middle, ridge in ((-28.5, 5.6), (-20.5, 5.2), (-12.5, 5.8), (-4.5, 5.4), (15.0, 5.8), (23.0, 5.2), (31.0, 5.6)):
        ground.house((middle, -8.5), (5.5, 7.0), 3.0, ridge)  # with their gables to the road
    ground.house((-22.0, 11.0), (7.0, 5.0), 2.4, 3.6)
    ground.house((21.0, 11.0), (8.0, 5.0), 2.6, 3.8)
    ground.box((-11.0, -8.0), (8.0, 12.0), 2.2, PLASTER)  # a garage
    for west in (-31.0, -25.5, -17.0, -11.0, 14.0, 19.5, 27.0):
        ground.car(west, -1.6)
    for west in (-15.0, 26.0):
        ground.car(west, 1.8)
    for place in ((-24.5, -8.0), (-8.5, -7.5), (10.5, -8.5), (19.0, -9.0), (-3.0, 9.0), (11.5, 9.0), (-15.0, 8.5)):
        ground.tree(*place, radius=rng.uniform(1.7, 2.3), top=rng.uniform(4.6, 5.8), rng=rng)
    ground.box((-40.0, -28.0), (5.2, 5.8), 1.3, LEAVES)  # hedges
    ground.box((13.0, 26.0), (5.2, 5.8), 1.3, LEAVES)
    return Scene("village", east[0], north[:, 0], ground.height, ground.brightness)
