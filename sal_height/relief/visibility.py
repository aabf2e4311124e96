"""Visibility: parts of the ground that hide others from the sensor.

A line of sight rises from the ground towards the sensor, and is followed cell by cell. A measured surface bounds the
height of all that it is seen over, and unmeasured ground behind a high surface may be in its shadow.
Pixels without a signal show a shadow that is too short for that.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sal_height.elevation import Validity
from sal_height.geometry import ApertureState, aperture_at, sphere_coordinates
from sal_height.numeric import F64, I64, Bool, Index
from sal_height.relief import _kernels as kernels
from sal_height.relief.heights import HeightField


def blocking_cells(place: F64, height: F64, towards: F64, top: F64, cell_size: float) -> tuple[Index, Index]:
    """Find the cells whose surface blocks lines of sight.

    Args:
        place: row and column of the points where the lines start, in cells, shape (n, 2); whole numbers are middles.
        height: height of the points, m, shape (n,).
        towards: distance east and north along each line per metre of rise, m/m, shape (n, 2).
        top: height of the highest surface of each cell, m, shape (rows, cols); NaN where none is known.
        cell_size: side of a cell, m. A surface that rises above a line by less does not block it.

    Returns:
        Number of a line and flat number of a cell that blocks it, for every such pair, each of shape (pairs,).
    """
    level = np.hypot(towards[:, 0], towards[:, 1])
    with np.errstate(invalid="ignore", divide="ignore"):
        direction, rise = towards[:, ::-1] / level[:, None], cell_size / level
    walls = np.nan_to_num(top, nan=-np.inf) - cell_size
    # Distance in cells from one point of a line of sight to the next, and to the first. Footprints are wider, and
    # the cells next to a wall are as uncertain in their position as the wall.
    stride = 2
    lines = place, height, direction, rise, walls, stride
    found = np.empty((kernels.follow_lines(*lines, np.empty((0, 2), np.int64)), 2), np.int64)
    kernels.follow_lines(*lines, found)
    return found[:, 0], found[:, 1]


def contradicted(lines: Index, cells: Index, measured: int, size: int) -> tuple[Bool, Bool]:
    """Decide which ones are wrong where measured points are hidden behind measured surfaces: the fewer give way.

    A high ghost hides many points that were measured all the same; a roof hides few ghosts with each of its cells.

    Args:
        lines: numbers of the points that are hidden (`blocking_cells`).
        cells: flat numbers of the cells that hide them.
        measured: number of points.
        size: number of cells.

    Returns:
        True if the surface of each cell is wrong, shape (size,), and True if each point is, shape (measured,).
    """
    share = 1 / np.maximum(np.bincount(lines, minlength=measured), 1)
    surface_wrong = np.bincount(cells, share[lines], size) > 1
    point_wrong = np.zeros(measured, dtype=bool)
    point_wrong[lines[~surface_wrong[cells]]] = True
    return surface_wrong, point_wrong


def silent_cells(field: HeightField, aperture: ApertureState, gate: float, cell_size: float) -> I64:
    """Find the cells in shadow that pixels without a signal show.

    Where nothing but pixels of NO_SIGNAL is between two measured pixels of a column, and the farther one is lower, the
    nearer one hides the ground from its edge to where the line of sight over it meets the height of the other. The
    middle of the hidden part is in the middle between both: neither is at its end, but up to a pixel away. Found are
    cells that are hidden as a whole.

    Args:
        field: height image.
        aperture: aperture from which it was seen.
        gate: standard deviations by which the farther one must be lower.
        cell_size: side of a cell, m.

    Returns:
        Row (north) and column (east) of the cells, counted from the map's origin, shape (n, 2).
    """
    heights = np.stack([np.where(surface.is_determined, surface.height, -np.inf) for surface in field.surfaces])
    highest, seen = np.argmax(heights, axis=0), np.isfinite(heights.max(axis=0))
    number = np.broadcast_to(np.arange(field.grid.rows)[:, None], field.grid.shape)
    signals = np.cumsum(field.validity != Validity.NO_SIGNAL, axis=0)
    last = np.maximum.accumulate(np.where(seen, number, -1), axis=0)
    row, col = np.nonzero(seen[1:] & (last[:-1] >= 0) & (last[:-1] < number[:-1]))
    silent = signals[row, col] == signals[last[row, col], col]
    row, col = row[silent], col[silent]
    far, near = (row + 1, col), (last[row, col], col)

    def at(pixels: tuple[I64, I64], values: Sequence[F64]) -> F64:
        of_surfaces = np.stack([one[pixels] for one in values])
        return np.asarray(of_surfaces[highest[pixels], np.arange(len(col))])

    positions = [surface.positions for surface in field.surfaces]
    sigmas = [surface.own_sigma for surface in field.surfaces]
    edge, foot = (np.stack(sphere_coordinates(at(pixels, positions)), axis=-1) for pixels in (near, far))
    drop = edge[:, 2] - foot[:, 2]
    chosen = drop > gate * np.hypot(at(near, sigmas), at(far, sigmas))
    points = at(far, positions)[chosen]
    sight = points - aperture_at(points, aperture).position
    away = -sight[:, :2] / sight[:, 2:]  # how far the line of sight goes per metre that it falls
    level = np.hypot(away[:, 0], away[:, 1])
    middle, half = (edge + foot)[chosen, :2] / 2, drop[chosen] * level / 2 - cell_size / 2
    places = 2 * np.maximum(np.ceil(2 * half / cell_size), 0).astype(np.int64)
    run = np.repeat(np.arange(len(places)), places)
    share = (np.arange(len(run)) - (np.cumsum(places) - places)[run]) / np.maximum(places[run] - 1, 1)
    along = middle[run] + ((2 * share - 1) * half[run] / level[run])[:, None] * away[run]
    beside = away[run, ::-1] * [-1, 1] * (field.grid.col_spacing / 4 / level[run])[:, None]
    both = np.concatenate([along - beside, along + beside])
    return np.unique(np.floor(both[:, ::-1] / cell_size).astype(np.int64), axis=0)
