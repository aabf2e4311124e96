"""Processes that start from the imports and tables of this one, and signals that wait for an orderly end."""

from __future__ import annotations

import ctypes
import gc
import os
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import FrameType, TracebackType
from typing import Self

from sal_height.errors import UserError

ONE_BLAS_THREAD = {"OPENBLAS_NUM_THREADS": "1"}
"""Matrices of a dwell are small: products of them are slower in several threads than in one."""

ONE_THREAD = {"SAL_HEIGHT_THREADS": "1", **ONE_BLAS_THREAD}
"""Environment of nodes in processes of their own: these share the processors among them, one thread each."""

PR_SET_PDEATHSIG, PR_SET_NAME = 1, 15
"""Options of prctl (Linux): the signal that a process gets when the one that started it ends; its name in lists."""

ENDING = tuple(signal.Signals[name] for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Signals that ask a process to end; Windows has no SIGHUP."""


def use_one_thread() -> None:
    """Work in one thread, and so do the processes that this one starts, unless the environment says otherwise.

    It has an effect before NumPy is imported only. Without other threads, `Forked` can be used.
    """
    os.environ.update(ONE_THREAD | os.environ)


def use_one_blas_thread() -> None:
    """Multiply matrices in one thread, unless the environment says otherwise; before NumPy is imported."""
    os.environ.update(ONE_BLAS_THREAD | os.environ)


def prepare_for_messages() -> None:
    """Have this process, and those that it starts, exchange many large messages at little cost; on Linux."""
    if sys.platform.startswith("linux"):
        _wake_without_preempting()
        _keep_freed_memory()


def _wake_without_preempting() -> None:
    """Have this thread, and those that it starts, wait for a processor where all are busy.

    Messages wake the threads that receive them. One that takes the processor from the thread that publishes goes to
    sleep again after each message; one that waits for a few milliseconds finds several messages, and wakes once.
    """
    if hasattr(os, "sched_setscheduler"):
        with suppress(OSError):  # a container may not allow it
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


def _keep_freed_memory() -> None:
    """Use freed memory again, of arrays and of messages, instead of giving it back to the system at once.

    By default glibc gives back more than some 100 kB at the end of its memory. All pages of the next message are then
    new ones, which takes longer than to copy the message.
    """
    trim_threshold, mmap_threshold = -1, -3  # options of mallopt(3)
    largest = 32 * 1024 * 1024  # bytes of an array that is allocated among others, the most that glibc allows
    if mallopt := getattr(ctypes.CDLL(None), "mallopt", None):  # other C libraries do not have it
        mallopt(mmap_threshold, largest)
        mallopt(trim_threshold, 4 * largest)


def can_fork() -> bool:
    """True if a process can go on with the memory of this one.

    Neither Python nor the middleware may have other threads, which a copy lacks and might wait for; nor may NumPy have
    been imported to use any. The two that LTTng starts with rclpy only wait for its tools.
    """
    tasks = Path("/proc/self/task")  # Linux
    limited = all(os.environ.get(name) == count for name, count in ONE_THREAD.items())
    if not (limited and tasks.is_dir() and threading.active_count() == 1):
        return False
    names = [(task / "comm").read_text(encoding="utf-8") for task in tasks.iterdir()]
    return not any(name.startswith("dds") for name in names)


def name_process(name: str) -> None:
    """Have lists of processes show this one by a name, of which they keep 15 bytes."""
    ctypes.CDLL(None).prctl(PR_SET_NAME, name.encode()[:15])


def end_with_parent(parent: int, number: signal.Signals) -> bool:
    """Have this process get a signal when its parent ends, even if that is killed.

    Args:
        parent: number of the parent's process.
        number: signal that it gets.

    Returns:
        False if the parent has ended already.
    """
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, number)
    return os.getppid() == parent


def process_age_s() -> float:
    """Time since the start of this process, s, to some 10 ms (Linux)."""
    fields = Path("/proc/self/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    began_s = int(fields[19]) / os.sysconf("SC_CLK_TCK")  # field 22, starttime, proc(5)
    return time.clock_gettime(time.CLOCK_BOOTTIME) - began_s


def cpu_of_thread(thread: threading.Thread) -> float:
    """Processor time of a thread, s; 0: it does not run."""
    if thread.ident is None or not thread.is_alive():
        return 0.0
    return time.clock_gettime(time.pthread_getcpuclockid(thread.ident))


class Forked:
    """A copy of this process that runs a function; used as a `subprocess.Popen` is.

    It has a process group of its own, so that Ctrl-C does not reach it, the signal handlers of a new process, and ends
    without what this one does at its end. It stays in the session: Linux divides the processors among sessions first
    (sched_autogroup), and nodes in sessions of their own would get equal parts, whatever their work needs.

    Attributes:
        pid: number of the process.
        returncode: exit status, or minus the number of the signal that ended it; None: it runs.
    """

    def __init__(self, run: Callable[[], int], name: str) -> None:
        """Start the process.

        Args:
            run: function that returns the exit status.
            name: name of the process, in lists of processes.

        Raises:
            OSError: there cannot be another process.
        """
        self.returncode: int | None = None
        sys.stdout.flush()
        sys.stderr.flush()
        gc.freeze()  # what lives now lives on: looking through it would copy its memory
        # What a handler raises while Python runs its hooks of a fork is lost: signals wait until these have run.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
        try:
            self.pid = os.fork()
            if self.pid == 0:
                _run_alone(run, name, before)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    def poll(self) -> int | None:
        """The exit status, if the process has ended."""
        if self.returncode is None:
            ended, status = os.waitpid(self.pid, os.WNOHANG)
            if ended:
                self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode

    def wait(self, timeout: float) -> int:
        """Wait until it has ended.

        Raises:
            subprocess.TimeoutExpired: it has not within `timeout` seconds.
        """
        deadline = time.monotonic() + timeout
        while (status := self.poll()) is None:
            if time.monotonic() > deadline:
                raise subprocess.TimeoutExpired(f"process {self.pid}", timeout)
            time.sleep(0.02)
        return status

    def terminate(self) -> None:
        """Ask it to end."""
        self._send(signal.SIGTERM)

    def kill(self) -> None:
        """End it."""
        self._send(signal.SIGKILL)

    def _send(self, number: signal.Signals) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)


def run_in_copy(run: Callable[[], int], name: str) -> Forked | None:
    """Have a function run in a copy of this process, which ends with this one; if it cannot fork, run it here.

    Args:
        run: function that returns the exit status; a UserError is written to stderr, and the status is 2.
        name: name of the copy, in lists of processes.

    Returns:
        The copy; None: the function has been run.

    Raises:
        UserError: the function did, here, or there cannot be another process.
    """
    if not can_fork():
        run()
        return None
    parent = os.getpid()

    def run_while_needed() -> int:
        if not end_with_parent(parent, signal.SIGKILL):
            return 1
        try:
            return run()
        except UserError as error:
            sys.stderr.write(f"{error}\n")
            return 2

    try:
        return Forked(run_while_needed, name)
    except OSError as error:
        raise UserError(f"The {name} cannot be started in a process of its own: {error.strerror}.") from error


def _run_alone(run: Callable[[], int], name: str, mask: set[int]) -> None:
    """Run a function in a process that has just been forked, with a mask of signals, and end it."""
    status = 1
    try:
        os.setpgrp()
        for number in ENDING:
            if signal.getsignal(number) != signal.SIG_IGN:
                signal.signal(number, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        sys.stdout, sys.stderr = sys.__stdout__, sys.__stderr__  # a display of the original may have put itself before
        name_process(name)
        status = run()
    except SystemExit as ended:
        status = ended.code if isinstance(ended.code, int) else 1
    except BaseException:  # noqa: BLE001 (the copy must not go on as the original does)
        traceback.print_exc()
    finally:
        with suppress(Exception):  # nobody may read it any more
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(status)


class Interruption:
    """While it is entered, SIGINT, SIGTERM and SIGHUP wait until `check`, so that they never cut a message in two.

    SIGHUP stays ignored where the caller wants it so (nohup).
    """

    def __init__(self) -> None:
        self._asked = False

    def check(self) -> None:
        """Raise KeyboardInterrupt if a signal has arrived."""
        if self._asked:
            raise KeyboardInterrupt

    def __enter__(self) -> Self:
        hangup = getattr(signal, "SIGHUP", None)
        numbers = [number for number in ENDING if number != hangup or signal.getsignal(number) != signal.SIG_IGN]
        self._before = {number: signal.signal(number, self._ask) for number in numbers}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _ask(self, _number: int, _frame: FrameType | None) -> None:
        self._asked = True
