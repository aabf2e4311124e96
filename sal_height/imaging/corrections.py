"""Correction of known errors: delays, air, clocks, and the uncertainty of the mounting.

The errors that settings state are removed before the images are formed. Their residuals (`instrument`) are common to
all pixels: they enter the covariance of the pose, as a shift of the antenna along the line of sight, along the flight
or in all directions, or as a rotation of the body.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from sal_height.geometry import (
    PRESSURES_PA,
    STANDARD_ATMOSPHERE,
    TEMPERATURES_K,
    AirPath,
    ApertureState,
    Atmosphere,
    Mounting,
    Trajectory,
    height_of,
    path_through_air,
)
from sal_height.imaging.autofocus.gradient import apply_phase
from sal_height.imaging.instrument import InstrumentError, InstrumentSettings, instrument_errors
from sal_height.imaging.pixels import aim_point
from sal_height.numeric import F64
from sal_height.sensor import PhaseHistory, Sensor
from sal_height.settings import setting

MEASURED_AIR = "air_temperature_k", "air_pressure_pa", "air_humidity", "air_height_m"
"""Settings that state the measurements of the air, and their height."""


class Corrected(NamedTuple):
    """A dwell without the known errors.

    Attributes:
        history: phase history at corrected ranges.
        track: track with corrected stamps.
        sensor: sensor with a mounting that contains the bend of the path.
        delay: excess of the ranges, m, shape (pulses,).
    """

    history: PhaseHistory
    track: Trajectory
    sensor: Sensor
    delay: F64


class CorrectionSettings(InstrumentSettings):
    """Known errors, and their standard deviations."""

    range_offset_m: float = setting(
        0.0, "by which slant ranges are too long, as by delays of receivers", unit="m", minimum=-1e4, maximum=1e4
    )
    elevation_offset_rad: float = setting(
        0.0, "by which echoes arrive from farther off nadir than targets are", unit="rad", minimum=-0.1, maximum=0.1
    )
    odometry_delay_s: float = setting(
        0.0, "by which the odometry is stamped too late", unit="s", minimum=-10.0, maximum=10.0
    )
    air: str = setting(
        "none",
        "air that delays and bends the path of echoes, in addition to the two offsets; standard: the standard "
        "atmosphere; "
        "measured: as the parameters air_... say",
        choices=("none", "standard", "measured"),
    )
    air_temperature_k: float = setting(
        288.15,
        "temperature that was measured in the air",
        unit="K",
        minimum=TEMPERATURES_K[0],
        maximum=TEMPERATURES_K[1],
    )
    air_pressure_pa: float = setting(
        101_325.0, "pressure that was measured there", unit="Pa", minimum=PRESSURES_PA[0], maximum=PRESSURES_PA[1]
    )
    air_humidity: float = setting(0.6, "relative humidity over water that was measured there", minimum=0.0, maximum=1.0)
    air_height_m: float = setting(
        0.0, "height above sea level at which all three were measured", unit="m", minimum=-1000.0, maximum=32_000.0
    )
    map_height_m: float = setting(
        0.0, "height of the map's origin above sea level, for the air", unit="m", minimum=-1000.0, maximum=10_000.0
    )
    elevation_sigma_rad: float = setting(
        0.0, "standard deviation of what is left of the elevation offset", unit="rad", minimum=0.0, maximum=0.1
    )

    @property
    def atmosphere(self) -> Atmosphere | None:
        """The air; None: no air."""
        if self.air == "measured":
            return Atmosphere.measured(
                self.air_height_m, self.air_temperature_k, self.air_pressure_pa, self.air_humidity
            )
        return STANDARD_ATMOSPHERE if self.air == "standard" else None

    @property
    def odometry_delay_ns(self) -> int:
        """The delay of the odometry in whole nanoseconds."""
        return round(1e9 * self.odometry_delay_s)


def correct_track(track: Trajectory, settings: CorrectionSettings) -> Trajectory:
    """The track with the stamps that it ought to have had."""
    if not (delay_ns := settings.odometry_delay_ns):
        return track
    states = [replace(state, stamp_ns=state.stamp_ns - delay_ns) for state in track.states]
    return track.of_states(states)


def correct_dwell(history: PhaseHistory, track: Trajectory, sensor: Sensor, settings: CorrectionSettings) -> Corrected:
    """Correct the ranges of the phase history by delays, and the mounting of the sensor by the bend of the path.

    The track is that of `correct_track`.

    A delay is that of the middle of all beams at the reference range. Over the swath it changes in proportion to range:
    for light and a window of 8 m at 5 km, by 2 mm. From pulse to pulse it changes as the antenna approaches, or images
    of a climbing antenna would move along the flight.

    Args:
        history: phase history of all detectors, as fast-time frequencies.
        track: track of the platform.
        sensor: sensor with waveform "spectrum".
        settings: settings that state known errors.

    Raises:
        UserError: the air is unknown for this wavelength or height.
    """
    track = correct_track(track, settings)
    of_air, bend = _air(history, track, sensor, settings)
    delay = settings.range_offset_m + of_air
    if delay.any():
        history = replace(history, reference_range=history.reference_range - delay)
    if bend := settings.elevation_offset_rad + bend:
        sensor = replace(sensor, mounting=_turned(sensor.mounting, bend * sensor.look_side))
    return Corrected(history, track, sensor, delay)


class StripDelay:
    """The delay in the phase of a strip, which is continuous from block to block.

    That of each block is computed for its lit ground, under the air of its time, and so jumps from one to the next: by
    less than ranges resolve, and by more than a wavelength.
    """

    def __init__(self) -> None:
        """Start with any block."""
        self._next: float | None = None

    def joined(self, history: PhaseHistory, delay: F64, sensor: Sensor) -> PhaseHistory:
        """The next block, corrected by a delay (m, shape (pulses,)), with the phase that joins on to the last one's."""
        jump = 0.0 if self._next is None else float(delay[0]) - self._next
        self._next = 2 * float(delay[-1]) - float(delay[-2]) - jump
        if not jump:
            return history
        return apply_phase(history, np.full(len(delay), sensor.centre_wavenumber * jump))


