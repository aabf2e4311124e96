"""Pairwise amplitude-comparison monopulse (SAL paper, sections 2 and 3).

For every two neighbouring detectors Sigma is the sum and Delta the upper minus the lower one. The channels have equal
noise (`whitened_channels`), so that the noise of Sigma and Delta is equal and independent, too. In each pixel the pair
with the most power in Sigma is selected; its discriminant mu = Re(Delta / Sigma) is estimated and inverted.
"""

from __future__ import annotations

import numpy as np

from sal_height.beams import Beams
from sal_height.elevation.array.estimate import ElevationEstimate, Validity, array_fit, decide_validity
from sal_height.elevation.array.height_settings import HeightSettings
from sal_height.elevation.array.likelihood import OBJECTIVES, SinglePeaks, search_guard
from sal_height.elevation.array.search import PIXELS_AT_ONCE, PeakSearch, PeakSearches, Pixels
from sal_height.elevation.layover.two_channels import in_two_channels
from sal_height.elevation.looks.looks import Covariance, Looks
from sal_height.elevation.monopulse._kernels import find_strongest_pairs
from sal_height.elevation.monopulse.estimators import (
    DISCRIMINANTS,
    Products,
    accuracy,
    discriminate,
    sum_and_difference,
)
from sal_height.elevation.monopulse.inverse_table import invert_pairs
from sal_height.elevation.monopulse.inversion import UNPAIRED
from sal_height.errors import Rejected
from sal_height.numeric import F64, Index, in_parallel
from sal_height.settings import setting


class MonopulseSettings(HeightSettings):
    """Settings of the estimator that uses the strongest pair of detectors."""

    discriminant: str = setting(
        "tls",
        "estimator of the ratio Delta / Sigma: tls (total least squares), ratio (as published; biased at low CNR) or "
        "noise_subtraction (ratio, with the noise power subtracted from that of Sigma)",
        choices=tuple(DISCRIMINANTS),
    )


def monopulse_elevation(looks: Looks, beams: Beams, settings: MonopulseSettings) -> ElevationEstimate:
    """Estimate the elevation of the dominant scatterer in every pixel from its strongest pair.

    Sigma and CNR are those of `estimators.accuracy`: the bound for the pair alone. Pixels are OUTSIDE_PAIR where their
    discriminant is outside the domain of their pair.

    Args:
        looks: covariance of M channels of equal noise in each pixel.
        beams: beams of the M detectors, 2 or more.
        settings: settings of the estimator.

    Raises:
        Rejected: the channels are mixtures of detectors.
    """
    if beams.matrix is not None:
        raise Rejected(
            "mixed channels",
            "The channel matrix of SensorInfo is no lossless hybrid, so the detectors' noise is correlated and they "
            "form no pairs; use ml_height, or sum_difference_height for a sum and a difference.",
        )
    pair, sums = strongest_pairs(looks)
    noise_powers = (2 * looks.receiver_noise, 2 * looks.receiver_noise)
    mu = discriminate(sums, DISCRIMINANTS[settings.discriminant], noise_powers)
    found = invert_pairs(beams, mu, pair, looks.squint, looks.columns)
    sigma, cnr = accuracy(sums, found, noise_powers, beams.uncertainty)

    first, last = beams.span

    def compare(search: PeakSearch, pixels: Covariance, here: Pixels) -> F64:
        """The `PeakSearch.fit` of `found` in the whole array, and 1 where a peak beyond the array wins, else 0.

        It wins where it is the highest peak, beyond the boresights, and explains more by three noise powers.
        """
        explained, gain, turning = search.fit(pixels, found.elevation[here])
        least, wins = explained + 3.0 * looks.receiver_noise, np.zeros(len(pixels))
        some = search.may_peak_beyond(pixels, beams.span, least)
        best = search.of(some).peaks(pixels[some])
        wins[some] = ((best.elevation < first) | (best.elevation > last)) & (best.height > least[some])
        return np.stack([explained, gain, turning, wins])

    searches = PeakSearches.over(beams, OBJECTIVES["normalised"], search_guard(beams))
    explained, gain, turning, outside = searches.of_pixels(looks, 4, compare)
    explained = explained / looks.receiver_noise
    inside = (found.elevation >= first) & (found.elevation <= last)
    fit, strong = array_fit(looks, explained, gain, beams.uncertainty), cnr >= settings.min_cnr
    validity = decide_validity(looks, fit, strong, inside, Validity.OUTSIDE_ARRAY, settings)
    validity[(validity == Validity.OK) & (outside > 0)] = Validity.OUTSIDE_ARRAY
    validity[UNPAIRED[found.reason] & looks.finite] = Validity.OUTSIDE_PAIR
    estimate = ElevationEstimate.of_one(found.elevation, sigma, cnr, validity)
    if beams.count > 2:
        return estimate
    peaks = SinglePeaks.alone(found.elevation, explained, gain, turning)
    return in_two_channels(estimate, peaks, looks, beams, settings)


def strongest_pairs(looks: Looks) -> tuple[Index, Products]:
    """The pair of neighbouring detectors with the most power in Sigma, and the products of its Sigma and Delta.

    Returns:
        Number of the lower detector of each pixel, shape (rows, cols), and the products, of that shape.
    """
    rows, cols = looks.count.shape
    pair, found = np.empty((rows, cols), np.intp), np.empty((4, rows, cols))
    high = max(1, PIXELS_AT_ONCE // cols)

    def find(part: slice) -> None:
        for first in range(part.start, part.stop, high):
            block = slice(first, min(first + high, part.stop))
            find_strongest_pairs(looks.covariance[block, :], pair[block], found[:, block])

    in_parallel(find, rows, high)
    lower, upper, real, imaginary = found
    return pair, sum_and_difference(lower, upper, real + 1j * imaginary, looks.count)
