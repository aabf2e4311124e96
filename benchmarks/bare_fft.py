"""FFT passes run bare: on whole arrays, in place, with nothing before or after, by the fastest library present."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
import scipy.fft

from sal_height.numeric import WORKERS


@dataclass(frozen=True)
class Pass:
    """One FFT of a whole array, complex64, zero-padding included.

    Attributes:
        shape: of the array.
        axis: that is transformed.
        count: how many such passes there are.
    """

    shape: tuple[int, ...]
    axis: int
    count: int = 1

    def __str__(self) -> str:
        return f"{self.count} × {list(self.shape)} axis {self.axis}"


def candidates(one: Pass) -> dict[str, Callable[[], object]]:
    """The pass by every library that is installed, as functions to be timed.

    All work in place on one array of zeros: that takes as long as with any other numbers, and never overflows.
    """
    data = np.zeros(one.shape, dtype=np.complex64)
    found: dict[str, Callable[[], object]] = {
        "scipy": lambda: scipy.fft.fft(data, axis=one.axis, overwrite_x=True, workers=WORKERS)
    }
    if find_spec("pyfftw"):
        found["pyfftw"] = _fftw(import_module("pyfftw"), one)
    if find_spec("ducc0"):
        ducc0: Any = import_module("ducc0")
        found["ducc0"] = lambda: ducc0.fft.c2c(data, axes=(one.axis,), out=data, nthreads=WORKERS)
    if find_spec("mkl_fft"):
        mkl: Any = import_module("mkl_fft")
        found["mkl_fft"] = lambda: mkl.fft(data, axis=one.axis, out=data)
    return found


def _fftw(pyfftw: Any, one: Pass) -> Callable[[], object]:
    data = pyfftw.zeros_aligned(one.shape, dtype="complex64")
    plan = pyfftw.FFTW(data, data, axes=(one.axis,), threads=WORKERS, flags=("FFTW_MEASURE",))
    data[:] = 0
    execute: Callable[[], object] = plan.execute
    return execute
