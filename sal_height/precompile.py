"""Kernels compiled on all processors side by side, before a run needs them one after the other."""

from __future__ import annotations

from collections import defaultdict
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from functools import cache
from graphlib import TopologicalSorter
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from numba import types

from sal_height.numeric import available_processors
from sal_height.numeric.jit import LOOPS, NOTICE, is_cached, loops_called
from sal_height.progress import Bar

LIST = Path(__file__).with_name("kernel_types.txt")
"""Kernels that runs of the presets need, with the types of their arguments: one call per line."""

MOST_PROCESSES = 16
"""Processes beyond which the longest kernels alone determine the time; each needs 300 MB."""

Types = tuple[Any, ...]


def precompile() -> int:
    """Compile the kernels of the list that no earlier process has cached; return their number.

    A kernel is compiled after those that it calls, for all its types in one process, because processes that cache
    code of one kernel at the same time would lose some of it.
    """
    missing = {name: calls for name, calls in _listed().items() if not _all_cached(name, calls)}
    if not missing:
        return 0
    order = TopologicalSorter({name: loops_called(_loop(name)) & missing.keys() for name in missing})
    order.prepare()
    processes = min(available_processors(), MOST_PROCESSES, len(missing))
    spawned = get_context("spawn")  # threads of numerical libraries do not survive a fork
    running: dict[Future[None], str] = {}
    with (
        ProcessPoolExecutor(processes, spawned) as pool,
        Bar(total=len(missing), unit="kernel", desc="compiling for this processor, once") as bar,
    ):
        while order.is_active():
            running |= {pool.submit(_compile, name, missing[name]): name for name in order.get_ready()}
            for done in wait(running, return_when=FIRST_COMPLETED).done:
                done.result()
                order.done(running.pop(done))
                bar.update()
    return len(missing)


def _listed() -> dict[str, list[str]]:
    """Kernels of the list, and the texts of the types of each call."""
    calls = defaultdict(list)
    for line in LIST.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            name, _, arguments = line.partition(" ")
            calls[name].append(arguments)
    return dict(calls)


def _all_cached(name: str, calls: list[str]) -> bool:
    return all(is_cached(_loop(name), _types(call)) for call in calls)


def _compile(name: str, calls: list[str]) -> None:
    """Compile a kernel, in a process of the pool."""
    NOTICE.is_given = True  # by the bar
    for call in calls:
        _loop(name).compile(_types(call))


def _loop(name: str) -> Any:
    import_module(name.rpartition(".")[0])
    return LOOPS[name]


@cache
def _types(text: str) -> Types:
    """Types of the arguments, from an expression of the names in `numba.types` and `tuple_of`."""
    arguments: Types = eval(text, {**vars(types), "tuple_of": _tuple_of})  # noqa: S307 (our own file)
    return arguments


def _tuple_of(kinds: list[Any], of_class: str = "") -> Any:
    """The type of tuples, or of named tuples of a class, which its module and name state."""
    module, _, name = of_class.rpartition(".")
    of = getattr(import_module(module), name) if of_class else None
    return types.BaseTuple.from_types(kinds, of)  # type: ignore[no-untyped-call]


if __name__ == "__main__":
    precompile()
