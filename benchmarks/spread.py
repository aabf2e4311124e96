"""Independent parts of a benchmark, each in one of as many processes as there are processors."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import TypeVar
from unittest.mock import patch

from benchmarks.row import sized
from sal_height.numeric import WORKERS

Item = TypeVar("Item")
Result = TypeVar("Result")

PROCESSES = sized(WORKERS, 1)


def in_processes(function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """Results of a function of each item, in the order of the items; function, items and results can be pickled.

    Matrix products have one thread in each process: several would wait for those of the other processes.
    """
    if PROCESSES == 1:
        yield from map(function, items)
        return
    pool = ProcessPoolExecutor(PROCESSES, get_context("spawn"))
    try:
        with patch.dict(os.environ, OPENBLAS_NUM_THREADS="1"):  # processes are started as items are handed in
            results = pool.map(function, items)
        yield from results
    finally:
        pool.shutdown(cancel_futures=True)
