"""BLAS in one thread: its rounding of a product depends on the number of its threads."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock

from threadpoolctl import LibController, OpenBLASController, ThreadpoolController


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
