"""Loops over pixels and samples, compiled: vectorised, and beside other threads."""

from __future__ import annotations

import os
from collections.abc import Callable
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
