"""Calibration of receivers and beams from images of any scene.

Read `calibration` first (the result: responses, gains, width of the beams, each with its standard error), then
`accumulate` (`Calibrator`: many dwells to one calibration), `receiver_responses` (differences between channels over the
band), `beam_calibration` (gains and beam width, and their likelihood) and `pupil` (aberrations).
"""

from sal_height.calibration.accumulate import Calibrator
from sal_height.calibration.beam_calibration import BeamCalibration, calibrate_beams
from sal_height.calibration.calibration import Calibration, CalibrationSettings
from sal_height.calibration.files import load_calibration, save_calibration

__all__ = [
    "BeamCalibration",
    "Calibration",
    "CalibrationSettings",
    "Calibrator",
    "calibrate_beams",
    "load_calibration",
    "save_calibration",
]
