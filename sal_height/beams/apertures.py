"""Amplitude patterns of apertures by formula, and their slopes, for point detectors; their means over finite detectors.

Offsets e (elevation, along the detector axis) and a (azimuth, across it) are in beamwidths, wavelength / aperture.

Detection is coherent: a detector adds up the amplitude, not the power, of the field that falls on it (SAL paper,
sections 2 and 3). The mean is a product of two Gauss-Legendre rules. It is computed once, at the Chebyshev points of
every square of two beamwidths that contains an offset, and interpolated by the polynomial through them (Trefethen,
Approximation Theory and Approximation Practice, 2013, chapter 8).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.polynomial.chebyshev import chebpts1, chebvander
from scipy.special import j0, j1, roots_legendre

from sal_height.numeric import F64

PatternFunction = Callable[[npt.ArrayLike, npt.ArrayLike], F64]
"""Amplitude, or a slope of it, at offsets e and a in beamwidths, which broadcast."""

GAUSSIAN_WIDTH = 0.617972
"""Standard deviation of the Gaussian pattern, in beamwidths: it has the half-power width of the circular aperture's."""

JINC_NULL = 1.2196698912665045
"""First null of the circular aperture's pattern, in beamwidths: the first zero of J1 over pi."""


def jinc(e: npt.ArrayLike, a: npt.ArrayLike) -> F64:
    """Evaluate the pattern of a circular aperture: 2 J1(x) / x with x = pi hypot(e, a); broadcasts."""
    x = np.pi * np.hypot(e, a)
    safe = np.where(x < 1e-6, 1.0, x)
    return np.where(x < 1e-6, 1.0, 2 * j1(safe) / safe)


def jinc_slope(e: npt.ArrayLike, a: npt.ArrayLike) -> F64:
    """Evaluate d jinc / de = -2 J2(x) / x dx/de with dx/de = pi e / hypot(e, a), per beamwidth; broadcasts."""
    x = np.pi * np.hypot(e, a)
    near = x < 0.1
    safe = np.where(near, 1.0, x)
    series = 0.25 * (1 - x**2 / 12 * (1 - x**2 / 32 * (1 - x**2 / 60)))
    recurrence = 2 * (2 * j1(safe) / safe - j0(safe)) / safe**2  # J2(x) = 2 J1(x) / x - J0(x), ten times as fast
    return -(np.pi**2) * np.asarray(e) * np.where(near, series, recurrence)


def sinc(e: npt.ArrayLike, a: npt.ArrayLike) -> F64:
    """Evaluate the pattern of a square aperture with sides along the axes; broadcasts."""
    return np.sinc(np.asarray(e)) * np.sinc(np.asarray(a))


def sinc_slope(e: npt.ArrayLike, a: npt.ArrayLike) -> F64:
    """Evaluate d sinc / de, per beamwidth; broadcasts."""
    e = np.asarray(e)
    near = np.abs(e) < 1e-4
    safe = np.where(near, 1.0, e)
    slope = np.where(near, -(np.pi**2) / 3 * e, (np.cos(np.pi * safe) - np.sinc(safe)) / safe)
    return slope * np.sinc(np.asarray(a))


def gaussian(e: npt.ArrayLike, a: npt.ArrayLike) -> F64:
    """Evaluate the Gaussian pattern of GAUSSIAN_WIDTH; broadcasts."""
    return _gaussian_profile(e) * _gaussian_profile(a)


def gaussian_slope(e: npt.ArrayLike, a: npt.ArrayLike) -> F64:
    """Evaluate d gaussian / de, per beamwidth; broadcasts."""
    return -np.asarray(e) / GAUSSIAN_WIDTH**2 * _gaussian_profile(e) * _gaussian_profile(a)


def _gaussian_profile(x: npt.ArrayLike) -> F64:
    return np.exp(-np.square(x) / (2 * GAUSSIAN_WIDTH**2))


Values = npt.NDArray[Any]
"""Float64 or complex128."""

POINTS = 22
"""Number of Chebyshev points along a side of a square.

Spatial frequencies of up to 1/2 cycle per beamwidth are interpolated within 2 (pi / 2)^22 / 22! = 4e-17, and the
Gaussian, the one pattern here with an unlimited spectrum, within 1e-12.
"""


def average_over_detector(function: PatternFunction, size: tuple[float, float]) -> PatternFunction:
    """Return the mean of a pattern, or of a slope, over a rectangular detector.

    Args:
        function: pattern of a point detector; real or complex, with spatial frequencies of up to 1/2 per beamwidth.
        size: widths of the detector along its axis (elevation) and across it (azimuth), beamwidths; 0: a point.

    Returns:
        A function of the same offsets, within 1e-11 of the integral; NaN where an offset is not finite.
    """
    (along, along_weights), (across, across_weights) = (_quadrature(width) for width in size)
    points = chebpts1(POINTS)
    to_coefficients = np.linalg.inv(chebvander(points, POINTS - 1))
    kind = np.result_type(function(0.0, 0.0))
    tables: dict[complex, Values] = {}

    def tabulate(e: float, a: float) -> Values:
        """Return the Chebyshev coefficients of the mean, shape (POINTS, POINTS), in the square around (e, a)."""
        nodes = np.add.outer(e + points, along).reshape(-1, 1)
        lines: Any = sum(
            weight * function(nodes, a + points + offset) for offset, weight in zip(across, across_weights, strict=True)
        )
        means = along_weights @ lines.reshape(POINTS, -1, POINTS)
        return to_coefficients @ means @ to_coefficients.T

    def average(e: npt.ArrayLike, a: npt.ArrayLike) -> Values:
        offsets = np.stack(np.broadcast_arrays(np.asarray(e, np.float64), np.asarray(a, np.float64)), axis=-1)
        result = np.full(offsets.shape[:-1], np.nan, kind)
        finite = np.isfinite(offsets).all(axis=-1)
        known = offsets[finite]
        at_once = 8192  # offsets whose Chebyshev polynomials, 3 MB, stay in the cache of a processor
        pieces = (known[first : first + at_once] for first in range(0, len(known), at_once))
        result[finite] = np.concatenate([np.zeros(0, kind), *map(interpolate, pieces)])
        return result

    def interpolate(offsets: F64) -> Values:
        """Return the mean at offsets, shape (number, 2)."""
        centres = 2 * np.rint(offsets / 2)
        x, y = (chebvander(inside, POINTS - 1) for inside in (offsets - centres).T)  # from -1 to 1
        squares, square_of = np.unique(centres.view(np.complex128)[:, 0], return_inverse=True)
        result = np.empty(len(offsets), kind)
        for index, square in enumerate(squares.tolist()):
            if square not in tables:
                tables[square] = tabulate(square.real, square.imag)
            inside = np.flatnonzero(square_of == index)
            result[inside] = (x[inside] @ tables[square] * y[inside]).sum(axis=-1)
        return result

    return average


def _quadrature(width: float) -> tuple[F64, F64]:
    """Return nodes (beamwidths) and weights of the mean over an interval of `width` around 0."""
    if width == 0:
        return np.zeros(1), np.ones(1)
    # Six nodes, and three for every beamwidth, leave an error below 1e-11, also for the Gaussian.
    nodes, weights = roots_legendre(6 + math.ceil(3 * width))
    return nodes * width / 2, weights / 2
