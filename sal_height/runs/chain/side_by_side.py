"""The chain host with worker processes: jobs that do not depend on each other are processed side by side.

Stages accept items here. Jobs of stages that compress dwells and estimate heights go to workers, those of a strip to
one of them in their order; what else depends on the dwells before (tracked heights, maps) is processed here. Results
are handed on in the order in which the jobs were made, so that the products are those of one process. Images and other
large arrays stay in memory that all processes share.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from queue import Empty, SimpleQueue
from threading import Thread
from types import TracebackType
from typing import Any, Self

from sal_height.engine.chain import Chain, Made
from sal_height.engine.image_items import Images
from sal_height.engine.results import Product, Result
from sal_height.engine.stage import Job, Stage
from sal_height.errors import UserError
from sal_height.workers.arena import Arena
from sal_height.workers.keeper import Keeper, Spawned, can_keep_workers, no_shared_memory
from sal_height.workers.sending import BYTES_TOGETHER, MEMORY_BYTES, Sender, Worker
from sal_height.workers.serving import Batch

TOGETHER = 8
"""Jobs that a worker is sent at a time, at most: heights are estimated together."""

AHEAD = 2
"""Batches that a worker may have at a time; it is sent the next one once it has returned one of them."""


def _together(pending: Sequence[Job]) -> int:
    """Number of jobs like the first pending one that a worker is sent at a time."""
    return max(1, min(TOGETHER, BYTES_TOGETHER // max(1, pending[0].size)))


class SideBySide(Chain):
    """A chain whose jobs that do not depend on each other are processed by worker processes; a context manager."""

    def __init__(self, stages: Sequence[Stage], settings: Sequence[Any], jobs: int) -> None:
        """Join stages.

        Args:
            stages: stages in the order of the data.
            settings: settings of each stage.
            jobs: number of worker processes, 1 or more.
        """
        super().__init__(stages, settings)
        self._jobs = jobs
        self._remote = [stage for stage in stages if stage.is_parallel and not self._has_feedback]
        self._cold = set(self._remote)
        """Stages that have not processed any job yet."""
        self._unfinished: deque[tuple[Stage, Job]] = deque()
        """Jobs whose results have not been handed on, in the order in which they were made."""
        self._returned: dict[int, Sequence[Result]] = {}
        """Results of jobs that workers have processed, by the identity of the job."""
        self._owners: dict[tuple[Stage, str], Worker] = {}
        """Worker of each series of a stage."""
        self._starter: Keeper | Spawned | None = None
        self._workers: Sequence[Worker] = []
        self._readers: Sequence[Thread] = []
        self._arrived: SimpleQueue[tuple[Worker, bytes]] = SimpleQueue()

    def __enter__(self) -> Self:
        return self

    def _start(self) -> None:
        """Start the workers.

        Forked ones start with all that this process has loaded and all tables that it has made. Elsewhere than on Linux
        they are spawned with a copy of the stages, and arrays are sent through pipes.

        Raises:
            UserError: they cannot be started.
        """
        stages = {stage.name: stage for stage in self._remote}
        forks = can_keep_workers()
        try:
            arena = Arena(MEMORY_BYTES) if forks else no_shared_memory()
            self._sender = Sender(arena)
            self._starter = Keeper(self._jobs, arena, stages) if forks else Spawned(self._jobs, stages)
            self._workers = [self._starter.started_worker() for _ in range(self._jobs)]
        except (OSError, RuntimeError) as error:
            raise UserError("The worker processes cannot be started; use fewer --jobs.") from error
        self._readers = [Thread(target=self._read, args=(worker,), daemon=True) for worker in self._workers]
        for reader in self._readers:
            reader.start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._starter:
            self._starter.close()
        for reader, worker in zip(self._readers, self._workers, strict=True):
            reader.join()
            worker.pipe.close()

    def _read(self, worker: Worker) -> None:
        """Read what a worker returns as soon as it does, so that it never waits while this process sends (a thread).

        Empty bytes stand for its end.
        """
        try:
            with suppress(EOFError, OSError):
                while True:
                    self._arrived.put((worker, worker.pipe.recv_bytes()))
        finally:
            self._arrived.put((worker, b""))

    def _keep(self, stage: Stage, job: Job) -> None:
        """Keep a job for later."""
        self._unfinished.append((stage, job))
        super()._keep(stage, job)

    def _results(self, *, drain: bool) -> Iterator[Made]:
        """Send jobs to workers, process the others here, and yield the results in the order of the jobs."""
        while self._unfinished:
            if self._remote and not (self._workers or self._cold or drain):
                self._start()
            self._send_jobs(drain=drain)
            self._receive()
            stage, job = self._unfinished[0]
            if not (self._workers and stage in self._remote):
                self._pending[stage].popleft()
                self._cold.discard(stage)
                (results,) = stage.process([job])
            elif id(job) in self._returned:
                results = [_completed(result, job) for result in self._returned.pop(id(job))]
            elif drain or self._is_crowded():
                self._receive(waits=True)
                continue
            else:
                break
            self._unfinished.popleft()
            self._conclude(stage, job, results)
            yield from self._given()
        yield from self._given()

    def _send_jobs(self, *, drain: bool) -> None:
        """Send jobs that are due to workers, those of later stages first: a dwell that was begun is finished.

        A worker that has jobs is sent more once there is a whole batch of them.
        """
        for stage in reversed(self._remote):
            while self._workers and (pending := self._pending[stage]):
                worker, together = self._worker_for(stage, pending[0]), _together(pending)
                if len(worker.sent) >= AHEAD or (worker.sent and len(pending) < together and not drain):
                    break
                jobs = [pending.popleft()]
                while pending and len(jobs) < together and pending[0].series == jobs[0].series:
                    jobs.append(pending.popleft())
                self._sender.send(worker, [Batch(stage.usual_name, stage.name, jobs)])

    def _worker_for(self, stage: Stage, job: Job) -> Worker:
        """The worker that has the fewest jobs, or the one that has the series of a job."""
        worker = min(self._workers, key=lambda one: sum(len(sent.batch.jobs) for sent in one.sent))
        return worker if job.series is None else self._owners.setdefault((stage, job.series), worker)

    def _is_crowded(self) -> bool:
        """True if so many jobs wait for workers, or so many results for the first job, that no more are to be made."""
        waiting = [self._pending[stage] for stage in self._remote]
        if any(pending and len(pending) >= _together(pending) for pending in waiting):
            return True
        first, job = self._unfinished[0]
        most = 2 * self._jobs * AHEAD * _together([job])  # twice as many as all workers may have
        return sum(stage is first for stage, _ in self._unfinished) > most

    def _receive(self, *, waits: bool = False) -> None:
        """Read what workers have returned, and wait for one of them if asked to.

        Raises:
            UserError: a worker has ended.
        """
        try:
            while True:
                worker, returned = self._arrived.get(block=waits)
                if not returned:
                    raise UserError("A worker process has ended, for example for lack of memory; use fewer --jobs.")
                batch, results, _ = self._sender.read(worker, returned)
                self._returned.update(zip(map(id, batch.jobs), results, strict=True))
                waits = False
        except Empty:
            return


def _completed(result: Result, job: Job) -> Result:
    """A result of a worker; images with the frames and the odometry of their job, which are not sent back."""
    if isinstance(result, Product) and isinstance(images := result.item, Images) and images.source:
        source = replace(images.source, frames=job.inputs.messages, states=job.inputs.supplies.states)
        return Product(result.port, replace(images, source=source))
    return result
