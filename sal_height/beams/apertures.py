"""Beam patterns along one axis, and what a detector of some width makes of them.

A detector behind the aperture adds up the amplitude, not the power, that falls on it (SAL paper, section 2): its
pattern is the mean of the point pattern over its width.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import erf, sici

from sal_height.numeric import F64

GAUSSIAN_WIDTH = 0.617972
"""Standard deviation of the Gaussian pattern in beamwidths: the half-power width of the circular aperture's."""

NARROW = 1e-3
"""Width in beamwidths below which a difference of integrals loses more than two Gauss-Legendre nodes do (1e-13)."""


@dataclass(frozen=True)
class Profile:
    """A real function f of one offset in beamwidths.

    Attributes:
        integral: of f from 0.
        value: f.
        slope: its derivative.
    """

    integral: Callable[[F64], F64]
    value: Callable[[F64], F64]
    slope: Callable[[F64], F64]

    def mean(self, x: npt.ArrayLike, width: npt.ArrayLike) -> F64:
        """Mean of f over `width` around `x`; both in beamwidths, broadcast. Float32 of a point where `x` is."""
        return _mean(self.integral, self.value, _as_float(x), np.asarray(width))

    def mean_slope(self, x: npt.ArrayLike, width: npt.ArrayLike) -> F64:
        """Derivative of `mean` with respect to `x`, per beamwidth."""
        return _mean(self.value, self.slope, _as_float(x), np.asarray(width))


def _as_float(x: npt.ArrayLike) -> F64:
    x = np.asarray(x)
    return x if x.dtype == np.float32 else x.astype(np.float64, copy=False)


def _mean(integral: Callable[[F64], F64], value: Callable[[F64], F64], x: F64, width: F64) -> F64:
    widest = np.max(width)
    if widest == 0:
        return value(x)
    if widest < NARROW:
        step = width / math.sqrt(12)
        return (value(x - step) + value(x + step)) / 2
    return (integral(x + width / 2) - integral(x - width / 2)) / width


def _sinc_integral(x: F64) -> F64:
    return sici(np.pi * x)[0] / np.pi


def _sinc_slope(x: F64) -> F64:
    near = np.abs(x) < 1e-4
    safe = np.where(near, 1.0, x)
    return np.where(near, -(np.pi**2) / 3 * x, (np.cos(np.pi * safe) - np.sinc(safe)) / safe)


def _gaussian_integral(x: F64) -> F64:
    return GAUSSIAN_WIDTH * math.sqrt(np.pi / 2) * erf(x / (GAUSSIAN_WIDTH * math.sqrt(2)))


def _gaussian(x: F64) -> F64:
    return np.exp(-np.square(x) / (2 * GAUSSIAN_WIDTH**2))


def _gaussian_slope(x: F64) -> F64:
    return -x / GAUSSIAN_WIDTH**2 * _gaussian(x)


SINC = Profile(_sinc_integral, np.sinc, _sinc_slope)
"""Of a straight aperture of length 1 (SAL paper, section 2)."""

GAUSSIAN = Profile(_gaussian_integral, _gaussian, _gaussian_slope)
