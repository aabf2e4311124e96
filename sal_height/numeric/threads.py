"""Work in several threads, as many as the process may use, which are started once and kept; BLAS in one thread."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import TypeVar

from threadpoolctl import LibController, OpenBLASController, ThreadpoolController

from sal_height.errors import UserError

Result = TypeVar("Result")

CONTROL_GROUPS = Path("/sys/fs/cgroup")
"""Folder in which a Linux container states its quota of processor time."""

THREADS_VARIABLE = "SAL_HEIGHT_THREADS"
"""Environment variable with a number of threads other than the number of processors."""


def available_processors() -> int:
    """Number of processors this process may use at the same time: by affinity, and by the quota of its container."""
    has_affinity = hasattr(os, "sched_getaffinity")  # not on macOS and Windows
    allowed = len(os.sched_getaffinity(0)) if has_affinity else os.cpu_count() or 1
    return min(allowed, _quota() or allowed)


def _quota() -> int | None:
    """Whole processors in the container's quota, at least 1; None: no container, or one without a quota.

    In version 2 of control groups one file has quota and period in microseconds, or "max" and the period; in version
    1 there is a file for each, and -1 is no quota.
    """
    for names in (("cpu.max",), ("cpu/cpu.cfs_quota_us", "cpu/cpu.cfs_period_us")):
        try:
            words = " ".join((CONTROL_GROUPS / name).read_text(encoding="ascii") for name in names)
            quota, period = map(int, words.split())
        except (OSError, ValueError):
            continue
        return max(1, quota // period) if quota > 0 else None
    return None


def number_of_threads() -> int:
    """Number of threads: that of THREADS_VARIABLE, or else of `available_processors`.

    Raises:
        UserError: the variable is not a whole number from 1 on.
    """
    wanted = os.environ.get(THREADS_VARIABLE, "")
    if not wanted:
        return available_processors()
    if not (wanted.isdecimal() and int(wanted) > 0):
        raise UserError(f"{THREADS_VARIABLE} is {wanted!r}; it must be a number of threads, 1 or more.")
    return int(wanted)


WORKERS = number_of_threads()
"""Number of threads that work at the same time on the request of one thread, itself included."""


@lru_cache(maxsize=1)
def _helpers() -> ThreadPoolExecutor:
    """The threads that help all others, one less than WORKERS."""
    return ThreadPoolExecutor(WORKERS - 1, "sal_height")


if hasattr(os, "register_at_fork"):  # not on Windows
    os.register_at_fork(after_in_child=_helpers.cache_clear)  # threads do not live on in a forked process


def in_threads(work: Callable[..., Result], *arguments: Iterable[object]) -> list[Result]:
    """The results of `work` for each of the arguments, as `map` gives them, computed in WORKERS threads.

    The calling thread takes part, and waits for nothing that has not started: work may itself call this function. An
    exception of `work` is raised here; work that has not started then is not done.
    """
    tasks = list(zip(*arguments, strict=True))
    results: dict[int, Result] = {}
    numbers, lock = iter(range(len(tasks))), Lock()

    def take_part() -> None:
        try:
            while True:
                with lock:
                    number = next(numbers, None)
                if number is None:
                    return
                results[number] = work(*tasks[number])
        except BaseException:
            with lock:
                for _ in numbers:  # nothing is left to start
                    pass
            raise

    helpers = [_helpers().submit(take_part) for _ in range(min(WORKERS, len(tasks)) - 1)]
    try:
        take_part()
    finally:
        started = [helper for helper in helpers if not helper.cancel()]
        errors = [helper.exception() for helper in started]
    for error in errors:
        if error is not None:
            raise error
    return [results[number] for number in range(len(tasks))]


def in_parallel(work: Callable[[slice], object], count: int, least: int = 1) -> None:
    """Run `work` on slices that together cover `count` items, in as many threads as there are processors.

    Another thread costs 0.1 ms of processor time: work of less than a few times that is best done in one.

    Args:
        work: function of a slice; called in several threads at the same time.
        count: number of items.
        least: smallest number of items for which another thread pays.
    """
    size = max(least, -(-count // WORKERS))
    if count > size:
        in_threads(work, [slice(first, min(first + size, count)) for first in range(0, count, size)])
    elif count:
        work(slice(0, count))


class _Limit:
    """One thread for every BLAS library of the process, while a thread of ours requires it.

    Attributes:
        lock: lock for the other attributes.
        users: number of threads that require it.
        libraries: libraries that are loaded; empty before the first user.
        before: numbers of threads of the libraries, to be restored after the last user; empty if all have one.
    """

    def __init__(self) -> None:
        self.lock = Lock()
        self.users = 0
        self.libraries: list[LibController] = []
        self.before: list[int] = []

    def enter(self) -> None:
        with self.lock:
            self.users += 1
            if self.users == 1:
                self.libraries = self.libraries or ThreadpoolController().select(user_api="blas").lib_controllers
                numbers = [library.num_threads or 1 for library in self.libraries]
                self.before = numbers if max(numbers, default=1) > 1 else []
                self._set([1] * len(self.before))

    def leave(self) -> None:
        with self.lock:
            self.users -= 1
            if self.users == 0:
                self._set(self.before)

    def _set(self, numbers: list[int]) -> None:
        if not numbers:
            return
        # OpenBLAS accepts a number from one thread alone until that releases it; the lock allows the owner to set it.
        for library, number in zip(self.libraries, numbers, strict=False):
            OpenBLASController.clear_controlling_thread(force=True)
            library.set_num_threads(number)
        OpenBLASController.clear_controlling_thread(force=True)


_limit = _Limit()


def _start_again() -> None:
    """Reset the limit in a forked process, which has no other threads."""
    global _limit  # noqa: PLW0603 (one for the process)
    _limit = _Limit()


if hasattr(os, "register_at_fork"):  # not on Windows
    os.register_at_fork(after_in_child=_start_again)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Multiply matrices in one thread of BLAS, in all threads of this process.

    Products then have the same bits on machines of any number of processors. They are small here: several threads of
    BLAS would mostly wait for each other, in addition to our own threads (`in_threads`). It applies to threads of BLAS
    itself, as in the wheels of NumPy and SciPy, not to threads of OpenMP.
    """
    limit = _limit
    limit.enter()
    try:
        yield
    finally:
        limit.leave()
