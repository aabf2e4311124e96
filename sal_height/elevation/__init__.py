"""Elevation angle of the scatterer in each pixel, from the amplitude ratios between channels.

Every estimator is a function `estimate(looks, beams, settings)` that returns an `ElevationEstimate`. Read `looks` first
(the covariance of the channels in each pixel; `cell_response`: the part of it that neighbouring pixels contribute),
then `estimate` (the result and the reasons for an invalid pixel), `likelihood` with `search` (one scatterer, by the
whole array), `several` (two and three scatterers in a pixel), `extended` (one surface that is spread over elevation),
`order` (probability of each of these models), `models` (choice of the model of each pixel) and `maximum_likelihood`,
which joins these; `spectra` (Capon and MUSIC, known from tomography, on the same search), `monopulse` (pairs; sum and
difference), `bounds` (the Cramér-Rao bounds) and `registry` (the estimators by name, one dwell or several). `profile`
gives the reflectivity at all elevations of a pixel, for tomography of vegetation, and `canopy_ground` the ground below
it.
"""

from sal_height.elevation.array.beam_error import common_deviation
from sal_height.elevation.array.bounds import conditional_crb, information, speckle_crb, stochastic_crb
from sal_height.elevation.array.estimate import (
    MEASURED,
    ORDERS,
    USABLE,
    ElevationEstimate,
    Fit,
    Residue,
    Validity,
    is_explained,
    scatterer_count,
    with_foreign_power,
    without_imprecise,
    without_saturated,
)
from sal_height.elevation.array.height_settings import (
    BEAM_PITCH,
    BEAM_WIDTH,
    CHANNEL_GAIN_DB,
    MISFIT_FRACTION,
    HeightSettings,
)
from sal_height.elevation.array.likelihood import AMBIGUOUS_RATIO, OBJECTIVES, peak_elevation, search_guard
from sal_height.elevation.array.response_spread import sidelobe_variance
from sal_height.elevation.array.search import Objective, PeakSearch, PeakSearches, Pixels
from sal_height.elevation.estimators.maximum_likelihood import MlSettings, ml_elevation
from sal_height.elevation.estimators.registry import ESTIMATORS, ElevationEstimator, MakeChannels
from sal_height.elevation.looks.cell_response import AxisResponse, CellResponse
from sal_height.elevation.looks.look_windows import Window, axis_looks
from sal_height.elevation.looks.looks import (
    Covariance,
    Looks,
    covariance,
    live_detectors,
    look_grid,
    windowed_looks,
)
from sal_height.elevation.monopulse.discriminant import (
    discriminant,
    discriminant_domain,
    discriminant_slope,
    moving_squint,
)
from sal_height.elevation.monopulse.estimators import (
    DISCRIMINANTS,
    Estimator,
    discriminate,
    discriminator_variance,
    products,
    ratio,
    sum_and_difference,
    total_least_squares,
)
from sal_height.elevation.monopulse.inversion import invert
from sal_height.elevation.vegetation.profile import PROFILES

__all__ = [
    "AMBIGUOUS_RATIO",
    "BEAM_PITCH",
    "BEAM_WIDTH",
    "CHANNEL_GAIN_DB",
    "DISCRIMINANTS",
    "ESTIMATORS",
    "MEASURED",
    "MISFIT_FRACTION",
    "OBJECTIVES",
    "ORDERS",
    "PROFILES",
    "USABLE",
    "AxisResponse",
    "CellResponse",
    "Covariance",
    "ElevationEstimate",
    "ElevationEstimator",
    "Estimator",
    "Fit",
    "HeightSettings",
    "Looks",
    "MakeChannels",
    "MlSettings",
    "Objective",
    "PeakSearch",
    "PeakSearches",
    "Pixels",
    "Residue",
    "Validity",
    "Window",
    "axis_looks",
    "common_deviation",
    "conditional_crb",
    "covariance",
    "discriminant",
    "discriminant_domain",
    "discriminant_slope",
    "discriminate",
    "discriminator_variance",
    "information",
    "invert",
    "is_explained",
    "live_detectors",
    "look_grid",
    "ml_elevation",
    "moving_squint",
    "peak_elevation",
    "products",
    "ratio",
    "scatterer_count",
    "search_guard",
    "sidelobe_variance",
    "speckle_crb",
    "stochastic_crb",
    "sum_and_difference",
    "total_least_squares",
    "windowed_looks",
    "with_foreign_power",
    "without_imprecise",
    "without_saturated",
]
