"""Beam patterns: the registry PATTERNS of apertures, and their averages over detectors of some size.

A pattern is a function h of the direction to the target, seen from the beam's boresight: e in elevation (along the
detector axis) and a in azimuth (beside it), both in beamwidths (wavelength / aperture). For a point detector
h(0, 0) = 1; a detector of some size has the mean of h over it (SAL paper, sections 2 and 3), which is less.

To add an aperture, add one entry to PATTERNS. Presets, commands and finite detectors then know it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.optimize import minimize_scalar

from sal_height.beams.apertures import (
    JINC_NULL,
    PatternFunction,
    gaussian,
    gaussian_slope,
    jinc,
    jinc_slope,
    sinc,
    sinc_slope,
)
from sal_height.beams.detector import average_over_detector
from sal_height.errors import UserError
from sal_height.numeric import F64

DIFFERENCE_STEP = 1e-3
"""Step of numerical slopes in beamwidths: by Bernstein's inequality they err by less than pi^5 STEP^4 / 30 = 1e-11."""

LOBE_STEPS = 2000
"""Steps in which the first null of a pattern is looked for."""


@dataclass(frozen=True)
class Pattern:
    """A beam pattern and its slopes.

    Attributes:
        name: its name in presets and messages.
        amplitude: h(e, a); broadcasts. Float64, or complex128 for a measured beam.
        slope: derivative of h with respect to e, per beamwidth; broadcasts.
        azimuth_slope: derivative of h with respect to a, per beamwidth; broadcasts.
        main_lobe: half-width of the main lobe in azimuth, from boresight to the first null, beamwidths.
        domain: least and greatest e at which the pattern is known, beamwidths.
    """

    name: str
    amplitude: PatternFunction
    slope: PatternFunction
    azimuth_slope: PatternFunction
    main_lobe: float
    domain: tuple[float, float] = (-np.inf, np.inf)

    def scaled(self, gain: float) -> Self:
        """Return the pattern times a constant, real or complex."""
        amplitude, slope, azimuth_slope = self.amplitude, self.slope, self.azimuth_slope
        return replace(
            self,
            amplitude=lambda e, a: gain * amplitude(e, a),
            slope=lambda e, a: gain * slope(e, a),
            azimuth_slope=lambda e, a: gain * azimuth_slope(e, a),
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
        name: its name in presets.
        amplitude: h(e, a) with h(0, 0) = 1; it must broadcast.
        main_lobe: half-width of the main lobe, beamwidths: the first null, or where h no longer matters.
        slope: dh/de; None: differences of the amplitude, within 1e-11.
        azimuth_slope: dh/da; None: as `slope`.
    """
    return Pattern(
        name,
        amplitude,
        slope or (lambda e, a: _difference(lambda step: amplitude(np.asarray(e) + step, a))),
        azimuth_slope or (lambda e, a: _difference(lambda step: amplitude(e, np.asarray(a) + step))),
        main_lobe,
    )


def _difference(function: Callable[[float], F64]) -> F64:
    """Return the derivative at 0 by the central difference of fourth order."""
    near, far = (function(step) - function(-step) for step in (DIFFERENCE_STEP, 2 * DIFFERENCE_STEP))
    return (8 * near - far) / (12 * DIFFERENCE_STEP)


def _exchanged(function: PatternFunction) -> PatternFunction:
    """Return the function with elevation and azimuth exchanged: the azimuth slope of a pattern that is the same so."""
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

    Detection is coherent: the amplitude is integrated over the detector, and divided by its area, so that a small one
    has the point pattern. Values are within 1e-10.

    Args:
        name: one of PATTERNS.
        size: widths of the detector along its axis and beside it, beamwidths; 0: a point.

    Raises:
        UserError: there is no such aperture, or a width is negative or not finite.
    """
    if not all(np.isfinite(width) and width >= 0 for width in size):
        raise UserError(f"The detector size is {size} beamwidths; both must be finite and 0 or more.")
    point = pattern_named(name)
    if not any(size):
        return point
    amplitude, slope, azimuth_slope = (
        average_over_detector(function, size) for function in (point.amplitude, point.slope, point.azimuth_slope)
    )
    return Pattern(name, amplitude, slope, azimuth_slope, first_null(amplitude, point.main_lobe + size[1] / 2))


def first_null(amplitude: PatternFunction, widest: float) -> float:
    """Find the half-width of the main lobe in azimuth, beamwidths.

    It ends on either side of boresight where the power, once it is below half its maximum, rises again; at `widest` if
    it does not. The greater of the two sides counts.
    """
    return max(_first_null_towards(amplitude, widest, side) for side in (1, -1))


def _first_null_towards(amplitude: PatternFunction, widest: float, side: int) -> float:
    def power(offset: F64) -> F64:
        return np.abs(amplitude(0.0, side * offset)) ** 2

    offsets = np.linspace(0.0, widest, LOBE_STEPS + 1)
    powers = power(offsets)
    rises = np.flatnonzero((np.diff(powers) > 0) & (powers[:-1] < powers.max() / 2))
    if not rises.size:
        return widest
    around = offsets[rises[0] - 1], offsets[rises[0] + 1]
    return float(minimize_scalar(power, bounds=around, method="bounded", options={"xatol": 1e-9}).x)
