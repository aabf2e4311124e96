"""Settings common to all estimators: the looks of a pixel, and the limits for valid pixels."""

from __future__ import annotations

from sal_height.elevation.looks.look_windows import LOOK_WINDOWS, Window
from sal_height.sensor import AS_DESCRIBED, MAX_SHARE
from sal_height.settings import Settings, setting

MISFIT_FRACTION = 0.03
"""Fraction of a pixel's explained power that may be left beyond the noise before it counts as several scatterers.

It allows for the extent of the ground in a pixel: looks, and parts of a range cell, that differ in elevation leave a
fraction of the power that does not depend on the CNR. Errors of the beams are counted separately (`beam_error`).
"""

BEAM_PITCH, BEAM_WIDTH, CHANNEL_GAIN_DB = 0.01, 0.02, 0.5
"""Standard deviations of the beams and channels of an array that nobody has calibrated: relative, and in dB."""


class HeightSettings(Settings):
    """Settings of a height image that apply to every estimator."""

    # Noise passes for a scatterer in the strongest of M independent directions. The search has more directions, but
    # most of them are outside the array: of pixels of noise alone, 0.1 to 1.7 times this rate are valid without a least
    # CNR where another pixel nearby is detected, and less elsewhere.
    false_alarm_rate: float = setting(
        1e-4,
        "fraction of single scatterers that are rejected because of noise, and of pixels of noise that pass for one",
        minimum=1e-12,
        maximum=0.1,
    )
    # Behind bright ground the power of sidelobes is that of one look of speckle, however many looks a pixel has, so
    # that each factor of 10 less costs 2.3 times their mean power: with the rectangular window, 10 % of the ground's
    # brightness.
    sidelobe_rate: float = setting(
        0.01,
        "fraction of pixels of shadow in which sidelobes of scatterers elsewhere pass for one; 1: sidelobes do not "
        "count",
        minimum=1e-12,
        maximum=1.0,
    )
    misfit_fraction: float = setting(
        MISFIT_FRACTION,
        "fraction of a pixel's power that may be left beyond the noise before the pixel is marked NOT_ONE_SCATTERER",
        minimum=0.0,
        maximum=1.0,
    )
    range_looks: int = setting(2, "pixels averaged in range", minimum=1, maximum=4096)
    azimuth_looks: int = setting(2, "pixels averaged in azimuth", minimum=1, maximum=4096)
    range_step: int = setting(
        0,
        "pixels from one height to the next in range; less than range_looks: the averages overlap; 0: as range_looks",
        minimum=0,
        maximum=4096,
    )
    azimuth_step: int = setting(
        0,
        "pixels from one height to the next in azimuth; less than azimuth_looks: the averages overlap; "
        "0: as azimuth_looks",
        minimum=0,
        maximum=4096,
    )
    look_window: str = setting(
        "boxcar", "weights of the pixels that are averaged, in range and azimuth", choices=tuple(LOOK_WINDOWS)
    )
    min_cnr_db: float = setting(
        -60.0,
        "lowest CNR of one look of a valid pixel, whatever the number of looks; -60: only that of detection",
        unit="dB",
        minimum=-60.0,
        maximum=100.0,
    )
    # Up to this sigma beams are straight enough for errors to be Gaussian.
    max_sigma_beamwidths: float = setting(
        0.25,
        "highest standard deviation of elevation of a valid pixel, in beamwidths",
        minimum=1e-6,
        maximum=100.0,
    )
    radial_velocity_mps: float = setting(
        0.0,
        "radial velocity of the targets of interest, positive if they recede; heights and positions are right for "
        "targets of this velocity only",
        unit="m/s",
        minimum=-1000.0,
        maximum=1000.0,
    )
    radial_velocity_sigma_mps: float = setting(
        0.0,
        "standard deviation of the radial velocity of what is seen, such as leaves in the wind; it makes the place "
        "along the flight uncertain, by range over the platform's speed times as much",
        unit="m/s",
        minimum=0.0,
        maximum=1000.0,
    )
    max_saturated_fraction: float = setting(
        MAX_SHARE,
        "highest fraction of clipped samples in a channel; above it, all heights of the dwell are marked SATURATED",
        minimum=0.0,
        maximum=1.0,
    )

    beam_pitch_sigma: float = setting(
        AS_DESCRIBED,
        "relative standard deviation of the angles between the beams, an error of elevation in proportion to the angle "
        "from the middle of the array; 0: exact; -1: as the sensor's description states, or else "
        f"{BEAM_PITCH:g}",
        minimum=-1.0,
        maximum=0.1,
    )
    beam_width_sigma: float = setting(
        AS_DESCRIBED,
        "relative standard deviation of the width of the beams where no calibration has measured it; 0: exact; -1: as "
        f"the sensor's description states, or else {BEAM_WIDTH:g}",
        minimum=-1.0,
        maximum=1.0,
    )
    channel_gain_sigma_db: float = setting(
        AS_DESCRIBED,
        "standard deviation of the gain of each channel where no calibration has measured it; 0: exact; -1: as the "
        f"sensor's description states, or else {CHANNEL_GAIN_DB:g} dB",
        unit="dB",
        minimum=-1.0,
        maximum=20.0,
    )

    @property
    def measures_noise_and_gains(self) -> bool:
        """True if noise power and gains are those of the data of a dwell that contradicts its description."""
        return False

    @property
    def windows(self) -> tuple[Window, Window]:
        """Looks in range and in azimuth."""
        return (
            Window.named(self.look_window, self.range_looks, self.range_step),
            Window.named(self.look_window, self.azimuth_looks, self.azimuth_step),
        )

    @property
    def min_cnr(self) -> float:
        """Lowest CNR of a valid pixel, power ratio."""
        return float(10 ** (self.min_cnr_db / 10))
