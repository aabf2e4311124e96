"""Waveforms: range compression of raw echoes to fast-time frequencies, and simulated echoes from frequencies.

Everything after this module works on "spectrum" samples: at the fast-time frequency f, a point of amplitude A whose
echo is late by d against the reference contributes A exp(-j 2 pi f d). Three sensors describe the three forms:

    sensor                   the raw samples, as the receiver delivers them
    spectrum_sensor(sensor)  the compressed samples: the frequencies in the band of the pulse
    echo_sensor(sensor)      the noise-free samples that echoes are simulated from: the frequencies of the whole record

Each waveform is a class; the functions choose the one that the sensor names.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property, lru_cache

import numpy as np
from scipy import fft
from scipy.special import diric

from sal_height.numeric import C64, F64, Complex, fast_length
from sal_height.sensor.sensor import PhaseHistory, Sensor

BLOCK_SAMPLES = 2**18  # samples transformed at a time, in complex128


def spectrum_sensor(sensor: Sensor) -> Sensor:
    """Return the sensor that describes the compressed samples: the same with waveform "spectrum".

    Its bandwidth is that of the frequencies kept, up to two steps less than that of the pulse. Its noise power is the
    mean over the band: exact for "deramped" (white noise), and for an unweighted image of "chirp". Its config_hash is
    that of `sensor`.
    """
    return _waveform(sensor).spectrum_sensor


def echo_sensor(sensor: Sensor) -> Sensor:
    """Return the sensor with waveform "spectrum" that describes the noise-free samples which `from_spectrum` takes."""
    return _waveform(sensor).echo_sensor


def to_spectrum(samples: C64, sensor: Sensor) -> C64:
    """Compress raw samples in range to those of `spectrum_sensor(sensor)`.

    Args:
        samples: samples of any waveform, shape (detectors, pulses, samples); not changed.
        sensor: sensor that delivers them.

    Returns:
        Complex64 samples over frequency, shape (detectors, pulses, frequencies); `samples` itself if they are that.
    """
    return _waveform(sensor).compress(samples)


def range_compressed(history: PhaseHistory, sensor: Sensor) -> tuple[PhaseHistory, Sensor]:
    """Return the phase history with waveform "spectrum", and the sensor that describes it."""
    if sensor.waveform == "spectrum":
        return history, sensor
    return replace(history, samples=to_spectrum(history.samples, sensor)), spectrum_sensor(sensor)


def from_spectrum(samples: Complex, sensor: Sensor) -> C64:
    """Simulate the raw echoes that a receiver delivers, from noise-free samples of `echo_sensor(sensor)`.

    With "chirp", points must lie in the range window of `spectrum_sensor(sensor)`. With "deramped" it is the inverse of
    `to_spectrum`, exact except for ripples at the ends of echoes.

    Args:
        samples: samples over frequency, shape (detectors, pulses, sensor.sample_count); not changed.
        sensor: sensor of the raw samples.

    Returns:
        Complex64 raw samples of the same shape.
    """
    return _waveform(sensor).simulate(samples)


class _Spectrum:
    """Samples that are frequencies already."""

    def __init__(self, sensor: Sensor) -> None:
        self.spectrum_sensor = self.echo_sensor = sensor

    def compress(self, samples: C64) -> C64:
        return samples

    def simulate(self, samples: Complex) -> C64:
        return samples.astype(np.complex64)


class _Chirp:
    """Echoes of a linear FM pulse s(t), compressed by the matched filter.

    The echo is correlated with s(t) at the delays at which the whole pulse lies in the record, and transformed to
    frequencies. The amplitude over frequency is that of |S(f)|^2, with its Fresnel ripples and soft edges; its mean in
    the band is scaled to 1, so that an unweighted image shows A. A window stresses the middle of the band: at a
    time-bandwidth product of 200, a Taylor window makes a point 1.3 % too high, and the noise power 2 % greater than
    stated. The band shapes clutter twice and noise once, so that clutter stands 0.2 dB higher above the noise than with
    a flat band.
    """

    def __init__(self, sensor: Sensor) -> None:
        time = _centred(round(sensor.pulse_duration * sensor.sampling_rate)) / sensor.sampling_rate
        self._sensor = sensor
        self._pulse = np.exp(1j * np.pi * sensor.chirp_rate * time**2)
        self._delays = sensor.sample_count - len(time) + 1  # at which the whole pulse lies in the record
        self._band = int(self._delays * sensor.bandwidth / sensor.sampling_rate * (1 + 1e-9))  # frequencies in the band

    @cached_property
    def spectrum_sensor(self) -> Sensor:
        _, noise_gain = self._gains
        noise = tuple(noise_gain * power for power in self._sensor.noise_power)
        step = self._sensor.sampling_rate / self._delays
        return replace(_with_frequencies(self._sensor, self._band, step), noise_power=noise)

    @cached_property
    def echo_sensor(self) -> Sensor:
        count = self._sensor.sample_count
        return _with_frequencies(self._sensor, count, self._sensor.sampling_rate / count)

    def compress(self, samples: C64) -> C64:
        size = fft.next_fast_len(self._sensor.sample_count)
        amplitude, _ = self._gains
        matched = np.conj(fft.fft(self._pulse, size)) / amplitude

        def transform(raw: Complex) -> Complex:
            correlation = fft.ifft(fft.fft(raw, size) * matched)[..., : self._delays]
            return _centred_dft(correlation, self._band, self._delays)

        return _in_blocks(transform, samples, self._band)

    def simulate(self, samples: Complex) -> C64:
        count = self._sensor.sample_count
        pulse = _centred_dft(self._pulse, count, count)

        def transform(clean: Complex) -> Complex:
            return _centred_dft((clean * pulse).conj(), count, count).conj() / count

        return _in_blocks(transform, samples, count)

    @cached_property
    def _gains(self) -> tuple[float, float]:
        """Amplitude of a correlated point, mean over the band, and the noise power after division by it.

        With rho the autocorrelation of the pulse and m(l) the mean over the band of exp(-j 2 pi f l), the correlation
        with a point of amplitude 1 in the middle of the window of W delays has the mean spectrum sum of rho(l) m(l)
        over the window, and that with white noise of power 1 the mean power sum of (W - |l|) rho(l) m(l).
        """
        count = len(self._pulse)
        lag = np.arange(1 - count, count)
        power_spectrum = np.abs(fft.fft(self._pulse, fast_length(2 * count))) ** 2
        rho = fft.ifft(power_spectrum)[lag].real
        rho *= diric(2 * np.pi * lag / self._delays, self._band)
        amplitude = float(rho[np.abs(lag) <= self._delays / 2].sum())
        power = float(np.sum(np.maximum(0, self._delays - np.abs(lag)) * rho))
        return amplitude, power / amplitude**2


class _Deramped:
    """Echoes of a linear FM pulse, mixed with a replica of it: frequencies already, f_c + chirp_rate t.

    The echo of a point at the delay d starts late by d and carries the residual video phase
    exp(j pi chirp_rate d^2). Its beat frequency is -chirp_rate d, so that one all-pass filter,
    exp(-j pi f^2 / chirp_rate), takes back both: range deskew (Carrara, Goodman, Majewski, Spotlight Synthetic Aperture
    Radar, 1995).
    """

    def __init__(self, sensor: Sensor) -> None:
        beat = fft.fftfreq(sensor.sample_count, 1 / sensor.sampling_rate)
        self._sensor = sensor
        self._video_phase = np.pi * beat**2 / sensor.chirp_rate
        # Samples in the duration of the pulse; even or odd as those of the record, so that they keep its grid.
        most = int(sensor.pulse_duration * sensor.sampling_rate * (1 + 1e-9))
        self._band = most - (sensor.sample_count - most) % 2

    @cached_property
    def spectrum_sensor(self) -> Sensor:
        return _with_frequencies(self._sensor, self._band, self._step)

    @cached_property
    def echo_sensor(self) -> Sensor:
        return _with_frequencies(self._sensor, self._sensor.sample_count, self._step)

    def compress(self, samples: C64) -> C64:
        deskew = np.exp(-1j * self._video_phase)
        first = (self._sensor.sample_count - self._band) // 2
        kept = slice(first, first + self._band)  # the middle of the record, in which an echo of no delay lasts
        return _in_blocks(lambda raw: self._ascending(_filtered(raw, deskew))[..., kept], samples, self._band)

    def simulate(self, samples: Complex) -> C64:
        count, skew = self._sensor.sample_count, np.exp(1j * self._video_phase)
        lasts = np.abs(_centred(count)) < self._band / 2
        return _in_blocks(lambda clean: _filtered(self._ascending(clean * lasts), skew), samples, count)

    @property
    def _step(self) -> float:
        """Frequencies from sample to sample, Hz."""
        return abs(self._sensor.chirp_rate) / self._sensor.sampling_rate

    def _ascending(self, values: Complex) -> Complex:
        """Turn samples from time to frequency order, or back."""
        return values if self._sensor.chirp_rate > 0 else values[..., ::-1]


@lru_cache(maxsize=8)
def _waveform(sensor: Sensor) -> _Spectrum | _Chirp | _Deramped:
    """Return the waveform of a sensor; kept, because the gains of a matched filter take 56 ms of 4096 samples."""
    if sensor.waveform == "spectrum":
        return _Spectrum(sensor)
    return _Chirp(sensor) if sensor.waveform == "chirp" else _Deramped(sensor)


def _with_frequencies(sensor: Sensor, count: int, step: float) -> Sensor:
    """Return the sensor with `count` samples `step` Hz apart in fast-time frequency."""
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
    """Transform the last axis to `count` samples, a few pulses of all detectors at a time."""
    detectors, pulses, before = samples.shape
    result = np.empty((detectors, pulses, count), dtype=np.complex64)
    block = max(1, BLOCK_SAMPLES // (detectors * before))
    for first in range(0, pulses, block):
        part = slice(first, first + block)
        result[:, part] = transform(samples[:, part].astype(np.complex128))
    return result


def _centred(count: int) -> F64:
    """Return the positions of `count` samples, one apart, around 0."""
    return np.arange(count, dtype=np.float64) - (count - 1) / 2


def _centred_dft(values: Complex, count: int, period: int) -> Complex:
    """Return sums over n of values[n] exp(-j 2 pi k n / period) for `count` k; k and n are centred on 0."""
    positions = _centred(values.shape[-1])
    ramp = np.exp(1j * np.pi * (count - 1) / period * positions)
    turn = np.exp(-2j * np.pi * positions[0] / period * np.arange(count))
    return fft.fft(values * ramp, period)[..., :count] * turn


def _filtered(values: Complex, response: Complex) -> Complex:
    """Filter values with a response over the frequencies of their FFT."""
    return fft.ifft(fft.fft(values) * response)
