"""A discrete Fourier transform of few numbers onto any even spacing around the middle, as products of real matrices.

With n and m counted from the middles, sum over n of x[n] exp(j step n m) is the sum over n >= 0 of
(x[n] + x[-n]) cos(step n m) + j (x[n] - x[-n]) sin(step n m), and for -m the same with the other sign of the sines: an
eighth of the multiplications of the complex matrix, and fewer than those of two FFTs up to LARGEST numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sal_height.numeric._kernels import fill_even_and_odd, fill_from_halves
from sal_height.numeric.arrays import C64, F32
from sal_height.numeric.fft import blocks

LARGEST = 2**14
"""Inputs times outputs up to which this is faster than two FFTs (measured: 0.15 against 0.6 us a line for 2944)."""

PRODUCT = 2**18
"""Greatest number of multiplications of one product of real matrices: for more, OpenBLAS starts threads, which spin."""


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
