"""Subscriptions of a recorder: quality of service that suits all publishers, and the messages that have arrived."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

QUEUE_DEPTH = 1000
"""Messages of a topic that may wait in the middleware until the node takes them."""


TAKE_PERIOD_S = 0.05
"""Time from one look at what has arrived to the next, s: to wake up for each message takes longer than to write it."""

IDLE_PERIOD_S = 0.2
"""The same while nothing arrives: of a topic that starts, the middleware keeps 5000 messages in a second until then."""

EMPTY_LOOKS = 20
"""Looks one after the other that find nothing, after which nothing is assumed to arrive."""


class Arrived(NamedTuple):
    """A message that has arrived, with its number and the times of its transport."""

    topic: str
    cdr: bytes
    info: dict[str, Any]


class TimedLooks:
    """A timer that takes what has arrived, less often while nothing arrives."""

    def __init__(self, node: Node, take: Callable[[], bool]) -> None:
        """Look from now on; `take` returns whether something had arrived, and must not raise."""
        self._take, self._empty = take, 0
        self._timer = node.create_timer(TAKE_PERIOD_S, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    @property
    def period_s(self) -> float:
        """Time from one look to the next, s."""
        return float(self._timer.timer_period_ns) * 1e-9

    def _look(self) -> None:
        self._empty = 0 if self._take() else self._empty + 1
        period_ns = round((IDLE_PERIOD_S if self._empty >= EMPTY_LOOKS else TAKE_PERIOD_S) * 1e9)
        if self._timer.timer_period_ns != period_ns:
            self._timer.timer_period_ns = period_ns
            self._timer.reset()  # else the next look is after the former period


def arrived(subscriptions: Mapping[str, Subscription]) -> Iterator[Arrived]:
    """The messages that have arrived on all topics and that no executor has handed out, in the order of arrival."""
    yield from in_order_of_arrival([list(_arrived_on(topic, one)) for topic, one in subscriptions.items()])


def in_order_of_arrival(topics: Iterable[Iterable[Arrived]]) -> Iterator[Arrived]:
    """The messages of several topics by the times of their arrival; those of one topic stay in their order.

    One that the network had lost arrives after those that its publisher sent later, and the middleware gives it before
    them.
    """
    return heapq.merge(*topics, key=lambda message: int(message.info["received_timestamp"]))


def _arrived_on(topic: str, subscription: Subscription) -> Iterator[Arrived]:
    for _ in range(QUEUE_DEPTH):
        with subscription.handle:
            taken = subscription.handle.take_message(subscription.msg_type, True)
        if taken is None:
            return
        yield Arrived(topic, *taken)


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
