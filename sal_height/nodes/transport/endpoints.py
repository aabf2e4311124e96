"""Ends of topics in a node: subscriptions that accept any quality of service, publishers that count."""

from __future__ import annotations

import copy
import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from typing import Any

from rclpy._rclpy_pybind11 import InvalidHandle, RCLError
from rclpy.event_handler import QoSRequestedIncompatibleQoSInfo, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_policy_name_from_kind
from rclpy.qos_overriding_options import QoSOverridingOptions, QoSPolicyKind
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from sal_height.nodes.transport.callbacks import guarded, guarded_with_times
from sal_height.nodes.transport.message_types import class_of, publish

RECENT_S = 10.0
"""Time after a loss during which the level of the diagnostics states it, s; the counts state all losses."""

QOS_OVERRIDES = QoSOverridingOptions(
    [QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY, QoSPolicyKind.DURABILITY]
)
"""Policies that users can set by the qos_overrides parameters; rclpy writes them into the profile that it is given."""

LESS = {
    "RELIABILITY": ("reliability", ReliabilityPolicy.BEST_EFFORT, "best-effort"),
    "DURABILITY": ("durability", DurabilityPolicy.VOLATILE, "volatile"),
}
"""Requests to make instead if no publisher offers as much: field of a profile, its value, and its name, by policy."""


NAMELESS = "_"
"""Start of the names that ROS gives to publishers of which it knows no node."""


class Outlet:
    """A publisher that counts its messages."""

    def __init__(self, publisher: Publisher) -> None:
        self.publisher = publisher
        self.topic: str = publisher.topic_name
        self.published = 0
        self.joined: list[Callable[[Any, float], None]] = []
        """Subscribers of this process, which accept items as they are, with the time at which the dwell was
        complete."""

    @property
    def subscribers(self) -> int:
        """Number of subscriptions that receive its messages or items."""
        return self.remote_subscribers + len(self.joined)

    @property
    def remote_subscribers(self) -> int:
        """Number of subscriptions that receive its messages."""
        return int(self.publisher.get_subscription_count())

    def hand_over(self, item: Any, complete_s: float) -> None:
        """Have the subscribers of this process accept an item of a dwell that was complete at a time, s."""
        for accept in tuple(self.joined):
            accept(item, complete_s)

    @property
    def keeps_all(self) -> bool:
        """True if it is meant to deliver every message; of a latched topic only the last one matters."""
        return bool(self.publisher.qos_profile.durability != DurabilityPolicy.TRANSIENT_LOCAL)

    def publish(self, message: Any) -> None:
        """Publish a plain message, or the bytes of a serialized one."""
        publish(self.publisher, message)
        self.published += 1

    def publish_if_heard(self, make: Callable[[], Any]) -> None:
        """Make a message and publish it, if there is a subscription."""
        if self.subscribers:
            self.publish(make())


