"""Loops over pixels and samples, compiled: vectorised, and beside other threads."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar, cast

from numba import njit

Function = TypeVar("Function", bound=Callable[..., Any])

WORKERS = len(os.sched_getaffinity(0))
"""Threads that work at the same time."""


def compiled(function: Function) -> Function:
    """The function compiled by numba on its first call, and kept for the next process; without the GIL.

    Sums may be reordered, and numbers are taken to be finite. Works fastest on one simple loop.
    """
    return cast("Function", njit(nogil=True, fastmath=True, error_model="numpy", cache=True)(function))


def inlined(function: Function) -> Function:
    """The function as a part of the `compiled` ones that call it: what a call costs, small ones save."""
    return cast("Function", njit(nogil=True, fastmath=True, error_model="numpy", inline="always")(function))


def in_parallel(work: Callable[[slice], object], count: int, least: int = 1) -> None:
    """Do `work` on slices that make up `count` items, one for each processor but of `least` items or more."""
    size = max(least, -(-count // WORKERS))
    pieces = [slice(first, min(first + size, count)) for first in range(0, count, size)]
    if len(pieces) == 1:
        work(pieces[0])
    elif pieces:
        with ThreadPoolExecutor(WORKERS) as pool:
            list(pool.map(work, pieces))
