"""Effect of an instrument that is known only so well: on the covariance of the pose, and as doubts about the images."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sal_height.doubts import UNKNOWN_SENSOR, Assumption, doubts_of_assumed
from sal_height.imaging import CorrectionSettings, Slc, errors_of_air, instrument_errors, with_errors
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
    slant_range = float(np.linalg.norm(slc.grid.middle - slc.aperture.position))
    errors = list(instrument_errors(slc.aperture, sensor, settings, slant_range))
    assumed = [Assumption(error.name, error.parameter) for error in errors if error.is_assumed]
    of_air = errors_of_air(slc.aperture, slc.grid.middle, sensor, settings)
    aperture = with_errors(slc.aperture, settings, [*(error.effects for error in errors), of_air])
    doubts = doubts_of_assumed(INSTRUMENT, UNKNOWN_SENSOR, assumed)
    return replace(slc, aperture=aperture, doubts=(*slc.doubts, *doubts))