class Inlet:
    """A subscription of a node.

    It asks for the quality of service that suits the topic. If the only publishers offer less, a new one asks
    for less, for it would receive nothing otherwise.

    Attributes:
        subscription: present subscription of the topic.
        latched: True if one message is enough for all time.
        has_one_source: True if several publishers would contradict each other.
        heard_at: arrival of the last message, s of the monotonic clock.
        received: number of messages that have arrived.
        missed: number of messages, of those numbered since the publisher's start, that have not arrived.
        unsuited: number of times that a publisher was found whose quality of service does not suit the subscription.
        strangers: publishers that define the type of the messages otherwise, as of the last `look_for_strangers`.
        has_only_strangers: True if no other publisher is known.
    """

    def __init__(
        self,
        node: Node,
        message_type: type[Any],
        topic: str,
        receive: Callable[[bytes], None],
        qos: QoSProfile,
        matched: Callable[[Any], None],
        fail: Callable[[Exception], None],
        *,
        has_one_source: bool = False,
    ) -> None:
        """Subscribe; users can set the quality of service by the qos_overrides parameters.

        Args:
            node: node that subscribes.
            message_type: class of plain messages of the type.
            topic: name of the topic.
            receive: callback for a serialized message.
            qos: quality of service.
            matched: callback for a publisher that appears or disappears.
            fail: callback for an error in a callback.
            has_one_source: True if several publishers would contradict each other.
        """
        self.has_one_source = has_one_source
        self.latched = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
        self.heard_at = -math.inf
        self.missed = 0
        self.unsuited = 0
        self.strangers: tuple[str, ...] = ()
        self.has_only_strangers = False
        self._node, self._name, self._type_name = node, topic, message_type.__msgtype__
        self._profile = copy.copy(qos)

        self.received = 0

        self.overflowed = False
        """True if messages were lost, since this was last set to False, for lack of room for those that wait."""
        self._message_class = class_of(message_type)
        self.receive = guarded(receive, fail)
        """Callback for a serialized message."""
        self.is_polled = False
        """True if the node takes the messages when it needs them, and no executor waits for them."""

        def take(cdr: bytes, info: dict[str, Any]) -> None:
            self._note(info)
            self.receive(cdr)

        self._take = guarded(take, fail)

        def subscribe(overrides: QoSOverridingOptions | None) -> Subscription:
            events = SubscriptionEventCallbacks(incompatible_qos=guarded(self._ask_for_less, fail), matched=matched)
            return node.create_subscription(
                self._message_class,
                topic,
                guarded_with_times(take, fail),
                self._profile,
                event_callbacks=events,
                qos_overriding_options=overrides,
                raw=True,
            )

        self._subscribe = subscribe
        self._changing = threading.Lock()  # while a subscription ends, and another takes its place or none
        self.subscription: Subscription | None = subscribe(QOS_OVERRIDES)
        self.topic = str(self.subscription.topic_name)
        """The topic, with its namespace."""
        self._leave = list[Callable[[], None]]()

    def join(self, outlet: Outlet, accept: Callable[[Any, float], None]) -> None:
        """Receive the items of a publisher of this process as they are, and no messages any more.

        Args:
            outlet: the publisher.
            accept: callback for an item, and the time at which its dwell was complete, s.
        """

        def take(item: Any, complete_s: float) -> None:
            self.heard_at = time.monotonic()
            accept(item, complete_s)

        with self._changing:
            self._node.destroy_subscription(self.subscription)
            self.subscription = None
            outlet.joined.append(take)
            self._leave.append(lambda: outlet.joined.remove(take))

    def _note(self, info: Mapping[str, Any]) -> None:
        """Count a message that arrives, and those before it that have not."""
        self.heard_at = time.monotonic()
        self.received += 1
        missed = max(0, info.get("publication_sequence_number", 0) - self.received)
        if missed > self.missed and self.received > 1 and self._profile.reliability == ReliabilityPolicy.RELIABLE:
            self.overflowed = True
        self.missed = missed

    def take_waiting(self) -> Iterator[bytes]:
        """The messages that wait."""
        for cdr, info in self._waiting():
            self._note(info)
            yield cdr

    def receive_waiting(self) -> None:
        """Receive the messages that wait before the executor, which has others to hand over, comes to them."""
        for cdr, info in self._waiting():
            self._take(cdr, info)

    def _waiting(self) -> Iterator[tuple[bytes, Mapping[str, Any]]]:
        """Messages that wait and the times of their transport, no more than there is room for."""
        for _ in range(self._profile.depth):
            taken = None
            with suppress(RCLError, InvalidHandle):  # the node may be ending in another thread
                taken = self.subscription and self.subscription.handle.take_message(self._message_class, True)
            if not taken:
                return
            yield taken

    @property
    def depth(self) -> int:
        """Number of messages that may wait, as users have set it; 0: the middleware chooses it."""
        return int(self._profile.depth)

    def leave(self) -> None:
        """Receive no items any more."""
        while self._leave:
            self._leave.pop()()

    @property
    def publishers(self) -> int:
        """Number of publishers from which messages or items arrive."""
        with self._changing:
            return len(self._leave) if self.subscription is None else int(self.subscription.get_publisher_count())

    @property
    def is_connected(self) -> bool:
        """True if the topic has a publisher, from which messages arrive without delay."""
        return self.publishers > 0

    def published_elsewhere(self) -> list[str]:
        """Topics of the same name in other namespaces that have publishers, if this one has none."""
        if self.is_connected:
            return []
        names = (name for name, _ in self._node.get_topic_names_and_types() if name != self.topic)
        return [name for name in names if name.endswith(f"/{self._name}") and self._node.count_publishers(name)]

    def look_for_strangers(self) -> None:
        """See which publishers were built with another definition of the type; the middleware goes by names alone.

        Publishers that state no hash of their definition, such as those without ROS, are taken to know it.
        """
        ours = {
            str(info.topic_type_hash)
            for info in self._node.get_subscriptions_info_by_topic(self.topic)
            if (info.node_namespace, info.node_name) == (self._node.get_namespace(), self._node.get_name())
        }
        publishers = self._node.get_publishers_info_by_topic(self.topic) if ours else []
        hashes = [(info, str(info.topic_type_hash)) for info in publishers if info.topic_type_hash.version > 0]
        strangers = [info for info, value in hashes if value not in ours]
        self.strangers = tuple(sorted({_name_of(info) for info in strangers}))
        self.has_only_strangers = len(strangers) == len(publishers) > 0

    @property
    def warning(self) -> str:
        """Warnings, each after a space, about publishers that are not right; else nothing."""
        publishers = self.publishers if self.has_one_source else 1
        crowd = f" {publishers} nodes publish {self.topic}: stop all but one."
        return (crowd if publishers > 1 else "") + "".join(
            f" {name} publishes {self.topic} with another definition of {self._type_name}: build it with the "
            f"{self._type_name.split('/')[0]} of this version."
            for name in self.strangers
        )

    def is_silent(self, now: float) -> bool:
        """True if expected messages do not arrive."""
        return now - self.heard_at > (math.inf if self.latched and self.heard_at > 0 else RECENT_S)

    def _ask_for_less(self, event: QoSRequestedIncompatibleQoSInfo) -> None:
        """Subscribe again if no publisher offers what is asked for, but one does less."""
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
        with self._changing:
            self._node.destroy_subscription(self.subscription)
            self.subscription = self._subscribe(None)


def _name_of(publisher: TopicEndpointInfo) -> str:
    """The node of a publisher, with its namespace."""
    if publisher.node_name.startswith(NAMELESS):
        return "A program without a node"
    return f"Node {publisher.node_namespace.rstrip('/')}/{publisher.node_name}"
