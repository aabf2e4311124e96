"""Maximum likelihood over the whole array: the estimator `ml`, from the likelihood, its prior and two scatterers."""

from __future__ import annotations

from sal_height.beams import Beams
from sal_height.elevation.estimate import ElevationEstimate
from sal_height.elevation.layover import resolve_layover
from sal_height.elevation.likelihood import OBJECTIVES, ArraySettings, estimate_at, estimate_at_highest
from sal_height.elevation.looks import Looks
from sal_height.elevation.spatial_prior import RECOMMENDED_STRENGTH, smoothed_peaks
from sal_height.settings import setting


class MlSettings(ArraySettings):
    """Settings of maximum likelihood over the whole array."""

    objective: str = setting(
        "normalised",
        "function that is maximised: normalised (exact) or numerator (as published; biased near the ends of the array)",
        choices=tuple(OBJECTIVES),
    )
    prior_strength: float = setting(
        0.0,
        f"weight of the spatial smoothness prior; 0: none; {RECOMMENDED_STRENGTH:g} is recommended at low CNR; "
        "small features may vanish",
        minimum=0.0,
        maximum=100.0,
    )
    layover: bool = setting(
        default=True, description="whether to search for two scatterers in pixels that a single one does not explain"
    )
    layover_false_alarm: float = setting(
        1e-3,
        "share of single scatterers that may be taken for two, of those that do not pass for one",
        minimum=1e-9,
        maximum=0.1,
    )


def ml_elevation(looks: Looks, beams: Beams, settings: MlSettings) -> ElevationEstimate:
    """Elevation of the dominant scatterer in every pixel, and of the second one where two are detected.

    Args:
        looks: covariance of M channels of equal noise in each pixel.
        beams: of the M detectors.
        settings: with a prior, the objective is always the exact one.

    Raises:
        UserError: a real covariance of complex beams.
    """
    if settings.prior_strength:
        # The peak that suits the neighbours best.
        elevation = smoothed_peaks(looks, beams, settings.prior_strength)
        estimate = estimate_at(elevation, looks, beams, settings)
    else:
        # The highest peak.
        estimate = estimate_at_highest(OBJECTIVES[settings.objective], looks, beams, settings)
    if settings.layover and beams.count > 2:
        # Pixels that one scatterer does not explain.
        estimate = resolve_layover(estimate, looks, beams, settings.min_cnr, settings.layover_false_alarm)
    return estimate
