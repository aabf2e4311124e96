"""Settings of the adjustment of dwells to each other."""

from __future__ import annotations

from typing import Self

from sal_height.elevation import BEAM_PITCH
from sal_height.sensor import AS_DESCRIBED, Sensor, deviation_of
from sal_height.settings import Settings, setting


class AdjustmentSettings(Settings):
    """Prior knowledge of navigation and mounting, before dwells are compared."""

    correlation_s: float = setting(
        100.0,
        "correlation time of the navigation's errors of velocity and attitude",
        unit="s",
        minimum=1e-3,
        maximum=1e6,
    )
    boresight_sigma_rad: float = setting(
        1e-3,
        "standard deviation of the mounting's rotation about each axis of the sensor; 0: it is exact",
        unit="rad",
        minimum=0.0,
        maximum=0.1,
    )
    lever_arm_sigma_m: float = setting(
        0.05,
        "standard deviation of each component of the lever arm; 0: it is exact",
        unit="m",
        minimum=0.0,
        maximum=10.0,
    )
    odometry_delay_sigma_s: float = setting(
        0.0, "standard deviation of the odometry's delay; 0: it is exact", unit="s", minimum=0.0, maximum=1.0
    )
    pitch_sigma: float = setting(
        AS_DESCRIBED,
        "relative standard deviation of the angles between the beams; 0: they are exact; -1: as the sensor's "
        f"description states, or else {BEAM_PITCH:g}",
        minimum=-1.0,
        maximum=0.1,
    )
    jitter_rad: float = setting(
        3e-6,
        "standard deviation of a dwell's own pointing, ahead and off nadir, that odometry does not contain",
        unit="rad",
        minimum=1e-9,
        maximum=0.1,
    )
    strip_s: float = setting(
        1.0,
        "longest flight whose dwells are joined when they are compared with others",
        unit="s",
        minimum=1e-3,
        maximum=1e3,
    )
    strip_dwells: int = setting(16, "most dwells that are joined", minimum=1, maximum=1000)
    partners: int = setting(4, "joined dwells that each dwell is compared with, at most", minimum=1, maximum=100)
    reach_spacings: float = setting(
        100.0,
        "largest offset between two images of the same ground that is searched, in spacings of their pixels",
        minimum=1.0,
        maximum=200.0,
    )

    def described(self, sensor: Sensor) -> Self:
        """These settings with the accuracy that the description of a sensor states, where they state none."""
        pitch = deviation_of(self.pitch_sigma, sensor.uncertainty.beam_pitch, BEAM_PITCH)
        return self.changed(pitch_sigma=pitch.sigma)
