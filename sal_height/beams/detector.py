"""Finite detectors: the mean of a point detector's pattern over a rectangle.

Detection is coherent: a detector adds up the amplitude, not the power, of the field that falls on it (SAL paper,
sections 2 and 3). The mean is a product of two Gauss-Legendre rules. Where there are many offsets, it is tabulated over
the region that they cover and interpolated by a spline.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from scipy.special import roots_legendre

from sal_height.beams.apertures import PatternFunction
from sal_height.beams.spline import spline_surface
from sal_height.numeric import F64

LEAST_NODES, NODES_PER_BEAMWIDTH = 6, 3
"""Quadrature nodes along one side of a detector: the least, and those added for every beamwidth.

They leave an error below 1e-11, also for the Gaussian, the one pattern here with an unlimited spectrum.
"""

STEP = 1 / 32
"""Step of the table in beamwidths: a spline of DEGREE follows 1/2 cycle per beamwidth within 4 (STEP / 2)^6 = 6e-11."""

DEGREE = 5

MARGIN = 16
"""Nodes of the table beyond the offsets on each side, in which the spline forgets its ends."""


def average_over_detector(function: PatternFunction, size: tuple[float, float]) -> PatternFunction:
    """Return the mean of a pattern, or of a slope, over a rectangular detector.

    Args:
        function: of a point detector; real or complex, with spatial frequencies of up to 1/2 per beamwidth.
        size: widths of the detector along its axis (elevation) and beside it (azimuth), beamwidths; 0: a point.

    Returns:
        A function of the same offsets, within 1e-10 of the integral; NaN where an offset is not finite.
    """
    (along, along_weights), (across, across_weights) = (_quadrature(width) for width in size)

    def integrate(e: F64, a: F64) -> F64:
        total = 0.0
        for x, x_weight in zip(along, along_weights, strict=True):
            for y, y_weight in zip(across, across_weights, strict=True):
                total = total + x_weight * y_weight * function(e + x, a + y)
        return np.asarray(total)

    def average(e: npt.ArrayLike, a: npt.ArrayLike) -> F64:
        e, a = np.broadcast_arrays(np.asarray(e, dtype=np.float64), np.asarray(a, dtype=np.float64))
        table_size = math.prod(np.ptp(offset) / STEP + 2 * MARGIN for offset in (e, a)) if e.size else math.inf
        if not table_size < e.size:
            return integrate(e, a)
        nodes_e, nodes_a = (_table_nodes(offset) for offset in (e, a))
        return spline_surface(nodes_e, nodes_a, integrate(nodes_e[:, None], nodes_a), DEGREE)(e, a, (0, 0))

    return average


def _quadrature(width: float) -> tuple[F64, F64]:
    """Return nodes (beamwidths) and weights of the mean over an interval of `width` around 0."""
    if width == 0:
        return np.zeros(1), np.ones(1)
    nodes, weights = roots_legendre(LEAST_NODES + math.ceil(NODES_PER_BEAMWIDTH * width))
    return nodes * width / 2, weights / 2


def _table_nodes(offset: F64) -> F64:
    """Return multiples of STEP around all offsets, MARGIN of them beyond on each side."""
    first, last = np.floor(offset.min() / STEP) - MARGIN, np.ceil(offset.max() / STEP) + MARGIN
    return STEP * np.arange(first, last + 1)
