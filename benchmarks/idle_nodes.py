"""Nodes that do nothing: they gather dwells as the real ones do, and publish products of the same size.

Each processes dwells until one has products, and publishes the bytes of these again, with a new stamp, for every dwell
that follows.
"""

from __future__ import annotations

from typing import Any

from sal_height.bag.topics import stamp_ns_of
from sal_height.engine.stage import Job
from sal_height.messages import serialize
from sal_height.nodes.playing.playlist import restamped
from sal_height.nodes.processing import PROCESSING
from sal_height.nodes.transport.endpoints import Outlet


class KeepingOutlet(Outlet):
    """A publisher that keeps the bytes of what it has published of the first stamp."""

    def __init__(self, outlet: Outlet) -> None:
        super().__init__(outlet.publisher)
        self._kept: list[bytes] = []

    def publish(self, message: Any) -> None:
        """Publish a message or its bytes."""
        cdr = message if isinstance(message, bytes) else serialize(message)
        if not self._kept or stamp_ns_of(cdr) == stamp_ns_of(self._kept[0]):
            self._kept.append(cdr)
        super().publish(cdr)

    def repeat(self, stamp_ns: int) -> int:
        """Publish once more what is kept, with another stamp; returns how many messages that are."""
        for cdr in self._kept:
            super().publish(restamped(cdr, stamp_ns - stamp_ns_of(cdr)))
        return len(self._kept)


class Repeating:
    """First base of a node that does nothing: its products are made once, and published again for every dwell."""

    def offer(self, *arguments: Any, **more: Any) -> Outlet:
        """A publisher that keeps what it publishes first."""
        outlet = KeepingOutlet(super().offer(*arguments, **more))  # type: ignore[misc]
        self.__dict__.setdefault("_keeping", []).append(outlet)
        return outlet

    def _process_job(self, job: Job, complete_s: float = 0.0) -> int:
        """Publish products once more, or those of the first dwell; returns how many messages that are."""
        repeated = sum(outlet.repeat(job.dwell.stamp_ns) for outlet in self.__dict__["_keeping"]) if job.dwell else 0
        return without_work(self, job, repeated) if repeated else super()._process_job(job, complete_s)  # type: ignore[misc]


class Entering:
    """First base of a mapper that takes heights, and enters none."""

    def _process_job(self, job: Job, complete_s: float = 0.0) -> int:
        return without_work(self, job, 0) if job.dwell else super()._process_job(job, complete_s)  # type: ignore[misc]


def without_work(node: Any, job: Job, published: int) -> int:
    """Let the stage of a node know that a job is done, of which nothing was made; returns what was published."""
    node._decide(lambda: node.stage.note_done(job, []))
    return published


IDLE: dict[str, type[Any]] = {
    **{name: type(f"Idle_{name}", (Repeating, node), {}) for name, node in PROCESSING.items()},
    "relief_mapper": type("IdleMapper", (Entering, PROCESSING["relief_mapper"]), {}),
}
"""Nodes that do nothing by the name of those that they stand for."""
