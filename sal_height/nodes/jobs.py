"""The bounded queue of work between a node's callbacks and its worker thread, or the workers of a pool."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from typing import Any, Literal, NamedTuple

from sal_height.nodes.transport.services import Said

QueuePolicy = Literal["oldest", "newest"]
"""Job that is dropped when there are too many: the one that waits longest, or the one that arrives."""


class QueuedJob(NamedTuple):
    """Work of a node.

    Attributes:
        run: function that does the work, and returns the number of messages that it has published.
        messages: number of messages that it consumes; 0: it is work of the node's own, which is never left out.
        size: size of these messages, bytes.
        item: data that is worked on, for work that looks ahead and for workers.
        complete_s: time at which its dwell was complete, s of the monotonic clock.
        answer: answer of a service that is sent once the work is done; None: nobody waits for one.
    """

    run: Callable[[], int]
    messages: int
    size: int = 0
    item: Any = None
    complete_s: float = 0.0
    answer: Future[Said] | None = None


class JobQueue:
    """Jobs in the order in which they were put; safe to use from several threads."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._waiting: deque[QueuedJob] = deque()
        self._waiting_size = 0
        self._running = 0
        self._closed = False

    def put(self, job: QueuedJob, capacity: int, capacity_bytes: float, policy: QueuePolicy) -> list[QueuedJob]:
        """Append a job, unless there is no room for it; a queue without any job accepts every job.

        Args:
            job: job to append.
            capacity: greatest number of jobs with messages that may wait, without the one that runs.
            capacity_bytes: greatest sum of their sizes, bytes.
            policy: choice of the jobs that are dropped to make room.

        Returns:
            The jobs that were dropped.
        """
        with self._changed:
            if self._closed:
                return [job]
            dropped: list[QueuedJob] = []
            while job.messages and self._is_full(job, capacity, capacity_bytes):
                if policy == "newest":
                    return [job]
                dropped.append(self._take(next(self._droppable())))
            self._waiting.append(job)
            self._waiting_size += job.size
            self._changed.notify()
            return dropped

    def get(self) -> QueuedJob | None:
        """Wait for the next job; the one before it is done. None: the queue is closed and empty."""
        with self._changed:
            self._running = 0
            self._changed.wait_for(lambda: self._waiting or self._closed)
            self._running = int(bool(self._waiting))
            return self._take() if self._waiting else None

    def take(self, most: int, most_bytes: int, suits: Callable[[Any], bool]) -> list[QueuedJob]:
        """The next jobs, as long as their items suit, up to so many and so many bytes, or one.

        None overtakes another one that does not suit: jobs are finished in the order in which they are taken. Each runs
        until `note_done`.
        """
        with self._changed:
            taken, size = list[QueuedJob](), 0
            while self._waiting and len(taken) < most and suits(self._waiting[0].item):
                size += self._waiting[0].size
                if taken and size > most_bytes:
                    break
                taken.append(self._take())
            self._running += len(taken)
            return taken

    def note_done(self) -> None:
        """One of the jobs that were taken is done."""
        with self._changed:
            self._running -= 1
            self._changed.notify_all()

    def wait_until_done(self, timeout_s: float) -> bool:
        """Wait until no job waits or runs; False: some do after that time."""
        with self._changed:
            return self._changed.wait_for(lambda: not (self._waiting or self._running), timeout_s)

    def close(self) -> None:
        """Accept no more jobs; those that wait are still handed out."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def clear(self) -> list[QueuedJob]:
        """Drop all jobs that wait, and return them."""
        with self._changed:
            dropped = [*self._waiting]
            self._waiting.clear()
            self._waiting_size = 0
            return dropped

    def items(self) -> list[Any]:
        """Items of the jobs that wait, in their order."""
        with self._changed:
            return [job.item for job in self._waiting if job.item is not None]

    @property
    def closed(self) -> bool:
        """True if no more jobs are accepted."""
        return self._closed

    @property
    def waiting(self) -> int:
        """Number of jobs that wait."""
        return len(self._waiting)

    @property
    def unfinished(self) -> int:
        """Number of jobs that wait or run."""
        with self._changed:
            return len(self._waiting) + self._running

    def _is_full(self, job: QueuedJob, capacity: int, capacity_bytes: float) -> bool:
        count = sum(1 for _ in self._droppable())
        return count > 0 and (count >= capacity or self._waiting_size + job.size > capacity_bytes)

    def _droppable(self) -> Iterator[int]:
        """Places of the jobs that wait and have messages, the oldest first."""
        return (place for place, job in enumerate(self._waiting) if job.messages)

    def _take(self, place: int = 0) -> QueuedJob:
        job = self._waiting[place]
        del self._waiting[place]
        self._waiting_size -= job.size
        return job
