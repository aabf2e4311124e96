"""Bilinear interpolation on nodes that increase, compiled; a test compares it with its formula in NumPy."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sal_height.numeric.arrays import F64
from sal_height.numeric.jit import compiled_with_nan, inlined


def bilinear(rows: F64, cols: F64, values: F64, row: npt.ArrayLike, col: npt.ArrayLike) -> F64:
    """Interpolate values on nodes at positions that are broadcast together; NaN outside the nodes.

    Args:
        rows: positions of the nodes along the first axis, increasing.
        cols: positions of the nodes along the second axis, increasing.
        values: values at the nodes, shape (rows, cols).
        row: positions of the results along the first axis.
        col: positions of the results along the second axis.
    """
    y, x = np.broadcast_arrays(np.asarray(row, dtype=np.float64), np.asarray(col, dtype=np.float64))
    result = np.empty(y.shape)
    y_nodes, x_nodes, table = (np.ascontiguousarray(v, dtype=np.float64) for v in (rows, cols, values))
    interpolate(y_nodes, x_nodes, table, y.ravel(), x.ravel(), result.reshape(-1))
    return result


@compiled_with_nan
def interpolate(rows: F64, cols: F64, values: F64, row: F64, col: F64, result: F64) -> None:
    """Bilinear interpolation of values (rows, cols) at positions (row, col), (n,); NaN outside. Nodes increase."""
    i, j = 0, 0
    for k in range(row.size):
        y, x = row[k], col[k]
        if not (rows[0] <= y <= rows[-1] and cols[0] <= x <= cols[-1]):
            result[k] = np.nan
            continue
        i, j = node_before(rows, y, i), node_before(cols, x, j)
        result[k] = between_nodes(rows, cols, values, i, j, y, x)


@inlined
def node_before(nodes: F64, position: float, node: int) -> int:
    """The node before a position between first and last, searched from another node, as successive ones are near."""
    while nodes[node] > position:
        node -= 1
    while nodes[node + 1] < position:
        node += 1
    return node


@inlined
def between_nodes(rows: F64, cols: F64, values: F64, i: int, j: int, y: float, x: float) -> float:
    """Bilinear interpolation at row y and col x between the nodes i and i + 1, and j and j + 1."""
    down, right = (y - rows[i]) / (rows[i + 1] - rows[i]), (x - cols[j]) / (cols[j + 1] - cols[j])
    upper = values[i, j] * (1 - right) + values[i, j + 1] * right
    lower = values[i + 1, j] * (1 - right) + values[i + 1, j + 1] * right
    return upper * (1 - down) + lower * down
