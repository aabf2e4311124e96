"""Compilation of loops over pixels and samples, and how they are spread over threads."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import njit

Function = TypeVar("Function", bound=Callable[..., Any])

CPU_QUOTA = Path("/sys/fs/cgroup/cpu.max")
"""Where a Linux container states how much processor time it may use: quota and period in microseconds, or "max"."""


def available_processors() -> int:
    """Number of processors this process may use at the same time: by affinity, and by the quota of its container."""
    has_affinity = hasattr(os, "sched_getaffinity")  # not on macOS and Windows
    allowed = len(os.sched_getaffinity(0)) if has_affinity else os.cpu_count() or 1
    try:
        quota, period = map(int, CPU_QUOTA.read_text(encoding="ascii").split())
    except (OSError, ValueError):  # no container, or one without a quota
        return allowed
    return max(1, min(allowed, quota // period))


WORKERS = available_processors()
"""Number of threads that work at the same time."""


def compiled(function: Function) -> Function:
    """Compile the function with numba on its first call, and cache it for later processes.

    The compiled function releases the GIL. It may reorder sums and assumes that all numbers are finite. One simple loop
    per function is compiled best.
    """
    return cast("Function", njit(nogil=True, fastmath=True, error_model="numpy", cache=True)(function))


def compiled_with_nan(function: Function) -> Function:
    """Compile as `compiled` does, but keep the meaning of NaN and of infinities, and the order of sums."""
    return cast("Function", njit(nogil=True, error_model="numpy", cache=True)(function))


def inlined(function: Function) -> Function:
    """Compile the function into the `compiled` functions that call it, which saves the cost of a call."""
    return cast("Function", njit(nogil=True, fastmath=True, error_model="numpy", inline="always")(function))


def in_parallel(work: Callable[[slice], object], count: int, least: int = 1) -> None:
    """Run `work` on slices that together cover `count` items, in as many threads as there are processors.

    Args:
        work: function of a slice; called in several threads at the same time.
        count: number of items.
        least: smallest number of items worth a thread of its own.
    """
    size = max(least, -(-count // WORKERS))
    pieces = [slice(first, min(first + size, count)) for first in range(0, count, size)]
    if len(pieces) == 1:
        work(pieces[0])
    elif pieces:
        with ThreadPoolExecutor(WORKERS) as pool:
            list(pool.map(work, pieces))
