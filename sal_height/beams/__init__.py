"""What each detector makes of a scatterer: its complex amplitude over elevation and squint.

Read `pattern` first (the registry PATTERNS of aperture patterns, point detectors and finite ones), then `table`
(measured beams from CSV) and `array` (`Beams`: all detectors of a sensor, looking along their boresights). `apertures`,
`pupil`, `band_limited` and `cubic_surface` are what patterns are computed with.
"""

from sal_height.beams.array import Beams, column_squint
from sal_height.beams.pattern import (
    GAUSSIAN_WIDTH,
    PATTERNS,
    Pattern,
    detector_pattern,
    pattern_named,
    tabulated_pattern,
)
from sal_height.beams.table import BeamTable, read_beam_tables

__all__ = [
    "GAUSSIAN_WIDTH",
    "PATTERNS",
    "BeamTable",
    "Beams",
    "Pattern",
    "column_squint",
    "detector_pattern",
    "pattern_named",
    "read_beam_tables",
    "tabulated_pattern",
]
