"""The messages of a live graph, which never waits for the viewer."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from functools import partial
from types import TracebackType
from typing import Any, Self

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from sal_height.messages import deserialize
from sal_height.nodes.transport.callbacks import guarded
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.message_types import message_class
from sal_height.view.drawings import ReceivedMessage
from sal_height.view.painter import is_shown

QOS = QoSProfile(depth=256, reliability=ReliabilityPolicy.BEST_EFFORT)
"""It suits every publisher, and no publisher waits for a subscription that is best-effort."""

ITEM_BYTES = 1000
"""Memory of a message that waits, in addition to its own bytes."""

WAIT_S = 0.2
"""Time without a message after which a reader can look at other things, s."""

TOO_SLOW, LOST = "arrived while too many waited to be drawn", "got lost on their way"


class Listener:
    """Receives messages in a thread of its own; the oldest are left out if too many wait.

    Use as a context manager.

    Attributes:
        graph: graph of the node that subscribes.
    """

    def __init__(self, namespace: str, most_bytes: int, domain_id: int | None = None) -> None:
        """Listen to sensors in a namespace.

        Args:
            namespace: namespace of the topics; empty: any.
            most_bytes: largest memory of messages that wait, bytes.
            domain_id: ROS domain; None: that of the environment.
        """
        self._namespace, self._most_bytes = namespace, most_bytes
        self._changed = threading.Condition()
        self._waiting: deque[tuple[int, ReceivedMessage]] = deque()
        self._size = 0
        self._left_out: Counter[tuple[str, str]] = Counter()
        self._over = threading.Event()
        self._subscribed: dict[str, Subscription] = {}
        self.graph = Graph(domain_id)
        self._node = self.graph.add(Node("sal_height_view", context=self.graph.context))
        self._node.create_timer(0.25, guarded(self._discover, self._fail))
        self._thread = threading.Thread(target=lambda: self.graph.spin_until(self._over.is_set), name="listener")

    @property
    def topics(self) -> list[str]:
        """Topics that are listened to."""
        return sorted(self._subscribed)

    @property
    def left_out(self) -> dict[tuple[str, str], int]:
        """Number of messages that have been left out, by topic and reason."""
        with self._changed:
            return dict(self._left_out)

    def received(self) -> ReceivedMessage | None:
        """The message that has waited longest; None: no message arrives for WAIT_S."""
        with self._changed:
            if not self._waiting:
                self._changed.wait(WAIT_S)
            if not self._waiting:
                return None
            size, message = self._waiting.popleft()
            self._size -= size
        return message

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self._thread.join()
        self.graph.close()

    def _discover(self) -> None:
        """Subscribe to new topics that are shown."""
        for topic, types in self._node.get_topic_names_and_types():
            fits = len(types) == 1 and is_shown(topic, types[0], self._namespace)
            if fits and topic not in self._subscribed and len(self._subscribed) < 100:
                self._subscribed[topic] = self._subscribe(topic, types[0])

    def _subscribe(self, topic: str, type_name: str) -> Subscription:
        def lose(event: Any) -> None:
            with self._changed:
                self._left_out[topic, LOST] += event.total_count_change

        def take(cdr: bytes) -> None:
            message = ReceivedMessage(
                topic, type_name, time.time_ns(), partial(deserialize, cdr, type_name, shared=True)
            )
            self._take(len(cdr) + ITEM_BYTES, message)

        events = SubscriptionEventCallbacks(message_lost=guarded(lose, self._fail))
        return self._node.create_subscription(
            message_class(type_name), topic, guarded(take, self._fail), QOS, event_callbacks=events, raw=True
        )

    def _take(self, size: int, message: ReceivedMessage) -> None:
        """Let a message of this size (bytes) wait, and leave out the oldest ones beyond the limit of memory."""
        with self._changed:
            while self._waiting and self._size + size > self._most_bytes:
                freed, oldest = self._waiting.popleft()
                self._size -= freed
                self._left_out[oldest.topic, TOO_SLOW] += 1
            self._waiting.append((size, message))
            self._size += size
            self._changed.notify()

    def _fail(self, error: Exception) -> None:
        self._node.get_logger().error(f"Unexpected failure, please report it: {error!r}", throttle_duration_sec=1.0)
