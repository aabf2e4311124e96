"""exp(j phase) of large phases: float64 until only the fraction of a turn is left, float32 from there on."""

from __future__ import annotations

import numpy as np

from sal_height.numeric._kernels import fill_outer_phasors, fill_phasors
from sal_height.numeric.arrays import C64, F64
from sal_height.numeric.threads import in_parallel

SMALL = 2**17  # least number for which another thread pays


def unit_phasors(phase: F64) -> C64:
    """exp(j phase), complex64 and of the shape of `phase` (rad); the error is less than 1e-6."""
    result = np.empty(phase.shape, dtype=np.complex64)
    flat, numbers = np.ascontiguousarray(phase).reshape(-1), result.reshape(-1).view(np.float32)
    in_parallel(lambda part: fill_phasors(flat[part], numbers[2 * part.start : 2 * part.stop]), flat.size, SMALL)
    return result


def outer_phasors(first: F64, second: F64) -> C64:
    """exp(j first second) of every two numbers, whose product is in rad: complex64, shape (first, second)."""
    result = np.empty((first.size, second.size), dtype=np.complex64)
    numbers = result.view(np.float32)
    in_parallel(
        lambda part: fill_outer_phasors(first[part], second, numbers[part]), first.size, -(-SMALL // second.size)
    )
    return result
