"""Nodes of one process that share its workers and hand items to each other as they are: the live host."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, Protocol

from sal_height.engine.results import Result
from sal_height.engine.stage import Job, Port
from sal_height.errors import Rejected
from sal_height.nodes.jobs import JobQueue, QueuedJob
from sal_height.nodes.transport.endpoints import Inlet, Outlet
from sal_height.nodes.worker import WorkerNode
from sal_height.workers.pool import Suits

Conclude = Callable[[Job, Sequence[Result], float, float], int]
"""Function of a job, its results, the time at which its dwell was complete, s, and the processor time that it took, s.

It publishes the results and returns the number of messages; it raises Rejected if the stage has left the job out.
"""


class PooledJobs:
    """The jobs of a node, as a pool processes them."""

    def __init__(self, node: WorkerNode, kind: str, jobs: JobQueue, conclude: Conclude) -> None:
        """Give the pool jobs from the queue of a node, whose stage is of a kind, and publish their results."""
        self._node, self._jobs, self._conclude = node, jobs, conclude
        self.kind, self.name = kind, node.get_fully_qualified_name()

    @property
    def waiting_jobs(self) -> int:
        """Number of jobs that wait."""
        return self._jobs.waiting

    def take_jobs(self, most: int, most_bytes: int, suits: Suits, ahead_s: float) -> Sequence[QueuedJob]:
        """The next jobs that suit a worker; those that cannot be in time are left out, as long as others wait."""
        taken: list[QueuedJob] = []
        while len(taken) < most and (found := self._jobs.take(most - len(taken), most_bytes, suits)):
            taken += [job for job in found if self._is_in_time(job, ahead_s)]
        return taken

    def conclude(self, entry: QueuedJob, results: Sequence[Result], cpu_s: float) -> None:
        """Publish and count the results of a job."""
        self._settle(entry, lambda: self._conclude(entry.item, results, entry.complete_s, cpu_s))

    def lose(self, entry: QueuedJob, reason: Rejected) -> None:
        """Count a job that was lost."""
        self._settle(entry, lambda: _fail(reason))

    def run_here(self, entry: QueuedJob) -> None:
        """Do work that no worker can do."""
        self._settle(entry, entry.run)

    def _settle(self, entry: QueuedJob, work: Callable[[], int]) -> None:
        try:
            self._node.settle(entry, work)
        finally:
            self._jobs.note_done()

    def _is_in_time(self, entry: QueuedJob, ahead_s: float) -> bool:
        try:
            self._node.check_budget(entry, ahead_s)
        except Rejected as late:
            self.lose(entry, late)
            return False
        return True


def _fail(reason: Rejected) -> int:
    raise reason


class Joinable(Protocol):
    """A node whose items others of its process can receive as they are.

    Attributes:
        joinable_outlets: its publishers.
        joinable_inlets: its subscriptions, each with the callback for an item.
    """

    joinable_outlets: Sequence[tuple[Port, Outlet]]
    joinable_inlets: Sequence[tuple[Port, Inlet, Callable[[Any, float], None]]]


def join(nodes: Sequence[Joinable]) -> None:
    """Have nodes of one process hand items to each other as they are, where one publishes what others subscribe to.

    A subscription ends then, and its publisher makes messages only while somebody else subscribes. Latched topics stay
    as they are, and topics that several nodes publish.
    """
    published = Counter(outlet.topic for node in nodes for _, outlet in node.joinable_outlets)
    makers = {
        (outlet.topic, port.kind): outlet
        for node in nodes
        for port, outlet in node.joinable_outlets
        if published[outlet.topic] == 1
    }
    for node in nodes:
        for port, inlet, accept in node.joinable_inlets:
            with suppress(KeyError):
                inlet.join(makers[inlet.topic, port.kind], accept)
