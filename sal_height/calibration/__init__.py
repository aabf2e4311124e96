"""Calibration of receivers and beams from the images of whatever is flown over.

Read `calibration` first (the result: responses, gains, width of the beams, each with its standard error), then
`accumulate` (`Calibrator`: many dwells to one calibration), `receivers` (differences between channels over the band),
`beams` with `beam_likelihood` (gains and beam width), `reference_target` (a reflector of known place), `files` (a
calibration in a file) and `settings`.
"""

from sal_height.calibration.accumulate import Calibrator
from sal_height.calibration.beams import BeamCalibration, calibrate_beams
from sal_height.calibration.calibration import Calibration
from sal_height.calibration.files import load_calibration, save_calibration
from sal_height.calibration.settings import CalibrationSettings

__all__ = [
    "BeamCalibration",
    "Calibration",
    "CalibrationSettings",
    "Calibrator",
    "calibrate_beams",
    "load_calibration",
    "save_calibration",
]
