"""Jobs that the stage of a node makes of messages, to be timed without what brings the messages."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from sal_height.engine.stage import Job
from sal_height.messages.kinds import kind_of
from sal_height.nodes.host import StageNode


def read_items(node: StageNode, port: str, serialized: Iterable[bytes]) -> list[Any]:
    """The items of serialized messages on a port of a node."""
    settings = node.current_parameters()
    kind = kind_of(next(one for one in node.stage.inputs(settings) if one.name == port))
    return [item for cdr in serialized for item in kind.read(cdr, settings)]


def job_of(node: StageNode, messages: Iterable[tuple[str, bytes]]) -> Job:
    """The last job of a dwell that the stage of a node makes of serialized messages (port, bytes).

    Raises:
        RuntimeError: it makes none of them.
    """
    jobs = [
        one
        for port, cdr in messages
        for item in read_items(node, port, [cdr])
        for one in node.stage.accept(port, item)
        if isinstance(one, Job) and one.dwell
    ]
    if not jobs:
        raise RuntimeError(f"Node {node.get_name()} makes no dwell of its messages.")
    return jobs[-1]
