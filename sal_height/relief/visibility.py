"""Visibility: what of the ground hides what else from the sensor.

A line of sight rises from the ground towards the sensor, and is followed cell by cell. A surface that was measured
bounds the height of all that it is seen over, and what was not measured behind a high surface may be in its shadow.
"""

from __future__ import annotations

import numpy as np

from sal_height.numeric import F64, Bool, Index

STRIDE = 2
"""Distance in cells from one place of a line of sight to the next, and to the first.

Footprints are wider, and the cells beside a wall are as uncertain in their place as the wall.
"""


def blocking_cells(place: F64, height: F64, towards: F64, top: F64, cell_size: float) -> tuple[Index, Index]:
    """Find the cells whose surface stands in the way of lines of sight.

    Args:
        place: row and column of the points where the lines begin, in cells, shape (n, 2); whole numbers are middles.
        height: of the points, m, shape (n,).
        towards: how far east and north each line goes per metre that it rises, shape (n, 2).
        top: height of the highest surface of each cell, m, shape (rows, cols); NaN where none is known.
        cell_size: m. What rises above a line by less is not in its way.

    Returns:
        Number of a line and flat number of a cell in its way, for every such pair, each of shape (pairs,).
    """
    rows, cols = top.shape
    level = np.hypot(towards[:, 0], towards[:, 1])
    with np.errstate(invalid="ignore", divide="ignore"):
        direction, rise = towards[:, ::-1] / level[:, None], cell_size / level
    highest = np.nanmax(top, initial=-np.inf) - cell_size
    lines = np.flatnonzero(height < highest)
    walls = np.nan_to_num(top, nan=-np.inf) - cell_size
    found_lines, found_cells = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    step = STRIDE
    while True:
        lines = lines[height[lines] + step * rise[lines] < highest]
        if not lines.size:
            return np.concatenate(found_lines), np.concatenate(found_cells)
        row, col = np.rint(place[lines] + step * direction[lines]).astype(np.int64).T
        inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
        lines, cell = lines[inside], (row * cols + col)[inside]
        blocked = walls.ravel()[cell] > height[lines] + step * rise[lines]
        found_lines.append(lines[blocked])
        found_cells.append(cell[blocked])
        step += STRIDE


def contradicted(lines: Index, cells: Index, measured: int, size: int) -> tuple[Bool, Bool]:
    """Decide what is wrong where measured points are hidden behind measured surfaces: the fewer give way.

    A high ghost hides many points that were measured all the same; a roof hides few ghosts with each of its cells.

    Args:
        lines: numbers of the points that are hidden (`blocking_cells`).
        cells: flat numbers of the cells that hide them.
        measured: number of points.
        size: number of cells.

    Returns:
        Whether the surface of each cell is wrong, shape (size,), and whether each point is, shape (measured,).
    """
    share = 1 / np.maximum(np.bincount(lines, minlength=measured), 1)
    surface_wrong = np.bincount(cells, share[lines], size) > 1
    point_wrong = np.zeros(measured, dtype=bool)
    point_wrong[lines[~surface_wrong[cells]]] = True
    return surface_wrong, point_wrong
