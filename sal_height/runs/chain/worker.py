"""A worker process of the chain: its jobs, their transport, and the results of its stages."""

from __future__ import annotations

import functools
import io
import mmap
import os
import pickle
import signal
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from sal_height.calibration import Calibration
from sal_height.engine.image_items import Images
from sal_height.engine.stage import DwellKey, Job, Product, Rehearsal, Result, Stage
from sal_height.sensor import Sensor
from sal_height.settings import Settings

SHARED = (Sensor, Settings, Calibration)
"""Classes of objects that are never changed, and of which workers keep the ones that they were sent."""


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


def count_messages(item: Any) -> int:
    """Number of messages that an item is."""
    if isinstance(item, Unsent):
        return item.messages
    return item.count if isinstance(item, Images) else 1


class Control(NamedTuple):
    """An item that the stages of a worker accept on a port in addition to dwells, such as a sensor."""

    port: str
    item: Any


Sent: TypeAlias = tuple[int, DwellKey | None, Result]
"""Number of a stage, the dwell of a job, and its products or loss."""


@dataclass
class Ring:
    """Memory shared by two processes; it is released in the order in which it was written."""

    memory: mmap.mmap
    size: int
    at: int = 0
    used: int = 0
    taken: int = 0
    """Bytes used by the current message."""

    @classmethod
    def of(cls, size: int) -> Ring:
        """A ring of `size` bytes, shared by processes that are forked."""
        return cls(mmap.mmap(-1, size), size)

    def put(self, array: np.ndarray[Any, np.dtype[Any]]) -> int | None:
        """Copy an array into the ring and return its offset; None: there is no room for it."""
        room = -(-array.nbytes // 64) * 64
        if not self.used:
            self.at = 0
        wraps = self.at + room > self.size
        skipped = self.size - self.at if wraps else 0
        if self.used + skipped + room > self.size:
            return None
        at = 0 if wraps else self.at
        np.frombuffer(self.memory, array.dtype, array.size, at)[:] = array.reshape(-1)
        self.at, self.used, self.taken = at + room, self.used + skipped + room, self.taken + skipped + room
        return at

    def release(self, taken: int) -> None:
        """Release the bytes of the oldest message."""
        self.used -= taken


@functools.cache
def _is_shared(kind: type) -> bool:
    """True if objects of a class are sent once."""
    return issubclass(kind, SHARED)


class Pickler(pickle.Pickler):
    """Sends shared objects once, and large arrays through the ring."""

    def __init__(self, file: io.BytesIO, known: dict[int, tuple[int, Any]], ring: Ring | None) -> None:
        super().__init__(file, protocol=5)
        self._known, self._ring = known, ring

    def persistent_id(self, obj: Any) -> Any:
        """Substitute for an object that is not sent as it is; called for every one, however small."""
        kind = type(obj)
        if kind is np.ndarray:
            least_shared_bytes = 16_384  # smaller arrays do not go through shared memory
            if self._ring and obj.nbytes >= least_shared_bytes and obj.flags.c_contiguous:
                at = self._ring.put(obj)
                if at is not None:
                    return "array", at, obj.dtype.str, obj.shape
            return None
        if not _is_shared(kind):  # type: ignore[arg-type]
            return None
        if id(obj) in self._known:
            return "known", self._known[id(obj)][0]
        number = len(self._known)
        self._known[id(obj)] = number, obj
        return "new", number, pickle.dumps(obj, protocol=5)


class Unpickler(pickle.Unpickler):
    """Reads what `Pickler` has written."""

    def __init__(self, file: io.BytesIO, known: dict[int, Any], ring: Ring | None) -> None:
        super().__init__(file)
        self._known, self._ring = known, ring

    def persistent_load(self, pid: Any) -> Any:
        """The object that was sent otherwise."""
        kind, *rest = pid
        if kind == "array" and self._ring:
            at, dtype, shape = rest
            return np.frombuffer(self._ring.memory, dtype, int(np.prod(shape)), at).reshape(shape)
        if kind == "new":
            self._known[rest[0]] = pickle.loads(rest[1])  # noqa: S301 (our own process wrote it)
        return self._known[rest[0]]


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
        sent_back: dict[int, tuple[int, Any]] = {}
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends it to all; the parent ends in order
        while True:
            try:
                sent = pipe.recv_bytes()
            except (EOFError, OSError):
                sent = b""
            if not sent:
                os._exit(0)
            message = Unpickler(io.BytesIO(sent), known, ring).load()
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
