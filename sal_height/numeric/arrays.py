"""Types of arrays by the type of their elements; docstrings of functions state shapes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
C64 = npt.NDArray[np.complex64]
C128 = npt.NDArray[np.complex128]
Complex = npt.NDArray[np.complexfloating]
"""Complex64 or complex128."""

Bool = npt.NDArray[np.bool_]
U8 = npt.NDArray[np.uint8]
I32 = npt.NDArray[np.int32]
I64 = npt.NDArray[np.int64]
Index = npt.NDArray[np.intp]
"""Indices of elements."""


def vertex(before: F64, there: F64, after: F64) -> tuple[F64, F64]:
    """Parabolas through three values each: distance of the vertex from the middle value, -1 to 1 steps; and their bend.

    The bend is that of a peak, twice the middle value less its neighbours, and greater than 0. Arguments and results
    are arrays of one shape, or numbers.
    """
    bend = np.maximum(2 * there - before - after, 1e-12 * (1 + np.abs(there)))  # greater than 0 also for a line
    return np.clip((after - before) / (2 * bend), -1.0, 1.0), bend
