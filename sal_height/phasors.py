"""exp(j phase) of large phases: float64 until only the fraction of a turn is left, float32 from there on."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import numpy.typing as npt

from sal_height.compiled import WORKERS, compiled

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex64]


SMALL = 2**16
"""Numbers that are not worth a thread."""


def phasors(phase: Array) -> ComplexArray:
    """exp(j phase), complex64 and of the shape of `phase` (rad); the error is less than 1e-6."""
    result = np.empty(phase.shape, dtype=np.complex64)
    flat, numbers = np.ascontiguousarray(phase).reshape(-1), result.reshape(-1).view(np.float32)
    share = max(SMALL, -(-flat.size // WORKERS))
    pieces = [slice(first, first + share) for first in range(0, flat.size, share)]
    if len(pieces) == 1:
        _fill(flat, numbers)
    elif pieces:
        with ThreadPoolExecutor(len(pieces)) as pool:
            list(pool.map(lambda piece: _fill(flat[piece], numbers[2 * piece.start : 2 * piece.stop]), pieces))
    return result


@compiled
def cosine_and_sine(turns: float) -> tuple[np.float32, np.float32]:
    """Cosine and sine of 2 pi `turns`, float32, by the series of the half angle, which lies within a quarter turn."""
    y = np.float32(turns - np.floor(turns + 0.5))
    q = y * y
    s = np.float32(-0.599264529321) + q * (np.float32(0.0821458866111) - q * np.float32(0.00737043094571))
    s = y * (np.float32(3.14159265359) + q * (np.float32(-5.16771278005) + q * (np.float32(2.55016403988) + q * s)))
    c = np.float32(0.235330630359) + q * (np.float32(-0.0258068913900) + q * np.float32(0.00192957430940))
    c = np.float32(4.05871212642) + q * (np.float32(-1.33526276885) + q * c)
    c = np.float32(1) + q * (np.float32(-4.93480220054) + q * c)
    return np.float32(1) - np.float32(2) * s * s, np.float32(2) * s * c


@compiled
def _fill(phase: Array, result: npt.NDArray[np.float32]) -> None:
    for i in range(phase.size):
        cosine, sine = cosine_and_sine(phase[i] * 0.15915494309189535)
        result[2 * i] = cosine
        result[2 * i + 1] = sine
