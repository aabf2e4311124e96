"""A pool of worker processes that process the jobs of the stages of a live graph.

Nodes keep their jobs in queues of their own. One thread, the pool's, gives a worker that has nothing to do the next
ones: those of later stages first, so that a dwell which was begun is finished, and several dwells together where
several wait. Arrays of jobs and products are in memory that all share. A worker that ends costs the dwells that it had;
another one takes its place at once, made by a process that was forked before the graph had any thread.
"""

from __future__ import annotations

import math
import selectors
import socket
import threading
import time
import traceback
from collections import OrderedDict, defaultdict, deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, Protocol, TypeAlias

from sal_height.engine.results import DwellKey, Result
from sal_height.engine.stage import Job, Rehearsal
from sal_height.errors import Rejected
from sal_height.workers.arena import Arena
from sal_height.workers.keeper import Keeper
from sal_height.workers.processes import cpu_of_thread
from sal_height.workers.sending import BYTES_TOGETHER, MEMORY_BYTES, Sender, Worker
from sal_height.workers.serving import Batch

TOGETHER = 4
"""Dwells that a worker is given at a time, at most: more would save little and wait."""

NICENESS = 4
"""Degree to which workers give way to the threads that receive and publish messages, as in nice(1)."""


Suits = Callable[[Job | None], bool]
"""Function that says whether a job may be given to a worker; None: work that no worker can do."""


Entry: TypeAlias = Any
"""A job as the queue of its node has it; `item` is the job of the stage, None: work that no worker can do."""


class Client(Protocol):
    """A node whose jobs a pool processes."""

    @property
    def kind(self) -> str:
        """Usual name of its stage."""

    @property
    def name(self) -> str:
        """Its name with its namespace, unlike that of any other client."""

    @property
    def waiting_jobs(self) -> int:
        """Number of jobs that wait."""

    def take_jobs(self, most: int, most_bytes: int, suits: Suits, ahead_s: float) -> Sequence[Entry]:
        """Take jobs of those that wait, in their order, and leave out those that cannot be in time.

        Args:
            most: greatest number of jobs.
            most_bytes: greatest sum of their sizes, bytes; one job in any case.
            suits: function that says which jobs the worker may have.
            ahead_s: time that passes until heights of these jobs are published, s.
        """

    def conclude(self, entry: Entry, results: Sequence[Result], cpu_s: float) -> None:
        """Publish and count the results of a job, and the processor time that it took, s."""

    def lose(self, entry: Entry, reason: Rejected) -> None:
        """Count a job that was lost with its worker."""

    def run_here(self, entry: Entry) -> None:
        """Do work that no worker can do."""


WORKER_ENDED = "worker ended"
"""Reason for which dwells are lost with their worker."""

LOST = (
    "The worker process that had the dwell, or its strip, ended, for example for lack of memory; those that follow go "
    "to another."
)


class Ahead:
    """Time from the start of the work on a dwell until its heights are published, as it was lately."""

    def __init__(self) -> None:
        self.expected_s = 0.0
        """Time to expect, s: most dwells take less."""
        self._begun: OrderedDict[DwellKey | None, float] = OrderedDict()
        self._taken_s: deque[float] = deque(maxlen=40)

    def begin(self, jobs: Sequence[Job], now_s: float) -> None:
        """The work on dwells begins."""
        dwells_kept = 256
        for job in jobs:
            if job.dwell:
                self._begun[job.dwell] = now_s
        while len(self._begun) > dwells_kept:
            self._begun.popitem(last=False)

    def end(self, jobs: Sequence[Job], now_s: float) -> None:
        """Heights of dwells have been published. A single dwell that took long does not count."""
        self._taken_s.extend(now_s - self._begun[job.dwell] for job in jobs if job.dwell in self._begun)
        if self._taken_s:
            self.expected_s = sorted(self._taken_s)[int(0.9 * (len(self._taken_s) - 1))]


