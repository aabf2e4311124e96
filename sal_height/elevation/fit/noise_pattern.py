"""Noise that channels have in common, from what single scatterers leave unexplained.

Independent noise of equal power is alike in all directions of the channels, and so is what a scatterer leaves of it,
across its response. A pattern in it is measured by its score (Rao, Proc. Cambridge Phil. Soc. 44, 1948) in pixels with
one scatterer, over the power that is left in the same pixel: neither bright scatterers nor another power of the noise
are a pattern. Pixels whose rest is concentrated are left out, and with them some of the pattern: without one, scores
are a little negative.

Strong interference leaves no pixel with one scatterer. It is found by all pixels together, if more of their rest is
alike in all channels than any two scatterers in the array would leave.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from scipy.special import ndtr

from sal_height.beams import Beams
from sal_height.doubts import FitTest
from sal_height.elevation.array.bounds import unit_vectors
from sal_height.elevation.fit._fit_kernels import ALIKE, NEIGHBOURS
from sal_height.elevation.fit.statistics import FitStatistics

INTERFERENCE, CORRELATED_NOISE = "interference", "correlated noise"
"""Names of the tests."""

FEWEST_CHANNELS = 8
"""Fewest channels whose patterns are tested: of fewer, a scatterer may have most of a wave alike in all of them."""

LEAST_FRACTION = 0.05
"""Least fraction of the pixels that must have one scatterer for the correlation of neighbours."""

ALIKE_IN_NOISE, NEIGHBOURS_IN_NOISE = -1.7, -0.8
"""Mean scores over their variances where the noise is independent, times the number of channels."""

ALIKE_OF_SCENE, NEIGHBOURS_OF_SCENE = 1.6, 0.4
"""Their standard deviations between scenes and CNRs of `benchmarks.goodness_of_fit`, times the number of channels."""


def interference_test(found: FitStatistics) -> FitTest:
    """Test for a wave alike in all of M channels: its power in a channel over that of the noise, ratio."""
    channels = found.beams.count
    of_several, of_single = (scores[ALIKE] for scores in found.scores)
    of_all = [a + b for a, b in zip(of_several, of_single, strict=True)]
    tries = []
    for (score, variance), mean, scene in (
        (of_single, ALIKE_IN_NOISE / channels, ALIKE_OF_SCENE / channels),
        (of_all, _greatest_of_scatterers(found.beams), 0.0),
    ):
        if variance > 0:
            excess = score / variance
            # With a wave its own power varies, too.
            of_noise = max(1.0, 1 + excess) * math.sqrt(found.repeated / variance)
            tries.append(((excess - mean) / math.hypot(of_noise, scene), excess, math.hypot(of_noise, scene)))
    if not tries:
        return FitTest(INTERFERENCE, unit="1")
    statistic, excess, sigma = max(tries)
    p_value = min(1.0, 2 * float(ndtr(-statistic)))
    # A part 1 + e of what is left is in one of M - 1 directions, over noise in the others.
    part = min(max(1 + excess, 0.0), channels - 2.0)
    power = (part * (channels - 2) / (channels - 1 - part) - 1) / channels
    return FitTest(INTERFERENCE, statistic=statistic, p_value=p_value, size=power, sigma=sigma / channels, unit="1")


def correlation_test(found: FitStatistics) -> FitTest:
    """Test the correlation of the noise of neighbouring channels against 0; NaN if few pixels have one scatterer."""
    channels = found.beams.count
    score, variance = found.scores[1][NEIGHBOURS]
    if variance == 0 or found.levels[-1][1] < LEAST_FRACTION * found.pixels:
        return FitTest(CORRELATED_NOISE, unit="1")
    size = score / variance - NEIGHBOURS_IN_NOISE / channels
    sigma = math.hypot(math.sqrt(found.repeated / variance), NEIGHBOURS_OF_SCENE / channels)
    statistic = abs(size) / sigma
    p_value = 2 * float(ndtr(-statistic))
    return FitTest(CORRELATED_NOISE, statistic=statistic, p_value=p_value, size=size, sigma=sigma, unit="1")


@lru_cache(maxsize=16)
def _greatest_of_scatterers(beams: Beams) -> float:
    """Greatest score over its variance that two scatterers in the array can have; beams by their identity.

    A scatterer with the unit response v leaves of another one, u, the vector v - u u^H v. Its part along what u leaves
    of a wave alike in all channels is looked for over both.
    """
    units = unit_vectors(beams.response(np.linspace(*beams.span, 16 * beams.count), 0.0))
    alike = units.conj() @ np.full(beams.count, 1 / math.sqrt(beams.count))
    overlap = units.conj() @ units.T
    shared = np.abs(alike.conj()[None, :] - alike.conj()[:, None] * overlap) ** 2
    left = (1 - np.abs(overlap) ** 2) * (1 - np.abs(alike[:, None]) ** 2)
    fraction = np.divide(shared, left, out=np.zeros_like(left), where=left > 1e-3)
    return (beams.count - 1) * float(fraction.max()) - 1
