"""The receive beams: the complex amplitude of every detector for a target at a given elevation and squint.

Read `pattern` first (the registry PATTERNS of apertures, point detectors and finite ones), then `table` (measured
beams, which `table_files` reads) and `array` (`Beams`: all detectors of a sensor, each along its boresight).
`apertures` contains the formulas and the mean over a finite detector, `pupil` aberrations of the optics.
"""

from sal_height.beams.apertures import GAUSSIAN_WIDTH
from sal_height.beams.array import Beams, column_squint
from sal_height.beams.pattern import PATTERNS, Pattern, detector_pattern, pattern_named
from sal_height.beams.pupil import ZERNIKE, aberrated_derivatives
from sal_height.beams.table import BeamTable, tabulated_pattern
from sal_height.beams.table_files import read_beam_tables

__all__ = [
    "GAUSSIAN_WIDTH",
    "PATTERNS",
    "ZERNIKE",
    "BeamTable",
    "Beams",
    "Pattern",
    "aberrated_derivatives",
    "column_squint",
    "detector_pattern",
    "pattern_named",
    "read_beam_tables",
    "tabulated_pattern",
]
