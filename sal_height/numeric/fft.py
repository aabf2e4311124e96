"""FFTs of rows that stay in a processor's cache: by scipy, or by FFTW where the user chooses it.

In the cache FFTW takes 0.4 times as long as scipy, and the fast image formers two thirds. The last digits of images
differ between the two, so FFTW is never taken just because it is installed: set SAL_HEIGHT_FFT=fftw in the environment.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np
import scipy.fft

from sal_height.errors import UserError
from sal_height.numeric.arrays import C64, F64
from sal_height.numeric.jit import compiled

BUFFER = 2**16
"""Numbers in a buffer: half a megabyte."""

CHOICE = "SAL_HEIGHT_FFT"
"""Environment variable that chooses the library."""


def chosen_library() -> str:
    """The library of FFTs that the user has chosen, "scipy" (the default) or "fftw".

    Raises:
        UserError: another name, or FFTW is not installed.
    """
    name = os.environ.get(CHOICE, "scipy")
    if name not in ("scipy", "fftw"):
        raise UserError(f"The environment variable {CHOICE} is {name!r}; allowed are 'scipy' and 'fftw'.")
    if name == "fftw":
        try:
            import_module("pyfftw")
        except ImportError as error:
            raise UserError(
                f"The environment variable {CHOICE} is 'fftw', but pyfftw is not installed; install it with: "
                "pip install 'sal_height[fast]'."
            ) from error
    return name


def fast_length(least: int) -> int:
    """Smallest length from `least` on that suits FFTs and vector units: a multiple of 16, with factors 2, 3 and 5."""
    return 16 * int(scipy.fft.next_fast_len(-(-least // 16), real=True))


def rows_at_once(length: int) -> int:
    """Rows of that length that fit into a processor's cache together."""
    return max(1, BUFFER // length)


def blocks(count: int, size: int) -> list[slice]:
    """`count` rows in blocks of `size`, the last of which may be smaller."""
    return [slice(first, min(first + size, count)) for first in range(0, count, size)]


class Rows:
    """Two buffers of rows, small enough for a processor's cache, and the transforms between them; for one thread.

    Two, because the plans that FFTW makes by rule are fast from one buffer to another, and slow in place. By rule,
    because plans chosen by timing differ from process to process, and with them the last digits of images.

    Attributes:
        data: complex64, shape (rows, length).
        spectrum: complex64, shape (rows, length).
    """

    def __init__(self, rows: int, length: int) -> None:
        """Plan the transforms of `rows` rows of `length` numbers.

        Raises:
            UserError: the library that was chosen cannot be used.
        """
        self.data: C64 = np.zeros((rows, length), dtype=np.complex64)
        self.spectrum: C64 = np.zeros((rows, length), dtype=np.complex64)
        self._planned: tuple[Callable[[], object], Callable[[], object]] | None = None
        if chosen_library() == "fftw":
            fftw: Any = import_module("pyfftw")
            self.data, self.spectrum = (fftw.zeros_aligned((rows, length), dtype="complex64") for _ in range(2))
            ways = ((self.data, self.spectrum, "FFTW_FORWARD"), (self.spectrum, self.data, "FFTW_BACKWARD"))
            forward, backward = (fftw.FFTW(*way[:2], direction=way[2], flags=("FFTW_ESTIMATE",)) for way in ways)
            self._planned = forward.execute, backward.execute

    def load(self, values: C64, factor: C64) -> None:
        """Put values * factor into the beginnings of `data`, then zeros; shapes (some rows, n), (as many or 1, n)."""
        _multiply_padded(values, factor, self.data)

    def filter(self, factor: C64) -> None:
        """Multiply the first rows of `spectrum` by `factor` of shape (some rows or 1, length)."""
        _multiply(self.spectrum, factor)

    def forward(self) -> None:
        """Put the FFT of every row of `data`, exp(-j 2 pi k n / length), not scaled, into `spectrum`."""
        if self._planned:
            self._planned[0]()
        else:
            self.spectrum[:] = scipy.fft.fft(self.data, axis=-1)

    def backward(self) -> None:
        """Put the FFT of every row of `spectrum` with exp(+j 2 pi k n / length), not scaled, into `data`."""
        if self._planned:
            self._planned[1]()
        else:
            self.data[:] = scipy.fft.ifft(self.spectrum, axis=-1, norm="forward")


@compiled
def _multiply_padded(values: C64, factor: C64, result: C64) -> None:
    count = values.shape[1]
    for i in range(values.shape[0]):
        given, weight, made = values[i], factor[i if factor.shape[0] > 1 else 0], result[i]
        for j in range(count):
            made[j] = given[j] * weight[j]
        made[count:] = 0


@compiled
def _multiply(values: C64, factor: C64) -> None:
    for i in range(values.shape[0] if factor.shape[0] == 1 else factor.shape[0]):
        made, weight = values[i], factor[i if factor.shape[0] > 1 else 0]
        for j in range(made.size):
            made[j] *= weight[j]


def frequencies(count: int) -> F64:
    """Of `count` bins, cycles per pixel: from -1/2 up, as `numpy.fft.fftshift` puts them."""
    return np.asarray((np.arange(count) - count // 2) / count, dtype=np.float64)
