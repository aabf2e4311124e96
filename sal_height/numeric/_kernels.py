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
def fill_outer_phasors(first: F64, second: F64, result: F32) -> None:
    """Cosine and sine in turn of the product (rad) of every number and every other one: (first, 2 second)."""
    turn = np.empty(second.size, np.float32)
    cosine, sine = np.empty_like(turn), np.empty_like(turn)
    for row in range(first.size):
        per_turn = first[row] * PER_TURN
        for i in range(second.size):
            turns = per_turn * second[i]
            turn[i] = np.float32(turns - np.floor(turns + 0.5))
        for i in range(second.size):
            cosine[i], sine[i] = cosine_and_sine_of_part(turn[i])
        pairs = result[row]
        for i in range(second.size):
            pairs[2 * i] = cosine[i]
            pairs[2 * i + 1] = sine[i]


@compiled
def tap_weights(fraction: F32, taps: F32) -> F32:
    """Values of `tap_polynomials` at each fraction, shape (TAPS, fractions); written out so that it is vectorised."""
    weights = np.empty((taps.shape[0], fraction.size), np.float32)
    for j in range(taps.shape[0]):
        p, weight = taps[j], weights[j]
        for i in range(fraction.size):
            t = fraction[i]
            weight[i] = p[0] + t * (p[1] + t * (p[2] + t * (p[3] + t * (p[4] + t * (p[5] + t * (p[6] + t * p[7]))))))
    return weights


@compiled
def fill_padded(spectra: C64, factor: F32, padded: C64) -> None:
    """Weighted spectra in the order of an FFT, with zeros between the highest frequencies and the lowest.

    Args:
        spectra: frequencies from the lowest to the highest, shape (detectors, pulses, frequencies).
        factor: factors of the frequencies.
        padded: array to fill, shape (pulses, length, detectors).
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


@compiled
def fill_products(values: C64, factors: C64, padded: C64) -> None:
    """Numbers times factors, and zeros after them.

    Args:
        values: shape (lines, inputs).
        factors: factors of every line, or the same for all, shape (lines or 1, inputs).
        padded: array to fill, shape (lines, length).
    """
    lines, inputs = values.shape
    common = factors.shape[0] == 1
    for line in range(lines):
        numbers, factor, products = values[line], factors[0 if common else line], padded[line]
        for i in range(inputs):
            products[i] = numbers[i] * factor[i]
        products[inputs:] = 0


@compiled
def multiply_lines(values: C64, factors: C64) -> None:
    """Multiply numbers by factors, in place.

    Args:
        values: shape (lines, length).
        factors: factors of every line, or the same for all, shape (lines or 1, length).
    """
    lines, length = values.shape
    common = factors.shape[0] == 1
    for line in range(lines):
        numbers, factor = values[line], factors[0 if common else line]
        for i in range(length):
            numbers[i] *= factor[i]


@compiled
def fill_even_and_odd(values: C64, factors: C64, even: F32, odd: F32) -> None:
    """Sums and differences of the products at the same distance after and before number inputs // 2 of every line.

    Args:
        values: shape (lines, inputs).
        factors: factors of every line, or the same for all, shape (lines or 1, inputs).
        even: array to fill with real parts of all lines, then imaginary parts, shape (2 lines, inputs // 2 + 1).
        odd: array to fill, same shape.
    """
    lines, inputs = values.shape
    middle, common = inputs // 2, factors.shape[0] == 1
    for line in range(lines):
        numbers, factor = values[line], factors[0 if common else line]
        real_even, real_odd, imag_even, imag_odd = even[line], odd[line], even[lines + line], odd[lines + line]
        for n in range(inputs - middle):
            after = numbers[middle + n] * factor[middle + n]
            before = numbers[middle - n] * factor[middle - n]
            real_even[n], real_odd[n] = after.real + before.real, after.real - before.real
            imag_even[n], imag_odd[n] = after.imag + before.imag, after.imag - before.imag
        if inputs == 2 * middle:  # the first number has no counterpart
            first = numbers[0] * factor[0]
            real_even[middle], real_odd[middle] = first.real, -first.real
            imag_even[middle], imag_odd[middle] = first.imag, -first.imag


@compiled
def fill_from_halves(in_phase: F32, across: F32, result: C64) -> None:
    """The sum and the difference of `in_phase` and j `across` as the last and the first rows of the result.

    Args:
        in_phase: real parts of all lines and then imaginary parts, shape (half of the outputs, 2 lines).
        across: numbers of the same shape.
        result: array to fill, shape (outputs, lines or more).
    """
    halves, lines, last = in_phase.shape[0], in_phase.shape[1] // 2, result.shape[0] - 1
    for half in range(halves):
        row = last - halves + 1 + half
        after, before = result[row], result[last - row]
        real, imag = in_phase[half, :lines], in_phase[half, lines:]
        across_real, across_imag = across[half, :lines], across[half, lines:]
        for line in range(lines):
            after[line] = complex(real[line] - across_imag[line], imag[line] + across_real[line])
        for line in range(lines):
            before[line] = complex(real[line] + across_imag[line], imag[line] - across_real[line])


@compiled
def fill_columns(values: C64, factors: C64, first: int, columns: C64) -> None:
    """Numbers times factors as columns of a matrix; a few lines at a time, for the cache.

    Args:
        values: shape (lines, outputs or more).
        factors: factors of every line, or the same for all, shape (lines or 1, outputs).
        first: number of the first column to fill.
        columns: array to fill, shape (outputs, columns).
    """
    lines, common = values.shape[0], factors.shape[0] == 1
    for start in range(0, lines, 8):
        for i in range(columns.shape[0]):
            for line in range(start, min(start + 8, lines)):
                columns[i, first + line] = values[line, i] * factors[0 if common else line, i]
