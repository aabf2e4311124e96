"""Range profiles between their samples: dense samples from a spectrum, and a short kernel to interpolate them.

The spectrum is divided by the transform of a Kaiser-Bessel kernel, zero-padded and transformed; the kernel then
interpolates without error except for aliases (non-uniform FFT: Beatty et al., IEEE Trans. Med. Imaging 24, 2005).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import scipy.fft
from scipy.special import i0

from sal_height.numeric._kernels import fill_padded
from sal_height.numeric.arrays import C64, F32, F64

OVERSAMPLING = 2  # dense samples per resolution cell of the unweighted band
TAPS = 6  # length of the kernel in dense samples: with OVERSAMPLING, aliases lie 105 dB below the profile

_SHAPE = float(np.pi * np.sqrt((TAPS / OVERSAMPLING * (OVERSAMPLING - 0.5)) ** 2 - 0.8))


@lru_cache(1)
def tap_polynomials() -> F32:
    """Weight of every tap as a polynomial of the fraction of a sample by which a position is past one: (TAPS, 8).

    Coefficients of rising powers; the error, 3e-8 of the peak, is that of float32. Tap j belongs to the sample
    j - TAPS / 2 + 1 past that before the position.
    """
    fraction = (1 - np.cos(np.pi * (np.arange(64) + 0.5) / 64)) / 2
    offsets = fraction[:, None] + TAPS // 2 - 1 - np.arange(TAPS)
    kernel = i0(_SHAPE * np.sqrt(np.maximum(0.0, 1 - (2 * offsets / TAPS) ** 2)))
    fit = np.polynomial.polynomial.polyfit(fraction, kernel, 7).T
    return np.ascontiguousarray(fit, dtype=np.float32)


def dense_profiles(spectra: C64, weights: F64) -> C64:
    """Dense range profiles of some pulses, ready to be interpolated.

    Args:
        spectra: fast-time frequencies, shape (detectors, pulses, frequencies).
        weights: weights of the frequencies, shape (frequencies,).

    Returns:
        Complex64, shape (pulses, OVERSAMPLING * frequencies + TAPS, detectors): detectors side by side, for vector
        units. Index i belongs to the delay (i - TAPS / 2 - OVERSAMPLING * frequencies // 2) /
        OVERSAMPLING cells; the profile repeats itself at the ends.
    """
    detectors, pulses, count = spectra.shape
    dense = OVERSAMPLING * count
    factor = (weights * _deconvolution(count)).astype(np.float32)
    ready = np.empty((pulses, dense + TAPS, detectors), dtype=np.complex64)
    period = ready[:, TAPS // 2 : -TAPS // 2]
    fill_padded(spectra, factor, period)
    transformed = scipy.fft.ifft(period, axis=1, norm="forward", overwrite_x=True)
    if not np.may_share_memory(transformed, period):  # it is made in place where the backend of scipy.fft can
        period[:] = transformed
    ready[:, : TAPS // 2] = ready[:, dense : dense + TAPS // 2]
    ready[:, -(TAPS // 2) :] = ready[:, TAPS // 2 : TAPS]
    return ready


def spectra_of_profiles(profiles: C64) -> C64:
    """Fast-time frequencies of dense range profiles: the adjoint of `dense_profiles` with weights of 1.

    With the taps of an echo added to a profile where `dense_profiles` would read it, this is the type-1 non-uniform
    FFT: a sum of exp(-j 2 pi f delay) over echoes.

    Args:
        profiles: complex64, shape (pulses, OVERSAMPLING * frequencies + TAPS, detectors); not changed.

    Returns:
        Shape (detectors, pulses, frequencies).
    """
    half = TAPS // 2
    period = profiles[:, half:-half].copy()
    period[:, -half:] += profiles[:, :half]
    period[:, :half] += profiles[:, -half:]
    count = period.shape[1] // OVERSAMPLING
    spectra = scipy.fft.fft(period, axis=1, overwrite_x=True)[:, np.arange(count) - count // 2]
    return np.ascontiguousarray((spectra * _deconvolution(count)[:, None].astype(np.float32)).transpose(2, 0, 1))


def kernel_transform(frequency: F64) -> F64:
    """Transform of the interpolator's kernel at `frequency` in cycles per dense sample, within -1/4 and 1/4."""
    root = np.sqrt(_SHAPE**2 - (np.pi * TAPS * frequency) ** 2)
    return np.asarray(TAPS * np.sinh(root) / root)


@lru_cache(8)
def _deconvolution(count: int) -> F64:
    """Inverse of the kernel's transform at `count` frequencies, with the delay 0 in the middle of the profile.

    A sign that alternates in frequency is half a period in delay.
    """
    frequency = np.arange(count) - count // 2
    return np.where(frequency % 2, -1, 1) / kernel_transform(frequency / (OVERSAMPLING * count))
