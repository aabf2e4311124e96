"""Compilation of loops over pixels and samples."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import njit
from numba.core import event
from numba.core.dispatcher import Dispatcher

Function = TypeVar("Function", bound=Callable[..., Any])

_LOG = logging.getLogger(__name__)


LOOPS: dict[str, Any] = {}
"""Loops that are compiled for each set of argument types on the first call, by module and name."""


class CompilationNotice(event.Listener):
    """Reports, once per process, that kernels are being compiled; attribute `is_given` is true from then on."""

    def __init__(self) -> None:
        self.is_given = False

    def on_start(self, _: event.Event) -> None:
        """Report it."""
        if not self.is_given:
            self.is_given = True
            _LOG.warning("Compiling kernels for this processor, once: the first run takes up to two minutes longer.")

    def on_end(self, ended: event.Event) -> None:
        """Do nothing."""


NOTICE = CompilationNotice()
event.register("numba:compile", NOTICE)  # type: ignore[no-untyped-call]


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
    loop: Any = njit(nogil=True, fastmath=fastmath, error_model="numpy", cache=True)(function)
    if loop is not function:  # NUMBA_DISABLE_JIT leaves the function as it is
        loop._cache._cache_file._source_stamp = sorted(set(_sources(function, set())))  # noqa: SLF001 (no other way)
        LOOPS[_name_of(function)] = loop
    return cast("Function", loop)


def is_cached(loop: Any, types: tuple[Any, ...]) -> bool:
    """True if an earlier process has compiled the loop for arguments of these numba types.

    It reads the index only, and no code.
    """
    key = loop._cache._index_key(types, loop.targetctx.codegen())  # noqa: SLF001 (no other way)
    return key in loop._cache._cache_file._load_index()  # noqa: SLF001


def loops_called(loop: Any) -> set[str]:
    """Names of the loops that a loop calls, directly or by functions that are inlined into it."""
    called = set()
    for name in loop.py_func.__code__.co_names:
        value = loop.py_func.__globals__.get(name)
        if isinstance(value, Dispatcher):
            full_name = _name_of(value.py_func)
            called |= {full_name} if full_name in LOOPS else loops_called(value)
    return called


def _name_of(function: Callable[..., Any]) -> str:
    return f"{function.__module__}.{function.__name__}"


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
