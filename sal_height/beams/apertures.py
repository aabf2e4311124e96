"""Amplitude patterns of apertures by formula, and their slopes, for point detectors.

Offsets e (elevation, along the detector axis) and a (azimuth, across it) are in beamwidths, wavelength / aperture.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from scipy.special import j0, j1

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
