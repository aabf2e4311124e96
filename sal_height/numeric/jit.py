"""Compilation of loops over pixels and samples."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import njit

Function = TypeVar("Function", bound=Callable[..., Any])


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
