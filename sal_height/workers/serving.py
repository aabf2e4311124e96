"""The loop of a worker process: batches of jobs, and the results of its stages."""

from __future__ import annotations

import io
import struct
import time
from collections.abc import Mapping, Sequence
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

from sal_height.engine.registry import STAGES
from sal_height.engine.stage import Job, Stage
from sal_height.workers.arena import Arena, MemoryBlock, Region
from sal_height.workers.transfer import Known, Pickler, Unpickler, array_in


class Batch(NamedTuple):
    """Jobs of a stage that a worker is given together.

    Attributes:
        kind: usual name of the stage.
        name: name of the stage, or of its node with the namespace.
        jobs: jobs of the stage.
        room: block for the arrays of the products; None: there is none.
    """

    kind: str
    name: str
    jobs: Sequence[Job]
    room: MemoryBlock | None = None


HEAD = struct.Struct("<QQd")
"""Start of the answer of a worker: bytes of the arrays of its products, bytes of them that are in the room of the
batch, and processor time of the work, s. The results follow."""


def serve(pipe: Connection, arena: Arena, stages: Mapping[str, Stage]) -> None:
    """Process the batches that a worker is sent until the other end of the pipe is closed.

    Args:
        pipe: connection to the process that sends batches.
        arena: memory that both share.
        stages: stages at first, by name; others are made when they have a job.
    """
    known: dict[int, Any] = {}
    returned = Known()
    own = dict(stages)
    array_at = array_in(arena.memory)
    while True:
        try:
            sent = pipe.recv_bytes()
        except (EOFError, OSError):
            return
        began = time.process_time()
        batches: list[Batch] = Unpickler(io.BytesIO(sent), known, array_at).load()
        for batch in batches:
            if batch.name not in own:
                name = batch.name.rpartition("/")[2]  # as provenance states it
                own[batch.name] = STAGES[batch.kind](batch.jobs[0].settings, {}, name)
            results = list(own[batch.name].process(batch.jobs))
            region = Region(arena.memory, batch.room)
            file = io.BytesIO(bytes(HEAD.size))
            file.seek(HEAD.size)
            Pickler(file, returned, region.put).dump(results)
            ended = time.process_time()
            HEAD.pack_into(file.getbuffer(), 0, region.asked, region.used, ended - began)
            began = ended
            pipe.send_bytes(file.getbuffer())
