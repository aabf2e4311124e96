"""Closed forms and Monte Carlo trials that estimators, figures and tests are held to.

Read `discriminator_noise` first (laws of the pair's discriminant), then `sum_difference` (the relief paper's radar)
and `array_trials` (fast draws of pixels for Monte Carlo). Nothing that processes data imports from here.
"""

from sal_height.theory.array_trials import TARGETS, TargetPixels, with_streams
from sal_height.theory.discriminator_noise import (
    NORMAL_SHARES,
    SteadyLaw,
    SteadyMlLaw,
    cnr_detector_of,
    gaussian_law,
    gaussian_mean,
    s68_of,
    steady_looks_mean,
    steady_mean,
    straight_power,
)
from sal_height.theory.sum_difference import crossover_slope, hybrid_gain, synthesise

__all__ = [
    "NORMAL_SHARES",
    "TARGETS",
    "SteadyLaw",
    "SteadyMlLaw",
    "TargetPixels",
    "cnr_detector_of",
    "crossover_slope",
    "gaussian_law",
    "gaussian_mean",
    "hybrid_gain",
    "s68_of",
    "steady_looks_mean",
    "steady_mean",
    "straight_power",
    "synthesise",
    "with_streams",
]
