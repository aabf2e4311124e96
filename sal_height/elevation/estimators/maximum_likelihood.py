"""Maximum likelihood over the whole array: the estimator `ml`, with several scatterers where the looks require them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sal_height.beams import Beams
from sal_height.elevation.array.estimate import ElevationEstimate
from sal_height.elevation.array.likelihood import (
    OBJECTIVES,
    estimate_of,
    highest_peaks,
    highest_peaks_of,
    peak_elevation,
    search_guard,
)
from sal_height.elevation.layover.models import resolve, where_single
from sal_height.elevation.layover.single import LayoverSettings
from sal_height.elevation.layover.two_channels import in_two_channels
from sal_height.elevation.looks.looks import Looks
from sal_height.settings import setting


class MlSettings(LayoverSettings):
    """Settings of maximum likelihood over the whole array."""

    objective: str = setting(
        "normalised",
        "function that is maximised: normalised (exact) or numerator (as published; biased near the ends of the array, "
        "and without heights in layover)",
        choices=tuple(OBJECTIVES),
    )
    noise_and_gains: str = setting(
        "stated",
        "noise power and gains of the channels: stated (as the sensor's description has them) or measured (where the "
        "tests of a dwell contradict it, those that its data show; such a dwell takes up to "
        "seven times as long)",
        choices=("stated", "measured"),
    )

    @property
    def measures_noise_and_gains(self) -> bool:
        """True if noise power and gains are those of the data of a dwell that contradicts its description."""
        return self.noise_and_gains == "measured"


def ml_elevation(looks: Looks, beams: Beams, settings: MlSettings) -> ElevationEstimate:
    """Elevations of the scatterers in every pixel: one, two, three or an extended one, as the looks require.

    Args:
        looks: covariance of M channels of equal noise in each pixel.
        beams: beams of the M detectors.
        settings: settings of the estimator.

    Raises:
        UserError: a real covariance of complex beams.
    """
    estimate = _exact_elevation(looks, beams, settings)
    return estimate if settings.objective == "normalised" else _by_numerator(estimate, looks, beams)


def _exact_elevation(looks: Looks, beams: Beams, settings: MlSettings) -> ElevationEstimate:
    """Elevations where the likelihood is greatest."""
    if settings.layover:
        peaks = highest_peaks(looks, beams, settings)
    else:
        # Without layover the gain of one more scatterer is not needed.
        peaks = highest_peaks_of(OBJECTIVES["normalised"], looks, beams, settings)
    estimate = estimate_of(peaks, looks, beams, settings)
    if beams.count == 2:
        return in_two_channels(estimate, peaks, looks, beams, settings)
    if not settings.layover:
        return estimate
    return replace(resolve(estimate, peaks, looks, beams, settings), residue=peaks.residue)


def _by_numerator(exact: ElevationEstimate, looks: Looks, beams: Beams) -> ElevationEstimate:
    """The elevations that the paper's objective has where there is a single surface; elsewhere it has none.

    Their error is that of the exact elevation, and what they differ from it by: sigma contains both.
    """
    elevation = peak_elevation(looks, beams, OBJECTIVES["numerator"], search_guard(beams))
    return where_single(exact, elevation, np.hypot(exact.sigma, elevation - exact.elevation))
