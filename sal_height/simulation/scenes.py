"""Scenes: a synthetic street, woods, a village, and terrain from elevation models."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from sal_height.errors import UserError, did_you_mean
from sal_height.geometry.elevation_model import read_elevation_model
from sal_height.simulation.canopy import Canopy
from sal_height.simulation.scene import PointScatterer, Scene
from sal_height.simulation.village import village


def load_scene(name_or_path: str, extent: float = 0.0) -> Scene:
    """The scene of that name (see SCENES), or the elevation model in that file (.tif, .tiff or .npz).

    Args:
        name_or_path: name or path of the scene.
        extent: extent of its scatterers in height, m (`Scene.extent`).

    Raises:
        UserError: no such scene, a file that cannot be used, or an extent below 0.
    """
    if name_or_path in SCENES:
        scene = SCENES[name_or_path]()
        return replace(scene, extent=extent) if extent else scene
    if not os.path.isfile(name_or_path):  # noqa: PTH113 (Path raises for a name that no file can have)
        raise UserError(
            f"Scene {name_or_path!r} is neither a file nor one of {', '.join(SCENES)}"
            f"{did_you_mean(name_or_path, SCENES)}; "
            "give an elevation model as .tif or .npz."
        )
    return replace(terrain(Path(name_or_path)), extent=extent)


def terrain(path: Path) -> Scene:
    """Terrain of uniform brightness from an elevation model in a file; errors as of `read_elevation_model`."""
    model = read_elevation_model(path)
    brightness = np.ones_like(model.height)
    return Scene(model.name, model.east, model.north, model.height, brightness, origin=model.origin)


def street(length: float = 60.0) -> Scene:
    """A street seen from the north: road with kerbs, steps, parked cars and a wall; heights 0 to 2 m, nodes 2 cm.

    Args:
        length: length of the street (east), m.
    """
    spacing = 0.02
    east = np.arange(-length / 2, length / 2 + spacing / 2, spacing)
    north = np.arange(-8.0, 8.0 + spacing / 2, spacing)
    height = np.zeros((len(north), len(east)))
    brightness = np.ones_like(height)

    def block(west: float, east_end: float, south: float, north_end: float, top: float, bright: float) -> None:
        cells = slice(*np.searchsorted(north, (south, north_end))), slice(*np.searchsorted(east, (west, east_end)))
        height[cells] = top
        brightness[cells] = bright

    block(-length, length, 2.4, 8.0, 0.12, 1.0)  # near pavement, kerb of 12 cm
    block(-length, length, -8.0, -2.4, 0.12, 1.0)  # far pavement
    for i in range(6):  # a flight of steps rising away from the street
        block(-length, -1.0, -8.0, -3.0 - 0.5 * i, 0.12 + 0.16 * (i + 1), 1.0)
    block(1.5, length, -5.2, -4.9, 2.0, 1.5)  # wall
    for start in np.arange(-length / 2 + 1.0, length / 2 - 5.0, 7.5):  # parked cars: bonnet, roof, boot
        block(start, start + 4.2, -2.2, -0.5, 0.85, 2.0)
        block(start + 1.0, start + 3.3, -2.05, -0.65, 1.45, 2.0)
    posts = tuple(PointScatterer(float(e), 3.0, 1.0, 30.0) for e in np.arange(-length / 2 + 4.0, length / 2, 7.5))
    return Scene("street", east, north, height, brightness, posts)


def woods() -> Scene:
    """Woods 6 to 12 m high on gently rolling ground, with two glades; crowns start 2 m above the ground, nodes 0.25 m.

    Through 10 m of woods under 45 degrees 32 % of the ground's power remain, and the crowns return half as much again.
    """
    east, north = np.arange(-40, 40.125, 0.25), np.arange(-30, 30.125, 0.25)
    ground = 0.4 * np.sin(2 * np.pi * east / 80) + 0.03 * north[:, None]
    crowns = 0.5 * np.sin(2 * np.pi * east / 5) * np.sin(2 * np.pi * north[:, None] / 5)
    glade = (np.abs(east + 9) < 4) | (np.abs(east - 11) < 2)
    top = np.where(glade, 0.0, 9 + 2.5 * np.sin(2 * np.pi * east / 60) + crowns)
    return Scene(
        "woods", east, north, ground, np.ones_like(ground), canopy=Canopy(top, 2.0, extinction=0.05, reflectivity=0.1)
    )


def jacksboro_fault() -> Scene:
    """The Jacksboro fault, Tennessee: 3-arc-second elevation model from the sample data of matplotlib."""
    from matplotlib.cbook import get_sample_data  # noqa: PLC0415 (slow to import)

    return terrain(Path(str(get_sample_data("jacksboro_fault_dem.npz", asfileobj=False))))


SCENES: dict[str, Callable[[], Scene]] = {
    "street": street,
    "woods": woods,
    "village": village,
    "jacksboro_fault": jacksboro_fault,
}
"""Built-in scenes by name. A new scene is one function and one entry here."""
