"""The gain of each channel, from its part of the scatterers that the other channels see.

A channel that receives noise only has the power of noise, as assumed; what it misses is what it should have in common
with the others. The amplitudes of the looks follow from all channels but one; the ratio of that channel to what they
predict is its gain (as leave-one-out residuals of a regression: Cook and Weisberg, Residuals and Influence in
Regression, 1982). The median over the pixels leaves out those with several scatterers.

The gain that all channels share is that of the scatterers. With Gaussian beams a linear and a quadratic course of the
logarithm of the gain over the channels are a shift and another width of the beams, and show less.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from scipy.special import stdtr

from sal_height.beams import Beams
from sal_height.doubts import FitTest
from sal_height.elevation.array.estimate import Residue
from sal_height.elevation.array.likelihood import OBJECTIVES, search_guard
from sal_height.elevation.array.search import PeakSearch, PeakSearches
from sal_height.elevation.fit._fit_kernels import BINS, gather_gains, median_gains
from sal_height.elevation.fit.noise_level import exact_squint
from sal_height.elevation.looks.looks import Covariance, Looks
from sal_height.numeric import F64, Index

CHANNEL_GAIN = "channel gain"
"""Name of the test."""

FEWEST_CHANNELS = 6
"""Fewest channels whose gains are tested: with few, another elevation is nearly as good an explanation."""

MOST_PIXELS = 288
"""Most pixels that gains are measured in, half of those of a dwell of preset sal_spotlight: all would take too long."""

FEWEST_PIXELS = 30
"""Fewest pixels for the gain of a channel."""

LEAST_PART, LEAST_CNR = 0.05, 1.0
"""Least part that a channel should have of a scatterer's power, and least power in the others over a look's noise."""

OF_SCENE = 0.03
"""Standard deviation of a gain between scenes, where pixels have several scatterers."""


def gain_tests(residue: Residue, looks: Looks, beams: Beams, channels: Index, repeated: float) -> list[FitTest]:
    """Test the gain of each of M channels against the median of all; NaN for one that too few pixels should be in.

    Args:
        residue: fit of a single scatterer to each pixel.
        looks: covariance of M channels of equal noise in each pixel.
        beams: beams of the M detectors.
        channels: numbers of the channels in the sensor.
        repeated: number of pixels in which each look is.

    Returns:
        Tests of the channels in their order: gain of the amplitude, ratio.
    """
    gain, sigma, number = measured_gains(residue, looks, beams)
    enough = number >= FEWEST_PIXELS
    ranked = np.sort(gain[enough])
    common = ranked[len(ranked) // 2] if len(ranked) else 0.0
    if not common > 0:
        return [FitTest(CHANNEL_GAIN, channel) for channel in channels.tolist()]
    # Where a channel counts it has a half of its full response on average.
    beyond_noise = math.hypot(OF_SCENE, 2 * beams.uncertainty)
    size, error = gain / common, np.hypot(math.sqrt(repeated) / common * sigma, beyond_noise)
    size[~enough] = error[~enough] = np.nan
    statistic = np.abs(size - 1) / error
    # A variance by the quartiles of N normal deviates is as uncertain as that of .37 N of them: Student's distribution.
    p_value = 2 * stdtr(np.maximum(0.37 * number, 1.0), -statistic)
    columns = (values.tolist() for values in (channels, statistic, p_value, size, error))
    return [FitTest(CHANNEL_GAIN, m, z, p, ratio, sd, "1") for m, z, p, ratio, sd in zip(*columns, strict=True)]


def measured_gains(residue: Residue, looks: Looks, beams: Beams) -> F64:
    """Gain of each of M channels, its standard deviation, and the number of pixels, (3, M); arguments as above.

    Responses are those at the nearest squint for which they are exact, which is the same in most dwells.
    """
    first, last = beams.span
    pixels = np.flatnonzero((residue.elevation >= first) & (residue.elevation <= last) & looks.finite)
    if len(pixels) > MOST_PIXELS:
        pixels = pixels[np.arange(MOST_PIXELS) * len(pixels) // MOST_PIXELS]
    search = _search(beams, tuple(exact_squint(looks.squint, beams).tolist()))
    matrices, numbers = _covariances(looks, pixels, is_complex=search.tables.complex_beams)
    weights, sums, found = np.zeros((beams.count, BINS)), np.zeros((2, beams.count)), np.empty((3, beams.count))
    gather_gains(
        matrices,
        numbers,
        search.squints[pixels % len(looks.squint)],
        search.position(residue.elevation.ravel()[pixels]),
        search.tables.unit_pieces,
        looks.receiver_noise * residue.explained.ravel()[pixels],
        looks.receiver_noise * looks.count.ravel()[pixels],
        (LEAST_PART, LEAST_CNR),
        weights,
        sums,
    )
    median_gains(weights, sums, found)
    return found


@lru_cache(maxsize=16)
def _search(beams: Beams, squint: tuple[float, ...]) -> PeakSearch:
    """The search of a column at each of the squints (rad); beams are distinguished by their identity."""
    return PeakSearches.over(beams, OBJECTIVES["normalised"], search_guard(beams)).at(np.array(squint))


def _covariances(looks: Looks, pixels: Index, *, is_complex: bool) -> tuple[Covariance, Index]:
    """Covariances of an image, or of some of its pixels, and the numbers of these among them."""
    whole, (cols, channels) = looks.covariance, looks.covariance.shape[1:3]
    if isinstance(whole, np.ndarray) and np.iscomplexobj(whole) == is_complex:
        return whole.reshape(-1, channels, channels), pixels
    some = whole[pixels // cols, pixels % cols]
    return (some if is_complex else np.ascontiguousarray(some.real)), np.arange(len(pixels))
