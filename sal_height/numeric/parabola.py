"""Where the parabola through three neighbouring values has its vertex."""

from __future__ import annotations

import numpy as np

from sal_height.numeric.arrays import F64

LEAST_BEND = 1e-12
"""Of values that lie on a line, over their size."""


def vertex(before: F64, there: F64, after: F64) -> tuple[F64, F64]:
    """Of parabolas through three values each: steps of the vertex off the middle one, from -1 to 1; and their bend.

    The bend is that of a peak, twice the middle value less its neighbours, and greater than 0. Arguments and results
    are arrays of one shape, or numbers.
    """
    bend = np.maximum(2 * there - before - after, LEAST_BEND * (1 + np.abs(there)))
    return np.clip((after - before) / (2 * bend), -1.0, 1.0), bend
