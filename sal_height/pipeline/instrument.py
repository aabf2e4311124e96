"""Effect of an instrument that is known only so well: on the covariance of the pose, and as doubts about the images."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sal_height.doubts import Assumption, doubts_of_assumed
from sal_height.imaging import CorrectionSettings, Slc, instrument_errors, with_all_errors
from sal_height.sensor import Sensor

INSTRUMENT = "instrument of unknown accuracy"
"""Name of the doubt about what is assumed of mounting, range and clocks."""


def with_instrument(slc: Slc, sensor: Sensor, settings: CorrectionSettings) -> Slc:
    """The images with the errors of the instrument in the covariance of the pose, and with a doubt if some are assumed.

    Args:
        slc: images of all channels.
        sensor: sensor of the images, with its mounting.
        settings: settings that state the errors that corrections leave.
    """
    slant_range = float(np.linalg.norm(slc.grid.middle - slc.aperture.position))
    errors = instrument_errors(slc.aperture, sensor, settings, slant_range)
    assumed = [Assumption(error.name, error.parameter) for error in errors if error.is_assumed]
    aperture = with_all_errors(slc.aperture, slc.grid.middle, sensor, settings)
    return replace(slc, aperture=aperture, doubts=(*slc.doubts, *doubts_of_assumed(INSTRUMENT, assumed)))
