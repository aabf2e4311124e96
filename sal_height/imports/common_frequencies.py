"""Samples of pulses over fast-time frequency or time of arrival, at frequencies that all pulses have."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft

from sal_height.errors import UserError
from sal_height.numeric import C64, F64, blocks, chirp_z, outer_phasors


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Samples over frequency: a point of amplitude A whose echo is late by d contributes A exp(-j 2 pi f d).

    Attributes:
        samples: samples over frequency, complex64, shape (pulses, frequencies).
        first: frequency of the first sample, Hz.
        step: frequency step between samples, Hz.
    """

    samples: C64
    first: float
    step: float

    @property
    def count(self) -> int:
        """Number of frequencies."""
        return int(self.samples.shape[1])

    @property
    def middle(self) -> float:
        """The frequency in the middle, Hz."""
        return self.first + (self.count - 1) / 2 * self.step


def from_frequencies(samples: C64, first: F64, step: F64) -> Spectrum:
    """Samples at the frequencies that all pulses have: as they are, or interpolated where pulses differ.

    The samples of a pulse are values of a trigonometric polynomial, whose coefficients are echoes at as many delays.

    Args:
        samples: samples of the pulses, complex64, shape (pulses, samples).
        first: frequency of the first sample of each pulse, Hz, shape (pulses,).
        step: frequency step between its samples, Hz, shape (pulses,).

    Raises:
        UserError: the pulses have fewer than two frequencies in common.
    """
    count = samples.shape[1]
    widest, highest = float(step.max()), float(first.max())
    # Delays reach to half of the unambiguous delay of a pulse's samples.
    off = np.abs(first - highest).max() + (count - 1) * np.abs(step - widest).max()
    # Cycles of phase by which frequencies of pulses may differ at the edge of the swath before they are
    # interpolated.
    same_frequency = 1e-3
    if off / (2 * widest) <= same_frequency:
        return Spectrum(samples, highest, widest)
    last = float((first + (count - 1) * step).min())
    kept = int((last - highest) / widest * (1 + 1e-12)) + 1
    _check_common(kept, highest, last)
    spacing = 1 / (count * step)
    delays = fft.fftshift(fft.ifft(samples), axes=-1)
    return Spectrum(_at(delays, -(count // 2) * spacing, spacing, highest - first, widest, kept), highest, widest)


def from_arrival_times(samples: C64, first: F64, step: F64, band: F64) -> Spectrum:
    """Samples over frequency of samples over the time of arrival.

    With the middle f_C of the band, a point of amplitude A whose echo is late by d has a main lobe at the time d with
    the peak A exp(-j 2 pi f_C d) (NGA.STND.0068, Global/SGN of -1), which is the mean of its spectrum over the band,
    A exp(-j 2 pi f d), times exp(j 2 pi (f - f_C) t). The inverse is B times the sum over the samples of
    s(t) exp(-j 2 pi (f - f_C) t) times their spacing, B being the width of the band.

    Args:
        samples: samples of the pulses, complex64, shape (pulses, samples).
        first: time of the first sample of each pulse after the echo from the reference point, s, shape (pulses,).
        step: time between its samples, s, shape (pulses,).
        band: least and greatest frequency of each pulse, Hz, shape (2, pulses).

    Returns:
        The samples at the frequencies that all pulses have, with the largest step that keeps all times unambiguous.

    Raises:
        UserError: the pulses have fewer than two of these frequencies in common.
    """
    low, high = float(band[0].max()), float(band[1].min())
    reach = float(np.maximum(np.abs(first), np.abs(first + samples.shape[1] * step)).max())
    spacing = 1 / (2 * reach)
    kept = int(max(high - low, 0.0) / spacing * (1 + 1e-9))
    _check_common(kept, low, high)
    begin = (low + high) / 2 - (kept - 1) / 2 * spacing
    sums = _at(samples, first, step, begin - band.mean(axis=0), spacing, kept)
    sums *= ((band[1] - band[0]) * step).astype(np.float32)[:, None]
    return Spectrum(sums, begin, spacing)


def _check_common(count: int, low: float, high: float) -> None:
    """Check that pulses have frequencies in common.

    Raises:
        UserError: they have fewer than two.
    """
    if count < 2:
        raise UserError(
            f"The pulses of the file have {max(count, 0)} frequencies in common, from {low:.6g} to {high:.6g} Hz; two "
            "or more are needed."
        )


def _at(samples: C64, first: F64, spacing: F64, offset: F64, step: float, count: int) -> C64:
    """The sums of samples at the delays t, s, times exp(-j 2 pi f t), at `count` frequencies f.

    Args:
        samples: samples of the pulses, complex64, shape (pulses, samples).
        first: first delay of each pulse, s, shape (pulses,).
        spacing: spacing of its delays, s, shape (pulses,).
        offset: first frequency of each pulse, Hz, shape (pulses,).
        step: step between frequencies, Hz.
        count: number of frequencies.
    """
    inputs = samples.shape[1]
    result = np.empty((len(samples), count), np.complex64)
    places, frequencies = np.arange(inputs, dtype=np.float64), step * np.arange(count, dtype=np.float64)
    pulses_at_once = 256  # pulses transformed at a time, so that the factors of the transforms stay small
    for pulses in blocks(len(samples), pulses_at_once):
        ramps = outer_phasors(-2 * np.pi * offset[pulses] * spacing[pulses], places)
        sums = chirp_z(-2 * np.pi * step * spacing[pulses], inputs, 0.0, count, 0.0).times(ramps)
        sums.fill_rows(np.ascontiguousarray(samples[pulses]), result[pulses])
        result[pulses] *= outer_phasors(-2 * np.pi * first[pulses], frequencies)
        result[pulses] *= np.exp(-2j * np.pi * first[pulses] * offset[pulses])[:, None]
    return result
