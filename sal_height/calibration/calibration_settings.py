"""Settings of the calibration of receivers and beams."""

from __future__ import annotations

from sal_height.elevation import MISFIT_FRACTION
from sal_height.response import PointTargetSettings
from sal_height.sensor import MAX_SHARE
from sal_height.settings import setting


class CalibrationSettings(PointTargetSettings):
    """Criteria for the data that a calibration is measured from, and its greatest error."""

    azimuth_looks: int = setting(
        4,
        "columns averaged to a pixel for gains and width of the beams; rows are not averaged, because on slopes they "
        "differ in elevation",
        minimum=1,
        maximum=64,
    )
    pixels_per_dwell: int = setting(
        256,
        "least number of pixels kept of each dwell for gains and width; 8000 of 15 dB give the width within 0.1 %",
        minimum=1,
        maximum=65_536,
    )
    min_energy: float = setting(
        50.0,
        "lowest energy of a pixel that is used for gains and width, summed over its looks and all detectors, over the "
        "noise power of one sample",
        minimum=1.0,
        maximum=1e9,
    )
    misfit_fraction: float = setting(
        MISFIT_FRACTION,
        "fraction of a pixel's power that one scatterer may leave beyond the noise; pixels with more are not used",
        minimum=0.0,
        maximum=1.0,
    )
    first_misfit_fraction: float = setting(
        0.15, "misfit_fraction of the first two steps, while gains and width are not known", minimum=0.0, maximum=1.0
    )
    pixels_per_parameter: int = setting(
        20, "least number of usable pixels for each gain, phase and width", minimum=1, maximum=1_000_000
    )
    max_uncertainty: float = setting(
        0.05,
        "greatest standard deviation of ln width, ln gain or phase, or of any combination of them (a unit vector); "
        "above it, gains and width stay as described",
        minimum=1e-6,
        maximum=1.0,
    )
    pupil_prior_waves: float = setting(
        0.0,
        "standard deviation that aberrations of the pupil are assumed to have, each Zernike term; such as 0.1; 0: the "
        "pupil is as described, and not measured",
        unit="waves rms",
        minimum=0.0,
        maximum=1.0,
    )
    echo_significance: float = setting(
        3.5,
        "standard errors above which an echo in the response of a receiver counts as real; of Gaussian noise one echo "
        "in exp(3.5^2) = 200000 is",
        minimum=0.0,
        maximum=100.0,
    )
    target_reach: int = setting(
        2, "pixels around its expected position in which the reference target is searched", minimum=0, maximum=1000
    )
    target_over_image_db: float = setting(
        20.0,
        "lowest power of the reference target, all channels together, over the median of the image",
        unit="dB",
        minimum=0.0,
        maximum=200.0,
    )
    max_saturated_fraction: float = setting(
        MAX_SHARE,
        "highest fraction of clipped samples in a channel of a dwell that is used",
        minimum=0.0,
        maximum=1.0,
    )


DEFAULTS = CalibrationSettings()
