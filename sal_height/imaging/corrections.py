"""What is known to be wrong beforehand: delays, air, clocks, and how well the mounting is known.

What a setting names is taken out before the images are formed. What it leaves, by its sigma, is an error that all
pixels share: it enters the covariance of the pose, as a shift of the antenna along the line of sight, along the flight
or anywhere, or as a turn of the body.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from sal_height.geometry import (
    STANDARD_ATMOSPHERE,
    AirPath,
    ApertureState,
    Atmosphere,
    Mounting,
    Trajectory,
    height_of,
    path_through_air,
)
from sal_height.imaging.pixels import aim_point, line_of_sight
from sal_height.sensor import PhaseHistory, Sensor
from sal_height.settings import Settings, setting

NO_AIR = AirPath(0.0, 0.0)


class CorrectionSettings(Settings):
    """Errors that are known, and how well."""

    range_offset_m: float = setting(
        0.0, "by which slant ranges are too long, as by delays of receivers", unit="m", minimum=-1e4, maximum=1e4
    )
    elevation_offset_rad: float = setting(
        0.0, "by which echoes come from farther off nadir than targets are", unit="rad", minimum=-0.1, maximum=0.1
    )
    odometry_delay_s: float = setting(
        0.0, "by which the odometry is stamped too late", unit="s", minimum=-10.0, maximum=10.0
    )
    air: str = setting(
        "none",
        "air that delays and bends the way of echoes, besides the two offsets; standard: the standard atmosphere; "
        "measured: as the parameters air_... say",
        choices=("none", "standard", "measured"),
    )
    air_temperature_k: float = setting(
        288.15, "temperature that was measured in the air", unit="K", minimum=180.0, maximum=340.0
    )
    air_pressure_pa: float = setting(
        101_325.0, "pressure that was measured there", unit="Pa", minimum=500.0, maximum=120_000.0
    )
    air_humidity: float = setting(0.6, "relative humidity over water that was measured there", minimum=0.0, maximum=1.0)
    air_height_m: float = setting(
        0.0, "height above sea level at which all three were measured", unit="m", minimum=-1000.0, maximum=32_000.0
    )
    map_height_m: float = setting(
        0.0, "height of the map's origin above sea level, for the air", unit="m", minimum=-1000.0, maximum=10_000.0
    )
    range_sigma_m: float = setting(
        0.0, "standard deviation of what is left of the range offset", unit="m", minimum=0.0, maximum=1e4
    )
    elevation_sigma_rad: float = setting(
        0.0, "standard deviation of what is left of the elevation offset", unit="rad", minimum=0.0, maximum=0.1
    )
    odometry_delay_sigma_s: float = setting(
        0.0, "standard deviation of what is left of the delay of the odometry", unit="s", minimum=0.0, maximum=10.0
    )
    lever_arm_sigma_m: float = setting(
        0.0, "standard deviation of each component of the lever arm", unit="m", minimum=0.0, maximum=100.0
    )
    boresight_sigma_rad: float = setting(
        0.0, "standard deviation of the rotation of the mounting about each axis", unit="rad", minimum=0.0, maximum=0.1
    )

    @property
    def atmosphere(self) -> Atmosphere | None:
        """The air; None: there is none."""
        if self.air == "measured":
            return Atmosphere.measured(
                self.air_height_m, self.air_temperature_k, self.air_pressure_pa, self.air_humidity
            )
        return STANDARD_ATMOSPHERE if self.air == "standard" else None

    @property
    def odometry_delay_ns(self) -> int:
        """The delay of the odometry in whole nanoseconds."""
        return round(1e9 * self.odometry_delay_s)

    @property
    def leaves_errors(self) -> bool:
        """Whether any sigma is not 0."""
        return any(
            (
                self.range_sigma_m,
                self.elevation_sigma_rad,
                self.odometry_delay_sigma_s,
                self.lever_arm_sigma_m,
                self.boresight_sigma_rad,
            )
        )


def correct_track(track: Trajectory, settings: CorrectionSettings) -> Trajectory:
    """The track with the stamps that it ought to have had."""
    if not (delay_ns := settings.odometry_delay_ns):
        return track
    states = [replace(state, stamp_ns=state.stamp_ns - delay_ns) for state in track.states]
    return Trajectory(states, track.mounting, track.motion)


def correct_dwell(
    history: PhaseHistory, track: Trajectory, sensor: Sensor, settings: CorrectionSettings
) -> tuple[PhaseHistory, Sensor]:
    """The phase history at ranges, and the sensor with a mounting, that know of delays and of the bend of the way.

    A delay is that of the middle of all beams at the reference range. Over the swath it changes by the share that the
    range does: for light and a window of 8 m at 5 km, by 2 mm.

    Args:
        history: of all detectors, as fast-time frequencies.
        track: of the platform, corrected.
        sensor: with waveform "spectrum".
        settings: what is known.

    Raises:
        UserError: the air is not known for this wavelength or height.
    """
    air = _air(history, track, sensor, settings)
    if delay := settings.range_offset_m + air.delay:
        history = replace(history, reference_range=history.reference_range - delay)
    if bend := settings.elevation_offset_rad + air.bend:
        sensor = replace(sensor, mounting=_turned(sensor.mounting, bend * sensor.look_side))
    return history, sensor


def with_known_errors(aperture: ApertureState, sensor: Sensor, settings: CorrectionSettings) -> ApertureState:
    """The aperture with what corrections leave in its covariance."""
    if not settings.leaves_errors:
        return aperture
    sight, velocity, forward = line_of_sight(sensor, aperture), aperture.velocity, aperture.forward
    covariance = np.array(aperture.covariance, dtype=np.float64)
    covariance[:3, :3] += (
        settings.lever_arm_sigma_m**2 * np.eye(3)
        + settings.range_sigma_m**2 * np.outer(sight, sight)
        + settings.odometry_delay_sigma_s**2 * np.outer(velocity, velocity)
    )
    covariance[3:, 3:] += settings.boresight_sigma_rad**2 * np.eye(3)
    covariance[3:, 3:] += settings.elevation_sigma_rad**2 * np.outer(forward, forward)
    return replace(aperture, covariance=covariance)


def _air(history: PhaseHistory, track: Trajectory, sensor: Sensor, settings: CorrectionSettings) -> AirPath:
    """What the air does to echoes from the middle of all beams at the reference range."""
    if (atmosphere := settings.atmosphere) is None:
        return NO_AIR
    aperture = track.mounted(sensor.mounting).aperture(history.stamp_ns, history.pulse_times)
    reference = float(history.reference_range[len(history.reference_range) // 2])
    aim = aim_point(sensor, aperture, reference)
    above, ground = (settings.map_height_m + float(height_of(point)) for point in (aperture.position, aim))
    off_nadir = math.acos(min(1.0, (above - ground) / reference))
    return path_through_air(sensor.wavelength, above, ground, off_nadir, atmosphere)


def _turned(mounting: Mounting, angle: float) -> Mounting:
    """A mounting whose sensor is turned by `angle` (rad) about its own forward axis, from left to up."""
    rotation = mounting.axes * Rotation.from_rotvec([angle, 0.0, 0.0])
    x, y, z, w = rotation.as_quat().tolist()
    return replace(mounting, rotation=(x, y, z, w))
