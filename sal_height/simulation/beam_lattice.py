"""Responses of the beams to many scatterers at a time, read from a table over a lattice of directions.

The amplitude of a beam is the spectrum of an aperture, so that it is smooth on the scale of a beamwidth. Nodes lie at
multiples of a fixed spacing, and a value depends on the 4 x 4 nodes around its direction alone.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from sal_height.beams import Beams
from sal_height.numeric import C64, F32, F64, I32, Bool
from sal_height.simulation._kernels import read_lattice

NODES_PER_BEAMWIDTH = 20
"""Nodes of the table in a beamwidth: Lagrange's cubics are then off by at most 9/384 (pi / 20)^4 = 1.4e-5 per axis."""

LATTICE_ERROR = 4e-5
"""Greatest error between nodes, as a share of the beams' peak."""

BLOCK = 32
"""The table ends at multiples of so many nodes, so that dwells over alike scenes have the same."""


def response_of(beams: Beams, offset: F64 | F32, squint: F64 | F32) -> F32 | C64:
    """Response of every detector, float32 or complex64, shape (scatterers, detectors).

    Within LATTICE_ERROR of the peak of `Beams.response`, which is asked where the table cannot keep this: at the edge
    of a measured beam, beyond which nothing is received.

    Args:
        beams: of the detectors.
        offset: elevation from the middle of the axis, rad, shape (scatterers,).
        squint: rad, same shape.
    """
    spacing = min(beams.beamwidth, beams.beamwidth_beside) / NODES_PER_BEAMWIDTH
    places = offset.astype(np.float64) / spacing, squint.astype(np.float64) / spacing
    extents = _extent(places[0]), _extent(places[1])
    parts, rough = _table(beams, spacing, *extents)
    bins, weights = _stencils(places, extents)
    read = []
    for table in parts:
        read.append(np.empty((len(places[0]), beams.count), np.float32))
        read_lattice(table, bins, weights, read[-1])
    response = read[0] if len(read) == 1 else read[0] + 1j * read[1]
    if np.any(rough) and (there := np.flatnonzero(rough[*bins])).size:
        response[there] = beams.response(offset[there] + beams.axis_middle, squint[there])
    return response


def _extent(places: F64) -> tuple[int, int]:
    """First and last node, multiples of BLOCK, of a table that holds places (in nodes) and two nodes to each side."""
    return BLOCK * int((np.min(places) - 2) // BLOCK), BLOCK * int((np.max(places) + 2) // BLOCK + 1)


def _stencils(places: tuple[F64, F64], extents: tuple[tuple[int, int], ...]) -> tuple[I32, F32]:
    """First node of 4 in each axis around places, counted from the first of the table, and the nodes' weights."""
    bins, weights = np.empty((2, len(places[0])), np.int32), np.empty((8, len(places[0])), np.float32)
    for axis, (place, (first, _)) in enumerate(zip(places, extents, strict=True)):
        before = np.floor(place)
        bins[axis] = before - (first + 1)
        t = (place - before).astype(np.float32)
        a, b, c = t + 1, t - 1, t - 2
        weights[4 * axis : 4 * axis + 4] = -t * b * c / 6, a * b * c / 2, -a * t * c / 2, a * t * b / 6
    return bins, weights


@lru_cache(maxsize=8)
def _table(beams: Beams, spacing: float, rows: tuple[int, int], cols: tuple[int, int]) -> tuple[list[F32], Bool]:
    """Responses on nodes in elevation (rows) and squint (cols), and where they are too rough to be interpolated.

    Real and, if they are complex, imaginary parts have the shape (rows, cols * detectors); `rough` tells it of the
    4 x 4 nodes that begin at each.
    """
    row, col = (np.arange(first, last + 1, dtype=np.float64) for first, last in (rows, cols))
    values = beams.response(row[:, None] * spacing + beams.axis_middle, col * spacing)
    halves = np.array([-1, 9, 9, -1]) / 16
    along = np.lib.stride_tricks.sliding_window_view(values, (4, 4), axis=(0, 1))
    middle = np.einsum("rckij,i,j->rck", along, halves, halves)
    exact = beams.response((row[1:-2, None] + 0.5) * spacing + beams.axis_middle, (col[1:-2] + 0.5) * spacing)
    rough = np.any(np.abs(middle - exact) > LATTICE_ERROR * np.abs(values).max(), axis=-1)
    parts = [values.real, values.imag] if np.iscomplexobj(values) else [values]
    return [np.ascontiguousarray(part.reshape(len(row), -1), dtype=np.float32) for part in parts], rough
