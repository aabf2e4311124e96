"""Receivers of the simulated sensor: their noise, their full scale, and the channels that a hybrid forms of them."""

from __future__ import annotations

import numpy as np
import scipy.fft

from sal_height.numeric import C64
from sal_height.sensor import Sensor, clipped


def received(samples: C64, sensor: Sensor, rng: np.random.Generator, adc_bits: int = 0) -> C64:
    """The channels' samples: the receivers add noise, clip what exceeds the full scale, and round.

    Args:
        samples: noise-free samples of every detector, shape (detectors, pulses, samples); not changed.
        sensor: sensor with noise, channel matrix and full scale.
        rng: generator of the noise.
        adc_bits: bits of the converters; 0: nothing is rounded.
    """
    noise = receiver_noise(sensor, samples.shape[1], rng)
    if sensor.matrix_in_antenna:
        return _converted(form_channels(samples, sensor) + noise, sensor.full_scale, adc_bits)
    return form_channels(_converted(samples + noise, sensor.full_scale, adc_bits), sensor)


def _converted(samples: C64, full_scale: float, bits: int) -> C64:
    """Samples clipped at full scale and rounded to 2^bits levels of real and imaginary part, the outermost at it.

    Rounding adds noise of the power step^2 / 6 to a sample.
    """
    samples = clipped(samples, full_scale)
    if not bits:
        return samples
    step = np.float32(2 * full_scale / (2**bits - 1))
    levels = np.floor(samples.view(np.float32) / step) + np.float32(0.5)
    return np.clip(levels * step, -full_scale, full_scale).astype(np.float32).view(np.complex64)


def blanked(samples: C64, sensor: Sensor, reference_range: float) -> C64:
    """The samples without the range cells in which their channels are blanked, noise included; of waveform "spectrum".

    Args:
        samples: samples of all channels, shape (channels, pulses, frequencies); not changed.
        sensor: sensor with `blanked_ranges`.
        reference_range: slant range of the echo without delay, m.
    """
    if not sensor.blanked_ranges:
        return samples
    count = sensor.sample_count
    cells = reference_range + sensor.range_resolution * scipy.fft.ifftshift(np.arange(count) - count // 2)
    profiles = scipy.fft.ifft(samples, axis=-1) * sensor.receives(cells, cells)[:, None]
    return np.asarray(scipy.fft.fft(profiles, axis=-1), dtype=np.complex64)


def form_channels(samples: C64, sensor: Sensor) -> C64:
    """Channel matrix times the detectors' samples, shape (detectors, pulses, samples)."""
    if not sensor.channel_matrix:
        return samples
    channels = np.zeros(samples.shape, dtype=np.complex64)
    for (channel, detector), factor in np.ndenumerate(sensor.mixing.astype(np.complex64)):
        if factor:
            channels[channel] += factor * samples[detector]
    return channels


def receiver_noise(sensor: Sensor, pulses: int, rng: np.random.Generator) -> C64:
    """Circular Gaussian noise of the stated power, independent between receivers, (receivers, pulses, frequencies)."""
    shape = (sensor.detector_count, pulses, sensor.sample_count, 2)
    noise = rng.standard_normal(shape, dtype=np.float32).view(np.complex64)[..., 0]
    return noise * np.sqrt(np.array(sensor.noise_power, dtype=np.float32) / 2)[:, None, None]
