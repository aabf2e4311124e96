"""Chirp z-transform: a discrete Fourier transform onto any even spacing, by FFTs (Bluestein; Rabiner et al. 1969)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy.fft

from sal_height.numeric._kernels import fill_columns, fill_products, multiply_lines
from sal_height.numeric.arrays import C64, F64
from sal_height.numeric.fft import blocks, fast_length, rows_at_once
from sal_height.numeric.phasors import outer_phasors
from sal_height.numeric.threads import WORKERS


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
