"""Narrow-band emitters in the samples of a dwell, before an image is formed of them.

Clutter and noise have a smooth power spectrum over fast-time frequency; an emitter of a narrow band has its power in
one frequency or a few, in whatever pulses and direction. In the image it is in all ranges, and if it is in the beams,
it looks like a scatterer there.

The power of a frequency, a mean over pulses and channels, has a gamma distribution if nothing is in it but clutter and
noise. How many of these are independent depends on the scene: a few bright points have a spectrum with ripples, as if
it were of one sample. So the shape of the distribution is that of the spread of the powers, by their median departure
from the median of the frequencies around.

Ripples of points that are close in range are wide, and the median near a gap between two of them is a power that few
frequencies have. So an emitter must also exceed the frequencies a little way off on both sides.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.ndimage import median_filter
from scipy.special import gammaincc

from sal_height.doubts import Doubt
from sal_height.numeric import C64, F64
from sal_height.sensor import Sensor

NARROW_BAND = "narrow-band interference"
"""Name of the doubt."""

SIGNIFICANCE = 1e-4
"""Probability of a doubt about a dwell without an emitter, if the powers have a gamma distribution."""

AROUND = 33
"""Frequencies whose median is the smooth spectrum."""

BESIDE = 3
"""Distance to the frequencies on both sides that an emitter exceeds: it is up to three frequencies wide."""

FEWEST_FREQUENCIES = 48
"""Fewest frequencies that are tested."""

LEAST_POWER = 0.03
"""Least mean power of an emitter that puts heights in doubt, over the noise of a sample: -15 dB."""

LEAST_RATIO = 4.0
"""Least power of its frequency over those around: the ripples at the ends of the band of a chirp are up to 3."""

EVERY, MOST_PULSES = 2, 8
"""Channels from one that is read to the next, as the beams of neighbours overlap; and pulses that are read: all would
take 4 % of the time of the image, these 1 %. Pulses of an emitter that none of them has are in another dwell."""


def narrow_band_doubts(samples: C64, sensor: Sensor) -> tuple[Doubt, ...]:
    """The doubt about a dwell with a narrow-band emitter; none if there is none, or the noise is not known.

    Args:
        samples: samples over fast-time frequency, shape (channels, pulses, frequencies).
        sensor: sensor with waveform "spectrum".
    """
    noise, (_, pulses, frequencies) = sum(sensor.noise_power) / len(sensor.noise_power), samples.shape
    if frequencies < FEWEST_FREQUENCIES or not noise > 0:
        return ()
    read = samples[::EVERY, :: -(-pulses // MOST_PULSES)]
    spectrum = power_spectrum(read)
    beside = greater_beside(spectrum)
    if not (np.isfinite(spectrum).all() and np.any(spectrum > LEAST_RATIO * beside)):
        return ()
    smooth = median_filter(spectrum, AROUND, mode="mirror")
    around = np.maximum(smooth, beside)
    beyond = spectrum - LEAST_RATIO * around
    strongest = int(beyond.argmax())
    power = float(spectrum[strongest] - smooth[strongest]) / (frequencies * noise)
    if not (beyond[strongest] > 0 and power > LEAST_POWER and smooth.min() > 0):
        return ()
    p_value = tail(spectrum / smooth, float(np.max(spectrum / around)), read.shape[0] * read.shape[1])
    if not p_value < SIGNIFICANCE:
        return ()
    decibels = 10 * math.log10(power)
    offset = sensor.frequency_step * (strongest - (frequencies - 1) / 2)
    sentence = (
        f"All ranges have a signal of a narrow band, {offset / 1e6:+.4g} MHz from the middle of the band, with "
        f"{decibels:+.0f} dB over the noise of a sample: an emitter, or a spur of the receivers. In the beams it looks "
        "like scatterers, and heights are wrong; find its source, or remove the frequency from the samples."
    )
    return (Doubt(NARROW_BAND, sentence, size=decibels, unit="dB", p_value=p_value),)


def power_spectrum(samples: C64) -> F64:
    """Mean power over channels and pulses, shape (frequencies,), of samples (channels, pulses, frequencies)."""
    parts = np.ascontiguousarray(samples).view(np.float32).reshape(-1, 2 * samples.shape[2])
    total = np.einsum("pf,pf->f", parts, parts).astype(np.float64)
    mean: F64 = (total[::2] + total[1::2]) / len(parts)
    return mean


def greater_beside(spectrum: F64) -> F64:
    """Greater power of the two frequencies BESIDE each; at the ends of the band that of the one there is."""
    last, number = len(spectrum) - 1, np.arange(len(spectrum))
    below, above = number - BESIDE, number + BESIDE
    greater: F64 = np.maximum(
        spectrum[np.where(below < 0, above, below)], spectrum[np.where(above > last, below, above)]
    )
    return greater


def tail(ratio: F64, greatest: float, looks: int) -> float:
    """Probability that the greatest of some powers over their median is as great or greater than one.

    Args:
        ratio: powers over their median, whose spread is that of the distribution.
        greatest: the one.
        looks: number of samples that each power is the mean of; noise alone is spread as they are, or more.
    """
    # Of normal deviates the standard deviation, by three of its own standard errors greater.
    spread = 1.4826 * float(np.median(np.abs(ratio - 1))) * (1 + 3 * 1.17 / math.sqrt(len(ratio)))
    shape = min(1 / max(spread, 1e-6) ** 2, looks)
    median = shape * max(1 - 1 / (9 * shape), 0.0) ** 3  # of a gamma distribution (Wilson and Hilferty, 1931)
    return min(1.0, len(ratio) * float(gammaincc(shape, median * greatest)))
