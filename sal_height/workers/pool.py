"""A pool of worker processes that process the jobs of the stages of a live graph.

Nodes keep their jobs in queues of their own. One thread, the pool's, gives a worker that has nothing to do the next
ones: those of later stages first, so that a dwell which was begun is finished, and several dwells together where
several wait. Arrays of jobs and products are in memory that all share. A worker that ends costs the dwells that it had;
another one takes its place at once, made by a process that was forked before the graph had any thread.
"""

from __future__ import annotations

import io
import json
import math
import os
import selectors
import signal
import socket
import threading
import time
import traceback
from collections import OrderedDict, defaultdict, deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from multiprocessing.connection import Connection
from typing import Any, Protocol, TypeAlias

import numpy as np

from sal_height.engine.stage import DwellKey, Job, Rehearsal, Result
from sal_height.errors import Rejected
from sal_height.workers.arena import Arena, MemoryBlock, Region
from sal_height.workers.processes import Forked, cpu_of_thread, end_with_parent
from sal_height.workers.serving import HEAD, Batch, keep_workers
from sal_height.workers.transfer import Array, ArrayAt, Known, Pickler, Unpickler, copy_into

MEMORY_BYTES = 1_000_000_000
"""Shared memory for what workers work on, bytes, as long as the machine has it; what is not used takes none."""

TOGETHER, BYTES_TOGETHER = 4, 32_000_000
"""Dwells that a worker is given at a time, and bytes of their messages, at most: more would save little and wait."""


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


@dataclass
class _Sent:
    """A batch that a worker has: the client, its jobs, and blocks of the jobs' arrays and for those of the products."""

    client: Client
    entries: Sequence[Entry]
    blocks: list[MemoryBlock]
    room: MemoryBlock | None


@dataclass(eq=False)
class _Worker:
    """A worker process, as the pool knows it."""

    number: int
    pid: int
    pipe: Connection
    known: Known = field(default_factory=Known)
    received: dict[int, Any] = field(default_factory=dict)
    sent: list[_Sent] = field(default_factory=list)


WORKER_ENDED = "worker ended"
"""Reason for which dwells are lost with their worker."""

LOST = (
    "The worker process that had the dwell, or its strip, ended, for example for lack of memory; those that follow go "
    "to another."
)


