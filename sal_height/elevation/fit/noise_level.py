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
from functools import lru_cache

import numpy as np

from sal_height.beams import Beams
from sal_height.doubts import ALL_CHANNELS, FitTest
from sal_height.elevation.array.estimate import Residue
from sal_height.elevation.array.search import SQUINT_STEP
from sal_height.elevation.fit._fit_kernels import levels_of_noise
from sal_height.elevation.layover.order import detection_threshold, path_length
from sal_height.elevation.looks.looks import Looks
from sal_height.numeric import F64

NOISE_LEVEL = "noise level"
"""Name of the test."""

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


def noise_test(residue: Residue, looks: Looks, beams: Beams, repeated: float) -> FitTest:
    """Test the noise of a dwell against the stated one: its level in dB; NaN where too few pixels have one scatterer.

    The search for the scatterer takes noise where it has nothing else: in shadow, and beyond the array, the level is
    found too low, by up to 1 dB with six channels and by 2.4 dB with three.

    Args:
        residue: fit of a single scatterer to each pixel.
        looks: covariance of M channels of equal noise in each pixel.
        beams: beams of the M detectors.
        repeated: number of pixels in which each look is.
    """
    power, levels = looks.power.ravel() / looks.receiver_noise, np.empty(looks.power.size)
    few, many = float(looks.count.min()), float(looks.count.max())
    usual = _usually_beside(beams, float(exact_squint(looks.squint[:1], beams)[0]), few, many)
    pixels = residue.explained.ravel(), residue.beside.ravel(), looks.count.ravel(), looks.finite.ravel()
    number = levels_of_noise(power, *pixels, beams.count, beams.count * beams.uncertainty**2, usual, levels)
    if number < max(1, LEAST_FRACTION * np.count_nonzero(looks.finite)):
        return FitTest(NOISE_LEVEL, unit="dB")
    levels = levels[:number]
    levels.partition(number // 2)
    degrees = (beams.count - 1) * few - 0.5
    of_noise = math.sqrt(np.pi / 2 * repeated / (number * degrees))
    size, sigma = DB * math.log(levels[number // 2]), DB * math.hypot(of_noise, OF_SCENE / beams.count)
    statistic = abs(size) / sigma
    return FitTest(NOISE_LEVEL, ALL_CHANNELS, statistic, math.erfc(statistic / math.sqrt(2)), size, sigma, "dB")


@lru_cache(maxsize=64)
def _usually_beside(beams: Beams, squint: float, few: float, many: float) -> tuple[float, float]:
    """Power that one more scatterer explains in half of the pixels of noise, as a line over the number of looks.

    Args:
        beams: beams of the channels, distinguished by their identity.
        squint: squint of a column, rad.
        few: least number of looks.
        many: greatest number of looks.
    """
    length = path_length(beams, squint)
    least, most = (detection_threshold(length, looks, 0.5) for looks in (few, many))
    slope = (most - least) / (many - few) if many > few else 0.0
    return least - slope * few, slope


def exact_squint(squint: F64, beams: Beams) -> F64:
    """Squints nearest to these (rad) for which responses are computed from the beams' patterns; same shape."""
    step = SQUINT_STEP * beams.track_beamwidth
    found: F64 = np.rint(squint / step) * step
    return found
