"""Closed forms and Monte Carlo trials as references for estimators, figures and tests.

Read `discriminator_noise` first (laws of the pair's discriminant), then `array_trials` (fast draws of pixels for Monte
Carlo), `link_budget` (power and CNR, and the relief paper's radar) and `aperture_phase` (effect of random phases on
images). Nothing that processes data imports from here.
"""

from sal_height.theory.aperture_phase import AperturePhase, phase_of_line, phase_of_structure, sum_of_phases
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
from sal_height.theory.link_budget import (
    Link,
    crossover_slope,
    diffuse_backscatter,
    effective_area,
    hybrid_gain,
    noise_density,
    synthesise,
)

__all__ = [
    "NORMAL_SHARES",
    "TARGETS",
    "AperturePhase",
    "Link",
    "SteadyLaw",
    "SteadyMlLaw",
    "TargetPixels",
    "cnr_detector_of",
    "crossover_slope",
    "diffuse_backscatter",
    "effective_area",
    "gaussian_law",
    "gaussian_mean",
    "hybrid_gain",
    "noise_density",
    "phase_of_line",
    "phase_of_structure",
    "s68_of",
    "steady_looks_mean",
    "steady_mean",
    "straight_power",
    "sum_of_phases",
    "synthesise",
    "with_streams",
]