class Pool:
    """Worker processes, and the thread that gives them jobs and takes their results."""

    def __init__(self, workers: int, memory_bytes: int = MEMORY_BYTES) -> None:
        """Start the processes; this one must not have any thread yet.

        Args:
            workers: number of processes.
            memory_bytes: memory that they share with this one, bytes.

        Raises:
            OSError: a process cannot be started.
        """
        self._arena = Arena(memory_bytes)
        self._sender = Sender(self._arena)
        self._keeper = Keeper(workers, self._arena, {}, NICENESS)
        self._wakes, self._waker = socket.socketpair()
        self._waker.setblocking(False)
        self._workers: dict[int, Worker] = {}
        self._clients: list[dict[str, Client]] = [{}, {}]
        """Clients by name: those whose jobs begin a dwell, and those whose jobs follow."""
        self._owners: dict[tuple[str, str], int] = {}
        """Worker of each series of a client."""
        self._ahead = Ahead()
        self._broken: set[tuple[str, str]] = set()
        """Series whose worker has ended while it had none of their jobs."""
        self._given: defaultdict[str, deque[Entry]] = defaultdict(deque)
        """Jobs that workers were given and that are not finished, in their order, by client."""
        self._outcomes: dict[int, Callable[[Entry], None]] = {}
        """Functions that finish jobs which wait for those before, by the identity of the jobs."""
        self._rehearsals: dict[int, int] = {}
        """Workers that have not returned a rehearsal yet, by its identity."""
        self._awake = self._closed = False
        self.failure = ""
        """Trace of an error after which no job is processed any more; empty: there was none."""
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._wakes, selectors.EVENT_READ)
        self._selector.register(self._keeper.starts, selectors.EVENT_READ)
        self._thread = threading.Thread(target=self._run, name="pool", daemon=True)

    def serve(self, client: Client, *, later: bool) -> None:
        """Process the jobs of a node; `later`: they follow from the products of others, and are given first."""
        self._clients[later][client.name] = client

    def start(self) -> None:
        """Begin to process jobs."""
        self._thread.start()

    def wake(self) -> None:
        """Look for jobs: some may have been made."""
        if threading.current_thread() is self._thread:
            self._awake = True
        else:
            with suppress(OSError):  # it has been woken often enough, or is closed
                self._waker.send(b"x")

    @property
    def cpu_s(self) -> float:
        """Processor time of the thread that gives jobs and publishes results, s."""
        return cpu_of_thread(self._thread)

    @property
    def worker_pids(self) -> list[int]:
        """Numbers of the processes that work."""
        return [worker.pid for worker in list(self._workers.values())]

    def close(self) -> None:
        """End the workers; jobs that they have are lost."""
        self._closed = True
        self.wake()
        if self._thread.is_alive():
            self._thread.join()
        self._keeper.close()
        self._wakes.close()
        self._waker.close()

    def _run(self) -> None:
        try:
            self._process_jobs()
        except Exception:  # noqa: BLE001 (whoever has the pool ends, and is started again)
            self.failure = traceback.format_exc()

    def _process_jobs(self) -> None:
        while not self._closed:
            for key, _ in self._selector.select():
                if isinstance(key.data, Worker):
                    if key.data in self._workers.values():
                        self._receive(key.data)
                elif key.fileobj is self._keeper.starts:
                    self._welcome()
                else:
                    self._wakes.recv(4096)
            self._give()

    def _welcome(self) -> None:
        """Take a worker in that has started; what the one before it has returned is taken first."""
        worker = self._keeper.started_worker()
        while before := self._workers.get(worker.number):
            self._receive(before)
        self._workers[worker.number] = worker
        self._selector.register(worker.pipe, selectors.EVENT_READ, worker)

    def _receive(self, worker: Worker) -> None:
        """Take the results of a batch, or note that the worker has ended."""
        try:
            returned = worker.pipe.recv_bytes()
        except (EOFError, OSError):
            self._forget(worker)
            return
        batch, results, cpu_s = self._sender.read(worker, returned)
        client, cpu_of_job_s = self._client(batch), cpu_s / len(batch.jobs)
        self._note(batch, lambda place, entry: client.conclude(entry, results[place], cpu_of_job_s))
        if batch.name in self._clients[1]:
            self._ahead.end(batch.jobs, time.monotonic())

    def _client(self, batch: Batch) -> Client:
        first, later = self._clients
        return first.get(batch.name) or later[batch.name]

    def _forget(self, worker: Worker) -> None:
        """Count what a worker that has ended had, and have others go on with its series."""
        self._selector.unregister(worker.pipe)
        worker.pipe.close()
        del self._workers[worker.number]
        gone = {series for series, number in self._owners.items() if number == worker.number}
        self._owners = {series: number for series, number in self._owners.items() if series not in gone}
        lost = {(sent.batch.name, job.series) for sent in worker.sent for job in sent.batch.jobs}
        self._broken |= gone - lost  # what the worker kept is lost with it: the next job says so
        self._sender.release(worker)
        for sent in worker.sent:
            client = self._client(sent.batch)
            self._note(sent.batch, lambda _, entry, client=client: _lose(client, entry))  # type: ignore[misc]

    def _give(self) -> None:
        """Give jobs to workers that have none, as long as there are any."""
        self._awake = True
        while self._awake:
            self._awake = False
            for worker in list(self._workers.values()):
                if not worker.sent:
                    self._give_to(worker)

    def _give_to(self, worker: Worker) -> None:
        """Give a worker the next jobs: of the series that it has; else of later stages; else of the first ones."""
        first, later = self._clients

        def has_series(client: Client, job: Job | None) -> bool:
            return job is not None and bool(job.series) and self._owner(client, job, worker) == worker.number

        def suits(client: Client, job: Job | None) -> bool:
            return job is None or not job.series or self._owner(client, job, worker) == worker.number

        steps = [(first, has_series)] if worker.number in self._owners.values() else []
        for clients, wanted in (*steps, (later, suits), (first, suits)):
            taken = [(client, self._take_jobs(client, partial(wanted, client))) for client in clients.values()]
            if batches := [Batch(client.kind, client.name, jobs) for client, jobs in taken if jobs]:
                self._send(worker, batches)
            if worker.sent:
                return

    def _owner(self, client: Client, job: Job, worker: Worker) -> int:
        """Number of the worker that has the series of a job: the one that is given its first job."""
        return self._owners.setdefault((client.name, str(job.series)), worker.number)

    def _take_jobs(self, client: Client, suits: Suits) -> Sequence[Job]:
        """Take jobs of a client: the part of a worker of those that wait, if several have none."""
        idle = sum(not one.sent for one in self._workers.values())
        most = min(TOGETHER, math.ceil(client.waiting_jobs / max(1, idle)))
        taken: list[Job] = []
        # While no dwell is in work, one begins that may be late: how long it takes now must be seen.
        first = self._clients[0]
        in_work = any(sent.batch.name in first for worker in self._workers.values() for sent in worker.sent)
        ahead_s = self._ahead.expected_s if in_work and client.name in first else 0.0
        for entry in client.take_jobs(most, BYTES_TOGETHER, suits, ahead_s) if most else ():
            if entry.item is None:
                client.run_here(entry)
            elif entry.item.messages and (client.name, entry.item.series) in self._broken:
                self._broken.discard((client.name, entry.item.series))
                _lose(client, entry)
            elif isinstance(entry.item.inputs, Rehearsal):
                self._rehearsals[id(entry.item)] = len(self._workers)
                self._given[client.name].append(entry)
                for worker in list(self._workers.values()):
                    self._send(worker, [Batch(client.kind, client.name, [entry.item])])
            else:
                self._given[client.name].append(entry)
                taken.append(entry.item)
        return taken

    def _send(self, worker: Worker, batches: Sequence[Batch]) -> None:
        """Send a worker batches of clients."""
        for batch in batches:
            if batch.name in self._clients[0]:
                self._ahead.begin(batch.jobs, time.monotonic())
        self._sender.send(worker, batches)

    def _note(self, batch: Batch, finish: Callable[[int, Entry], None]) -> None:
        """Have a client finish the jobs of a batch, once it has finished those that it was given before.

        A rehearsal is finished once all workers have returned it.

        Args:
            batch: jobs, in their order.
            finish: function of the place of a job in the batch and of its entry.
        """
        for place, job in enumerate(batch.jobs):
            left = self._rehearsals.pop(id(job), 1) - 1
            if left:
                self._rehearsals[id(job)] = left
            else:
                self._outcomes[id(job)] = partial(finish, place)
        given = self._given[batch.name]
        while given and (outcome := self._outcomes.pop(id(given[0].item), None)):
            outcome(given.popleft())


def _lose(client: Client, entry: Entry) -> None:
    """Have a client count a job that was lost with its worker; its own work, which no message waits for, is done."""
    if entry.item.messages:
        client.lose(entry, Rejected(WORKER_ENDED, LOST))
    else:
        client.conclude(entry, (), 0.0)
