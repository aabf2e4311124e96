"""Responses of the beams to many scatterers at a time, read from a table over a lattice of directions.

The amplitude of a beam is the spectrum of an aperture, so that it is smooth on the scale of a beamwidth. Nodes lie at
multiples of a fixed spacing, and a value depends on the 4 x 4 nodes around its direction alone.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from sal_height.beams import Beams
from sal_height.numeric import C64, F32, F64, Bool
from sal_height.simulation._kernels import read_lattice

NODES_PER_BEAMWIDTH = 20
"""Nodes of the table in a beamwidth: Lagrange's cubics are then off by at most 9/384 (pi / 20)^4 = 1.4e-5 per axis."""

LEAST_REACH, MOST_REACH = 32, 512
"""Nodes to each side of the middle of a table, and powers of 2 between, so that the dwells of a flight use one table.

The responses to scatterers farther off, by more than 25 beamwidths, are computed one by one.
"""


def response_of(beams: Beams, offset: F64, squint: F64) -> F32 | C64:
    """Response of every detector, float32 or complex64, shape (scatterers, detectors).

    Within 4e-5 of the peak of `Beams.response`, which is evaluated where the table is less accurate: beyond its
    ends, and at the edge of a measured beam, beyond which nothing is received. Scatterers that are seen in several
    directions, shape (directions, scatterers), have the detectors of each in turn: (scatterers, directions *
    detectors).

    Args:
        beams: beams of the detectors.
        offset: elevation from the middle of the axis, rad, shape (scatterers,).
        squint: squint, rad, same shape.
    """
    spacing = min(beams.beamwidth, beams.beamwidth_beside) / NODES_PER_BEAMWIDTH
    offset, squint = (np.atleast_2d(np.ascontiguousarray(angle, dtype=np.float64)) for angle in (offset, squint))
    widest = [max(float(angle.max()), -float(angle.min())) for angle in (offset, squint)]
    rows, cols = (_reach(angle / spacing) for angle in widest)
    parts, rough = _table(beams, spacing, rows, cols)
    inside = (MOST_REACH - 3) * spacing
    near = [np.clip(angle, -inside, inside) if max(widest) > inside else angle for angle in (offset, squint)]
    read = [np.empty((offset.shape[1], len(offset) * beams.count), np.float32) for _ in parts]
    for table, values in zip(parts, read, strict=True):
        for number in range(len(offset)):
            first = number * beams.count
            read_lattice(table, spacing, np.array([rows, cols]), near[0][number], near[1][number], first, values)
    response = read[0] if len(read) == 1 else read[0] + 1j * read[1]
    if max(widest) > inside or np.any(rough):
        node = [np.floor(angle / spacing).astype(np.intp) for angle in near]
        asked = (np.maximum(np.abs(offset), np.abs(squint)) > inside) | rough[node[0] + rows - 1, node[1] + cols - 1]
        direction, there = np.nonzero(asked)
        exact = beams.response(offset[direction, there] + beams.axis_middle, squint[direction, there])
        response.reshape(offset.shape[1], len(offset), -1)[there, direction] = exact
    return response


def _reach(nodes: float) -> int:
    """Nodes to each side of 0 of a table that has at least these nodes and two more."""
    return min(MOST_REACH, LEAST_REACH * 2 ** math.ceil(max(0.0, math.log2((nodes + 2) / LEAST_REACH))))


@lru_cache(maxsize=8)
def _table(beams: Beams, spacing: float, rows: int, cols: int) -> tuple[list[F32], Bool]:
    """Responses on nodes to `rows` in elevation and `cols` in squint, and a mask of those too rough to be interpolated.

    Real and, if they are complex, imaginary parts have the shape (rows, cols * detectors); `rough` is
    the mask for the 4 x 4 nodes that start at each.
    """
    row, col = (np.arange(-reach, reach + 1, dtype=np.float64) for reach in (rows, cols))
    values = beams.response(row[:, None] * spacing + beams.axis_middle, col * spacing)
    halves = np.array([-1, 9, 9, -1]) / 16
    along = np.lib.stride_tricks.sliding_window_view(values, (4, 4), axis=(0, 1))
    middle = np.einsum("rckij,i,j->rck", along, halves, halves)
    exact = beams.response((row[1:-2, None] + 0.5) * spacing + beams.axis_middle, (col[1:-2] + 0.5) * spacing)
    rough = np.any(np.abs(middle - exact) > 4e-5 * np.abs(values).max(), axis=-1)
    parts = [values.real, values.imag] if np.iscomplexobj(values) else [values]
    return [np.ascontiguousarray(part.reshape(len(row), -1), dtype=np.float32) for part in parts], rough
