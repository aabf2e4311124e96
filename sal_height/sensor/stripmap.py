"""Stripmap sensors: the illuminated angle, the processed angle, and the synthetic aperture."""

from __future__ import annotations

import math

from sal_height.beams import Beams
from sal_height.sensor.sensor import Sensor


def lit_angle(beams: Beams) -> float:
    """Return the angle along the flight, to each side of the middle of all beams, that main lobes illuminate, rad.

    It is the half-width of the widest main lobe and the `look_ahead_angle`. The pulse repetition frequency that presets
    require samples the Doppler of this angle; echoes from beyond would appear as ambiguities.
    """
    return max(pattern.main_lobe for pattern in beams.patterns) * beams.track_beamwidth + look_ahead_angle(beams)


def lit_doppler(sensor: Sensor, speed: float) -> float:
    """Return the band of Doppler frequencies (Hz) of the main lobes at a speed (m/s); pulses must sample it."""
    return 4 * lit_angle(sensor.beams) * speed / sensor.wavelength


def look_ahead_angle(beams: Beams) -> float:
    """Return the angle by which the beams at the ends of a turned detector axis look ahead and back, rad.

    That is sin(psi) times half the length of the axis, which is turned by psi.
    """
    first, last = beams.span
    return (last - first) / 2 * abs(math.sin(beams.rotation))


def processed_angle(sensor: Sensor) -> float:
    """Return the angle over which a target is processed, rad.

    It is one beamwidth along the flight, for a resolution of half the antenna's size in that direction.
    """
    return sensor.beams.track_beamwidth


def aperture_length(sensor: Sensor, slant_range: float) -> float:
    """Return the length of the synthetic aperture of a target at `slant_range` (m), in m."""
    return processed_angle(sensor) * slant_range
