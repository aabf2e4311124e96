"""Aberrations of the common pupil: Zernike terms of its phase, and the far field behind them.

With the phase Phi over a circular pupil of the diameter of a beamwidth's reciprocal the pattern of a point detector is

    h(e, a) = mean over the pupil of exp(j Phi) exp(j 2 pi (u e + v a)),   u^2 + v^2 < 1/4 cycle per beamwidth,

jinc for Phi = 0. Phi = 2 pi sum c_k Z_k, with Zernike polynomials of the mean square 1 (Noll, J. Opt. Soc. Am. 66,
1976), so that c_k is in waves rms. Terms that are even in (u, v) make h complex: it then has h(-e, -a) = h(e, a), and
the conjugate of h for the opposite sign. Odd terms leave it real and make it lopsided. A power |h|^2 alone, as of one
detector, is the same for both signs of all even terms; ratios of the complex amplitudes of several detectors are not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.special import roots_legendre

from sal_height.beams.apertures import JINC_NULL, PatternFunction, average_over_detector
from sal_height.beams.pattern import Pattern
from sal_height.errors import UserError
from sal_height.numeric import C128, F64

ZERNIKE: dict[str, Callable[[F64, F64], F64]] = {
    "defocus": lambda r, _: np.sqrt(3) * (2 * r**2 - 1),
    "astigmatism": lambda r, t: np.sqrt(6) * r**2 * np.cos(2 * t),
    "oblique_astigmatism": lambda r, t: np.sqrt(6) * r**2 * np.sin(2 * t),
    "coma": lambda r, t: np.sqrt(8) * (3 * r**3 - 2 * r) * np.cos(t),
    "coma_beside": lambda r, t: np.sqrt(8) * (3 * r**3 - 2 * r) * np.sin(t),
    "spherical": lambda r, _: np.sqrt(5) * (6 * r**4 - 6 * r**2 + 1),
}
"""Zernike polynomials of mean square 1 over the pupil, of radius (0 to 1) and angle from the detector axis."""

RADII, ANGLES = 20, 56
"""Numbers of nodes of the quadrature over the pupil, exact within 1e-11 up to ten beamwidths from the boresight."""


def aberrated_pattern(coefficients: tuple[float, ...], size: tuple[float, float] = (0.0, 0.0)) -> Pattern:
    """Return the pattern of a detector behind a circular aperture whose pupil has aberrations.

    Args:
        coefficients: coefficients of the terms of ZERNIKE in their order, waves rms.
        size: widths of the detector along and across its axis, beamwidths; 0: a point.

    Raises:
        UserError: a coefficient is missing or not finite.
    """
    if len(coefficients) != len(ZERNIKE) or not np.all(np.isfinite(coefficients)):
        raise UserError(
            f"The pupil has the coefficients {coefficients}; {len(ZERNIKE)} finite ones are needed: "
            f"{', '.join(ZERNIKE)}."
        )
    return _pattern(coefficients, size)


@lru_cache(maxsize=32)
def _pattern(coefficients: tuple[float, ...], size: tuple[float, float]) -> Pattern:
    """Return the pattern; cached, because it is tabulated."""
    u, v, _, _ = _pupil()
    field = _field(coefficients)
    along, beside = (_far_field(2j * np.pi * direction * field, size) for direction in (u, v))
    return Pattern("jinc", _far_field(field, size), along, beside, JINC_NULL + size[1] / 2, size=size)


def aberrated_derivatives(coefficients: tuple[float, ...], size: tuple[float, float] = (0.0, 0.0)) -> list[Pattern]:
    """Return the derivatives of `aberrated_pattern` with respect to each coefficient, per wave; they have no slopes.

    Args:
        coefficients: coefficients of the terms of ZERNIKE in their order, waves rms.
        size: widths of the detector along and across its axis, beamwidths; 0: a point.
    """
    field, terms = _field(coefficients), _pupil()[3]
    point = aberrated_pattern(coefficients, size)
    return [replace(point, amplitude=_far_field(2j * np.pi * term * field, size)) for term in terms]


def _field(coefficients: tuple[float, ...]) -> C128:
    """Amplitude at the nodes of the pupil, times the weights of its mean."""
    _, _, weights, terms = _pupil()
    return np.asarray(weights * np.exp(2j * np.pi * np.asarray(coefficients) @ terms))


def _far_field(field: C128, size: tuple[float, float]) -> PatternFunction:
    """Return the far field of a field in the pupil, mean over a detector, tabulated."""
    u, v, _, _ = _pupil()

    def value(e: npt.ArrayLike, a: npt.ArrayLike) -> F64:
        """Field at offsets: e is a column and a is a row, or both are numbers."""
        offsets = np.asarray(e, dtype=np.float64), np.asarray(a, dtype=np.float64)
        along, across = (np.exp(2j * np.pi * np.outer(one, node)) for one, node in zip(offsets, (u, v), strict=True))
        values: Any = (along * field) @ across.T
        return values.reshape(np.broadcast_shapes(offsets[0].shape, offsets[1].shape))

    return average_over_detector(value, size)


@lru_cache(maxsize=1)
def _pupil() -> tuple[F64, F64, F64, F64]:
    """Nodes of the pupil (u and v, cycles per beamwidth), weights of its mean, and the terms of ZERNIKE there."""
    nodes, weights = roots_legendre(RADII)
    radius, angle = np.sqrt((nodes + 1) / 2), 2 * np.pi * np.arange(ANGLES) / ANGLES  # even in area
    r, t = (grid.ravel() for grid in np.meshgrid(radius, angle, indexing="ij"))
    terms = np.stack([term(r, t) for term in ZERNIKE.values()])
    return r * np.cos(t) / 2, r * np.sin(t) / 2, np.repeat(weights / 2, ANGLES) / ANGLES, terms
