"""Batches of jobs on their way to worker processes, and their results on the way back.

Whoever has the workers decides which batch is next, and when an answer is read.
"""

from __future__ import annotations

import io
import math
from collections import deque
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

import numpy as np

from sal_height.engine.results import Result
from sal_height.workers.arena import Arena, MemoryBlock, Region
from sal_height.workers.serving import HEAD, Batch
from sal_height.workers.transfer import Array, ArrayAt, Known, Pickler, Unpickler, copy_into

BYTES_TOGETHER = 32_000_000
"""Bytes of the messages of a batch of several jobs, at most: more would save little and wait."""

MEMORY_BYTES = 1_000_000_000
"""Shared memory for what workers work on, bytes, as long as the machine has it; what is not used takes none."""


@dataclass
class Sent:
    """A batch that a worker has.

    Attributes:
        batch: batch with its jobs.
        blocks: blocks of the arrays of the jobs.
    """

    batch: Batch
    blocks: Sequence[MemoryBlock] = ()


@dataclass(eq=False)
class Worker:
    """A worker process, as the process that sends it batches knows it.

    Attributes:
        number: number of the worker; the one that replaces it has the same.
        pid: number of its process.
        pipe: connection to it.
        known: shared objects that it keeps.
        received: shared objects that were received from it.
        sent: batches that it has, in their order.
    """

    number: int
    pid: int
    pipe: Connection
    known: Known = field(default_factory=Known)
    received: dict[int, Any] = field(default_factory=dict)
    sent: deque[Sent] = field(default_factory=deque)


class Returned(NamedTuple):
    """Results of a batch.

    Attributes:
        batch: batch with its jobs.
        results: results of each job.
        cpu_s: processor time of the work, s.
    """

    batch: Batch
    results: Sequence[Sequence[Result]]
    cpu_s: float


class _Placing:
    """Puts arrays into shared memory, those of a dwell one after the other, unless they are there already."""

    def __init__(self, arena: Arena, size: int) -> None:
        """Place arrays of `size` bytes in all together, as far as there is room, and others wherever there is."""
        self._arena, self._size = arena, size
        self._region: Region | None = None
        self._blocks: list[MemoryBlock] = []

    def put(self, array: Array) -> int | None:
        """Offset of an array, which is copied unless it is in the memory; None: there is no room for it."""
        at = self._arena.offset_of(array)
        if at is not None:
            return at
        if self._region is None:
            self._region = Region(self._arena.memory, self._arena.allocate(self._size))
        at = self._region.put(array)
        if at is None and (block := self._arena.allocate(array.nbytes)):
            self._blocks.append(block)
            at = block.start
            copy_into(self._arena.memory, at, array)
        return at

    def blocks(self) -> Sequence[MemoryBlock]:
        """Blocks that are in use until the message is answered."""
        used = [self._arena.shrink(self._region.block, self._region.used)] if self._region else []
        return [*used, *self._blocks]


class Sender:
    """Sends batches to workers and reads their results; large arrays stay in the memory that all share."""

    def __init__(self, arena: Arena) -> None:
        self._arena = arena
        self._expected: dict[str, int] = {}
        """Bytes of the arrays of the products of a job, by the name of the stage."""

    def send(self, worker: Worker, batches: Iterable[Batch]) -> None:
        """Send a worker batches, each of which it answers; one that has ended is noticed once its end is read."""
        message = list[Batch]()
        for batch in batches:
            expected = self._expected.get(batch.name)
            size = sum(job.size for job in batch.jobs) if expected is None else expected * len(batch.jobs)
            message.append(batch._replace(room=self._arena.allocate(size)))
        placing = _Placing(self._arena, sum(job.size for batch in message for job in batch.jobs))
        file = io.BytesIO()
        Pickler(file, worker.known, placing.put).dump(message)
        worker.sent.extend(map(Sent, message))
        worker.sent[-1].blocks = placing.blocks()  # what the batches share is released after the last of them
        with suppress(OSError):
            worker.pipe.send_bytes(file.getbuffer())

    def read(self, worker: Worker, returned: bytes) -> Returned:
        """The results of the oldest batch that a worker has, from the bytes that it has returned."""
        sent = worker.sent.popleft()
        batch = sent.batch
        asked, used, cpu_s = HEAD.unpack_from(returned)
        array_at = self._arrays_of(batch.room, used) if batch.room else None
        results = Unpickler(io.BytesIO(memoryview(returned)[HEAD.size :]), worker.received, array_at).load()
        for block in sent.blocks:
            self._arena.release(block)
        self._expected[batch.name] = max(self._expected.get(batch.name, 0), asked // len(batch.jobs))
        return Returned(batch, results, cpu_s)

    def release(self, worker: Worker) -> None:
        """Release the memory of the batches of a worker that has ended."""
        for sent in worker.sent:
            for block in (*sent.blocks, *([sent.batch.room] if sent.batch.room else [])):
                self._arena.release(block)

    def _arrays_of(self, room: MemoryBlock, used: int) -> ArrayAt:
        """Function that returns arrays in a room, which is given back once nobody uses any of them."""
        room = self._arena.shrink(room, used)
        whole = self._arena.bytes_of(room)

        def array_at(at: int, dtype: str, shape: tuple[int, ...]) -> Array:
            first = at - room.start
            size = math.prod(shape) * np.dtype(dtype).itemsize
            return whole[first : first + size].view(dtype).reshape(shape)

        return array_at
