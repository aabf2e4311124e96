"""Nodes that do nothing: they gather dwells as the real ones do, and publish products of the same size.

Each processes dwells until one has products, and publishes the bytes of these again, with a new stamp, for every dwell
that follows.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from sal_height import messages
from sal_height.bag.stamps import stamp_ns_of
from sal_height.messages import serialize
from sal_height.nodes.endpoints import Outlet
from sal_height.nodes.height import HEIGHT_NODES
from sal_height.nodes.playlist import restamped
from sal_height.nodes.relief_mapper import ReliefMapper
from sal_height.nodes.relief_tracker import ReliefTracker
from sal_height.nodes.sar_compression import SarCompression


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

    def process(self, received: Any, *others: Any) -> int:
        """Publish products.

        Args:
            received: the message, or those of all channels.
            others: what else the node takes.
        """
        first = received[0] if isinstance(received, Sequence) else received
        stamp_ns = messages.to_ns(first.header.stamp)
        repeated = sum(outlet.repeat(stamp_ns) for outlet in self.__dict__["_keeping"])
        return repeated or super().process(received, *others)  # type: ignore[misc]


class IdleMapper(ReliefMapper):
    """Takes heights, and enters none."""

    def _enter(self, image: Any) -> int:  # noqa: ARG002 (what comes is left out)
        return 0


REAL: dict[str, type[Any]] = {"sar_compression": SarCompression, **HEIGHT_NODES, "relief_tracker": ReliefTracker}

IDLE: dict[str, type[Any]] = {
    **{name: type(f"Idle_{name}", (Repeating, node), {}) for name, node in REAL.items()},
    "relief_mapper": IdleMapper,
}
"""Nodes that do nothing by the name of those that they stand for."""
