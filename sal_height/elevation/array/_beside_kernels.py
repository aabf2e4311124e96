"""Compiled loops that try one scatterer in addition to the single one of a pixel.

Each has a twin in plain NumPy in the tests. Matrices are real or complex, as the beams are; positions are in steps of
the table of unit responses, `SearchTables.unit_pieces`. The compiler takes all numbers to be finite.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from sal_height.numeric import F32, F64, Index, compiled, inlined

Numbers = npt.NDArray[Any]

LEAST_RESIDUE = 0.02  # least fraction of |a|^2 perpendicular to the other scatterers for which a node is tried


@compiled
def gain_beside_one(
    matrices: Numbers, squints: Index, values: F32, position: F64, pieces: Numbers, units: Numbers, found: F64
) -> None:
    """Power that one more scatterer explains: at the best node of the grid, and along the slope of the single one.

    With the unit response u of the single scatterer and u_j of node j, the node adds the power along the part of u_j
    perpendicular to u. A surface that is spread over elevation adds power along the slope u', less its part along u:
    responses of complex beams turn in phase.

    Args:
        matrices: R, (pixels, M, M).
        squints: number of the squint of each pixel, (pixels,).
        values: u_j^H R u_j, (pixels, nodes).
        position: position of the single scatterer, (pixels,).
        pieces: cubics of the table of unit responses, (squints, table nodes - 1, 4, M).
        units: u_j, (squints, M, nodes).
        found: gains to fill in, at the best node and along the slope, (2, pixels).
    """
    _, size, nodes = units.shape
    unit, slope, output = np.empty(size, units.dtype), np.empty(size, units.dtype), np.empty(size, units.dtype)
    overlap, cross = np.empty(nodes, units.dtype), np.empty(nodes, units.dtype)
    one, two, least = np.float32(1), np.float32(2), np.float32(LEAST_RESIDUE)
    for i in range(len(position)):
        matrix, line, table = matrices[i], values[i], units[squints[i]]
        unit_at(position[i], pieces[squints[i]], unit, slope)
        multiply(matrix, unit, output)
        own = inner(unit, output).real
        overlap[:] = 0
        cross[:] = 0
        for m in range(0, size - 3, 4):
            _add_products(table[m : m + 4], unit[m : m + 4], output[m : m + 4], overlap, cross)
        for m in range(size // 4 * 4, size):
            row, u, y = table[m], unit[m], output[m]
            for j in range(nodes):
                overlap[j] += np.conj(row[j]) * u
                cross[j] += np.conj(row[j]) * y
        best = np.float32(0)
        for j in range(nodes):
            inside = (overlap[j] * np.conj(overlap[j])).real
            beyond, apart = line[j] - two * (np.conj(overlap[j]) * cross[j]).real + inside * own, one - inside
            best = max(best, beyond / max(apart, least) if apart > least else np.float32(0))
        found[0, i] = best
        turn = inner(unit, slope)
        for m in range(size):
            slope[m] -= turn * unit[m]
        multiply(matrix, slope, output)
        norm = inner(slope, slope).real
        found[1, i] = inner(slope, output).real / norm if norm > 0 else 0.0


@inlined
def _add_products(rows: Numbers, unit: Numbers, output: Numbers, overlap: Numbers, cross: Numbers) -> None:
    """Add the products of four channels' responses at all nodes, conjugate, with two vectors of the same channels."""
    r0, r1, r2, r3 = rows[0], rows[1], rows[2], rows[3]
    u0, u1, u2, u3 = unit[0], unit[1], unit[2], unit[3]
    y0, y1, y2, y3 = output[0], output[1], output[2], output[3]
    for j in range(overlap.size):
        a, b, c, d = np.conj(r0[j]), np.conj(r1[j]), np.conj(r2[j]), np.conj(r3[j])
        overlap[j] += a * u0 + b * u1 + c * u2 + d * u3
        cross[j] += a * y0 + b * y1 + c * y2 + d * y3


@compiled
def unit_at(position: float, pieces: Numbers, unit: Numbers, slope: Numbers) -> None:
    """Unit response and its slope at a position, from the cubics of the table."""
    node = min(int(position), len(pieces) - 1)
    piece, t = pieces[node], np.float32(position - node)
    for m in range(unit.size):
        unit[m] = piece[0, m] + t * (piece[1, m] + t * (piece[2, m] + t * piece[3, m]))
        slope[m] = piece[1, m] + t * (2 * piece[2, m] + 3 * t * piece[3, m])


@compiled
def multiply(matrix: Numbers, vector: Numbers, product: Numbers) -> None:
    for m in range(vector.size):
        total = vector.dtype.type(0)
        for n in range(vector.size):
            total += matrix[m, n] * vector[n]
        product[m] = total


@compiled
def inner(left: Numbers, right: Numbers) -> Any:
    """The product left^H right."""
    total = left.dtype.type(0)
    for m in range(left.size):
        total += np.conj(left[m]) * right[m]
    return total
