"""Settings that all estimators share: which looks make a pixel, and which pixels are valid."""

from __future__ import annotations

from sal_height.elevation.looks.look_windows import LOOK_WINDOWS, Window
from sal_height.sensor import MAX_SHARE
from sal_height.settings import Settings, setting

MISFIT_FRACTION = 0.03
"""Share of a pixel's explained power that may be left beyond the noise before it counts as more than one scatterer.

It is for the extent of the ground in a pixel: looks, and parts of a range cell, that differ in elevation leave a share
of the power that does not depend on the CNR. Errors of the beams are counted apart (`beam_error`).
"""

FALSE_ALARM_RATE = 1e-4
"""Share of single scatterers that are rejected because of noise, and of noise that passes for a scatterer.

The latter is that of the strongest of M independent directions. The search sees more directions, but most of them are
outside the array: of pixels of noise alone 0.1 to 1.7 times this share are valid, without any least CNR.
"""

SIDELOBE_RATE = 0.01
"""Share of pixels in which the sidelobes of others pass for a scatterer, at most.

Behind bright ground their power is that of one look of speckle however many looks a pixel has, so that each factor of
10 less costs 2.3 times their mean power: with the rectangular window 10 % of the ground's brightness.
"""

NO_LIMIT_DB = -60.0
"""Least CNR that no pixel with a detected scatterer falls below."""


MAX_SIGMA_BEAMWIDTHS = 0.25
"""Standard deviation of elevation, in beamwidths, up to which beams are straight enough for errors to be Gaussian."""


class HeightSettings(Settings):
    """What a height image is made with, whichever estimator makes it."""

    false_alarm_rate: float = setting(
        FALSE_ALARM_RATE,
        "fraction of single scatterers that are rejected because of noise, and of pixels of noise that pass for one",
        minimum=1e-12,
        maximum=0.1,
    )
    sidelobe_rate: float = setting(
        SIDELOBE_RATE,
        "fraction of pixels of shadow in which sidelobes of scatterers elsewhere pass for one; 1: sidelobes do "
        "not count",
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
        NO_LIMIT_DB,
        "lowest CNR of one look of a valid pixel, whatever the number of looks; -60: none but that of detection",
        unit="dB",
        minimum=NO_LIMIT_DB,
        maximum=100.0,
    )
    max_sigma_beamwidths: float = setting(
        MAX_SIGMA_BEAMWIDTHS,
        "highest standard deviation of elevation of a valid pixel, in beamwidths",
        minimum=1e-6,
        maximum=100.0,
    )
    radial_velocity_mps: float = setting(
        0.0,
        "radial velocity of the targets of interest, positive if they recede; heights and places are right for "
        "targets of this velocity only",
        unit="m/s",
        minimum=-1000.0,
        maximum=1000.0,
    )
    max_saturated_fraction: float = setting(
        MAX_SHARE,
        "highest fraction of clipped samples in a channel; above it, all heights of the dwell are marked SATURATED",
        minimum=0.0,
        maximum=1.0,
    )

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
