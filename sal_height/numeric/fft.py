"""Lengths and blocks of FFTs of many rows."""

from __future__ import annotations

import numpy as np
import scipy.fft

from sal_height.numeric.arrays import F64

BUFFER = 2**16  # numbers that fit into a processor's cache: half a megabyte


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