class _Placing:
    """Puts the arrays of a message into shared memory, those of a dwell one after the other; others are there already.

    Attributes:
        blocks: blocks that are in use until the message is answered.
    """

    def __init__(self, arena: Arena, size: int) -> None:
        """Place arrays of `size` bytes in all together, as far as there is room, and others wherever there is."""
        self._arena = arena
        block = arena.allocate(size) if size else None
        self._region = Region(arena.memory, block)
        self.blocks = [block] if block else []

    def put(self, array: Array) -> int | None:
        """Offset of an array, which is copied unless it is in the memory; None: there is no room for it."""
        at = self._arena.offset_of(array)
        if at is None:
            at = self._region.put(array)
        if at is None and (block := self._arena.allocate(array.nbytes)):
            self.blocks.append(block)
            at = block.start
            copy_into(self._arena.memory, at, array)
        return at


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
        self._count = workers
        self._control, theirs = socket.socketpair()
        self._wakes, self._waker = socket.socketpair()
        self._waker.setblocking(False)
        parent = os.getpid()

        def keep() -> int:
            self._control.close()
            return keep_workers(theirs, workers, self._arena) if end_with_parent(parent, signal.SIGKILL) else 1

        self._keeper = Forked(keep, "workers")
        theirs.close()
        self._workers: dict[int, _Worker] = {}
        self._clients: list[list[Client]] = [[], []]
        self._owners: dict[tuple[str, str], int] = {}
        """Worker of each series of a client."""
        self._ahead = Ahead()
        self._broken: set[tuple[str, str]] = set()
        """Series whose worker has ended while it had none of their jobs."""
        self._expected: dict[str, int] = {}
        """Bytes of the arrays of the products of a job, by client."""
        self._given: defaultdict[str, deque[Entry]] = defaultdict(deque)
        """Jobs that workers were given and that are not finished, in their order, by client."""
        self._outcomes: dict[int, Callable[[], None]] = {}
        """What finishes jobs that wait for those before, by the identity of their entries."""
        self._rehearsals: dict[int, int] = {}
        """Workers that have not returned a rehearsal yet, by the identity of its entry."""
        self._awake = self._closed = False
        self.failure = ""
        """Trace of an error after which no job is processed any more; empty: there was none."""
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._wakes, selectors.EVENT_READ)
        self._selector.register(self._control, selectors.EVENT_READ)
        self._thread = threading.Thread(target=self._run, name="pool", daemon=True)

    def serve(self, client: Client, *, later: bool) -> None:
        """Process the jobs of a node; `later`: they follow from the products of others, and are given first."""
        self._clients[later].append(client)

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
        self._keeper.kill()
        self._keeper.wait(10.0)
        for one in (self._control, self._wakes, self._waker):
            one.close()

    def _run(self) -> None:
        try:
            self._process_jobs()
        except Exception:  # noqa: BLE001 (whoever has the pool ends, and is started again)
            self.failure = traceback.format_exc()

    def _process_jobs(self) -> None:
        while not self._closed:
            for key, _ in self._selector.select():
                if isinstance(key.data, _Worker):
                    if key.data in self._workers.values():
                        self._receive(key.data)
                elif key.fileobj is self._control:
                    self._welcome()
                else:
                    self._wakes.recv(4096)
            self._give()

    def _welcome(self) -> None:
        """Take a worker in that has started; what the one before it has returned is taken first."""
        said, handles, _, _ = socket.recv_fds(self._control, 4096, 1)
        if not handles:
            raise RuntimeError("the process that starts workers has ended")
        worker = _Worker(**json.loads(said), pipe=Connection(handles[0]))
        while before := self._workers.get(worker.number):
            self._receive(before)
        self._workers[worker.number] = worker
        self._selector.register(worker.pipe, selectors.EVENT_READ, worker)

    def _receive(self, worker: _Worker) -> None:
        """Take the results of a batch, or note that the worker has ended."""
        try:
            returned = worker.pipe.recv_bytes()
        except (EOFError, OSError):
            self._forget(worker)
            return
        sent = worker.sent.pop(0)
        asked, used, cpu_s = HEAD.unpack_from(returned)
        array_at = self._arrays_of(sent.room, used) if sent.room else None
        results = Unpickler(io.BytesIO(memoryview(returned)[HEAD.size :]), worker.received, array_at).load()
        for block in sent.blocks:
            self._arena.release(block)
        name, count = sent.client.name, len(sent.entries)
        self._expected[name] = max(self._expected.get(name, 0), asked // count)
        self._note(sent, lambda entry, place: sent.client.conclude(entry, results[place], cpu_s / count))
        if sent.client in self._clients[1]:
            self._ahead.end([entry.item for entry in sent.entries], time.monotonic())

    def _arrays_of(self, room: MemoryBlock, used: int) -> ArrayAt:
        """Function that returns arrays in a room, which is given back once nobody uses any of them."""
        room = self._arena.shrink(room, used)
        whole = self._arena.bytes_of(room)

        def array_at(at: int, dtype: str, shape: tuple[int, ...]) -> Array:
            first = at - room.start
            size = math.prod(shape) * np.dtype(dtype).itemsize
            return whole[first : first + size].view(dtype).reshape(shape)

        return array_at

    def _forget(self, worker: _Worker) -> None:
        """Count what a worker that has ended had, and have others go on with its series."""
        self._selector.unregister(worker.pipe)
        worker.pipe.close()
        del self._workers[worker.number]
        gone = {series for series, number in self._owners.items() if number == worker.number}
        self._owners = {series: number for series, number in self._owners.items() if series not in gone}
        lost = {(sent.client.name, entry.item.series) for sent in worker.sent for entry in sent.entries}
        self._broken |= gone - lost  # what the worker kept is lost with it: the next job says so
        for sent in worker.sent:
            for block in (*sent.blocks, *([sent.room] if sent.room else [])):
                self._arena.release(block)
            self._note(sent, partial(_lose, sent.client))

    def _give(self) -> None:
        """Give jobs to workers that have none, as long as there are any."""
        self._awake = True
        while self._awake:
            self._awake = False
            for worker in list(self._workers.values()):
                if not worker.sent:
                    self._give_to(worker)

    def _give_to(self, worker: _Worker) -> None:
        """Give a worker the next jobs: of the series that it has; else of later stages; else of the first ones."""
        first, later = self._clients

        def has_series(client: Client, job: Job | None) -> bool:
            return job is not None and bool(job.series) and self._owner(client, job, worker) == worker.number

        def suits(client: Client, job: Job | None) -> bool:
            return job is None or not job.series or self._owner(client, job, worker) == worker.number

        steps = [(first, has_series)] if worker.number in self._owners.values() else []
        for clients, wanted in (*steps, (later, suits), (first, suits)):
            taken = [(client, self._take_jobs(client, partial(wanted, client))) for client in clients]
            if batches := [(client, entries) for client, entries in taken if entries]:
                self._send(worker, batches)
            if worker.sent:
                return

    def _owner(self, client: Client, job: Job, worker: _Worker) -> int:
        """Number of the worker that has the series of a job: the one that is given its first job."""
        return self._owners.setdefault((client.name, str(job.series)), worker.number)

    def _take_jobs(self, client: Client, suits: Suits) -> Sequence[Entry]:
        """Take jobs of a client: the part of a worker of those that wait, if several have none."""
        idle = sum(not one.sent for one in self._workers.values())
        most = min(TOGETHER, math.ceil(client.waiting_jobs / max(1, idle)))
        taken: list[Entry] = []
        # While no dwell is in work, one begins that may be late: how long it takes now must be seen.
        in_work = any(sent.client in self._clients[0] for worker in self._workers.values() for sent in worker.sent)
        ahead_s = self._ahead.expected_s if in_work and client in self._clients[0] else 0.0
        for entry in client.take_jobs(most, BYTES_TOGETHER, suits, ahead_s) if most else ():
            if entry.item is None:
                client.run_here(entry)
            elif entry.item.messages and (client.name, entry.item.series) in self._broken:
                self._broken.discard((client.name, entry.item.series))
                _lose(client, entry)
            elif isinstance(entry.item.inputs, Rehearsal):
                self._rehearsals[id(entry)] = len(self._workers)
                self._given[client.name].append(entry)
                for worker in list(self._workers.values()):
                    self._send(worker, [(client, [entry])])
            else:
                taken.append(entry)
        self._given[client.name].extend(taken)
        return taken

    def _send(self, worker: _Worker, batches: Sequence[tuple[Client, Sequence[Entry]]]) -> None:
        """Send a worker jobs of clients; one that has ended is noted once its end is read."""
        message = []
        for client, entries in batches:
            jobs = [entry.item for entry in entries]
            if client in self._clients[0]:
                self._ahead.begin(jobs, time.monotonic())
            expected = self._expected.get(client.name)
            size = sum(job.size for job in jobs) if expected is None else expected * len(jobs)
            room = self._arena.allocate(size)
            message.append(Batch(client.kind, client.name, jobs, room))
            worker.sent.append(_Sent(client, entries, [], room))
        is_first = any(client in self._clients[0] for client, _ in batches)
        placing = _Placing(self._arena, sum(job.size for batch in message for job in batch.jobs) if is_first else 0)
        file = io.BytesIO()
        Pickler(file, worker.known, placing.put).dump(message)
        worker.sent[-1].blocks = placing.blocks  # what the batches share is released after the last of them
        with suppress(OSError):
            worker.pipe.send_bytes(file.getbuffer())

    def _note(self, sent: _Sent, finish: Callable[[Entry, int], None]) -> None:
        """Have a client finish the jobs of a batch, once it has finished those that it was given before.

        A rehearsal is finished once all workers have returned it.
        """
        for place, entry in enumerate(sent.entries):
            left = self._rehearsals.pop(id(entry), 1) - 1
            if left:
                self._rehearsals[id(entry)] = left
            else:
                self._outcomes[id(entry)] = partial(finish, entry, place)
        given = self._given[sent.client.name]
        while given and id(given[0]) in self._outcomes:
            self._outcomes.pop(id(given.popleft()))()


def _lose(client: Client, entry: Entry, _place: int = 0) -> None:
    """Have a client count a job that was lost with its worker; its own work, which no message waits for, is done."""
    if entry.item.messages:
        client.lose(entry, Rejected(WORKER_ENDED, LOST))
    else:
        client.conclude(entry, (), 0.0)
