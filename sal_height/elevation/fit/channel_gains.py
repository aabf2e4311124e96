"""The gain of each channel and the width of the beams, from what scatterers in the array have in the channels.

A channel that receives noise only has the power of noise, as assumed; what it misses is what it should have in common
with the others. The amplitudes of the looks follow from all channels but one; the ratio of that channel to what they
predict is its gain (as leave-one-out residuals of a regression: Cook and Weisberg, Residuals and Influence in
Regression, 1982). The median over the pixels leaves out those with several scatterers.

The gain that all channels share is that of the scatterers. With Gaussian beams a linear and a quadratic course of the
logarithm of the gain over the channels are a shift and another width of the beams, and show less.

Beams that are wider than described, and beams that are closer to each other, change the response of a scatterer alike:
only the width over the distance is known from the data, as the stretch of the beams. Both together by the same factor
are another elevation, in proportion to the angle from the middle of the array, and do not show at all.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import chdtrc, ndtri, stdtr

from sal_height.doubts import ALL_CHANNELS, FitTest
from sal_height.elevation.fit._fit_kernels import MAGNIFIED
from sal_height.elevation.fit.statistics import FitStatistics
from sal_height.numeric import Index

CHANNEL_GAIN, BEAM_STRETCH = "channel gain", "beam stretch"
"""Names of the tests."""

FEWEST_CHANNELS = 6
"""Fewest channels whose gains are tested: with few, another elevation is nearly as good an explanation."""

FEWEST_PIXELS = 27
"""Fewest pixels for the gain of a channel."""

OF_SCENE = 0.03
"""Standard deviation of a gain between scenes, where pixels have several scatterers."""

NOT_TESTED = (math.nan, math.nan)
"""Size and standard deviation of what was not tested."""

STRETCH_OF_SCENE = 0.002
"""Standard deviation of the stretch between scenes."""


def gain_tests(found: FitStatistics, channels: Index) -> list[FitTest]:
    """Test the gain of each of M channels against the median of all; NaN for one that too few pixels should be in.

    Args:
        found: statistics of the dwell.
        channels: numbers of the channels in the sensor.

    Returns:
        Tests of the channels in their order: gain of the amplitude, ratio.
    """
    measured = found.gains
    ranked = sorted(gain for gain, _, number in measured if number >= FEWEST_PIXELS)
    common = ranked[len(ranked) // 2] if ranked else 0.0
    # Where a channel counts it has a half of its full response on average.
    beyond_noise, times = math.hypot(OF_SCENE, 2 * found.beams.uncertainty), math.sqrt(found.repeated)
    sizes = []
    for gain, sigma, number in measured:
        known = common > 0 and number >= FEWEST_PIXELS
        sizes.append((gain / common, math.hypot(times * sigma / common, beyond_noise)) if known else NOT_TESTED)
    statistics = [abs(size - 1) / error for size, error in sizes]
    tails = two_tails(statistics, [number for *_, number in measured])
    return [
        FitTest(CHANNEL_GAIN, channel, statistic, tail, *size, "1")
        for channel, statistic, tail, size in zip(channels.tolist(), statistics, tails, sizes, strict=True)
    ]


def common_gain_test(tests: Sequence[FitTest]) -> FitTest:
    """Test the gains of all channels together, which finds smaller errors than one by one; NaN if few were tested.

    The chi-squared test of the normal deviates that are as improbable as the gains.

    Args:
        tests: tests of a dwell, those of the channels among them.

    Returns:
        Test whose size is the rms departure of the gains from 1, ratio.
    """
    of_channels = [test for test in tests if test.name == CHANNEL_GAIN]
    known = [test for test in of_channels if math.isfinite(test.p_value)]
    if 2 * len(known) <= len(of_channels):
        return FitTest(CHANNEL_GAIN, unit="1")
    statistic = sum(float(ndtri(max(test.p_value, 1e-300) / 2)) ** 2 for test in known)
    size = math.sqrt(sum((test.size - 1) ** 2 for test in known) / len(known))
    sigma = math.sqrt(sum(test.sigma**2 for test in known) / len(known))
    return FitTest(CHANNEL_GAIN, ALL_CHANNELS, statistic, float(chdtrc(len(known), statistic)), size, sigma, "1")


def stretch_test(found: FitStatistics) -> FitTest:
    """Test the width of the beams over the distance between them against the described one: its ratio less 1."""
    beams = found.beams
    ratio, sigma, number = found.stretch
    if number < FEWEST_PIXELS:
        return FitTest(BEAM_STRETCH, unit="1")
    size, of_noise = (ratio - 1) / MAGNIFIED, math.sqrt(found.repeated) * sigma / MAGNIFIED
    error = math.hypot(of_noise, STRETCH_OF_SCENE, beams.pitch_uncertainty, 2 * beams.uncertainty)
    statistic = abs(size) / error
    (tail,) = two_tails([statistic], [number])
    return FitTest(BEAM_STRETCH, ALL_CHANNELS, statistic, tail, size, error, "1")


def two_tails(statistics: Sequence[float], pixels: Sequence[float]) -> list[float]:
    """Probabilities of these statistics, or of larger ones, on either side, of medians over numbers of pixels.

    A variance by the quartiles of N normal deviates is as uncertain as that of .37 N of them: Student's distribution.
    """
    tails: list[float] = (2 * stdtr(0.37 * np.array(pixels), -np.array(statistics))).tolist()
    return tails
