"""Goodness of fit of a dwell: tests of its data, and doubts where they contradict the description of the sensor."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sal_height.beams import Beams
from sal_height.doubts import Doubt, FitTest
from sal_height.elevation import HeightSettings, Looks, Residue
from sal_height.elevation.fit import channel_gains, noise_level
from sal_height.numeric import Index
from sal_height.sensor import Sensor

SIGNIFICANCE = 1e-4
"""Probability that any of the tests of a dwell that fits is significant."""

LOUDER_DB, QUIETER_DB = 0.6, -3.0
"""Noise levels beyond which heights are in doubt.

Below the first, less than .2 % of the heights are beyond 5 sigma. The search takes up to 2.4 dB from the noise of three
channels where it finds nothing else.
"""

GREATEST_GAIN = 10 ** (1.5 / 20)
"""Gain of a channel, or its inverse, beyond which heights are in doubt: 1.5 dB."""

NOISE_ONLY = 0.35
"""Gain below which a channel receives next to nothing."""


@dataclass(frozen=True)
class DwellFit:
    """Goodness of fit of a dwell.

    Attributes:
        tests: tests of the data.
        doubts: those that are significant and large.
    """

    tests: tuple[FitTest, ...] = ()
    doubts: tuple[Doubt, ...] = ()


def fit_of(
    residue: Residue | None, looks: Looks, beams: Beams, channels: Index, sensor: Sensor, settings: HeightSettings
) -> DwellFit:
    """Tests of the noise level and of the gain of each channel, and doubts.

    Gains are not tested where channels are mixtures of detectors. Each test has its FEWEST_CHANNELS.

    Args:
        residue: fit of a single scatterer to each pixel; None: there is none.
        looks: covariance of M channels in each pixel.
        beams: beams of the channels.
        channels: number of each of them in the sensor.
        sensor: sensor of the dwell.
        settings: settings of the looks.
    """
    if residue is None or beams.count < noise_level.FEWEST_CHANNELS:
        return DwellFit()
    repeated = math.prod(max(1.0, len(window.weights) / window.step) for window in settings.windows)
    level = noise_level.noise_test(residue, looks, beams, repeated)
    gains: list[FitTest] = []
    if beams.count >= channel_gains.FEWEST_CHANNELS and not sensor.is_mixed:
        gains = channel_gains.gain_tests(residue, looks, beams, channels, repeated)
    limit = SIGNIFICANCE / (1 + len(gains))
    # What wrong gains leave of strong scatterers looks like noise.
    doubts = tuple(_of_gains(gains, limit)) or tuple(_of_noise(level, sensor, limit))
    return DwellFit((level, *gains), doubts)


def _of_noise(test: FitTest, sensor: Sensor, limit: float) -> Iterator[Doubt]:
    """The doubt about the noise level, if it is significant and large."""
    if not (test.p_value < limit and not QUIETER_DB <= test.size <= LOUDER_DB):
        return
    stated = float(np.mean(sensor.noise_power))
    found = stated * 10 ** (test.size / 10)
    side, heights = ("above", "too small") if test.size > 0 else ("below", "too great")
    sentence = (
        f"The noise of the images is {abs(test.size):.1f} dB {side} the stated one: that of the samples is {found:.3g} "
        f"and the description of the sensor states {stated:.3g} (noise_power, mean of the channels). The sigma of the "
        f"heights is {heights}; state a noise_power of {found:.3g}, or find what else is in the channels."
    )
    yield Doubt(test.name, sentence, test.channel, test.size, test.unit, test.p_value)


def _of_gains(tests: list[FitTest], limit: float) -> Iterator[Doubt]:
    """The doubts about gains that are significant and large: of every channel without signal; else one of the worst."""
    off = [one for one in tests if one.p_value < limit and not 1 / GREATEST_GAIN <= one.size <= GREATEST_GAIN]
    silent = [one for one in off if one.size < NOISE_ONLY]
    for one in silent:
        sentence = (
            f"Channel {one.channel} has {one.size:.2f} +- {one.sigma:.2f} of the amplitude that the other channels "
            "predict: it receives next to nothing but noise. Heights near its beam are wrong; repair it, or make its "
            "samples 0, so that it is left out."
        )
        yield Doubt(one.name, sentence, one.channel, one.size, one.unit, one.p_value)
    if off and not silent:  # without a channel, its neighbours are not predicted well
        worst = max(off, key=lambda one: abs(np.log(max(one.size, 1e-3))))
        decibels = 20 * np.log10(worst.size)
        others = f" So do {len(off) - 1} others, less." if len(off) > 1 else ""
        sentence = (
            f"Channel {worst.channel} has {worst.size:.2f} +- {worst.sigma:.2f} of the amplitude that the others "
            f"predict ({decibels:+.1f} dB); the description states the same gain for all.{others} "
            "Heights are biased; measure the gains (sal-height calibrate), or check the beams of the description."
        )
        yield Doubt(worst.name, sentence, worst.channel, worst.size, worst.unit, worst.p_value)
