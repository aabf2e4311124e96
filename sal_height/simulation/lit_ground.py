"""Cells of the ground in an image: seen, in shadow, or outside of the array."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sal_height.beams import Beams
from sal_height.geometry import ApertureState, Grid, angles_of, aperture_at, pixels_at, sphere_coordinates, sphere_point
from sal_height.numeric import F64, Bool, Index
from sal_height.simulation.scene import Scene, VisibleSurface


@dataclass(frozen=True, eq=False)
class GroundCells:
    """Cells of the ground whose centres fall into an image by range and Doppler; arrays of one entry per cell.

    Attributes:
        number: row (north) and column (east) of the cell, counted from the map's origin, shape (cells, 2); its centre
            is at (number + 0.5) cells.
        height: height of the terrain at the centre, m.
        lit: True where the sensor sees the centre over everything nearer.
        inside: True where the elevation of the centre is between the first boresight of the array and the last.
        pixel: row and column of the image's pixel that it falls into, shape (cells, 2).
    """

    number: Index
    height: F64
    lit: Bool
    inside: Bool
    pixel: Index


def ground_cells(
    scene: Scene,
    surface: VisibleSurface,
    aperture: ApertureState,
    grid: Grid,
    beams: Beams,
    look_side: int,
    size: float,
) -> GroundCells:
    """Cells of the ground in an image.

    Args:
        scene: scene with the ground.
        surface: lit part of it; only cells between its outermost scatterers are tested.
        aperture: aperture from which range and Doppler are measured.
        grid: pixels of the image.
        beams: beams of the detectors.
        look_side: look side, +1 right, -1 left.
        size: side of a cell, m.
    """
    east, north, _ = sphere_coordinates(surface.positions)
    rows, cols = (np.arange(np.floor(v.min() / size), np.ceil(v.max() / size)).astype(np.intp) for v in (north, east))
    centres = (rows + 0.5) * size
    # Vertical cuts through the terrain, at its nodes and at the centres of cells, ordered outwards.
    outwards = -look_side * int(np.sign(aperture.direction[0]))
    places = np.union1d(scene.north, centres)[::outwards]
    there = np.broadcast_to((cols[:, None] + 0.5) * size, (len(cols), len(places)))
    height = scene.heights(there, places)
    points = sphere_point(there, places, height)
    _, elevation, _ = angles_of(points, aperture_at(points, aperture), look_side)
    lit = elevation >= np.maximum.accumulate(np.nan_to_num(elevation, nan=-np.pi), axis=1)
    # Of these, the centres of cells, and their pixels.
    index = np.searchsorted(places * outwards, centres * outwards)
    sight = points[:, index] - aperture.position
    along = sight @ aperture.direction
    across = np.sqrt(np.maximum(np.sum(sight**2, axis=-1) - along**2, 0.0))
    pixel = np.stack(pixels_at(across, along, aperture, grid), axis=-1)
    kept = np.all((pixel > -0.5) & (pixel < np.array(grid.shape) - 0.5), axis=-1)
    number = np.stack(np.broadcast_arrays(rows, cols[:, None]), axis=-1)
    inside = (elevation >= beams.span[0]) & (elevation <= beams.span[1])
    return GroundCells(
        number=number[kept],
        height=height[:, index][kept],
        lit=lit[:, index][kept],
        inside=inside[:, index][kept],
        pixel=np.rint(pixel[kept]).astype(np.intp),
    )