def with_known_errors(
    aperture: ApertureState, sensor: Sensor, settings: CorrectionSettings, slant_range: float
) -> ApertureState:
    """The aperture with the residual errors of corrections, as far as they are stated, in its covariance.

    Args:
        aperture: state of the antenna.
        sensor: sensor with its mounting.
        settings: settings that state residual errors.
        slant_range: slant range of the middle of the image, m.
    """
    errors = instrument_errors(aperture, sensor, settings, slant_range)
    stated = [error for error in errors if not error.is_assumed]
    return _with_errors(aperture, stated, settings)


def with_all_errors(
    aperture: ApertureState, sensor: Sensor, settings: CorrectionSettings, slant_range: float
) -> ApertureState:
    """The aperture as of `with_known_errors`, with those that are only assumed, too."""
    return _with_errors(aperture, instrument_errors(aperture, sensor, settings, slant_range), settings)


def _with_errors(
    aperture: ApertureState, of_instrument: Iterable[InstrumentError], settings: CorrectionSettings
) -> ApertureState:
    by_elevation = np.hstack([np.zeros(3), settings.elevation_sigma_rad * aperture.forward])
    effects = np.vstack([*(error.effects for error in of_instrument), by_elevation])
    if not effects.any():
        return aperture
    return replace(aperture, covariance=aperture.covariance + effects.T @ effects)


def _air(history: PhaseHistory, track: Trajectory, sensor: Sensor, settings: CorrectionSettings) -> tuple[F64, float]:
    """The effect of the air on echoes from the middle of all beams at the reference range.

    Returns:
        Additional range at each pulse, m, and the additional angle of arrival off nadir, rad.
    """
    pulses = len(history.reference_range)
    if (atmosphere := settings.atmosphere) is None:
        return np.zeros(pulses), 0.0
    mounted = track.mounted(sensor.mounting)
    aperture = mounted.aperture(history.stamp_ns, history.pulse_times)
    aim = aim_point(sensor, aperture, float(history.reference_range[pulses // 2]))
    ends = mounted.positions(history.stamp_ns, history.pulse_times[[0, -1]])
    first, last = (_way_from(antenna, aim, sensor, settings.map_height_m, atmosphere) for antenna in ends)
    return np.linspace(first.delay, last.delay, pulses), (first.bend + last.bend) / 2


def _way_from(antenna: F64, aim: F64, sensor: Sensor, map_height: float, atmosphere: Atmosphere) -> AirPath:
    """Path in the air from the antenna to a point of the ground (m, map axes)."""
    above, ground = (map_height + float(height_of(point)) for point in (antenna, aim))
    off_nadir = math.acos(min(1.0, (above - ground) / float(np.linalg.norm(aim - antenna))))
    return path_through_air(sensor.wavelength, above, ground, off_nadir, atmosphere)


def _turned(mounting: Mounting, angle: float) -> Mounting:
    """A mounting whose sensor is turned by `angle` (rad) about its own forward axis, from left to up."""
    rotation = mounting.axes * Rotation.from_rotvec([angle, 0.0, 0.0])
    x, y, z, w = rotation.as_quat().tolist()
    return replace(mounting, rotation=(x, y, z, w))
