"""What a node receives from and publishes on: subscriptions that take any quality of service, publishers that count."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable
from typing import Any

from rclpy.event_handler import QoSRequestedIncompatibleQoSInfo, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_policy_name_from_kind
from rclpy.qos_overriding_options import QoSOverridingOptions, QoSPolicyKind
from rclpy.subscription import Subscription

from sal_height.nodes.guard import guarded

RECENT_S = 10.0
"""The level of the diagnostics tells what was lost in this time; the counts tell what was lost at all."""

QOS_OVERRIDES = QoSOverridingOptions(
    [QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY, QoSPolicyKind.DURABILITY]
)
"""Policies that users can set by the qos_overrides parameters; rclpy writes them into the profile that it is given."""

LESS = {
    "RELIABILITY": ("reliability", ReliabilityPolicy.BEST_EFFORT, "best-effort"),
    "DURABILITY": ("durability", DurabilityPolicy.VOLATILE, "volatile"),
}
"""What to ask for instead if no publisher offers as much: field of a profile, its value, and its name, by policy."""


class Outlet:
    """A publisher that counts its messages."""

    def __init__(self, publisher: Publisher) -> None:
        self.publisher = publisher
        self.topic: str = publisher.topic_name
        self.published = 0

    @property
    def subscribers(self) -> int:
        """Number of subscriptions that receive its messages."""
        return int(self.publisher.get_subscription_count())

    @property
    def keeps_all(self) -> bool:
        """Whether it is meant to deliver every message; of a latched topic only the last one matters."""
        return bool(self.publisher.qos_profile.durability != DurabilityPolicy.TRANSIENT_LOCAL)

    def publish(self, message: Any) -> None:
        """Publish a message, or the bytes of a serialized one."""
        self.publisher.publish(message)
        self.published += 1

    def publish_if_heard(self, make: Callable[[], Any]) -> None:
        """Make a message and publish it, if there is a subscription."""
        if self.subscribers:
            self.publish(make())


class Inlet:
    """A subscription of a node.

    It asks for the quality of service that suits the topic. If the only publishers offer less, it is made anew and asks
    for less, for it would receive nothing otherwise.

    Attributes:
        subscription: of the topic, as it is now.
        latched: whether one message is enough for all time.
        has_one_source: whether several publishers would contradict each other.
        heard_at: when the last message came, s of the monotonic clock.
        unsuited: how often a publisher was found whose quality of service does not suit the subscription.
    """

    def __init__(
        self,
        node: Node,
        message_type: type,
        topic: str,
        receive: Callable[[Any], None],
        qos: QoSProfile,
        matched: Callable[[Any], None],
        fail: Callable[[Exception], None],
        *,
        raw: bool,
        has_one_source: bool = False,
    ) -> None:
        """Subscribe; users can set the quality of service by the qos_overrides parameters.

        Args:
            node: that subscribes.
            message_type: class of the messages.
            topic: its name.
            receive: takes a message.
            qos: quality of service.
            matched: called when a publisher comes or goes.
            fail: takes an error in a callback.
            raw: whether `receive` takes serialized messages.
            has_one_source: whether several publishers would contradict each other.
        """
        self.has_one_source = has_one_source
        self.latched = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
        self.heard_at = -math.inf
        self.unsuited = 0
        self._node, self._name = node, topic
        self._profile = copy.copy(qos)

        def take(message: Any) -> None:
            self.heard_at = time.monotonic()
            receive(message)

        def subscribe(overrides: QoSOverridingOptions | None) -> Subscription:
            events = SubscriptionEventCallbacks(incompatible_qos=guarded(self._ask_for_less, fail), matched=matched)
            return node.create_subscription(
                message_type,
                topic,
                guarded(take, fail),
                self._profile,
                event_callbacks=events,
                qos_overriding_options=overrides,
                raw=raw,
            )

        self._subscribe = subscribe
        self.subscription = subscribe(QOS_OVERRIDES)

    @property
    def topic(self) -> str:
        """The topic, with its namespace."""
        return str(self.subscription.topic_name)

    @property
    def publishers(self) -> int:
        """Number of publishers from which messages come."""
        return int(self.subscription.get_publisher_count())

    @property
    def is_connected(self) -> bool:
        """Whether the topic has a publisher, from which messages come without delay."""
        return self.publishers > 0

    def published_elsewhere(self) -> list[str]:
        """Topics of the same name in other namespaces that have publishers, if this one has none."""
        if self.is_connected:
            return []
        names = (name for name, _ in self._node.get_topic_names_and_types() if name != self.topic)
        return [name for name in names if name.endswith(f"/{self._name}") and self._node.count_publishers(name)]

    def is_silent(self, now: float) -> bool:
        """Whether messages that should come do not."""
        return now - self.heard_at > (math.inf if self.latched and self.heard_at > 0 else RECENT_S)

    def _ask_for_less(self, event: QoSRequestedIncompatibleQoSInfo) -> None:
        """Subscribe anew if no publisher offers what is asked for, but one does less."""
        policy = qos_policy_name_from_kind(event.last_policy_kind)
        self.unsuited += 1
        if self.is_connected or policy not in LESS:
            self._node.get_logger().warning(
                f"Nothing is received from one of the publishers on {self.topic}: its {policy.lower()} does not suit "
                "the subscription. Publish as the others do."
            )
            return
        field, value, name = LESS[policy]
        setattr(self._profile, field, value)
        self._node.get_logger().info(f"{self.topic} is published {name}; it is received so, and messages may get lost.")
        self._node.destroy_subscription(self.subscription)
        self.subscription = self._subscribe(None)
