"""Fourier transforms of many rows: lengths of FFTs, chirp z-transform, and few numbers onto any even spacing.

Factors exp(j phase) of large phases are float64 until only the fraction of a turn is left, and float32 from there on.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy.fft

from sal_height.numeric._kernels import (
    fill_columns,
    fill_even_and_odd,
    fill_from_halves,
    fill_outer_phasors,
    fill_phasors,
    fill_products,
    multiply_lines,
)
from sal_height.numeric.arrays import C64, F32, F64
from sal_height.numeric.threads import WORKERS, in_parallel

SMALL = 2**17  # least number for which another thread pays

BUFFER = 2**16  # numbers that fit into a processor's cache: half a megabyte

LARGEST = 2**14
"""Inputs times outputs up to which this is faster than two FFTs (measured: 0.15 against 0.6 us a line for 2944)."""

PRODUCT = 2**18
"""Greatest number of multiplications of one product of real matrices: for more, OpenBLAS starts threads, which spin."""


def unit_phasors(phase: F64) -> C64:
    """exp(j phase), complex64 and of the shape of `phase` (rad); the error is less than 1e-6."""
    result = np.empty(phase.shape, dtype=np.complex64)
    flat, numbers = np.ascontiguousarray(phase).reshape(-1), result.reshape(-1).view(np.float32)
    in_parallel(lambda part: fill_phasors(flat[part], numbers[2 * part.start : 2 * part.stop]), flat.size, SMALL)
    return result


def outer_phasors(first: F64, second: F64) -> C64:
    """exp(j first second) of every two numbers, whose product is in rad: complex64, shape (first, second)."""
    result = np.empty((first.size, second.size), dtype=np.complex64)
    numbers = result.view(np.float32)
    in_parallel(
        lambda part: fill_outer_phasors(first[part], second, numbers[part]), first.size, -(-SMALL // second.size)
    )
    return result


def fast_length(least: int) -> int:
    """Smallest length of `least` or more that is fast: a multiple of 16, with factors 2, 3 and 5."""
    return 16 * int(scipy.fft.next_fast_len(-(-least // 16), real=True))


def rows_at_once(length: int) -> int:
    """Rows of that length that fit into a processor's cache together."""
    return max(1, BUFFER // length)


def blocks(count: int, size: int) -> list[slice]:
    """`count` rows in blocks of `size`, the last of which may be smaller."""
    return [slice(first, min(first + size, count)) for first in range(0, count, size)]


def frequencies(count: int) -> F64:
    """Frequencies of `count` bins, cycles per pixel: from -1/2 up, in the order of `numpy.fft.fftshift`."""
    return np.asarray((np.arange(count) - count // 2) / count, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class ChirpZ:
    """The sums y[m] = sum over n of x[n] exp(j step (n - n0) (m - m0)) of many lines, each with its own step.

    n m = (n^2 + m^2 - (m - n)^2) / 2 makes each sum a convolution with a chirp between two products with chirps. Other
    factors of the numbers before and after may be multiplied into `before` and `after`. A factor of one line is the
    same for all.

    Attributes:
        before: factors before, complex64, shape (lines or 1, inputs).
        spectrum: spectrum of the chirp over the length of the FFTs, complex64, shape (lines or 1, length).
        after: factors after, complex64, shape (lines or 1, outputs).
    """

    before: C64
    spectrum: C64
    after: C64

    @property
    def length(self) -> int:
        """Length of the FFTs."""
        return int(self.spectrum.shape[-1])

    @property
    def outputs(self) -> int:
        """Number of sums of a line."""
        return int(self.after.shape[-1])

    @property
    def is_common(self) -> bool:
        """True if all lines have the same factors."""
        return len(self.before) == len(self.spectrum) == len(self.after) == 1

    def times(self, factors: C64) -> ChirpZ:
        """The sums of numbers that are multiplied by factors before, (lines, inputs)."""
        return replace(self, before=self.before * factors)

    def fill_rows(self, values: C64, result: C64) -> None:
        """The sums of all lines: complex64, from shape (lines, inputs) to fill one of (lines, outputs)."""
        for lines, sums in self._sums(values):
            np.multiply(sums, _of(self.after, lines), out=result[lines])

    def fill_columns(self, values: C64, result: C64) -> None:
        """The sums of all lines as columns: complex64, from shape (lines, inputs) to (outputs, lines or more)."""
        for lines, sums in self._sums(values):
            fill_columns(sums, _of(self.after, lines), lines.start, result)

    def _sums(self, values: C64) -> Iterator[tuple[slice, C64]]:
        """The sums before the last factors, shape (lines, outputs), of as many lines at a time as the cache holds."""
        count = len(values)
        buffer = np.empty((min(count, rows_at_once(self.length)), self.length), np.complex64)
        for lines in blocks(count, len(buffer)):
            numbers = buffer[: lines.stop - lines.start]
            fill_products(values[lines], _of(self.before, lines), numbers)
            spectra = scipy.fft.fft(numbers, overwrite_x=True)
            multiply_lines(spectra, _of(self.spectrum, lines))
            yield lines, scipy.fft.ifft(spectra, norm="forward", overwrite_x=True)[:, : self.outputs]


def _of(factor: C64, lines: slice) -> C64:
    """The factors of some lines, or the one that all have."""
    return factor[lines] if len(factor) > 1 else factor


def chirp_z(steps: F64, inputs: int, n0: float, outputs: int, m0: float) -> ChirpZ:
    """Factors for transforms of `inputs` numbers, indices counted from `n0`, to `outputs`, counted from `m0`.

    Args:
        steps: phase (rad) per input and output index of each line, shape (lines,).
        inputs: number of inputs.
        n0: input index without phase.
        outputs: number of outputs.
        m0: output index without phase.
    """
    length = fast_length(inputs + outputs - 1)
    half = steps / 2
    index = np.arange(length, dtype=np.float64)
    index[outputs:] -= length
    chirp = outer_phasors(-half, (index - m0 + n0) ** 2)
    spectrum = scipy.fft.fft(chirp, axis=-1, overwrite_x=True, workers=WORKERS)
    spectrum *= np.float32(1 / length)
    return ChirpZ(
        outer_phasors(half, (np.arange(inputs, dtype=np.float64) - n0) ** 2),
        spectrum,
        outer_phasors(half, (np.arange(outputs, dtype=np.float64) - m0) ** 2),
    )


@dataclass(frozen=True, eq=False)
class CentredSums:
    """The sums y[m] = sum over n of x[n] exp(j step (n - n0) (m - m0)) of lines of numbers.

    n0 is inputs // 2 and m0 is (outputs - 1) / 2.

    Attributes:
        cosines: cosines, float32, shape (half of the outputs, inputs // 2 + 1).
        sines: sines, same shape.
        outputs: number of sums of a line.
        before: factors of the numbers, complex64, shape (lines or 1, inputs).
    """

    cosines: F32
    sines: F32
    outputs: int
    before: C64

    @classmethod
    def of(cls, step: float, inputs: int, outputs: int) -> CentredSums:
        """Sums of `inputs` to `outputs` numbers; step: phase (rad) per input and output index."""
        after = np.arange(outputs // 2, outputs) - (outputs - 1) / 2
        turns = step * np.outer(after, np.arange(inputs // 2 + 1))
        cosines, sines = np.cos(turns), np.sin(turns)
        cosines[:, 0] /= 2  # the number in the middle is its own counterpart
        return cls(cosines.astype(np.float32), sines.astype(np.float32), outputs, np.ones((1, inputs), np.complex64))

    @property
    def is_common(self) -> bool:
        """True: all lines have the same factors."""
        return True

    def times(self, factors: C64) -> CentredSums:
        """The sums of numbers that are multiplied by factors before, (lines, inputs)."""
        return replace(self, before=self.before * factors)

    def fill_columns(self, values: C64, result: C64) -> None:
        """The sums of some lines as the columns of a matrix.

        Args:
            values: numbers, complex64, shape (lines, inputs).
            result: array to fill, shape (outputs, lines or more).
        """
        halves, count = self.cosines.shape
        even, odd = np.empty((2, 2 * len(values), count), np.float32)
        fill_even_and_odd(values, self.before, even, odd)
        in_phase, across = np.empty((2, halves, 2 * len(values)), np.float32)
        for part in blocks(2 * len(values), max(1, PRODUCT // self.cosines.size)):
            np.matmul(self.cosines, even[part].T, out=in_phase[:, part])
            np.matmul(self.sines, odd[part].T, out=across[:, part])
        fill_from_halves(in_phase, across, result)
