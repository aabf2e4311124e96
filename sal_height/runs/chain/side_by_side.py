"""The chain host with worker processes: jobs that do not depend on each other are processed side by side.

A dwell goes to a worker as the job of the first stage, and returns as the products of all stages that work on
single dwells: its images never leave the worker unless a stage here consumes them. What depends on the dwells before is
processed here, in the order in which the jobs were made, so that the products are those of one process.

Large arrays go to a worker through shared memory; sensors, settings and calibrations go once.
"""

from __future__ import annotations

import io
import multiprocessing
from collections import deque
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from queue import Empty, SimpleQueue
from threading import Thread
from types import TracebackType
from typing import Any, Self

from sal_height.engine.chain import Chain, Made
from sal_height.engine.stage import DwellKey, Job, Product, Stage
from sal_height.errors import UserError
from sal_height.runs.chain.worker import Control, Remote, Scheduled, Sent, Unsent, WorkerChain
from sal_height.topics import CALIBRATION, SENSOR_INFO
from sal_height.workers.transfer import Known, Pickler, Ring, Unpickler

CONTROLS = (SENSOR_INFO, CALIBRATION)
"""Ports of controls, which are not dwells and which all workers must receive."""

TOGETHER = 8
"""Jobs that a worker is sent at a time, at most: heights are estimated together."""

AHEAD = 2
"""Batches of jobs that a worker may have at a time; it is sent the next one once it has returned one of them."""

LEAST_RING_BYTES, MOST_RING_BYTES = 64_000_000, 256_000_000
"""Shared memory of a worker, bytes; arrays beyond it are sent as other objects are."""

BYTES_TOGETHER = 32_000_000
"""Largest size of a batch of more than one job: results have about the same size as their jobs."""


@dataclass
class _Worker:
    """A worker process, as its parent knows it."""

    process: Any
    pipe: Connection
    ring: Ring | None
    known: Known = field(default_factory=Known)
    received: dict[int, Any] = field(default_factory=dict)
    sent: deque[tuple[int, int, int]] = field(default_factory=deque)
    """Number of each message with jobs, the bytes that it uses of the ring, and the number of its jobs."""

    @property
    def dwells(self) -> int:
        """Dwells that it has been sent and not returned."""
        return sum(jobs for _, _, jobs in self.sent)

    def send(self, message: Any) -> int:
        """Send a message; returns the bytes that it uses of the ring."""
        file = io.BytesIO()
        if self.ring:
            self.ring.taken = 0
        Pickler(file, self.known, self.ring.put if self.ring else None).dump(message)
        self.pipe.send_bytes(file.getbuffer())
        return self.ring.taken if self.ring else 0

    def receive(self, arrived: SimpleQueue[tuple[_Worker, bytes]]) -> None:
        """Read what the process returns as soon as it does, so that it never waits while this one sends (a thread).

        Empty bytes stand for its end.
        """
        try:
            while True:
                arrived.put((self, self.pipe.recv_bytes()))
        except (EOFError, OSError):
            arrived.put((self, b""))

    def read(self, returned: bytes) -> tuple[int, Sequence[Sent]]:
        """The number of the oldest message with jobs, and the results.

        Raises:
            UserError: the process has ended.
        """
        if not returned:
            raise UserError("A worker process has ended, for example for lack of memory; use fewer --jobs.")
        number, taken, _ = self.sent.popleft()
        results = Unpickler(io.BytesIO(returned), self.received, None).load()
        if self.ring:
            self.ring.release(taken)
        return number, results


def _ring_bytes(job: Job) -> int:
    """Size of a ring for the jobs that a worker is sent ahead, if they are as large as this one.

    A larger one would be slower: its memory is used in turn, and what was used last is at hand.
    """
    trial = Ring.of(MOST_RING_BYTES)
    Pickler(io.BytesIO(), Known(), trial.put).dump(job)
    return min(MOST_RING_BYTES, max(LEAST_RING_BYTES, (AHEAD + 1) * TOGETHER * trial.taken))


