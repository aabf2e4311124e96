"""exp(j phase) of large phases: float64 until only the fraction of a turn is left, float32 from there on."""

from __future__ import annotations

import math

import numpy as np

from sal_height.numeric.arrays import C64, F32, F64
from sal_height.numeric.jit import compiled, in_parallel

SMALL = 2**15
"""Numbers that are not worth a thread."""


def unit_phasors(phase: F64) -> C64:
    """exp(j phase), complex64 and of the shape of `phase` (rad); the error is less than 1e-6."""
    result = np.empty(phase.shape, dtype=np.complex64)
    flat, numbers = np.ascontiguousarray(phase).reshape(-1), result.reshape(-1).view(np.float32)
    in_parallel(lambda part: _fill(flat[part], numbers[2 * part.start : 2 * part.stop]), flat.size, SMALL)
    return result


def outer_phasors(rows: F64, cols: F64) -> C64:
    """exp(j rows[i] cols[j]) as of `unit_phasors`, complex64, shape (rows, cols); the phases are held nowhere."""
    result = np.empty((rows.size, cols.size), dtype=np.complex64)
    numbers = result.view(np.float32)
    in_parallel(lambda part: _fill_outer(rows[part], cols, numbers[part]), rows.size, max(1, SMALL // cols.size))
    return result


def distance_phasors(wavenumber: float, points: F64, positions: F64, references: F64) -> C64:
    """exp(j wavenumber (|points[i] - positions[j]| - references[j])) as of `unit_phasors`.

    Args:
        wavenumber: rad/m.
        points: m, shape (points, 3).
        positions: m, shape (positions, 3).
        references: m, shape (positions,).

    Returns:
        Complex64, shape (points, positions).
    """
    result = np.empty((len(points), len(positions)), dtype=np.complex64)
    numbers, (x, y, z) = result.view(np.float32), np.ascontiguousarray(positions.T)
    in_parallel(
        lambda part: _fill_distances(wavenumber, points[part], x, y, z, references, numbers[part]),
        len(points),
        max(1, SMALL // len(positions)),
    )
    return result


@compiled
def cosine_and_sine(turns: float) -> tuple[np.float32, np.float32]:
    """Cosine and sine of 2 pi `turns`, float32, by the series of the half angle, which lies within a quarter turn."""
    y = np.float32(turns - np.floor(turns + 0.5))
    q = y * y
    s = np.float32(-0.599264529321) + q * (np.float32(0.0821458866111) - q * np.float32(0.00737043094571))
    s = y * (np.float32(3.14159265359) + q * (np.float32(-5.16771278005) + q * (np.float32(2.55016403988) + q * s)))
    c = np.float32(0.235330630359) + q * (np.float32(-0.0258068913900) + q * np.float32(0.00192957430940))
    c = np.float32(4.05871212642) + q * (np.float32(-1.33526276885) + q * c)
    c = np.float32(1) + q * (np.float32(-4.93480220054) + q * c)
    return np.float32(1) - np.float32(2) * s * s, np.float32(2) * s * c


@compiled
def _fill(phase: F64, result: F32) -> None:
    for i in range(phase.size):
        cosine, sine = cosine_and_sine(phase[i] * 0.15915494309189535)
        result[2 * i] = cosine
        result[2 * i + 1] = sine


@compiled
def _fill_outer(rows: F64, cols: F64, result: F32) -> None:
    for i in range(rows.size):
        turns, line = rows[i] * 0.15915494309189535, result[i]
        for j in range(cols.size):
            cosine, sine = cosine_and_sine(turns * cols[j])
            line[2 * j] = cosine
            line[2 * j + 1] = sine


@compiled
def _fill_distances(wavenumber: float, points: F64, x: F64, y: F64, z: F64, references: F64, result: F32) -> None:
    turns = wavenumber * 0.15915494309189535
    for i in range(len(points)):
        px, py, pz = points[i]
        line = result[i]
        for j in range(x.size):
            dx, dy, dz = px - x[j], py - y[j], pz - z[j]
            cosine, sine = cosine_and_sine(turns * (math.sqrt(dx * dx + dy * dy + dz * dz) - references[j]))
            line[2 * j] = cosine
            line[2 * j + 1] = sine
