"""The noise of each channel over that of the others, where it has little else.

A scatterer is in the few channels whose beams see it. In all others of the pixel there is noise, and what is left of
them across the response of the scatterer has the same power in each; the gain of a channel is not in it. The median
over the pixels leaves out those with a second scatterer in the channel.
"""

from __future__ import annotations

import math

from sal_height.doubts import FitTest
from sal_height.elevation.fit.channel_gains import NOT_TESTED, two_tails
from sal_height.elevation.fit.statistics import FitStatistics
from sal_height.numeric import Index

CHANNEL_NOISE = "noise of channel"
"""Name of the tests."""

FEWEST_PIXELS = 40
"""Fewest pixels for the noise of a channel."""

LEAST_FRACTION = 0.75
"""Least fraction of the channels that must be tested."""

GREATEST_SPREAD = 1.5
"""Greatest standard deviation of the amplitudes over that of noise: it is 1.2 in noise, and 2 to 6 in a canopy."""

LEAST_AMPLITUDE = 0.25
"""Least amplitude of the noise of most channels, over the stated one, that the bins of the ratios resolve."""

OF_SCENE = 0.04
"""Standard deviation of the amplitude between scenes, where pixels have several scatterers."""

DB_OF_AMPLITUDE = 20 / math.log(10)
"""A relative error of 1 of an amplitude, if it were small, in dB."""


def channel_noise_tests(found: FitStatistics, channels: Index) -> list[FitTest]:
    """Test the noise of each of M channels against the median of all.

    It is NaN for a channel that has little else in too few pixels, or something that is not spread as noise, and for
    all if this is so in more than a quarter of them. No amplitude above HIGHEST is distinguished: 9.5 dB over the
    stated noise.

    Args:
        found: statistics of the dwell.
        channels: numbers of the channels in the sensor.

    Returns:
        Tests of the channels in their order: power of the noise, dB.
    """
    usable = [_is_like_noise(found, *measured) for measured in found.noises]
    ranked = sorted(amplitude for (amplitude, *_), one in zip(found.noises, usable, strict=True) if one)
    common = ranked[len(ranked) // 2] if len(ranked) >= LEAST_FRACTION * len(usable) else 0.0
    times, sizes = math.sqrt(found.repeated), []
    for (amplitude, sigma, _), one in zip(found.noises, usable, strict=True):
        if not one or common < LEAST_AMPLITUDE:
            sizes.append(NOT_TESTED)
            continue
        error = DB_OF_AMPLITUDE * math.hypot(times * sigma / amplitude, OF_SCENE)
        sizes.append((20 * math.log10(amplitude / common), error))
    statistics = [abs(size) / error for size, error in sizes]
    tails = two_tails(statistics, [number for *_, number in found.noises])
    return [
        FitTest(CHANNEL_NOISE, channel, statistic, tail, *size, "dB")
        for channel, statistic, tail, size in zip(channels.tolist(), statistics, tails, sizes, strict=True)
    ]


def _is_like_noise(found: FitStatistics, amplitude: float, sigma: float, number: float) -> bool:
    """True if the amplitudes in a channel are enough, and spread as those of noise, not as those of scatterers."""
    if number < FEWEST_PIXELS or amplitude <= 0:
        return False
    spread, of_noise = math.sqrt(2 / math.pi * number) * sigma, 0.5 * amplitude / math.sqrt(found.least_looks)
    return spread <= GREATEST_SPREAD * of_noise
