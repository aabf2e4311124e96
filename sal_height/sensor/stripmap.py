"""Stripmap sensors: the angle that a pulse lights up, the angle that is processed, and the synthetic aperture."""

from __future__ import annotations

import math

from sal_height.beams import Beams
from sal_height.sensor.sensor import Sensor

LIT_BEAMWIDTHS = 1.0
"""Ground to each side of a beam's middle, along the flight, that a pulse lights up; in beamwidths.

That is the main lobe of the square aperture. The pulse repetition frequency that presets demand samples its Doppler;
what lies beyond would appear as ambiguities.
"""


def lit_angle(beams: Beams) -> float:
    """Angle along the flight to each side of the middle of all beams within which main lobes lie, rad.

    One beamwidth; with the detector axis turned by psi the beams at its ends look ahead and back by sin(psi) times
    half its length.
    """
    first, last = beams.span
    return LIT_BEAMWIDTHS * beams.beamwidth + (last - first) / 2 * abs(math.sin(beams.rotation))


def processed_angle(sensor: Sensor) -> float:
    """Angle over which a target is processed, rad: one beamwidth, which gives a resolution of half the aperture."""
    return sensor.beamwidth


def aperture_length(sensor: Sensor, slant_range: float) -> float:
    """Length of the synthetic aperture of a target at `slant_range` (m), m."""
    return processed_angle(sensor) * slant_range
