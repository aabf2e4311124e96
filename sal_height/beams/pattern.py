"""Amplitude patterns of a detector's beam.

A pattern is a function h of the direction to the target, seen from the beam's boresight: e in elevation and a in
azimuth, both in beamwidths (wavelength / aperture diameter). For a point detector h(0, 0) = 1; a detector of some size
has the mean of h over it (SAL paper, sections 2 and 3), which is less.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Self

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline
from scipy.special import j0, j1

from sal_height.beams.apertures import GAUSSIAN, GAUSSIAN_WIDTH, SINC, Profile
from sal_height.beams.cubic_surface import Amplitudes, CubicSurface
from sal_height.beams.pupil import Apodisation, apodised_sums, jinc_sums
from sal_height.beams.table import BeamTable
from sal_height.errors import UserError
from sal_height.numeric import F64

__all__ = [
    "GAUSSIAN_WIDTH",
    "PATTERNS",
    "Pattern",
    "apodised_pattern",
    "detector_pattern",
    "pattern_named",
    "sample_pattern",
    "tabulated_pattern",
]

Function = Callable[[npt.ArrayLike, npt.ArrayLike], F64]

EDGE = 1e-9
"""Beamwidths beyond a table that are rounding, and belong to it."""


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
    amplitude: Callable[[npt.ArrayLike, npt.ArrayLike], F64]
    slope: Callable[[npt.ArrayLike, npt.ArrayLike], F64]
    azimuth_slope: Callable[[npt.ArrayLike, npt.ArrayLike], F64]
    domain: tuple[float, float] = (-np.inf, np.inf)

    def scaled(self, gain: float) -> Self:
        """The pattern times a constant, real or complex."""
        amplitude, slope, azimuth_slope = self.amplitude, self.slope, self.azimuth_slope
        return replace(
            self,
            amplitude=lambda e, a: gain * amplitude(e, a),
            slope=lambda e, a: gain * slope(e, a),
            azimuth_slope=lambda e, a: gain * azimuth_slope(e, a),
        )


def _jinc(e: npt.ArrayLike, a: npt.ArrayLike) -> F64:
    """Circular aperture: 2 J1(x) / x with x = pi r."""
    x = np.pi * np.hypot(e, a)
    safe = np.where(x < 1e-6, 1.0, x)
    return np.where(x < 1e-6, 1.0, 2 * j1(safe) / safe)


def _jinc_slope(e: npt.ArrayLike, a: npt.ArrayLike) -> F64:
    """d/dx [2 J1(x) / x] = -2 J2(x) / x, times dx/de = pi e / r."""
    x = np.pi * np.hypot(e, a)
    near = x < 0.1
    safe = np.where(near, 1.0, x)
    series = 0.25 * (1 - x**2 / 12 * (1 - x**2 / 32 * (1 - x**2 / 60)))
    recurrence = 2 * (2 * j1(safe) / safe - j0(safe)) / safe**2  # J2(x) = 2 J1(x) / x - J0(x), ten times as fast
    return -(np.pi**2) * np.asarray(e) * np.where(near, series, recurrence)


def _turned(slope: Function) -> Function:
    """The slope in azimuth of a pattern that is the same with elevation and azimuth exchanged."""
    return lambda e, a: slope(a, e)


def _separable(name: str, profile: Profile, size: tuple[float, float]) -> Pattern:
    """The product of a profile along elevation and the same along azimuth, averaged over a detector."""
    height, width = size
    return Pattern(
        name,
        lambda e, a: profile.mean(e, height) * profile.mean(a, width),
        lambda e, a: profile.mean_slope(e, height) * profile.mean(a, width),
        lambda e, a: profile.mean(e, height) * profile.mean_slope(a, width),
    )


PROFILES = {"gaussian": GAUSSIAN, "sinc": SINC}
"""Of the patterns that are a product: of a Gaussian beam, and of a square aperture with sides along the axes."""

PATTERNS = {
    **{name: _separable(name, profile, (0.0, 0.0)) for name, profile in PROFILES.items()},
    "jinc": Pattern("jinc", _jinc, _jinc_slope, _turned(_jinc_slope)),
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
    """The pattern of a rectangular detector behind the aperture called `name` (SAL paper, sections 2 and 3).

    Detection is coherent: the amplitude is integrated over the detector, and divided by its area, so that a small one
    has the point pattern. Closed forms but for "jinc", which is within 1e-10.

    Args:
        name: one of PATTERNS.
        size: widths of the detector along its axis and beside it, beamwidths; 0: a point.

    Raises:
        UserError: no such aperture, or a size that is negative or not finite.
    """
    _check_size(size)
    point = pattern_named(name)
    if not any(size):
        return point
    return _separable(name, PROFILES[name], size) if name in PROFILES else Pattern(name, *jinc_sums(size))


def apodised_pattern(apodisation: Apodisation, size: tuple[float, float] = (0.0, 0.0)) -> Pattern:
    """The pattern of a rectangular detector behind a circular aperture that is weighted.

    A weighting A(u, v) gives h(e, a) = int int A exp(-j 2 pi (u e + v a)) du dv / int int A du dv, averaged over the
    detector: the field in the focal plane of SAL paper, section 2. Within 1e-9 where A is smooth; an edge in A is
    followed by a grid of 1/96 of the diameter only. For very many values make a table of it with `sample_pattern`.

    Args:
        apodisation: A at arrays u, along the detector axis, and v, beside it, in aperture diameters: u^2 + v^2 <= 1/4;
            real or complex, of any scale.
        size: as in `detector_pattern`.

    Returns:
        Pattern: named "apodised"; float64 where A(-u, -v) is the conjugate of A(u, v), otherwise complex128.

    Raises:
        UserError: A is not finite, or its integral is 0; or a size that is negative or not finite.
    """
    _check_size(size)
    return Pattern("apodised", *apodised_sums(apodisation, size))


def _check_size(size: tuple[float, float]) -> None:
    if not all(np.isfinite(width) and width >= 0 for width in size):
        raise UserError(f"The detector size is {size} beamwidths; both must be finite and 0 or more.")


def tabulated_pattern(table: BeamTable, beamwidth: float) -> Pattern:
    """The pattern that a table holds: the cubic spline through its amplitudes, and that spline's derivatives.

    A single azimuth: the pattern is the same at all. Beyond the table nothing is received: 0.

    Args:
        table: of a beam.
        beamwidth: wavelength / aperture diameter, rad.

    Returns:
        Pattern: named "table", known where the table is; float64 where all amplitudes are real, otherwise complex128.
    """
    elevation, azimuth = (np.array(angles) / beamwidth for angles in (table.elevation, table.azimuth))
    values: Amplitudes = table.values if any(table.imaginary) else table.values.real
    extent = (elevation[[0, -1]], azimuth[[0, -1]] if azimuth.size > 1 else np.array([-np.inf, np.inf]))
    spline = _surface(elevation, azimuth, values) if azimuth.size > 1 else _line(elevation, values[:, 0])
    amplitude, slope, azimuth_slope = (_within(extent, partial(spline, orders)) for orders in ((0, 0), (1, 0), (0, 1)))
    return Pattern("table", amplitude, slope, azimuth_slope, (float(elevation[0]), float(elevation[-1])))


Spline = Callable[[tuple[int, int], F64, F64], F64]
"""Derivatives of given orders with respect to elevation and azimuth, at both."""


def _line(elevation: F64, values: Amplitudes) -> Spline:
    spline = CubicSpline(elevation, values)

    def derivative(orders: tuple[int, int], e: F64, _: F64) -> F64:
        return np.zeros_like(e, dtype=values.dtype) if orders[1] else spline(e, orders[0])

    return derivative


def _surface(elevation: F64, azimuth: F64, values: Amplitudes) -> Spline:
    surface = CubicSurface.through(elevation, azimuth, values)
    return lambda orders, e, a: np.asarray(surface.at(e, a, orders))


def _within(extent: tuple[F64, F64], spline: Callable[[F64, F64], F64]) -> Function:
    """The spline, but 0 beyond its extent in elevation and azimuth (beamwidths)."""

    def values(e: npt.ArrayLike, a: npt.ArrayLike) -> F64:
        offsets = np.broadcast_arrays(np.asarray(e, dtype=np.float64), np.asarray(a, dtype=np.float64))
        scale = np.ones(offsets[0].shape)
        for offset, (low, high) in zip(offsets, extent, strict=True):
            scale[(offset < low - EDGE) | (offset > high + EDGE)] = 0.0
            scale[np.isnan(offset)] = np.nan
        inside = (np.clip(np.nan_to_num(offset), *ends) for offset, ends in zip(offsets, extent, strict=True))
        return scale * spline(*inside)

    return values


def sample_pattern(pattern: Pattern, elevation: npt.ArrayLike, azimuth: npt.ArrayLike, beamwidth: float) -> BeamTable:
    """The table that a measurement of a pattern would give.

    Args:
        pattern: what is measured.
        elevation: offsets from boresight, rad, increasing, shape (elevations,).
        azimuth: the same across, shape (azimuths,).
        beamwidth: wavelength / aperture diameter, rad.

    Raises:
        UserError: the angles make no table.
    """
    x, y = np.atleast_1d(elevation), np.atleast_1d(azimuth)
    values = np.asarray(pattern.amplitude(x[:, None] / beamwidth, y / beamwidth))
    real, imaginary = values.real.ravel(), values.imag.ravel()
    return BeamTable(tuple(x.tolist()), tuple(y.tolist()), tuple(real.tolist()), tuple(imaginary.tolist()))
