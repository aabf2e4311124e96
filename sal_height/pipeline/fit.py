"""Goodness of fit of a dwell: tests of its data, and doubts where they contradict the description of the sensor."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from sal_height.beams import Beams
from sal_height.calibration import Calibration
from sal_height.doubts import Doubt, FitTest
from sal_height.elevation import HeightSettings, Looks, Residue, Window
from sal_height.elevation.fit import channel_gains, channel_noise, noise_level, noise_pattern
from sal_height.elevation.fit.channel_gains import BEAM_STRETCH, CHANNEL_GAIN
from sal_height.elevation.fit.channel_noise import CHANNEL_NOISE
from sal_height.elevation.fit.noise_level import NOISE_LEVEL, NOISE_OVER_RANGE
from sal_height.elevation.fit.noise_pattern import CORRELATED_NOISE, INTERFERENCE
from sal_height.elevation.fit.statistics import FitStatistics
from sal_height.imaging import Slc
from sal_height.numeric import Index
from sal_height.sensor import Sensor

SIGNIFICANCE = 1e-4
"""Probability that any of the tests of a dwell that fits is significant."""

NOISE_ONLY = 0.35
"""Gain below which a channel receives next to nothing."""

GREATEST_GAIN = 10 ** (1.5 / 20)
"""Gain of a channel, or its inverse, beyond which heights are in doubt: 1.5 dB."""

HARMLESS: Mapping[str, tuple[float, float]] = {
    INTERFERENCE: (-math.inf, 0.04),
    CHANNEL_NOISE: (-math.inf, 2.0),
    CHANNEL_GAIN: (1 / GREATEST_GAIN, GREATEST_GAIN),
    BEAM_STRETCH: (-0.007, 0.007),
    CORRELATED_NOISE: (-0.1, 0.1),
    NOISE_LEVEL: (-3.0, 0.6),
    NOISE_OVER_RANGE: (-1.0, 1.0),
}
"""Sizes from the least to the greatest that leave the heights good, in the unit of each test.

Below a noise level of .6 dB, and noise of a channel of 2 dB, less than .2 % of the heights are beyond 5 sigma. The
search takes up to 2.4 dB from the noise of three channels where it finds nothing else.
"""

EXPLANATIONS = (
    (INTERFERENCE,),
    (CHANNEL_NOISE,),
    (CHANNEL_GAIN,),
    (BEAM_STRETCH,),
    (CORRELATED_NOISE,),
    (NOISE_LEVEL, NOISE_OVER_RANGE),
)
"""Tests that may explain a dwell, the first that does first: what is wrong in one way looks wrong in others.

