"""A worker process of the chain: its jobs, and the results of its stages."""

from __future__ import annotations

import io
import os
import signal
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, NamedTuple, TypeAlias

from sal_height.engine.image_items import count_messages
from sal_height.engine.stage import DwellKey, Job, Product, Rehearsal, Result, Stage
from sal_height.workers.transfer import Known, Pickler, Ring, Unpickler, array_in


class Remote(NamedTuple):
    """Jobs of one stage, by its number, that a worker is sent together."""

    stage: int
    jobs: Sequence[Job]


class Scheduled(NamedTuple):
    """An item that a stage accepts right before the job of a dwell is made; port "": other settings."""

    stage: int
    before: DwellKey
    port: str
    item: Any


@dataclass(frozen=True)
class Unsent:
    """Stands for an item of a product that is not needed outside the worker, and the messages it would be."""

    messages: int


class Control(NamedTuple):
    """An item that the stages of a worker accept on a port in addition to dwells, such as a sensor."""

    port: str
    item: Any


Sent: TypeAlias = tuple[int, DwellKey | None, Result]
"""Number of a stage, the dwell of a job, and its products or loss."""


@dataclass(frozen=True)
class WorkerChain:
    """The stages of a chain as a worker process has them.

    Attributes:
        stages: all stages of the chain, in the order of the data.
        remote: True for each of these stages whose jobs workers process.
        consumers: stages that accept the products of each port.
        kept: ports whose products are returned.
    """

    stages: Sequence[Stage]
    remote: Sequence[bool]
    consumers: Mapping[str, Sequence[Stage]]
    kept: Collection[str]

    def _is_remote(self, stage: Stage) -> bool:
        return self.remote[self.stages.index(stage)]

    def serve(self, pipe: Connection, others: Sequence[Connection], ring: Ring | None) -> None:
        """Process the jobs that the parent sends until it closes its end."""
        for other in others:
            other.close()
        known: dict[int, Any] = {}
        sent_back = Known()
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends it to all; the parent ends in order
        while True:
            try:
                sent = pipe.recv_bytes()
            except (EOFError, OSError):
                sent = b""
            if not sent:
                os._exit(0)
            message = Unpickler(io.BytesIO(sent), known, array_in(ring.memory) if ring else None).load()
            if isinstance(message, Scheduled):
                self.stages[message.stage].schedule(message.before, message.port, message.item)
            elif isinstance(message, Control):
                for stage in filter(self._is_remote, self.consumers.get(message.port, ())):
                    stage.accept(message.port, message.item)
            else:
                file = io.BytesIO()
                Pickler(file, sent_back, None).dump(self._made_of(message))
                pipe.send_bytes(file.getbuffer())

    def _made_of(self, remote: Remote) -> list[Sent]:
        """Results of the stages of a worker for jobs, in the order of the stages."""
        made: list[Sent] = []
        waiting: dict[int, list[Job]] = {remote.stage: list(remote.jobs)}
        while waiting:
            number = min(waiting)
            jobs = waiting.pop(number)
            for job, results in zip(jobs, self.stages[number].process(jobs), strict=True):
                for result in results:
                    if not isinstance(result, Product):
                        made.append((number, job.dwell, result))
                        continue
                    is_kept = result.port in self.kept
                    sent = result if is_kept else Product(result.port, Unsent(count_messages(result.item)))
                    made.append((number, job.dwell, sent))
                    for consumer in filter(self._is_remote, self.consumers.get(result.port, ())):
                        other = self.stages.index(consumer)
                        for one in consumer.accept(result.port, result.item):
                            if not isinstance(one, Job):
                                made.append((other, job.dwell, one))
                            elif not isinstance(one.inputs, Rehearsal):
                                waiting.setdefault(other, []).append(one)
        return made