def _together(pending: Sequence[Job]) -> int:
    """Number of jobs like the first pending one that a worker is sent at a time."""
    return max(1, min(TOGETHER, BYTES_TOGETHER // max(1, pending[0].size)))


class SideBySide(Chain):
    """A chain whose jobs that do not depend on each other are processed by worker processes; a context manager."""

    def __init__(self, stages: Sequence[Stage], settings: Sequence[Any], jobs: int, wanted: Collection[str]) -> None:
        """Join stages.

        Args:
            stages: stages in the order of the data.
            settings: settings of each stage.
            jobs: number of worker processes, 1 or more.
            wanted: ports whose products the caller needs; others are returned only if a stage here consumes them.

        Raises:
            UserError: a worker process has ended.
        """
        super().__init__(stages, settings)
        self._jobs = jobs
        self._workers: list[_Worker] = []
        self._sent = self._given_back = 0
        self._returned: dict[int, Sequence[Sent]] = {}
        self._arrived: SimpleQueue[tuple[_Worker, bytes]] = SimpleQueue()
        self._remote = [stage.is_parallel and not self._has_feedback for stage in stages]
        local = {
            port for port, consumers in self._consumers.items() if any(not self._is_remote(one) for one in consumers)
        }
        self._kept = local.union(wanted)
        self._first: Job | None = None
        self._cold = {stage for stage, remote in zip(stages, self._remote, strict=True) if remote}

    def __enter__(self) -> Self:
        return self

    def _start(self, job: Job) -> None:
        """Start the workers; `job` is the first one that was processed here.

        Forked ones start with all that this process has loaded and all tables that it has made. Where there is no fork,
        they are spawned with a copy of the stages, and arrays are sent through pipes.
        """
        forks = "fork" in multiprocessing.get_all_start_methods()
        context: Any = multiprocessing.get_context("fork" if forks else "spawn")
        pipes, size = [context.Pipe() for _ in range(self._jobs)], _ring_bytes(job)
        chain = WorkerChain(self.stages, self._remote, self._consumers, self._kept)
        for ours, theirs in pipes:
            ring = Ring.of(size) if forks else None
            others = [pipe for pair in pipes for pipe in pair if forks and pipe is not theirs]
            process = context.Process(target=chain.serve, args=(theirs, others, ring), daemon=True)
            process.start()
            self._workers.append(_Worker(process, ours, ring))
        for _, theirs in pipes:
            theirs.close()
        for worker in self._workers:
            Thread(target=worker.receive, args=(self._arrived,), daemon=True).start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for worker in self._workers:
            if kind is not None:  # no other process waits for its result
                worker.process.kill()
            with suppress(OSError):  # it may have ended
                worker.pipe.send_bytes(b"")
        for worker in self._workers:
            worker.process.join(5.0)  # longest wait, s
            if worker.process.is_alive():
                worker.process.kill()
                worker.process.join()
        self._workers.clear()

    def change(self, stage: Stage, settings: Any, before: DwellKey) -> None:
        """Have a stage use other settings from a dwell on, here and in the workers."""
        super().change(stage, settings, before)
        self._schedule(stage, Scheduled(self.stages.index(stage), before, "", settings))

    def schedule(self, stage: Stage, before: DwellKey, port: str, item: Any) -> None:
        """Have a stage accept an item right before the job of a dwell is made, here and in the workers."""
        super().schedule(stage, before, port, item)
        self._schedule(stage, Scheduled(self.stages.index(stage), before, port, item))

    def give(self, stage: Stage, port: str, item: Any) -> None:
        """Have a stage accept an item now, here and in the workers."""
        super().give(stage, port, item)
        if self._is_remote(stage):
            for worker in self._workers:
                worker.send(Control(port, item))

    def _schedule(self, stage: Stage, message: Scheduled) -> None:
        if self._is_remote(stage):
            for worker in self._workers:
                worker.send(message)

    def _is_remote(self, stage: Stage) -> bool:
        return self._remote[self.stages.index(stage)]

    def _deliver(self, port: str, item: Any) -> None:
        """Deliver as a chain does; also send controls to workers, and leave out stages whose jobs they process."""
        super()._deliver(port, item)
        if port in CONTROLS and any(map(self._is_remote, self._consumers.get(port, ()))):
            for worker in self._workers:
                worker.send(Control(port, item))

    def _results(self, *, drain: bool) -> Iterator[Made]:
        """Send jobs to workers, process the others here, and yield the results."""
        while True:
            yield from super()._results(drain=drain)
            sent = self._send_jobs(drain=drain)
            self._receive(blocking=False)
            if not self._give_back():
                waits = self._waits_for_workers(drain=drain)
                if not waits and not sent:
                    break
                if waits:
                    self._receive(blocking=True)
                    self._give_back()
        yield from self._given()

    def _due(self, *, drain: bool) -> list[tuple[Stage, list[Job]]]:
        """The jobs that are processed here: those of other stages, and those that depend on each other.

        Until every stage has processed a job, all are, one by one: what is slow at first is done once, and not by
        each worker, and no job waits when the workers start, so that none overtakes another.
        """
        alone = not self._workers
        for number, stage in enumerate(self.stages):
            pending, remote = self._pending[stage], self._remote[number]
            if alone or not remote:
                most = self._at_once[stage]
                if len(pending) >= most or (pending and (drain or (alone and remote))):
                    self._cold.discard(stage)
                    jobs = [pending.popleft() for _ in range(min(most, len(pending)))]
                    self._first = self._first or (jobs[0] if remote else None)
                    return [(stage, jobs)]
            elif pending and pending[0].series is not None:
                return [(stage, [pending.popleft()])]
        if self._first and alone and not (self._cold or drain):
            self._start(self._first)
            self._first = None
        return []

    def _send_jobs(self, *, drain: bool) -> bool:
        """Send jobs that are due to the workers with the fewest; whether there were any."""
        sent = False
        for number, stage in enumerate(self.stages):
            pending = self._pending[stage]
            while self._workers and self._remote[number] and pending and (drain or len(pending) >= _together(pending)):
                worker, together = min(self._workers, key=lambda one: one.dwells), _together(pending)
                if worker.dwells >= AHEAD * together:
                    break
                jobs = [pending.popleft() for _ in range(min(together, len(pending)))]
                taken = worker.send(Remote(number, jobs))
                worker.sent.append((self._sent, taken, len(jobs)))
                self._sent += 1
                sent = True
        return sent

    def _waits_for_workers(self, *, drain: bool) -> bool:
        """True if nothing can go on here before a worker has returned something."""
        if not any(worker.sent for worker in self._workers):
            return False
        waiting = [self._pending[stage] for stage, remote in zip(self.stages, self._remote, strict=True) if remote]
        crowded = any(pending and len(pending) >= _together(pending) for pending in waiting)
        return drain or crowded

    def _receive(self, *, blocking: bool) -> None:
        """Read what workers have returned; if blocking, wait for one of them."""
        waits = blocking and any(worker.sent for worker in self._workers)
        with suppress(Empty):
            while True:
                worker, returned = self._arrived.get(block=waits)
                number, results = worker.read(returned)
                self._returned[number] = results
                waits = False

    def _give_back(self) -> bool:
        """Deliver results in the order in which the jobs were sent; True if there was any."""
        before = self._given_back
        while (results := self._returned.pop(self._given_back, None)) is not None:
            self._given_back += 1
            for number, dwell, result in results:
                stage = self.stages[number]
                self._made.append(Made(stage, dwell, result))
                if isinstance(result, Product) and not isinstance(result.item, Unsent):
                    for consumer in self._consumers.get(result.port, ()):
                        if not self._is_remote(consumer):
                            self._take(consumer, consumer.accept(result.port, result.item))
        return self._given_back > before
