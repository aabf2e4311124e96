"""The process that starts workers, and workers where no process can be forked."""

from __future__ import annotations

import gc
import json
import mmap
import multiprocessing
import os
import signal
import socket
import sys
import time
import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from multiprocessing.connection import Connection

from sal_height.engine.stage import Stage
from sal_height.workers.arena import Arena
from sal_height.workers.processes import Forked, end_with_parent, name_process
from sal_height.workers.sending import Worker
from sal_height.workers.serving import serve


def can_keep_workers() -> bool:
    """True where workers can start as copies of this process and end with it: by fork(2) and prctl(2), on Linux."""
    return sys.platform.startswith("linux") and hasattr(os, "fork")


RESTART_S = 0.1
"""Time from the end of a worker to the start of the next one, s."""


class Keeper:
    """A process that starts workers, and another one whenever one has ended.

    It has no thread but its own, so that workers start at any time with all that this process had loaded at first.

    Attributes:
        starts: socket that can be read once a worker has started.
    """

    def __init__(self, workers: int, arena: Arena, stages: Mapping[str, Stage], niceness: int = 0) -> None:
        """Start the process.

        Args:
            workers: number of workers.
            arena: memory that they share with this process.
            stages: stages that they have at first, by name, in the state of this process.
            niceness: degree to which they give way to other processes, as in nice(1).

        Raises:
            OSError: the process cannot be started.
        """
        self.starts, theirs = socket.socketpair()
        parent = os.getpid()

        def keep() -> int:
            self.starts.close()
            if not end_with_parent(parent, signal.SIGKILL):
                return 1
            os.nice(niceness)
            with suppress(OSError):  # the parent notices the end
                _keep_workers(theirs, workers, arena, stages)
            return 1

        try:
            self._process = Forked(keep, "workers")
        except OSError:
            self.starts.close()
            raise
        finally:
            theirs.close()

    def started_worker(self) -> Worker:
        """The next worker that has started, once one has.

        Raises:
            RuntimeError: the process that starts workers has ended.
        """
        said, handles, _, _ = socket.recv_fds(self.starts, 4096, 1)
        if not handles:
            raise RuntimeError("the process that starts workers has ended")
        return Worker(**json.loads(said), pipe=Connection(handles[0]))

    def close(self) -> None:
        """End the process, and the workers with it."""
        self._process.kill()
        self._process.wait(10.0)
        self.starts.close()
        gc.unfreeze()  # `Forked` has frozen what this process had then


def _keep_workers(starts: socket.socket, workers: int, arena: Arena, stages: Mapping[str, Stage]) -> None:
    """Start workers, and another one whenever one has ended, until this process is killed.

    Args:
        starts: socket that the number of each worker, and the connection to it, are written to.
        workers: number of workers.
        arena: memory that they share.
        stages: stages that they have at first, by name.

    Raises:
        OSError: one of the first workers cannot be started.
    """
    keeper = os.getpid()
    numbers: dict[int, int] = {}

    def serve_alone(number: int, pipe: socket.socket) -> None:
        if end_with_parent(keeper, signal.SIGKILL):
            name_process(f"worker {number}")
            serve(Connection(pipe.detach()), arena, stages)

    def start(number: int) -> None:
        numbers[_started(starts, number, serve_alone)] = number

    for number in range(workers):
        start(number)
    while True:
        ended, _ = os.wait()
        number = numbers.pop(ended)
        while number not in numbers.values():
            time.sleep(RESTART_S)
            with suppress(OSError):  # there is no memory for it yet, as often where a worker has ended for lack of it
                start(number)


def _started(starts: socket.socket, number: int, work: Callable[[int, socket.socket], None]) -> int:
    """Start a worker.

    Args:
        starts: socket that its number, and the connection to it, are written to.
        number: number of the worker.
        work: function of the number and of the other end of the connection, which the worker runs.

    Returns:
        The number of its process.

    Raises:
        OSError: it cannot be started, or nobody can be notified of it.
    """
    ours, theirs = socket.socketpair()
    with ours, theirs:
        pid = os.fork()
        if pid == 0:
            try:
                starts.close()
                ours.close()
                work(number, theirs)
            except ConnectionError:
                pass  # whoever reads the results has ended
            except BaseException:  # noqa: BLE001 (the copy must not go on as the original does)
                traceback.print_exc()
            finally:
                os._exit(0)
        try:
            socket.send_fds(starts, [json.dumps({"number": number, "pid": pid}).encode()], [ours.fileno()])
        except OSError:
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
            raise
    return pid


class Spawned:
    """Workers that start as new programs with copies of stages, for where there is no fork; they share no memory."""

    def __init__(self, workers: int, stages: Mapping[str, Stage]) -> None:
        """Start the workers.

        Args:
            workers: number of workers.
            stages: stages that they have at first, by name.
        """
        context = multiprocessing.get_context("spawn")
        self._started = []
        for number in range(workers):
            ours, theirs = context.Pipe()
            process = context.Process(target=_serve_spawned, args=(theirs, stages), daemon=True)
            process.start()
            theirs.close()
            self._started.append((process, Worker(number, process.pid or 0, ours)))
        self._waiting = [worker for _, worker in self._started]

    def started_worker(self) -> Worker:
        """The next worker that has started."""
        return self._waiting.pop(0)

    def close(self) -> None:
        """End the workers."""
        for process, _ in self._started:
            process.kill()
            process.join()


def no_shared_memory() -> Arena:
    """Memory that is smaller than any array that would be sent through it: all arrays go through pipes."""
    return Arena(mmap.PAGESIZE)


def _serve_spawned(pipe: Connection, stages: Mapping[str, Stage]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends it to all; the parent ends in order
    serve(pipe, no_shared_memory(), stages)
