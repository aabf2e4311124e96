"""Calibration of receivers and beams from images of any scene.

Read `calibration` first (the result: responses, gains, width of the beams, each with its standard error), then
`accumulate` (`Calibrator`: many dwells to one calibration), `receiver_responses` (differences between channels over the
band), `beam_calibration` with `beam_likelihood` (gains and beam width), `pupil` (aberrations), `reference_target` (a
reflector at a known position), `files` (a calibration in a file) and `calibration_settings`.
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
