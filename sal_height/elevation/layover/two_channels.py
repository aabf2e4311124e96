"""Ambiguities of two channels: several scatterers in a pixel, and scatterers in a sidelobe of the beams.

In addition to the response of a scatterer, two channels have one direction, that of its slope. All other contents of a
pixel - another scatterer of layover at any elevation, a slope, the extent of the ground - have power there, and three
real numbers of the covariance do not determine two elevations and two powers. Layover therefore cannot be resolved,
only detected.

Of the power along the slope one real dimension of K complex ones, that in phase with the scatterer, moves the
elevation; K - 1/2 are left. If phases are those of speckle, the variance is that of noise times the power along the
slope over that of noise (`spectra.misfit_factor`). A few looks hardly show it, so neighbouring pixels give the usual
power. Sigma includes both, but not that the mean of two surfaces is neither of them, which no look shows.

The responses of more than two detectors in sidelobes differ from those in the main lobe; of two, the ratio is the same.
An apparent scatterer between the boresights may be one in a sidelobe, brighter by as much as the sidelobe is weaker.
That is excluded if hardly a pixel of the dwell is half as bright.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache, partial

import numpy as np

from sal_height.beams import Beams
from sal_height.elevation.array.bounds import unit_vectors
from sal_height.elevation.array.estimate import ElevationEstimate, Validity
from sal_height.elevation.array.height_settings import HeightSettings
from sal_height.elevation.array.likelihood import SinglePeaks
from sal_height.elevation.layover.extended import free_looks
from sal_height.elevation.layover.order import NEIGHBOURS
from sal_height.elevation.layover.several import power_of
from sal_height.elevation.layover.single import PixelNoise
from sal_height.elevation.looks.looks import Looks
from sal_height.numeric import F64, U8


def in_two_channels(
    estimate: ElevationEstimate, peaks: SinglePeaks, looks: Looks, beams: Beams, settings: HeightSettings
) -> ElevationEstimate:
    """The estimate with a sigma that includes layover, and AMBIGUOUS where a sidelobe would give the same ratio.

    Args:
        estimate: estimate of single scatterers.
        peaks: these scatterers; NaN without an elevation. `beside` and `along_slope` are not used.
        looks: covariance of two channels, those of `beams` or their sum and difference.
        beams: beams of the two channels.
        settings: fraction of a pixel's power that may be left.
    """
    sigma = np.sqrt(estimate.sigma**2 + layover_variance(estimate.sigma, peaks, looks, beams, settings))
    return _without_sidelobes(estimate.with_sigma(sigma), peaks, looks, beams)


def layover_variance(sigma: F64, peaks: SinglePeaks, looks: Looks, beams: Beams, settings: HeightSettings) -> F64:
    """Variance of elevation from power along the slope, in addition to that of noise, sigma^2; rad^2, (rows, cols)."""
    known, count = looks.finite & np.isfinite(peaks.explained * peaks.turning), np.maximum(looks.count, 1.0)
    peaks = SinglePeaks(**{name: np.where(known, values, 1.0) for name, values in vars(peaks).items()})
    # Sidelobes have a small fraction of the power; main lobes of neighbours, in the floor next to shadow, are layover.
    highest = 1 + settings.misfit_fraction * peaks.explained / count
    noise = PixelNoise.of(peaks, replace(looks, floor=np.minimum(looks.floor, highest)), beams)
    usual, free = noise.raised * noise.along_slope, free_looks(count)
    along = left_by_one(looks) / usual
    # The power of the pixels around beyond noise, in one look, over their own power: the spread of elevations.
    turning = power_of(peaks.explained / noise.raised, count) * peaks.turning / noise.along_slope
    values = np.where(known, np.stack([along - free, free * turning, free]), 0.0)
    more, unit, variance = looks.columns.mean_of_neighbours(values, NEIGHBOURS)
    number = min(NEIGHBOURS, len(free)) * min(NEIGHBOURS, looks.columns.cols)
    # Less half a standard error, power is that of noise.
    sure = np.maximum(more - 0.5 * np.sqrt(np.maximum(variance, 0.0) / number), 0.0)
    spread = np.divide(sure, unit, where=unit > 0, out=np.zeros_like(unit))
    # Noise alone sometimes has much power: the pixel's own counts as far as the pixels around have more, too.
    around = spread * turning
    own = np.maximum(along / free - 1, 0.0) * around / (1 + around)
    return own * np.where(np.isfinite(sigma), sigma, 0.0) ** 2 + spread / (2 * count)


def left_by_one(looks: Looks) -> F64:
    """Power in two channels that one scatterer leaves at any elevation: the lesser eigenvalue, in noise powers.

    Channels of unlike noise are scaled to that of the first.
    """
    scale = np.sqrt(looks.receiver_noise / looks.noise_powers)
    covariance = looks.covariance[:, :] * np.outer(scale, scale)
    return np.linalg.eigvalsh(covariance.astype(np.result_type(covariance, np.float64)))[..., 0] / looks.receiver_noise


def _without_sidelobes(
    estimate: ElevationEstimate, peaks: SinglePeaks, looks: Looks, beams: Beams
) -> ElevationEstimate:
    """AMBIGUOUS where a scatterer in a sidelobe, no brighter than others in the dwell, would give the same ratio."""
    weaker = sidelobe_power(beams)
    if not weaker:
        return estimate
    middle = looks.columns.each(partial(beams.power, float(np.mean(beams.span))), looks.squint)
    seen = np.maximum(peaks.explained / looks.count - 1, 0.0)
    inside, beside = seen / peaks.array_power, seen / (weaker * middle)

    def marked(validity: U8, inside: F64, beside: F64) -> U8:
        usable = validity == Validity.OK
        if not usable.any():
            return validity
        # Twice as bright as all but 0.2 % of the pixels, which are single reflectors: sidelobes may receive from more
        # pixels than the main lobe, and the brightest of these count.
        brightest = 2.0 * np.quantile(inside[usable], 1 - 0.002, method="higher")
        return np.where(usable & (beside <= brightest), np.uint8(Validity.AMBIGUOUS), validity)

    return replace(estimate, validity=looks.columns.each(marked, estimate.validity, inside, beside))


@lru_cache(maxsize=8)
def sidelobe_power(beams: Beams) -> float:
    """Greatest |a|^2 of a scatterer outside two boresights whose response is that of one between, over the middle's.

    0 without such an elevation. Elevations outside the boresights, up to the first with another response, belong to
    the main lobe. Beams are distinguished by their identity.
    """
    (first, last), (lowest, highest) = beams.span, beams.known
    # Within ten distances of the boresights, or beamwidths if these are more.
    reach, step = 10.0 * max(last - first, beams.beamwidth), beams.beamwidth / 64
    inside = np.linspace(first, last, max(2, round((last - first) / step) + 1))
    units = unit_vectors(beams.response(inside, 0.0))
    greatest = 0.0
    for end, limit in ((first, max(lowest, first - reach)), (last, min(highest, last + reach))):
        outside = np.linspace(end, limit, max(2, round(abs(limit - end) / step) + 1))
        response = beams.response(outside, 0.0)
        explained = (np.abs(unit_vectors(response) @ units.conj().T) ** 2).max(axis=1)  # by one inside
        alike = explained >= 0.99
        alike &= np.maximum.accumulate(~alike)
        greatest = max(greatest, float(np.max(np.sum(np.abs(response) ** 2, axis=1), where=alike, initial=0.0)))
    return greatest / float(beams.power(np.mean(beams.span), 0.0))
