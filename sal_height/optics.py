"""Amplitude patterns of a detector's beam.

A pattern is a real function h of the direction to the target, seen from the beam's boresight: e in elevation and a in
azimuth, both in beamwidths (wavelength / aperture diameter), with h(0, 0) = 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import j1, jv

from sal_height.beam_table import BeamTable
from sal_height.errors import UserError

Array = npt.NDArray[np.float64]

GAUSSIAN_WIDTH = 0.617972
"""Standard deviation of the Gaussian pattern in beamwidths: the half-power width of the circular aperture's."""


@dataclass(frozen=True)
class Pattern:
    """A beam pattern and its slopes.

    Attributes:
        name: how presets and messages call it.
        amplitude: h(e, a); broadcasts. Float64, or complex128 for a measured beam.
        slope: the derivative of h with respect to e; broadcasts.
        azimuth_slope: the derivative of h with respect to a; broadcasts.
        domain: least and greatest e at which it is known.
    """

    name: str
    amplitude: Callable[[npt.ArrayLike, npt.ArrayLike], Array]
    slope: Callable[[npt.ArrayLike, npt.ArrayLike], Array]
    azimuth_slope: Callable[[npt.ArrayLike, npt.ArrayLike], Array]
    domain: tuple[float, float] = (-np.inf, np.inf)


def _gaussian(e: npt.ArrayLike, a: npt.ArrayLike) -> Array:
    return np.exp(-(np.square(e) + np.square(a)) / (2 * GAUSSIAN_WIDTH**2))


def _gaussian_slope(e: npt.ArrayLike, a: npt.ArrayLike) -> Array:
    return -np.asarray(e) / GAUSSIAN_WIDTH**2 * _gaussian(e, a)


def _sinc(e: npt.ArrayLike, a: npt.ArrayLike) -> Array:
    """Square aperture, sides along elevation and azimuth."""
    return np.asarray(np.sinc(np.asarray(e)) * np.sinc(np.asarray(a)))


def _sinc_slope(e: npt.ArrayLike, a: npt.ArrayLike) -> Array:
    e = np.asarray(e, dtype=np.float64)
    near = np.abs(e) < 1e-4
    safe = np.where(near, 1.0, e)
    along_e = np.where(near, -(np.pi**2) / 3 * e, (np.cos(np.pi * safe) - np.sinc(safe)) / safe)
    return np.asarray(along_e * np.sinc(np.asarray(a)))


def _jinc(e: npt.ArrayLike, a: npt.ArrayLike) -> Array:
    """Circular aperture: 2 J1(x) / x with x = pi r."""
    x = np.pi * np.hypot(e, a)
    safe = np.where(x < 1e-6, 1.0, x)
    return np.where(x < 1e-6, 1.0, 2 * j1(safe) / safe)


def _jinc_slope(e: npt.ArrayLike, a: npt.ArrayLike) -> Array:
    """d/dx [2 J1(x) / x] = -2 J2(x) / x, times dx/de = pi e / r."""
    x = np.pi * np.hypot(e, a)
    safe = np.where(x < 1e-6, 1.0, x)
    return -(np.pi**2) * np.asarray(e) * np.where(x < 1e-6, 0.25, 2 * jv(2, safe) / safe**2)


def _turned(slope: Callable[[npt.ArrayLike, npt.ArrayLike], Array]) -> Callable[[npt.ArrayLike, npt.ArrayLike], Array]:
    """The slope in azimuth of a pattern that is the same with elevation and azimuth exchanged."""
    return lambda e, a: slope(a, e)


PATTERNS = {
    pattern.name: pattern
    for pattern in (
        Pattern("gaussian", _gaussian, _gaussian_slope, _turned(_gaussian_slope)),
        Pattern("sinc", _sinc, _sinc_slope, _turned(_sinc_slope)),
        Pattern("jinc", _jinc, _jinc_slope, _turned(_jinc_slope)),
    )
}
"""Patterns of point detectors by name."""


def pattern_named(name: str) -> Pattern:
    """The pattern called `name`.

    Raises:
        UserError: there is none of that name.
    """
    if name not in PATTERNS:
        raise UserError(f"The beam pattern is {name!r}; allowed are {', '.join(sorted(PATTERNS))}.")
    return PATTERNS[name]


def detector_pattern(name: str, size: tuple[float, float]) -> Pattern:
    """The pattern of a rectangular detector behind the aperture called `name`.

    Args:
        name: one of PATTERNS.
        size: widths of the detector along its axis and beside it, beamwidths; 0: a point.

    Raises:
        UserError: no such aperture, or a size that is negative or not finite.
    """
    if not all(np.isfinite(width) and width >= 0 for width in size):
        raise UserError(f"The detector size is {size} beamwidths; both must be finite and 0 or more.")
    if any(size):
        raise NotImplementedError
    return pattern_named(name)


def tabulated_pattern(table: BeamTable, beamwidth: float) -> Pattern:
    """The pattern that a table holds, between whose angles it is interpolated; `beamwidth` in rad."""
    raise NotImplementedError
