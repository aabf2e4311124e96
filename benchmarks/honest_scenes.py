"""Scenes of the group `honest`: the sensor flies east in the north of them and looks south.

East and north are those of the middle of the image; the ground reaches far enough that no edge of it is in the image.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.ndimage import gaussian_filter

from sal_height.numeric import F64
from sal_height.simulation import Scene
from sal_height.simulation import scenes as simulation

HALF_LENGTH = 60.0
"""Half the extent of a scene along the flight, m; images are at most 100 m long."""

REACH = 8.0
"""Half the extent of level ground across the flight, m; the range window of 7.7 m shows 5.4 m to each side."""

STEP_OF_A_BEAMWIDTH = 0.775 * np.sin(np.pi / 4)
"""Height that lies one beamwidth across the line of sight at 5 km, seen at 45 degrees, m."""

SEED = 15


def level() -> Scene:
    """Level ground."""
    return _scene("level", np.zeros((2, 2)), np.array([-REACH, REACH]), _ends())


def slope(angle: float) -> Scene:
    """A plane that rises by `angle` (rad) away from the sensor: a positive one faces it."""
    reach = min(40.0, REACH / (1 - np.tan(angle)))  # a face towards the sensor extends over less range
    north = np.array([-reach, reach])
    return _scene("slope", np.repeat(-np.tan(angle) * north[:, None], 2, axis=1), north, _ends())


def fields(seed: int, angle: float) -> Scene:
    """A plane that rises by `angle` (rad) along the flight: fields of 2 m, whose brightness differs by 5 dB (rms).

    Each seed has a brightness of its own: where the edges of the same fields put images is the same in all flights.
    """
    edges = np.arange(-HALF_LENGTH, HALF_LENGTH, 2.0)
    east = np.sort(np.concatenate([edges, edges[1:] - 1e-3, [HALF_LENGTH]]))
    brightness = 10 ** (0.5 * np.random.default_rng([SEED, seed]).standard_normal(len(edges)))
    shown = brightness[np.searchsorted(edges, east, side="right") - 1]
    north = np.array([-REACH, REACH])
    return Scene("fields", east, north, np.tile(np.tan(angle) * east, (2, 1)), np.tile(shown, (2, 1)))


def roofs(angle: float = np.radians(26.0), span: float = 3.0) -> Scene:
    """Gables of faces inclined by `angle` (rad), one every `span` m, their ridges aslant to the flight."""
    east, north = _nodes(0.1, 0.05)
    place = (north[:, None] + 0.1 * east) % span
    return _scene("roofs", np.tan(angle) * np.minimum(place, span - place), north, east)


def rubble(sigma: float = 0.15, size: float = 0.3) -> Scene:
    """Random ground: standard deviation `sigma` and correlation length `size`, both in m."""
    east, north = _nodes(0.05, 0.05)
    height = gaussian_filter(np.random.default_rng(SEED).standard_normal((len(north), len(east))), size / 0.05)
    return _scene("rubble", sigma * height / np.std(height), north, east)


def forest(density: float = 0.15) -> Scene:
    """Cones of .5 to .8 m radius and 1 to 2 m height, `density` of them a square metre."""
    east, north = _nodes(0.05, 0.05)
    rng = np.random.default_rng(SEED)
    height = np.zeros((len(north), len(east)))
    count = int(density * 4 * HALF_LENGTH * 8)
    for x, y in zip(rng.uniform(-HALF_LENGTH, HALF_LENGTH, count), rng.uniform(-8, 8, count), strict=True):
        radius, top = rng.uniform(0.5, 0.8), rng.uniform(1.0, 2.0)
        near = np.ix_(np.abs(north - y) < radius, np.abs(east - x) < radius)
        distance = np.hypot(north[np.abs(north - y) < radius][:, None] - y, east[np.abs(east - x) < radius] - x)
        height[near] = np.maximum(height[near], top * (1 - distance / radius))
    return _scene("forest", height, north, east)


def canopy(extent: float = 1.5) -> Scene:
    """Scatterers spread evenly over a height of `extent` m; no ground."""
    return Scene("canopy", _ends(), np.array([-REACH, REACH]), np.zeros((2, 2)), np.ones((2, 2)), extent=extent)


def step(beamwidths: float) -> Scene:
    """A straight step aslant to the flight: up behind a wall that faces the sensor, or down if negative."""
    east, north = _nodes(0.05, 0.02)
    behind = north[:, None] < 0.05 * east
    return _scene("step", np.where(behind, beamwidths * STEP_OF_A_BEAMWIDTH, 0.0), north, east)


def fence(height: float = 2.0, length: float = 0.6, thickness: float = 0.06) -> Scene:
    """Upright boards on level ground, with gaps as long as they are (all in m); behind them lies their shadow."""
    east, north = _nodes(0.02, 0.02)
    board = (np.abs(north[:, None] - 1.0) <= thickness / 2) & (east % (2 * length) < length)
    return _scene("fence", np.where(board, height, 0.0), north, east)


def street() -> Scene:
    """The built-in street, as long as the other scenes: kerbs, steps, parked cars and a wall."""
    return simulation.street(2 * HALF_LENGTH)


SCENES: dict[str, Callable[[], Scene]] = {"roofs": roofs, "rubble": rubble, "forest": forest, "canopy": canopy}
"""Scenes that are a case as they are, by name."""


def _ends() -> F64:
    return np.array([-HALF_LENGTH, HALF_LENGTH])


def _nodes(east_spacing: float, north_spacing: float) -> tuple[F64, F64]:
    """Nodes of a scene, m."""
    east = np.arange(-HALF_LENGTH, HALF_LENGTH + east_spacing / 2, east_spacing)
    north = np.arange(-REACH, REACH + north_spacing / 2, north_spacing)
    return east, north


def _scene(name: str, height: F64, north: F64, east: F64) -> Scene:
    return Scene(name, east, north, height, np.ones(height.shape))
