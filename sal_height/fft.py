"""FFTs of rows in place, as fast as the machine has them: FFTW where pyfftw is installed, scipy's otherwise."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.fft

ComplexArray = npt.NDArray[np.complex64]

BACKEND = "pyfftw" if find_spec("pyfftw") else "scipy"


def fast_length(least: int) -> int:
    """Smallest length from `least` on that suits FFTs and vector units: a multiple of 16, with factors 2, 3 and 5."""
    return 16 * int(scipy.fft.next_fast_len(-(-least // 16), real=True))


class Rows:
    """A buffer of rows, small enough for a processor's cache, and the transforms of its rows; for one thread.

    Attributes:
        data: complex64, shape (rows, length).
    """

    def __init__(self, rows: int, length: int) -> None:
        """Plan the transforms of `rows` rows of `length` numbers; by rule, so that every process has the same."""
        self.data: ComplexArray
        if BACKEND == "pyfftw":
            fftw: Any = import_module("pyfftw")
            self.data = fftw.zeros_aligned((rows, length), dtype="complex64")
            plans = [
                fftw.FFTW(self.data, self.data, direction=f"FFTW_{way}", flags=("FFTW_ESTIMATE",))
                for way in ("FORWARD", "BACKWARD")
            ]
            self._forward, self._backward = (plan.execute for plan in plans)
            self.data[:] = 0
        else:
            self.data = np.zeros((rows, length), dtype=np.complex64)

    def forward(self) -> None:
        """FFT of every row, exp(-j 2 pi k n / length), not scaled."""
        if BACKEND == "pyfftw":
            self._forward()
        else:
            self.data[:] = scipy.fft.fft(self.data, axis=-1, overwrite_x=True)

    def backward(self) -> None:
        """FFT of every row with exp(+j 2 pi k n / length), not scaled."""
        if BACKEND == "pyfftw":
            self._backward()
        else:
            self.data[:] = scipy.fft.ifft(self.data, axis=-1, norm="forward", overwrite_x=True)
