"""The power of the noise over the stated one, from what single scatterers leave unexplained.

The power L that a scatterer leaves of a pixel is noise, with a gamma distribution of known order. More scatterers would
leave more, and an unknown level cannot be told from them by L alone; but they concentrate it in one direction. Noise of
any level does not: the part of L that the best direction explains has no unit, and it is independent of L (Basu,
Sankhya 15, 1955). So pixels whose best direction explains no more than it usually does in noise are selected, and the
median of L over its expected median, taken over these, is the level. (Noise level from eigenvalues: Kritchman and
Nadler, IEEE Trans. Signal Processing 57, 2009, for covariances of more looks than channels.)
"""

from __future__ import annotations

import math

from scipy.special import ndtr

from sal_height.doubts import FitTest
from sal_height.elevation.fit.statistics import BLOCKS, FitStatistics

NOISE_LEVEL, NOISE_OVER_RANGE = "noise level", "noise over range"
"""Names of the tests."""

FEWEST_CHANNELS = 3
"""Fewest channels whose noise level can be told from several scatterers: two of these explain all of two channels."""

LEAST_FRACTION = 0.2
"""Least fraction of the pixels that must have one scatterer.

In noise it is .6 with 16 channels and .26 with 3. Where range cells spread over elevation far above the noise, as level
ground does at 40 dB, and in a canopy, it is next to 0, and the level of those that are left has an error of 1 dB.
"""

OF_SCENE = 0.4
"""Standard deviation of the level between scenes and CNRs, times the number of channels.

The fewer channels, the more of the noise do scatterers that are not found, and the search, add or take. In the scenes
of `benchmarks.goodness_of_fit` at 3 to 30 dB levels are -.45 to .5 dB with 16 channels, and -1 to .65 dB with 6.
"""

DB = 10 / math.log(10)
"""A relative error of 1, if it were small, in dB."""


def level_test(found: FitStatistics) -> FitTest:
    """Test the noise of a dwell against the stated one: its level in dB; NaN where too few pixels have one scatterer.

    The search for the scatterer takes noise where it has nothing else: in shadow, and beyond the array, the level is
    found too low, by up to 1 dB with six channels and by 2.4 dB with three.
    """
    level, number = found.levels[-1]
    if number < max(1, LEAST_FRACTION * found.pixels):
        return FitTest(NOISE_LEVEL, unit="dB")
    return _test(NOISE_LEVEL, level, _deviation(found, number), 1)


def range_test(found: FitStatistics) -> FitTest:
    """Test the noise of blocks of ranges against that of the dwell: the level farthest from it, in dB.

    NaN if less than two blocks have enough pixels with one scatterer.
    """
    *blocks, (level, _) = found.levels
    known = [
        (one / level, number) for one, number in blocks if number >= max(1, LEAST_FRACTION * found.pixels / BLOCKS)
    ]
    if len(known) < 2:
        return FitTest(NOISE_OVER_RANGE, unit="dB")
    farthest, number = max(known, key=lambda one: abs(math.log(one[0])))
    return _test(NOISE_OVER_RANGE, farthest, _deviation(found, number), len(known))


def _deviation(found: FitStatistics, number: float) -> float:
    """Relative standard deviation of the median level of a number of pixels, by noise and by the scene."""
    channels = found.beams.count
    degrees = (channels - 1) * found.least_looks - 0.5
    return math.hypot(math.sqrt(math.pi / 2 * found.repeated / (number * degrees)), OF_SCENE / channels)


def _test(name: str, level: float, sigma: float, searched: int) -> FitTest:
    """The test of a level with a relative standard deviation, the one farthest from 1 of a number of them."""
    size = DB * math.log(level)
    statistic = abs(size) / (DB * sigma)
    p_value = min(1.0, searched * 2 * float(ndtr(-statistic)))
    return FitTest(name, statistic=statistic, p_value=p_value, size=size, sigma=DB * sigma, unit="dB")
