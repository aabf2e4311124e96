"""Effect of an instrument that is known only so well: on the covariance of the pose, and as doubts about the images."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sal_height.doubts import UNKNOWN_SENSOR, Assumption, doubts_of_assumed
from sal_height.geometry import ApertureState
from sal_height.imaging import CorrectionSettings, Slc, errors_of_air, instrument_errors, with_errors
from sal_height.numeric import F64
from sal_height.sensor import Sensor

INSTRUMENT = "instrument of unknown accuracy"
"""Name of the doubt about what is assumed of mounting, range and clocks."""


def with_instrument(slc: Slc, sensor: Sensor, settings: CorrectionSettings) -> Slc:
    """The images with the errors of instrument and air in the covariance of the pose, and a doubt if some are assumed.

    Args:
        slc: images of all channels.
        sensor: sensor of the images, with its mounting.
        settings: settings that state the errors that corrections leave.
    """
    errors = list(instrument_errors(slc.aperture, slc.grid.middle, sensor, settings))
    assumed = [Assumption(error.name, error.parameter) for error in errors if error.is_assumed]
    of_air = errors_of_air(slc.aperture, slc.grid.middle, sensor, settings)
    aperture = with_errors(slc.aperture, settings, [*(error.effects for error in errors), of_air])
    doubts = doubts_of_assumed(INSTRUMENT, UNKNOWN_SENSOR, assumed)
    return replace(slc, aperture=aperture, doubts=(*slc.doubts, *doubts))


def range_covariance(aperture: ApertureState, middle: F64, sensor: Sensor, settings: CorrectionSettings) -> F64:
    """Covariance of the pose by what is not known of ranges and air, which dwells that overlap do not show, (6, 6).

    It contains the errors of range delay, sample clock, air and elevation offset.

    Args:
        aperture: aperture of the image.
        middle: middle of the image in map, m, shape (3,).
        sensor: sensor of the image, with its mounting.
        settings: settings that the image was made with.
    """
    errors = instrument_errors(aperture, middle, sensor, settings)
    effects = [error.effects for error in errors if error.parameter in {"range_sigma_m", "sample_clock_sigma"}]
    effects.append(errors_of_air(aperture, middle, sensor, settings))
    return with_errors(replace(aperture, covariance=np.zeros((6, 6))), settings, effects).covariance
