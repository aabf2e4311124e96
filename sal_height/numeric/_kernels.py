"""Loops over numbers, compiled; a test compares each with its formula in NumPy."""

from __future__ import annotations

import numpy as np

from sal_height.numeric.arrays import C64, F32, F64
from sal_height.numeric.jit import compiled

PER_TURN = 1 / (2 * np.pi)


@compiled
def cosine_and_sine(turns: float) -> tuple[np.float32, np.float32]:
    """Cosine and sine of 2 pi `turns`, float32."""
    return cosine_and_sine_of_part(np.float32(turns - np.floor(turns + 0.5)))


@compiled
def cosine_and_sine_of_part(y: np.float32) -> tuple[np.float32, np.float32]:
    """Cosine and sine of 2 pi `y`, within half a turn, by the series of the half angle, within a quarter turn."""
    q = y * y
    s = np.float32(-0.599264529321) + q * (np.float32(0.0821458866111) - q * np.float32(0.00737043094571))
    s = y * (np.float32(3.14159265359) + q * (np.float32(-5.16771278005) + q * (np.float32(2.55016403988) + q * s)))
    c = np.float32(0.235330630359) + q * (np.float32(-0.0258068913900) + q * np.float32(0.00192957430940))
    c = np.float32(4.05871212642) + q * (np.float32(-1.33526276885) + q * c)
    c = np.float32(1) + q * (np.float32(-4.93480220054) + q * c)
    return np.float32(1) - np.float32(2) * s * s, np.float32(2) * s * c


@compiled
def fill_phasors(phase: F64, result: F32) -> None:
    """Cosine and sine in turn of each phase (rad)."""
    for i in range(phase.size):
        cosine, sine = cosine_and_sine(phase[i] * PER_TURN)
        result[2 * i] = cosine
        result[2 * i + 1] = sine


@compiled
def tap_weights(fraction: F32, taps: F32) -> F32:
    """Values of `tap_polynomials` at each fraction, shape (TAPS, fractions); written out so that it is vectorised."""
    weights = np.empty((taps.shape[0], fraction.size), np.float32)
    for j in range(taps.shape[0]):
        p, weight = taps[j], weights[j]
        for i in range(fraction.size):
            t = fraction[i]
            high = p[6] + t * (p[7] + t * (p[8] + t * (p[9] + t * p[10])))
            weight[i] = p[0] + t * (p[1] + t * (p[2] + t * (p[3] + t * (p[4] + t * (p[5] + t * high)))))
    return weights


@compiled
def fill_padded(spectra: C64, factor: F32, padded: C64) -> None:
    """Weighted spectra in the order of an FFT, with zeros between the highest frequencies and the lowest.

    Args:
        spectra: frequencies from the lowest to the highest, shape (detectors, pulses, frequencies).
        factor: of the frequencies.
        padded: to fill, shape (pulses, length, detectors).
    """
    detectors, pulses, count = spectra.shape
    middle, length = count // 2, padded.shape[1]
    for pulse in range(pulses):
        padded[pulse, count - middle : length - middle] = 0
        for detector in range(detectors):
            spectrum, rising, falling = spectra[detector, pulse], padded[pulse], padded[pulse, length - middle :]
            for frequency in range(middle, count):
                rising[frequency - middle, detector] = factor[frequency] * spectrum[frequency]
            for frequency in range(middle):
                falling[frequency, detector] = factor[frequency] * spectrum[frequency]
