"""Chirp z-transform: a discrete Fourier transform onto any even spacing, by FFTs (Bluestein; Rabiner et al. 1969)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft

from sal_height.numeric.arrays import C64, F64
from sal_height.numeric.fft import fast_length
from sal_height.numeric.jit import WORKERS
from sal_height.numeric.phasors import outer_phasors


@dataclass(frozen=True)
class ChirpZ:
    """The factors of y[m] = sum over n of x[n] exp(j step (n - n0) (m - m0)), one line for each step.

    Multiply x by `before`, transform forward over `length`, multiply by `spectrum`, transform backward, multiply by
    `after`: n m = (n^2 + m^2 - (m - n)^2) / 2 makes the sum a convolution with a chirp.

    Attributes:
        before: complex64, shape (lines, inputs).
        spectrum: of the chirp, over `length`: complex64, shape (lines, length).
        after: complex64, shape (lines, outputs).
    """

    before: C64
    spectrum: C64
    after: C64

    @property
    def length(self) -> int:
        """Length of the FFTs."""
        return int(self.spectrum.shape[-1])


def apply_chirp_z(steps: F64, inputs: int, n0: float, outputs: int, m0: float) -> ChirpZ:
    """Factors for transforms of `inputs` numbers, indices counted from `n0`, to `outputs`, counted from `m0`.

    Args:
        steps: phase (rad) per input and output index of each line, shape (lines,).
        inputs: numbers in.
        n0: index in that has no phase.
        outputs: numbers out.
        m0: index out that has no phase.
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
