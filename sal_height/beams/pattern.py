"""Beam patterns: the registry PATTERNS of apertures, and their averages over detectors of some size.

A pattern is a function h of the direction to the target from the beam's boresight: e in elevation (along the detector
axis) and a in azimuth (across it), both in beamwidths (wavelength / aperture). For a point detector
h(0, 0) = 1; a detector of some size has the mean of h over it (SAL paper, sections 2 and 3), which is less.

To add an aperture, add one entry to PATTERNS. Presets, commands and finite detectors then know it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Self

import numpy as np
from scipy.optimize import minimize_scalar

from sal_height.beams.apertures import (
    JINC_NULL,
    PatternFunction,
    average_over_detector,
    gaussian,
    gaussian_slope,
    jinc,
    jinc_slope,
    sinc,
    sinc_slope,
)
from sal_height.errors import UserError
from sal_height.numeric import F64


@dataclass(frozen=True)
class Pattern:
    """A beam pattern and its slopes.

    Attributes:
        name: name in presets and messages.
        amplitude: amplitude h(e, a); broadcasts. Float64, or complex128 for a measured beam.
        slope: derivative of h with respect to e, per beamwidth; broadcasts.
        azimuth_slope: derivative of h with respect to a, per beamwidth; broadcasts.
        main_lobe: half-width of the main lobe in azimuth, from boresight to the first null, beamwidths.
        domain: least and greatest e at which the pattern is known, beamwidths.
        size: widths of the detector along and across its axis, beamwidths; 0: a point.
        gain: constant factor of the pattern, real or complex.
    """

    name: str
    amplitude: PatternFunction
    slope: PatternFunction
    azimuth_slope: PatternFunction
    main_lobe: float
    domain: tuple[float, float] = (-np.inf, np.inf)
    size: tuple[float, float] = (0.0, 0.0)
    gain: float = 1.0

    def scaled(self, gain: float) -> Self:
        """Return the pattern times a constant, real or complex."""
        amplitude, slope, azimuth_slope = self.amplitude, self.slope, self.azimuth_slope
        return replace(
            self,
            amplitude=lambda e, a: gain * amplitude(e, a),
            slope=lambda e, a: gain * slope(e, a),
            azimuth_slope=lambda e, a: gain * azimuth_slope(e, a),
            gain=gain * self.gain,
        )


def aperture_pattern(
    name: str,
    amplitude: PatternFunction,
    main_lobe: float,
    slope: PatternFunction | None = None,
    azimuth_slope: PatternFunction | None = None,
) -> Pattern:
    """Describe the pattern of a point detector behind an aperture, as an entry of PATTERNS.

    Args:
        name: name in presets.
        amplitude: amplitude h(e, a) with h(0, 0) = 1; it must broadcast.
        main_lobe: half-width of the main lobe: the first null, or the offset from which h is negligible, beamwidths.
        slope: slope dh/de, per beamwidth; None: differences of the amplitude, within 1e-11.
        azimuth_slope: slope dh/da, per beamwidth; None: differences likewise.
    """
    return Pattern(
        name,
        amplitude,
        slope or (lambda e, a: _difference(lambda offset: amplitude(np.asarray(e) + offset, a))),
        azimuth_slope or (lambda e, a: _difference(lambda offset: amplitude(e, np.asarray(a) + offset))),
        main_lobe,
    )


def _difference(function: Callable[[float], F64]) -> F64:
    """Return the derivative at 0, by the central difference of fourth order over a function of the offset."""
    step = 1e-3  # beamwidths: by Bernstein's inequality the error is less than pi^5 step^4 / 30 = 1e-11
    near, far = (function(offset) - function(-offset) for offset in (step, 2 * step))
    return (8 * near - far) / (12 * step)


def _exchanged(function: PatternFunction) -> PatternFunction:
    """Return the function with elevation and azimuth exchanged: the azimuth slope of a symmetric pattern."""
    return lambda e, a: function(a, e)


PATTERNS = {
    pattern.name: pattern
    for pattern in (
        # A Gaussian has no null; its main lobe is that of the circular aperture with the same half-power width.
        aperture_pattern("gaussian", gaussian, JINC_NULL, gaussian_slope, _exchanged(gaussian_slope)),
        aperture_pattern("sinc", sinc, 1.0, sinc_slope, _exchanged(sinc_slope)),
        aperture_pattern("jinc", jinc, JINC_NULL, jinc_slope, _exchanged(jinc_slope)),
    )
}
"""Patterns of point detectors behind a Gaussian, a square ("sinc") and a circular aperture ("jinc"), by name."""


def pattern_named(name: str) -> Pattern:
    """Return the point detector's pattern called `name`.

    Raises:
        UserError: PATTERNS has no such entry.
    """
    if name not in PATTERNS:
        raise UserError(f"The beam pattern is {name!r}; allowed are {', '.join(sorted(PATTERNS))}.")
    return PATTERNS[name]


def detector_pattern(name: str, size: tuple[float, float]) -> Pattern:
    """Return the pattern of a rectangular detector behind the aperture called `name` (SAL paper, sections 2 and 3).

    Detection is coherent: the amplitude is integrated over the detector and divided by its area, so that a small one
    has the point pattern. Values are within 1e-11.

    Args:
        name: name of an entry of PATTERNS.
        size: widths of the detector along and across its axis, beamwidths; 0: a point.

    Raises:
        UserError: there is no such aperture, or a width is negative or greater than 64 beamwidths.
    """
    largest = 64.0  # real detectors have about 1
    if not all(0 <= width <= largest for width in size):
        raise UserError(f"The detector size is {size} beamwidths; both must be from 0 to {largest:g}.")
    point = pattern_named(name)
    return _averaged(point, size) if any(size) else point


@lru_cache(maxsize=16)
def _averaged(point: Pattern, size: tuple[float, float]) -> Pattern:
    """Return the mean of a point detector's pattern over a detector; cached, because it is tabulated."""
    amplitude, slope, azimuth_slope = (
        average_over_detector(function, size) for function in (point.amplitude, point.slope, point.azimuth_slope)
    )
    null = first_null(amplitude, point.main_lobe + size[1] / 2)
    return Pattern(point.name, amplitude, slope, azimuth_slope, null, size=size)


def first_null(amplitude: PatternFunction, widest: float) -> float:
    """Find the half-width of the main lobe in azimuth, beamwidths; the greater of both sides counts.

    It ends where the power, once it is below half its maximum, rises again; at `widest` if it does not.
    """
    return max(_first_null_towards(amplitude, widest, side) for side in (1, -1))


def _first_null_towards(amplitude: PatternFunction, widest: float, side: int) -> float:
    def power(offset: F64) -> F64:
        return np.abs(amplitude(0.0, side * offset)) ** 2

    offsets = np.linspace(0.0, widest, 2001)
    powers = power(offsets)
    rises = np.flatnonzero((np.diff(powers) > 0) & (powers[:-1] < powers.max() / 2))
    if not rises.size:
        return widest
    around = offsets[rises[0] - 1], offsets[rises[0] + 1]
    return float(minimize_scalar(power, bounds=around, method="bounded", options={"xatol": 1e-9}).x)
