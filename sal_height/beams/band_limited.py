"""Functions of two offsets that an aperture limits in band, evaluated anywhere from samples on a grid.

With offsets in beamwidths, an aperture of diameter 1 passes spatial frequencies of up to 1/2 only. By Bernstein's
inequality the n-th derivative of such a function along an axis is at most pi^n times its greatest modulus, so that a
Lagrange polynomial through NODES samples, STEP apart, errs by less than 1e-11 of it (3e-11 in two dimensions).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from sal_height.numeric import F64, compiled, in_parallel

Samples = npt.NDArray[Any]
Sampler = Callable[[F64, F64], Samples]
"""From grid coordinates x and y (beamwidths) to values (float64 or complex128), shape (len(x), len(y))."""

NODES = 8
STEP = 1 / 32

BLOCK = 1 << 20
"""Values that are interpolated at once."""

FEW_SAMPLES, MOST_SAMPLES = 1 << 15, 1 << 20
SPARSE = 64
"""Samples per value, as many as a lone one needs: a region with more, and not FEW_SAMPLES, is split."""

LEAST = 1 << 14
"""Values that are worth a thread."""


def interpolated(sampler: Sampler, dtype: npt.DTypeLike, e: npt.ArrayLike, a: npt.ArrayLike) -> Samples:
    """The function that `sampler` samples, at offsets `e` and `a` in beamwidths, which broadcast.

    Samples are taken of the region that the offsets cover, or of parts of it where that is large. Values are of
    `dtype`, float64 or complex128; NaN where an offset is not finite.
    """
    e, a = np.broadcast_arrays(np.asarray(e, dtype=np.float64), np.asarray(a, dtype=np.float64))
    values = np.empty(e.size, dtype=dtype)
    for first in range(0, e.size, BLOCK):
        block = slice(first, first + BLOCK)
        values[block] = _block(sampler, dtype, e.flat[block], a.flat[block])
    return values.reshape(e.shape)


def _block(sampler: Sampler, dtype: npt.DTypeLike, e: F64, a: F64) -> Samples:
    values = np.full(e.size, np.nan, dtype=dtype)
    finite = np.isfinite(e) & np.isfinite(a)
    if np.all(finite) and _is_worth(e, a):
        return _from_region(sampler, dtype, e, a)
    waiting = [np.flatnonzero(finite)] if np.any(finite) else []
    while waiting:
        some = waiting.pop()
        if _is_worth(e[some], a[some]):
            values[some] = _from_region(sampler, dtype, e[some], a[some])
        else:
            wider = max(e[some], a[some], key=np.ptp)
            lower = wider < (wider.min() + wider.max()) / 2
            waiting += [some[lower], some[~lower]]
    return values


def _is_worth(e: F64, a: F64) -> bool:
    samples = (np.ptp(e) / STEP + NODES) * (np.ptp(a) / STEP + NODES)
    return bool(samples <= min(MOST_SAMPLES, max(FEW_SAMPLES, SPARSE * e.size)))


def _from_region(sampler: Sampler, dtype: npt.DTypeLike, e: F64, a: F64) -> Samples:
    x, y = _nodes_around(e), _nodes_around(a)
    table = np.ascontiguousarray(sampler(x * STEP, y * STEP), dtype=dtype)
    values = np.empty(e.size, dtype=dtype)
    in_parallel(lambda part: _interpolate(table, x[0], y[0], e[part], a[part], values[part]), e.size, LEAST)
    return values


def _nodes_around(x: F64) -> F64:
    """Multiples of STEP, NODES / 2 of them on each side of every offset, even one that rounds up to the next."""
    low, high = np.floor(np.array([x.min(), x.max()]) / STEP)
    return np.arange(low - (NODES // 2 - 1), high + NODES // 2 + 2)


_SCALE = 1 / np.array([np.prod([float(j - m) for m in range(NODES) if m != j]) for j in range(NODES)])


@compiled
def _interpolate(table: Samples, first_x: float, first_y: float, e: F64, a: F64, values: Samples) -> None:
    across = np.empty(NODES)
    along = np.empty(NODES)
    for i in range(len(e)):
        row = _weigh(e[i] / STEP - first_x, along)
        col = _weigh(a[i] / STEP - first_y, across)
        total = 0 * table[0, 0]
        for j in range(NODES):
            line = 0 * total
            for k in range(NODES):
                line += across[k] * table[row + j, col + k]
            total += along[j] * line
        values[i] = total


@compiled
def _weigh(place: float, weights: F64) -> int:
    """Lagrange weights of the NODES samples around a place counted in samples, and the number of the first."""
    first = int(place) - (NODES // 2 - 1)
    before = 1.0
    for j in range(NODES):
        weights[j] = before * _SCALE[j]
        before *= place - first - j
    after = 1.0
    for j in range(NODES - 1, -1, -1):
        weights[j] *= after
        after *= place - first - j
    return first
