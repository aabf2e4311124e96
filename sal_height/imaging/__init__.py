"""Image formation: from the phase history of a dwell or strip to single-look complex images of all detectors.

Read `focus` and `strip_focus` first (`focus_dwell`, `StripFocuser`: the whole of it), then `pixels` (image grids,
their noise, windows, and beams in strip images), `corrections` (known errors), `air` (delay and bend), `instrument`
(errors that the sensor's description leaves), `unknown_odometry` (assumed ones of odometry, and between its samples),
`ambiguous_position` (along the flight, by Doppler), `checks` (dwells that alias are refused), `interference`
(narrow-band emitters), `formers` (backprojection and the fast ones), `autofocus` (phase errors common to all detectors)
and `strip` (blocks that join).
"""

from sal_height.imaging.air import MEASURED_AIR, STANDARD_AIR, UNKNOWN_AIR, VACUUM, StatedAir, errors_of_air
from sal_height.imaging.ambiguous_position import with_ambiguous_position
from sal_height.imaging.autofocus.gradient import apply_phase, focus_cells, is_for_speckle
from sal_height.imaging.autofocus.placement import Centroid, NavigationPrior, Placement
from sal_height.imaging.autofocus.strip_phase import stays_in_range_cell
from sal_height.imaging.corrections import (
    Corrected,
    CorrectionSettings,
    StripDelay,
    correct_dwell,
    correct_track,
    with_errors,
    with_known_errors,
)
from sal_height.imaging.focus import ImageSettings, Slc, cell_response, focus_dwell
from sal_height.imaging.formers.backprojection import backproject, backproject_points
from sal_height.imaging.formers.choice import FORMERS, FormImages
from sal_height.imaging.instrument import instrument_errors
from sal_height.imaging.interference import NARROW_BAND, narrow_band_doubts
from sal_height.imaging.pixels import Processing, azimuth_resolution, image_beams, line_of_sight
from sal_height.imaging.strip_focus import StripFocuser
from sal_height.imaging.unknown_odometry import SPARSE_ODOMETRY, UNKNOWN_ODOMETRY, with_unknown_odometry

__all__ = [
    "FORMERS",
    "MEASURED_AIR",
    "NARROW_BAND",
    "SPARSE_ODOMETRY",
    "STANDARD_AIR",
    "UNKNOWN_AIR",
    "UNKNOWN_ODOMETRY",
    "VACUUM",
    "Centroid",
    "Corrected",
    "CorrectionSettings",
    "FormImages",
    "ImageSettings",
    "NavigationPrior",
    "Placement",
    "Processing",
    "Slc",
    "StatedAir",
    "StripDelay",
    "StripFocuser",
    "apply_phase",
    "azimuth_resolution",
    "backproject",
    "backproject_points",
    "cell_response",
    "correct_dwell",
    "correct_track",
    "errors_of_air",
    "focus_cells",
    "focus_dwell",
    "image_beams",
    "instrument_errors",
    "is_for_speckle",
    "line_of_sight",
    "narrow_band_doubts",
    "stays_in_range_cell",
    "with_ambiguous_position",
    "with_errors",
    "with_known_errors",
    "with_unknown_odometry",
]
