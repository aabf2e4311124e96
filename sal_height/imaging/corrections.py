"""Correction of known errors: delays, air, clocks, and the uncertainty of the mounting.

The errors that settings state are removed before the images are formed. Their residuals (`instrument`) are common to
all pixels: they enter the covariance of the pose, as a shift of the antenna along the line of sight, along the flight
or in all directions, or as a rotation of the body.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from sal_height.geometry import ApertureState, Mounting, Trajectory
from sal_height.imaging.air import StatedAir, air_effect
from sal_height.imaging.autofocus.gradient import apply_phase
from sal_height.imaging.instrument import InstrumentSettings, instrument_errors
from sal_height.numeric import F64
from sal_height.sensor import PhaseHistory, Sensor
from sal_height.settings import setting


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


class CorrectionSettings(InstrumentSettings, StatedAir):
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
    elevation_sigma_rad: float = setting(
        0.0, "standard deviation of what is left of the elevation offset", unit="rad", minimum=0.0, maximum=0.1
    )

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
    of_air, bend = air_effect(history, track, sensor, settings)
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
    aperture: ApertureState, middle: F64, sensor: Sensor, settings: CorrectionSettings
) -> ApertureState:
    """The aperture with the residual errors of corrections, as far as they are stated, in its covariance.

    Args:
        aperture: aperture of the image.
        middle: middle of the image in map, m, shape (3,).
        sensor: sensor of the image, with its mounting.
        settings: settings that state known errors.
    """
    errors = instrument_errors(aperture, middle, sensor, settings)
    return with_errors(aperture, settings, (error.effects for error in errors if not error.is_assumed))


def with_errors(aperture: ApertureState, settings: CorrectionSettings, effects: Iterable[F64]) -> ApertureState:
    """The aperture with errors in its covariance, and with that of the elevation offset.

    Args:
        aperture: aperture of the image.
        settings: settings that state known errors.
        effects: shift of the antenna (m) and turn of the body (rad) by one standard deviation of each, (errors, 6).
    """
    by_elevation = np.hstack([np.zeros(3), settings.elevation_sigma_rad * aperture.forward])
    errors = np.vstack([*effects, by_elevation])
    if not errors.any():
        return aperture
    return replace(aperture, covariance=aperture.covariance + errors.T @ errors)


def _turned(mounting: Mounting, angle: float) -> Mounting:
    """A mounting whose sensor is turned by `angle` (rad) about its own forward axis, from left to up."""
    rotation = mounting.axes * Rotation.from_rotvec([angle, 0.0, 0.0])
    x, y, z, w = rotation.as_quat().tolist()
    return replace(mounting, rotation=(x, y, z, w))
