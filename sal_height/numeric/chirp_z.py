"""Chirp z-transform: a discrete Fourier transform onto any even spacing, by FFTs (Bluestein; Rabiner et al. 1969)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.fft

from sal_height.numeric.arrays import C64, F64
from sal_height.numeric.fft import fast_length
from sal_height.numeric.phasors import unit_phasors
from sal_height.numeric.threads import WORKERS

PRODUCT = 2**15
"""Complex multiplications of one product of matrices: for more OpenBLAS starts threads, which spin while they wait."""

SMALL_MATRIX = 2**13
"""Entries up to which a product of matrices is faster than two FFTs (measured: 0.3 against 0.6 us a line for 2944)."""


@dataclass(frozen=True, eq=False)
class ChirpZ:
    """The sums y[m] = sum over n of x[n] exp(j step (n - n0) (m - m0)) of many lines, each with a step of its own.

    n m = (n^2 + m^2 - (m - n)^2) / 2 makes each sum a convolution with a chirp between two products with chirps. Other
    factors of the numbers before and after may be multiplied into `before` and `after`. A factor of one line is the
    same for all.

    Attributes:
        before: complex64, shape (lines or 1, inputs).
        spectrum: of the chirp, over the length of the FFTs: complex64, shape (lines or 1, length).
        after: complex64, shape (lines or 1, outputs).
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
        """Numbers out."""
        return int(self.after.shape[-1])

    @property
    def is_common(self) -> bool:
        """Whether all lines have the same factors."""
        return len(self.before) == len(self.spectrum) == len(self.after) == 1

    @cached_property
    def _matrix(self) -> C64 | None:
        """The transform of all lines, shape (inputs, outputs), where a product with it is faster than the FFTs."""
        inputs = self.before.shape[-1]
        if not self.is_common or inputs * self.outputs > SMALL_MATRIX:
            return None
        return self._by_fft(np.eye(inputs, dtype=np.complex64), slice(0, inputs))

    def apply(self, values: C64, lines: slice) -> C64:
        """The sums of the numbers of some lines: complex64, from shape (these lines, inputs) to (these, outputs)."""
        if self._matrix is None:
            return self._by_fft(values, lines)
        few = PRODUCT // self._matrix.size
        whole = len(values) // few * few
        many = values[:whole].reshape(-1, few, values.shape[1]) @ self._matrix
        return np.concatenate([many.reshape(whole, self.outputs), values[whole:] @ self._matrix])

    def _by_fft(self, values: C64, lines: slice) -> C64:
        before, spectrum, after = (
            factor[lines] if len(factor) > 1 else factor for factor in (self.before, self.spectrum, self.after)
        )
        spectra = scipy.fft.fft(values * before, self.length, overwrite_x=True)
        spectra *= spectrum
        sums: C64 = scipy.fft.ifft(spectra, norm="forward", overwrite_x=True)[:, : after.shape[1]]
        sums *= after
        return sums


def chirp_z(steps: F64, inputs: int, n0: float, outputs: int, m0: float) -> ChirpZ:
    """Factors for transforms of `inputs` numbers, indices counted from `n0`, to `outputs`, counted from `m0`.

    Args:
        steps: phase (rad) per input and output index of each line, shape (lines,).
        inputs: numbers in.
        n0: index in that has no phase.
        outputs: numbers out.
        m0: index out that has no phase.
    """
    length = fast_length(inputs + outputs - 1)
    half = steps[:, None] / 2
    index = np.arange(length, dtype=np.float64)
    index[outputs:] -= length
    chirp = unit_phasors(-half * (index - m0 + n0) ** 2)
    spectrum = scipy.fft.fft(chirp, axis=-1, overwrite_x=True, workers=WORKERS)
    spectrum *= np.float32(1 / length)
    return ChirpZ(
        unit_phasors(half * (np.arange(inputs) - n0) ** 2),
        spectrum,
        unit_phasors(half * (np.arange(outputs) - m0) ** 2),
    )
