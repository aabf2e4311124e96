"""Pairwise amplitude-comparison monopulse (SAL paper, sections 2 and 3).

For every two neighbouring detectors Sigma is the sum and Delta the upper minus the lower one. The channels have equal
noise (`whitened_channels`), so that the noise of Sigma and Delta is equal and independent, too. In each pixel the pair
with the most power in Sigma is selected; its discriminant mu = Re(Delta / Sigma) is estimated and inverted.
"""

from __future__ import annotations

import numpy as np

from sal_height.beams import Beams
from sal_height.elevation.estimate import ElevationEstimate, Validity, array_fit, decide_validity
from sal_height.elevation.likelihood import OBJECTIVES, search_guard
from sal_height.elevation.looks import Covariance, Looks
from sal_height.elevation.monopulse.estimators import DISCRIMINANTS, accuracy, discriminate, sum_and_difference
from sal_height.elevation.monopulse.inversion import Inversion, Reason, invert
from sal_height.elevation.search import PeakSearch, PeakSearches
from sal_height.elevation.settings import HeightSettings
from sal_height.errors import Rejected
from sal_height.numeric import F64, Index
from sal_height.settings import setting

OUTSIDE_MARGIN = 3.0
"""Noise powers by which a direction outside the array must explain a pixel better than the pair's elevation does."""


class MonopulseSettings(HeightSettings):
    """Settings of the estimator that takes the strongest pair of detectors."""

    discriminant: str = setting(
        "tls",
        "estimator of the ratio Delta / Sigma: tls (total least squares), ratio (as published; biased at low CNR) or "
        "noise_subtraction (ratio, with the noise power subtracted from that of Sigma)",
        choices=tuple(DISCRIMINANTS),
    )


def monopulse_elevation(looks: Looks, beams: Beams, settings: MonopulseSettings) -> ElevationEstimate:
    """Estimate the elevation of the dominant scatterer in every pixel from its strongest pair.

    Sigma and CNR are those of `estimators.accuracy`: the bound for the pair by itself. Pixels are OUTSIDE_PAIR where
    their discriminant lies outside the domain of their pair.

    Args:
        looks: covariance of M channels of equal noise in each pixel.
        beams: of the M detectors, 2 or more.
        settings: of the estimator.

    Raises:
        Rejected: the channels are mixtures of detectors.
    """
    if beams.matrix is not None:
        raise Rejected(
            "mixed channels",
            "The channel matrix of SensorInfo is no lossless hybrid, so the detectors' noise is correlated and they "
            "form no pairs; use ml_height, or sum_difference_height for a sum and a difference.",
        )
    searches = PeakSearches.over(beams, OBJECTIVES["normalised"], search_guard(beams))

    def strongest(search: PeakSearch, pixels: Covariance, *_where: object) -> F64:
        best = search.peaks(pixels).elevation
        return np.stack([*_strongest_pair(pixels), best, search.fit(pixels, best)[0]])

    pair, lower, upper, real, imaginary, best, best_explained = searches.of_pixels(looks, 7, strongest)
    sums = sum_and_difference(lower, upper, real + 1j * imaginary, looks.count)
    noise_powers = (2 * looks.receiver_noise, 2 * looks.receiver_noise)
    mu = discriminate(sums, DISCRIMINANTS[settings.discriminant], noise_powers)
    found, response = _invert_pairs(beams, pair.astype(np.intp), mu, np.broadcast_to(looks.squint, mu.shape))
    sigma, cnr = accuracy(sums, response, found.slope, noise_powers, beams.uncertainty)

    def at_found(search: PeakSearch, pixels: Covariance, rows: slice, cols: Index) -> F64:
        return search.fit(pixels, found.elevation[rows, cols].reshape(-1))[:2]

    explained, gain = searches.of_pixels(looks, 2, at_found)
    explained = explained / looks.receiver_noise
    first, last = beams.span
    inside = (found.elevation >= first) & (found.elevation <= last)
    fit, strong = array_fit(looks, explained, gain, beams.uncertainty), cnr >= settings.min_cnr
    validity = decide_validity(looks, fit, strong, inside, Validity.OUTSIDE_ARRAY, settings)
    outside = ((best < first) | (best > last)) & (best_explained / looks.receiver_noise - explained > OUTSIDE_MARGIN)
    validity = np.where((validity == Validity.OK) & outside, Validity.OUTSIDE_ARRAY, validity)
    unpaired = np.isin(found.reason, [Reason.BELOW, Reason.ABOVE, Reason.NO_DOMAIN]) & looks.finite
    validity = np.where(unpaired, Validity.OUTSIDE_PAIR, validity).astype(np.uint8)
    return ElevationEstimate.of_one(found.elevation, sigma, cnr, validity)


def _strongest_pair(covariance: Covariance) -> tuple[F64, F64, F64, F64, F64]:
    """Select the pair with the most power in Sigma.

    Args:
        covariance: of pixels, shape (..., M, M); real where the beams are.

    Returns:
        Index of the lower detector, and the sums over looks of |l|^2, |u|^2 and the real and imaginary part of l u*.
    """
    diagonal = np.diagonal(covariance, axis1=-2, axis2=-1).real.astype(np.float64)
    beside = np.diagonal(covariance, offset=1, axis1=-2, axis2=-1).astype(np.complex128)
    power = diagonal[..., :-1] + diagonal[..., 1:] + 2 * beside.real
    pair = np.argmax(power, axis=-1, keepdims=True)
    lower, upper = (np.take_along_axis(diagonal, pair + step, axis=-1)[..., 0] for step in (0, 1))
    product = np.take_along_axis(beside, pair, axis=-1)[..., 0]
    return pair[..., 0].astype(np.float64), lower, upper, product.real, product.imag


def _invert_pairs(beams: Beams, pair: Index, mu: F64, squint: F64) -> tuple[Inversion, F64]:
    """Invert the discriminant of each pixel's `pair`; also return the response of the pair's beams there, (..., 2)."""
    elevation, slope = np.full((2, *mu.shape), np.nan)
    reason = np.full(mu.shape, Reason.NOT_FINITE, np.uint8)
    response = np.full((*mu.shape, 2), np.nan, dtype=np.complex128)
    for lower in np.unique(pair).tolist():
        here, pair_beams = pair == lower, beams.pair(lower)
        found = invert(pair_beams, mu[here], squint[here])
        elevation[here], slope[here], reason[here] = found.elevation, found.slope, found.reason
        response[here] = pair_beams.response(found.elevation, squint[here])
    return Inversion(elevation, slope, reason), response
