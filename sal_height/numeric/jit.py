"""Compilation of loops over pixels and samples."""

from __future__ import annotations

import hashlib
import logging
import math
import time
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import njit
from numba.core import event
from numba.core.dispatcher import Dispatcher

Function = TypeVar("Function", bound=Callable[..., Any])

_LOG = logging.getLogger(__name__)


class Progress(event.Listener):
    """Reports compilation of functions, which takes a minute for all of them at the first start on a machine.

    Attributes:
        functions: functions that are compiled on their first call.
        done: functions that this process has compiled, for any types; all others are not needed, or are cached.
    """

    def __init__(self) -> None:
        self.functions: set[Callable[..., Any]] = set()
        self.done: set[Callable[..., Any]] = set()
        self._reported_at = -math.inf

    def on_start(self, _: event.Event) -> None:
        """Report it, every five seconds at most."""
        if time.monotonic() - self._reported_at > 5.0:
            self._reported_at = time.monotonic()
            _LOG.warning(
                "Compiling for this processor, once: %d functions done, %d at most.",
                len(self.done),
                len(self.functions),
            )

    def on_end(self, ended: event.Event) -> None:
        """Count the function if it is one of ours; numba compiles its own functions in the same way."""
        self.done |= self.functions & {ended.data["dispatcher"].py_func}


PROGRESS = Progress()
event.register("numba:compile", PROGRESS)  # type: ignore[no-untyped-call]


def compiled(function: Function) -> Function:
    """Compile the function with numba on its first call, and cache it for later processes.

    The compiled function releases the GIL. It may reorder sums and assumes that all numbers are finite. One simple loop
    per function gives the fastest code.
    """
    return _cached(function, fastmath=True)


def compiled_with_nan(function: Function) -> Function:
    """Compile as `compiled` does, but keep the meaning of NaN and of infinities, and the order of sums.

    Powers and np.hypot are forbidden in it (`squared` instead): numba makes one loop of these for all functions of a
    process, and if a `compiled` function was the first to need it, it assumes that all numbers are finite.
    """
    return _cached(function, fastmath=False)


def inlined(function: Function) -> Function:
    """Compile the function into the `compiled` functions that call it, which saves the cost of a call."""
    return cast("Function", njit(nogil=True, fastmath=True, error_model="numpy", inline="always")(function))


def _cached(function: Function, *, fastmath: bool) -> Function:
    """Compile the function, and compile it again when one of those that it calls has changed.

    Numba itself asks only whether the file of the function has changed, although the code that it stores contains that
    of the functions of other files, and their constants.
    """
    PROGRESS.functions.add(function)
    loop: Any = njit(nogil=True, fastmath=fastmath, error_model="numpy", cache=True)(function)
    if loop is not function:  # NUMBA_DISABLE_JIT leaves the function as it is
        loop._cache._cache_file._source_stamp = sorted(set(_sources(function, set())))  # noqa: SLF001 (no other way)
    return cast("Function", loop)


def _sources(function: Callable[..., Any], seen: set[Callable[..., Any]]) -> Iterator[str]:
    """Sources of the code of a function: the files of it and of those that it calls, and their constants."""
    seen.add(function)
    yield _digest(function.__code__.co_filename)
    for name, value in function.__globals__.items():
        if isinstance(value, Dispatcher) and value.py_func not in seen:
            yield from _sources(value.py_func, seen)
        elif isinstance(value, int | float):
            yield f"{name}={value}"


@cache
def _digest(file: str) -> str:
    return hashlib.sha256(Path(file).read_bytes()).hexdigest()


@inlined
def squared(number: float) -> float:
    """The square of a number, also in functions with NaN (`compiled_with_nan`)."""
    return number * number
