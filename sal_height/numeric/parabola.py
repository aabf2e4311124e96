"""Vertex of the parabola through three neighbouring values."""

from __future__ import annotations

import numpy as np

from sal_height.numeric.arrays import F64


def vertex(before: F64, there: F64, after: F64) -> tuple[F64, F64]:
    """Parabolas through three values each: distance of the vertex from the middle value, -1 to 1 steps; and their bend.

    The bend is that of a peak, twice the middle value less its neighbours, and greater than 0. Arguments and results
    are arrays of one shape, or numbers.
    """
    bend = np.maximum(2 * there - before - after, 1e-12 * (1 + np.abs(there)))  # greater than 0 also for a line
    return np.clip((after - before) / (2 * bend), -1.0, 1.0), bend