Interference has any gain, noise of one channel looks like scatterers in its beam, of which its neighbours have too
little, what wrong gains and beams leave of strong scatterers looks like noise, and noise that channels have in common
looks like less noise of each.
"""


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
    residue: Residue | None,
    looks: Looks,
    beams: Beams,
    channels: Index,
    sensor: Sensor,
    settings: HeightSettings,
    calibration: Calibration | None = None,
) -> DwellFit:
    """Tests of a dwell against the description of its sensor, and doubts.

    Channels that are mixtures of detectors are tested for their noise level only. Each test has its FEWEST_CHANNELS.

    Args:
        residue: fit of a single scatterer to each pixel; None: there is none.
        looks: covariance of M channels in each pixel.
        beams: beams of the channels.
        channels: number of each of them in the sensor.
        sensor: sensor of the dwell.
        settings: settings of the looks.
        calibration: calibration of the images, which doubts about gains and beams name; None: none.
    """
    if residue is None or beams.count < noise_level.FEWEST_CHANNELS:
        return DwellFit()
    down, across = (settings.range_looks, settings.range_step), (settings.azimuth_looks, settings.azimuth_step)
    repeated = _repeated(settings.look_window, *down) * _repeated(settings.look_window, *across)
    found = FitStatistics.of(residue, looks, beams, repeated)
    tests = [noise_level.level_test(found)]
    if beams.count >= channel_gains.FEWEST_CHANNELS and not sensor.is_mixed:
        tests += channel_gains.gain_tests(found, channels)
    if beams.count >= noise_pattern.FEWEST_CHANNELS and not sensor.is_mixed:
        tests.append(noise_level.range_test(found))
        tests.append(noise_pattern.interference_test(found))
        tests.append(noise_pattern.correlation_test(found))
        if not sensor.detector_rotation:
            tests.append(channel_gains.stretch_test(found))
        tests += channel_noise.channel_noise_tests(found, channels)
    significant = [test for test in tests if _is_significant(test, tests)]
    return DwellFit(tuple(tests), _doubts(significant, sensor, calibration) if significant else ())


def with_measured_channel_noise(slc: Slc, tests: Sequence[FitTest]) -> Slc | None:
    """Images with the noise power of single channels by the tests of a dwell; None: all are as stated."""
    power = np.array(slc.noise_power, dtype=float)
    off = [test for test in tests if test.name == CHANNEL_NOISE and _is_significant(test, tests)]
    for test in off:
        power[test.channel] *= 10 ** (test.size / 10)
    return replace(slc, noise_power=power) if off else None


def without_silent(slc: Slc, tests: Sequence[FitTest]) -> Slc | None:
    """Images in which channels of noise alone, by the tests of a dwell, are dead and left out; None: there are none."""
    silent = [test.channel for test in _significant_gains(tests) if test.size < NOISE_ONLY]
    if not silent:
        return None
    images = slc.images.copy()
    images[silent] = 0
    return replace(slc, images=images)


def with_measured_gains(slc: Slc, tests: Sequence[FitTest]) -> Slc | None:
    """Images of equal gain by the tests of a dwell; None: no gain is significant. The mean gain of all is not known.

    Gains that would be those of noise alone remain as they are.
    """
    if not _significant_gains(tests):
        return None
    gain = np.ones(len(slc.images), np.float32)
    for test in tests:
        if test.name == CHANNEL_GAIN and test.size >= NOISE_ONLY:
            gain[test.channel] = test.size
    return replace(slc, images=slc.images / gain[:, None, None], noise_power=slc.noise_power / gain.astype(float) ** 2)


def gain_left(tests: Sequence[FitTest]) -> float:
    """Standard deviation of the gains that are left where they were measured on a dwell: half of what was measured.

    Each gain is measured by channels whose own gains are wrong, and its course over the array, as that of another width
    or pointing of the beams, does not show. With a half, errors of the heights are .8 to 1.1 sigma rms (level ground,
    16 channels, gains 2 dB rms at 10 to 30 dB and 1 dB rms at 30 dB); without it they are up to 2.5.
    """
    departures = [test.size - 1 for test in tests if test.name == CHANNEL_GAIN and test.size >= NOISE_ONLY]
    return 0.5 * math.sqrt(sum(one**2 for one in departures) / max(1, len(departures)))


def _significant_gains(tests: Sequence[FitTest]) -> list[FitTest]:
    """Tests of gains that are significant."""
    return [test for test in tests if test.name == CHANNEL_GAIN and _is_significant(test, tests)]


def with_measured_noise(slc: Slc, tests: Sequence[FitTest]) -> Slc | None:
    """Images with the noise power of the tests of a dwell; None: it is as stated."""
    for test in tests:
        if test.name == NOISE_LEVEL and _is_significant(test, tests):
            return replace(slc, noise_power=10 ** (test.size / 10) * slc.noise_power)
    return None


def _is_significant(test: FitTest, tests: Sequence[FitTest]) -> bool:
    return test.p_value < SIGNIFICANCE / len(tests)


@lru_cache(maxsize=16)
def _repeated(window: str, looks: int, step: int) -> float:
    """Number of pixels along an axis in which each look is."""
    named = Window.named(window, looks, step)
    return max(1.0, len(named.weights) / named.step)


def _doubts(tests: list[FitTest], sensor: Sensor, calibration: Calibration | None) -> tuple[Doubt, ...]:
    """The first explanation of the significant tests that is large."""
    for names in EXPLANATIONS:
        large = [test for test in tests if test.name in names and not _is_harmless(test)]
        if not large:
            continue
        doubts = (
            _of_gains(large) if CHANNEL_GAIN in names else [_doubt(test, _sentence(test, sensor)) for test in large]
        )
        if calibration and large[0].name in {CHANNEL_GAIN, BEAM_STRETCH}:
            reason = (
                f" The images have calibration {calibration.id}, which may be of another instrument or another day: "
                "calibrate the sensor again, or leave the calibration out."
            )
            doubts = [doubt._replace(sentence=doubt.sentence + reason) for doubt in doubts]
        return tuple(doubts)
    return ()


def _is_harmless(test: FitTest) -> bool:
    least, greatest = HARMLESS[test.name]
    return least <= test.size <= greatest


def _doubt(test: FitTest, sentence: str) -> Doubt:
    return Doubt(test.name, sentence, test.channel, test.size, test.unit, test.p_value)


def _sentence(test: FitTest, sensor: Sensor) -> str:
    """Warning about a dwell as a whole."""
    size, sigma = test.size, test.sigma
    if test.name == INTERFERENCE:
        return (
            "All channels receive something alike that no scatterer in their beams would give, with "
            f"{10 * np.log10(size):+.0f} dB over the noise of a channel: interference, or crosstalk of the "
            "receivers. Heights and their sigma are wrong; find its source, or remove it from the samples."
        )
    if test.name == BEAM_STRETCH:
        side = "wider, or closer to each other," if size > 0 else "narrower, or farther from each other,"
        return (
            f"The beams are {side} than described, by {100 * abs(size):.1f} +- {100 * sigma:.1f} %. "
            "Heights are biased, most at the ends of the array; measure the beams (sal-height calibrate), or check "
            "the width of the antenna and the boresights in the description."
        )
    if test.name == CHANNEL_NOISE:
        return (
            f"The noise of channel {test.channel} is {size:.1f} +- {sigma:.1f} dB stronger than that of the others, "
            "each relative to what is stated. It looks like scatterers in the beam of the channel, and heights there "
            "are wrong; repair the receiver, or state the noise_power of each channel."
        )
    if test.name == CORRELATED_NOISE:
        return (
            f"The noise of neighbouring channels has a correlation of {size:.2f} +- {sigma:.2f}; the "
            "description states that it is independent. The sigma of the heights is too small; look for crosstalk "
            "of the receivers, or describe it by the channel matrix."
        )
    if test.name == NOISE_OVER_RANGE:
        return (
            f"In a quarter of the ranges the noise of the images is {size:+.1f} +- {sigma:.1f} dB over "
            "that of the whole dwell; the description states one noise_power for all ranges. The sigma of the "
            "heights is wrong there. Remove the gain over range from the samples, or find what else is in the "
            "channels."
        )
    stated = float(np.mean(sensor.noise_power))
    found = stated * 10 ** (size / 10)
    side, heights = ("above", "too small") if size > 0 else ("below", "too great")
    return (
        f"The noise of the images is {abs(size):.1f} dB {side} the stated one: that of the samples is "
        f"{found:.3g} and the description of the sensor states {stated:.3g} (noise_power, mean of the channels). "
        f"The sigma of the heights is {heights}; state a noise_power of {found:.3g}, or find what else is in the "
        "channels."
    )


def _of_gains(off: list[FitTest]) -> list[Doubt]:
    """The doubts about channels whose gain is off: those without signal; else the worst."""
    silent = [one for one in off if one.size < NOISE_ONLY]
    if silent:  # without a channel, its neighbours are not predicted well
        return [
            _doubt(
                one,
                f"Channel {one.channel} has {one.size:.2f} +- {one.sigma:.2f} of the amplitude that the other channels "
                "predict: it receives next to nothing but noise. Heights near its beam are wrong; repair it, or make "
                "its samples 0, so that it is left out.",
            )
            for one in silent
        ]
    worst = max(off, key=lambda one: abs(np.log(max(one.size, 1e-3))))
    others = f" So do {len(off) - 1} others, less." if len(off) > 1 else ""
    return [
        _doubt(
            worst,
            f"Channel {worst.channel} has {worst.size:.2f} +- {worst.sigma:.2f} of the amplitude that the others "
            f"predict ({20 * np.log10(worst.size):+.1f} dB); the description states the same gain for all.{others} "
            "Heights are biased; measure the gains (sal-height calibrate), or check the beams of the description.",
        )
    ]
