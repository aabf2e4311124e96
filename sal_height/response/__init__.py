"""The response of an imaging system, measured on its images: point targets, speckle, and both compared.

Read `impulse` first (width, PSLR and ISLR of a point), then `point_targets` (finding them), `transfer_function` and
`point_spread` (the function that follows), `speckle_tiles` and `speckle_spectra` (the same from pure speckle),
`linearity` (a test that both agree, as they do if the system is linear), and `report` (all of it for the images of
one receiver, in one band in azimuth for all columns).
"""

from sal_height.response.impulse import (
    OVERSAMPLING,
    REACH,
    Chip,
    CutResponse,
    ImpulseResponse,
    chip_around,
    measure_brightest,
    measure_windows,
)
from sal_height.response.linearity import ShapedNoise, superposition
from sal_height.response.point_spread import (
    FINENESS,
    AxisSpread,
    PointSpread,
    cut_through,
    estimate_point_spread,
)
from sal_height.response.point_targets import (
    CHIP,
    PointTarget,
    PointTargetSettings,
    chip_at,
    find_targets,
)
from sal_height.response.report import LONG_CHIPS, NOISE_UNKNOWN, PsfReport, PsfSettings, report_on
from sal_height.response.speckle_spectra import (
    AxisSpectrum,
    Pointing,
    SpeckleSpectra,
    estimate_speckle_spectra,
    periodogram_covariance,
)
from sal_height.response.speckle_tiles import find_pure_speckle
from sal_height.response.transfer_function import FLOOR, AxisTransfer, TransferFunction, estimate_transfer_function

__all__ = [
    "CHIP",
    "FINENESS",
    "FLOOR",
    "LONG_CHIPS",
    "NOISE_UNKNOWN",
    "OVERSAMPLING",
    "REACH",
    "AxisSpectrum",
    "AxisSpread",
    "AxisTransfer",
    "Chip",
    "CutResponse",
    "ImpulseResponse",
    "PointSpread",
    "PointTarget",
    "PointTargetSettings",
    "Pointing",
    "PsfReport",
    "PsfSettings",
    "ShapedNoise",
    "SpeckleSpectra",
    "TransferFunction",
    "chip_around",
    "chip_at",
    "cut_through",
    "estimate_point_spread",
    "estimate_speckle_spectra",
    "estimate_transfer_function",
    "find_pure_speckle",
    "find_targets",
    "measure_brightest",
    "measure_windows",
    "periodogram_covariance",
    "report_on",
    "superposition",
]
