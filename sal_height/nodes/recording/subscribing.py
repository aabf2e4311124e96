"""Subscriptions of a recorder: quality of service that suits all publishers, and the messages that have arrived."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

QUEUE_DEPTH = 1000
"""Messages of a topic that may wait in the middleware until the node takes them."""


def arrived(subscription: Subscription) -> Iterator[tuple[bytes, dict[str, Any]]]:
    """The messages that have arrived and that no executor has handed out, with the times of their transport."""
    for _ in range(QUEUE_DEPTH):
        with subscription.handle:
            taken = subscription.handle.take_message(subscription.msg_type, True)
        if taken is None:
            return
        yield taken


def matching_profile(offered: Sequence[QoSProfile]) -> QoSProfile:
    """The strictest profile that receives from all publishers, with a deep queue."""
    reliable = all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in offered)
    latched = all(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in offered)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=QUEUE_DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def replaces_messages(offered: Sequence[QoSProfile]) -> bool:
    """True if a message of the publishers may replace the one before; where the middleware states no depth, it is 0."""
    return all(one.durability == DurabilityPolicy.TRANSIENT_LOCAL and one.depth <= 1 for one in offered)
