"""A worker process of a pool, and the process that starts workers."""

from __future__ import annotations

import io
import json
import os
import signal
import socket
import struct
import time
from collections.abc import Sequence
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

from sal_height.engine.image_items import Images
from sal_height.engine.registry import STAGES
from sal_height.engine.stage import Job, Product, Result, Stage
from sal_height.workers.arena import Arena, MemoryBlock, Region
from sal_height.workers.processes import end_with_parent, name_process
from sal_height.workers.transfer import Known, Pickler, Unpickler, array_in

NICENESS = 4
"""Degree to which workers give way to the threads that receive and publish messages, as in nice(1)."""

RESTART_S = 0.1
"""Time from the end of a worker to the start of the next one, s."""


class Batch(NamedTuple):
    """Jobs of a node that a worker is given together.

    Attributes:
        kind: usual name of the stage.
        name: name of the node, with its namespace.
        jobs: jobs of the node.
        room: block for the arrays of the products; None: there is none.
    """

    kind: str
    name: str
    jobs: Sequence[Job]
    room: MemoryBlock | None


HEAD = struct.Struct("<QQd")
"""Start of the answer of a worker: bytes of the arrays of its products, bytes of them that are in the room of the
batch, and processor time of the work, s. The results follow."""


def keep_workers(keeper_of: socket.socket, workers: int, arena: Arena) -> int:
    """Start workers, and another one whenever one has ended, until this process is killed.

    Args:
        keeper_of: connection to the pool, which gets that of each worker.
        workers: number of workers.
        arena: memory that they share.
    """
    keeper = os.getpid()
    numbers: dict[int, int] = {}

    def start(number: int) -> None:
        ours, theirs = socket.socketpair()
        pid = os.fork()
        if pid == 0:
            keeper_of.close()
            ours.close()
            if end_with_parent(keeper, signal.SIGKILL):
                name_process(f"worker {number}")
                serve(Connection(theirs.detach()), arena)
            os._exit(0)
        numbers[pid] = number
        theirs.close()
        socket.send_fds(keeper_of, [json.dumps({"number": number, "pid": pid}).encode()], [ours.fileno()])
        ours.close()

    waiting = list(range(workers))
    while True:
        while waiting:
            try:
                start(waiting[0])
            except OSError:  # there is no memory for it yet, as often where a worker has ended for lack of it
                time.sleep(RESTART_S)
            else:
                waiting.pop(0)
        ended, _ = os.wait()
        time.sleep(RESTART_S)
        waiting.append(numbers.pop(ended))


def serve(pipe: Connection, arena: Arena) -> None:
    """Process the batches that the pool sends until it closes its end."""
    known: dict[int, Any] = {}
    returned = Known()
    stages: dict[str, Stage] = {}
    array_at = array_in(arena.memory)
    os.nice(NICENESS)
    while True:
        try:
            sent = pipe.recv_bytes()
        except (EOFError, OSError):
            return
        began = time.process_time()
        batches: list[Batch] = Unpickler(io.BytesIO(sent), known, array_at).load()
        for batch in batches:
            if batch.name not in stages:
                name = batch.name.rpartition("/")[2]  # as provenance states it
                stages[batch.name] = STAGES[batch.kind](batch.jobs[0].settings, {}, name)
            results = [[_to_send(one) for one in made] for made in stages[batch.name].process(batch.jobs)]
            region = Region(arena.memory, batch.room)
            file = io.BytesIO(bytes(HEAD.size))
            file.seek(HEAD.size)
            Pickler(file, returned, region.put).dump(results)
            ended = time.process_time()
            HEAD.pack_into(file.getbuffer(), 0, region.asked, region.used, ended - began)
            began = ended
            pipe.send_bytes(file.getbuffer())


def _to_send(result: Result) -> Result:
    """A result as it is sent: images without the data that they were compressed from, which no message has either."""
    if isinstance(result, Product) and isinstance(result.item, Images):
        return Product(result.port, replace(result.item, source=None))
    return result
