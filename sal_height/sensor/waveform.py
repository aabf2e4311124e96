"""Waveforms: range compression of raw echoes, by matched filter or by deramp, to fast-time frequencies and back.

Everything after this module works on "spectrum" samples, where a point of amplitude A at the delay d after the
reference contributes A exp(-j 2 pi f d) at the fast-time frequency f. Three sensors describe the three forms:

    sensor                   the raw samples, as the receiver delivers them
    spectrum_sensor(sensor)  the sensor of what `to_spectrum` returns: the frequencies in the band of the pulse
    echo_sensor(sensor)      what `from_spectrum` makes them of: the frequencies of the whole record

"chirp" is compressed by the matched filter: correlation with the pulse s(t), at the delays at which the whole pulse
lies in the record, and a Fourier transform. The amplitude over frequency is that of |S(f)|^2, with its Fresnel
ripples and soft edges; it is scaled to a mean of 1 in the band, so that an unweighted image shows A. A
weighted one stresses the middle of the band: at a time-bandwidth product of 200 and with a Taylor window a point
comes out 1.3 % too high and noise power 2 % above the stated one. Clutter, coloured twice by the band, stands 0.2 dB
higher above the noise, coloured once, than over a flat band.

"deramped" samples are frequencies already, f_c + chirp_rate t for a point at the reference. A point at d is late by d
and carries the residual video phase exp(j pi chirp_rate d^2). Its beat frequency is -chirp_rate d, so that one
all-pass filter, exp(-j pi f^2 / chirp_rate), takes back both ("range deskew": Carrara, Goodman, Majewski, Spotlight
Synthetic Aperture Radar, 1995).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
from scipy import fft
from scipy.special import diric

from sal_height.numeric import C64, C128, F64, Complex
from sal_height.sensor.phase_history import PhaseHistory
from sal_height.sensor.sensor import Sensor

BLOCK_SAMPLES = 2**18
"""Samples transformed at a time, in complex128."""


def spectrum_sensor(sensor: Sensor) -> Sensor:
    """Return the sensor that describes the samples made by `to_spectrum`: the same with waveform "spectrum".

    Its bandwidth is that of the frequencies kept, up to two steps less than that of the pulse. Its noise power is the
    mean over the band: exact for "deramped" (white noise), and for an unweighted image of "chirp". Its config_hash is
    that of `sensor`.
    """
    if sensor.waveform == "spectrum":
        return sensor
    if sensor.waveform == "deramped":
        return _with_frequencies(sensor, _deramped_band(sensor), abs(sensor.chirp_rate) / sensor.sampling_rate)
    step = sensor.sampling_rate / _whole_pulse_delays(sensor)
    _, noise_gain = _matched_filter_gains(sensor)
    noise = tuple(noise_gain * power for power in sensor.noise_power)
    return replace(_with_frequencies(sensor, _chirp_band(sensor), step), noise_power=noise)


def echo_sensor(sensor: Sensor) -> Sensor:
    """Return the sensor with waveform "spectrum" that describes the noise-free samples which `from_spectrum` takes."""
    if sensor.waveform == "spectrum":
        return sensor
    rate = sensor.sampling_rate
    step = rate / sensor.sample_count if sensor.waveform == "chirp" else abs(sensor.chirp_rate) / rate
    return _with_frequencies(sensor, sensor.sample_count, step)


def to_spectrum(samples: C64, sensor: Sensor) -> C64:
    """Compress raw samples in range to those of `spectrum_sensor(sensor)`.

    Args:
        samples: of any waveform, shape (detectors, pulses, samples); not changed.
        sensor: that took them.

    Returns:
        Complex64 samples over frequency, shape (detectors, pulses, frequencies); `samples` itself if they are that.
    """
    if sensor.waveform == "spectrum":
        return samples
    count = spectrum_sensor(sensor).sample_count
    if sensor.waveform == "chirp":
        return _in_blocks(_matched_filter(sensor), samples, count)
    deskew = np.exp(-1j * _video_phase(sensor))
    first = (sensor.sample_count - count) // 2
    return _in_blocks(lambda raw: _ascending(_filtered(raw, deskew), sensor)[..., first:][..., :count], samples, count)


def range_compressed(history: PhaseHistory, sensor: Sensor) -> tuple[PhaseHistory, Sensor]:
    """Return the phase history with waveform "spectrum", and the sensor that describes it."""
    return replace(history, samples=to_spectrum(history.samples, sensor)), spectrum_sensor(sensor)


def from_spectrum(samples: Complex, sensor: Sensor) -> C64:
    """Simulate the raw echoes that a receiver delivers, from noise-free samples of `echo_sensor(sensor)`.

    "chirp": the samples are multiplied by the spectrum of the pulse; points must lie in the range window of
    `spectrum_sensor(sensor)`. "deramped": the inverse of `to_spectrum`, exact except for ripples at the ends of echoes.

    Args:
        samples: over frequency, shape (detectors, pulses, sensor.sample_count); not changed.
        sensor: whose raw samples to make.

    Returns:
        Complex64 raw samples of the same shape.
    """
    count = sensor.sample_count
    if sensor.waveform == "spectrum":
        return samples.astype(np.complex64)
    if sensor.waveform == "chirp":
        pulse = _centred_dft(_replica(sensor), count, count)
        return _in_blocks(
            lambda clean: _centred_dft((clean * pulse).conj(), count, count).conj() / count, samples, count
        )
    skew = np.exp(1j * _video_phase(sensor))
    lasts = np.abs(_centred(count)) < _deramped_band(sensor) / 2
    return _in_blocks(lambda clean: _filtered(_ascending(clean * lasts, sensor), skew), samples, count)


def _with_frequencies(sensor: Sensor, count: int, step: float) -> Sensor:
    """The sensor with `count` samples `step` Hz apart in fast-time frequency."""
    return replace(
        sensor,
        waveform="spectrum",
        chirp_rate=0.0,
        pulse_duration=0.0,
        sampling_rate=0.0,
        bandwidth=count * step,
        sample_count=count,
    )


def _in_blocks(transform: Callable[[Complex], Complex], samples: Complex, count: int) -> C64:
    """The transform of the last axis to `count` samples, a few pulses of all detectors at a time."""
    detectors, pulses, before = samples.shape
    result = np.empty((detectors, pulses, count), dtype=np.complex64)
    block = max(1, BLOCK_SAMPLES // (detectors * before))
    for first in range(0, pulses, block):
        part = slice(first, first + block)
        result[:, part] = transform(samples[:, part].astype(np.complex128))
    return result


def _centred(count: int) -> F64:
    """Places of `count` samples, one apart, around 0."""
    return np.arange(count, dtype=np.float64) - (count - 1) / 2


def _centred_dft(values: Complex, count: int, period: int) -> Complex:
    """Sum over n of values[n] exp(-j 2 pi k n / period) for `count` k, both k and n centred on 0 (`_centred`)."""
    places = _centred(values.shape[-1])
    ramp = np.exp(1j * np.pi * (count - 1) / period * places)
    turn = np.exp(-2j * np.pi * places[0] / period * np.arange(count))
    return fft.fft(values * ramp, period)[..., :count] * turn


# Matched filter


def _replica(sensor: Sensor) -> C128:
    """Samples of the pulse s(t), its middle in the middle."""
    time = _centred(round(sensor.pulse_duration * sensor.sampling_rate)) / sensor.sampling_rate
    return np.exp(1j * np.pi * sensor.chirp_rate * time**2)


def _whole_pulse_delays(sensor: Sensor) -> int:
    """Number of delays, one sample apart, at which the whole pulse lies in the record."""
    return sensor.sample_count - len(_replica(sensor)) + 1


def _chirp_band(sensor: Sensor) -> int:
    """Number of frequencies in the band of the pulse."""
    return int(_whole_pulse_delays(sensor) * sensor.bandwidth / sensor.sampling_rate * (1 + 1e-9))


def _matched_filter(sensor: Sensor) -> Callable[[Complex], Complex]:
    """Correlation with the pulse at the delays at which it lies in the record, and the band of its spectrum."""
    delays, band, size = _whole_pulse_delays(sensor), _chirp_band(sensor), fft.next_fast_len(sensor.sample_count)
    gain, _ = _matched_filter_gains(sensor)
    matched = np.conj(fft.fft(_replica(sensor), size)) / gain

    def compress(raw: Complex) -> Complex:
        correlation = fft.ifft(fft.fft(raw, size) * matched)[..., :delays]
        return _centred_dft(correlation, band, delays)

    return compress


@lru_cache(maxsize=8)
def _matched_filter_gains(sensor: Sensor) -> tuple[float, float]:
    """Gains of the matched filter, in the mean over the frequencies of the band.

    With rho the autocorrelation of the pulse and m(l) the mean over the band of exp(-j 2 pi f l), the correlation with
    a point of amplitude 1 in the middle of the window of W delays has the mean spectrum sum of rho(l) m(l) over the
    window, and that with white noise of power 1 the mean power sum of (W - |l|) rho(l) m(l).

    Returns:
        What to divide the correlation by so that a point has mean amplitude 1, and the noise power after that.
    """
    from scipy.signal import correlate  # noqa: PLC0415 (brings scipy.stats, 0.4 s of every node's start)

    replica, delays = _replica(sensor), _whole_pulse_delays(sensor)
    lag = np.arange(1 - len(replica), len(replica))
    rho = correlate(replica, replica, method="fft").real * diric(2 * np.pi * lag / delays, _chirp_band(sensor))
    amplitude = float(rho[np.abs(lag) <= delays / 2].sum())
    power = float(np.sum(np.maximum(0, delays - np.abs(lag)) * rho))
    return amplitude, power / amplitude**2


# Deramp


def _deramped_band(sensor: Sensor) -> int:
    """Number of samples in the duration of the pulse; even or odd as that of the record, so that they keep its grid."""
    most = int(sensor.pulse_duration * sensor.sampling_rate * (1 + 1e-9))
    return most - (sensor.sample_count - most) % 2


def _video_phase(sensor: Sensor) -> F64:
    """Residual video phase at each beat frequency, in the order of an FFT, rad."""
    beat = fft.fftfreq(sensor.sample_count, 1 / sensor.sampling_rate)
    return np.pi * beat**2 / sensor.chirp_rate


def _filtered(values: Complex, response: Complex) -> Complex:
    """Values filtered with a response over the frequencies of their FFT."""
    return fft.ifft(fft.fft(values) * response)


def _ascending(values: Complex, sensor: Sensor) -> Complex:
    """Samples of a deramped pulse from time to frequency order, or back: turned round where frequency falls."""
    return values if sensor.chirp_rate > 0 else values[..., ::-1]
