"""Subscriptions that receive from publishers of any quality of service."""

from __future__ import annotations

import threading

import pytest
from helpers import publisher_of
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from sal_height.messages.types import KeyValue
from sal_height.nodes.accounts.account import Account
from sal_height.nodes.transport.endpoints import Outlet
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.qos import FRAMES_QOS, LATCHED_QOS
from sal_height.nodes.worker import WorkerNode

TIMEOUT_S = 120.0
BEST_EFFORT, RELIABLE = ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE
VOLATILE, LATCHED = DurabilityPolicy.VOLATILE, DurabilityPolicy.TRANSIENT_LOCAL


class Hearing(WorkerNode):
    """A stage that keeps what it hears on a topic."""

    def __init__(self, graph: Graph, qos: QoSProfile) -> None:
        super().__init__("hearing", context=graph.context)
        self.heard: list[str] = []
        self.listen(KeyValue, "words", lambda message: self.heard.append(message.value), qos)
        graph.add(self)

    @property
    def asks_for(self) -> QoSProfile:
        return self._inlets[0].subscription.qos_profile


@pytest.mark.parametrize("wanted", [FRAMES_QOS, LATCHED_QOS], ids=["frames", "latched"])
@pytest.mark.parametrize("reliability", [BEST_EFFORT, RELIABLE])
@pytest.mark.parametrize("durability", [VOLATILE, LATCHED])
def test_messages_of_any_publisher_are_received(
    reliability: ReliabilityPolicy, durability: DurabilityPolicy, wanted: QoSProfile, graph: Graph
) -> None:
    source = graph.add(Node("source", context=graph.context))
    offered = QoSProfile(depth=5, reliability=reliability, durability=durability)
    publisher = publisher_of(source, KeyValue, "words", offered)
    hearing = Hearing(graph, wanted)
    assert graph.spin_until(lambda: hearing.is_ready and publisher.get_subscription_count() == 1, TIMEOUT_S)
    publisher.publish(KeyValue(value="hello"))
    assert graph.spin_until(lambda: hearing.heard == ["hello"], TIMEOUT_S)
    assert hearing.asks_for.reliability == reliability
    less = VOLATILE in {durability, wanted.durability}
    assert hearing.asks_for.durability == (VOLATILE if less else LATCHED)


def test_a_publisher_that_offers_less_than_another_does_not_make_a_node_ask_for_less(graph: Graph) -> None:
    source = graph.add(Node("source", context=graph.context))
    reliable = publisher_of(source, KeyValue, "words", FRAMES_QOS)
    hearing = Hearing(graph, FRAMES_QOS)
    assert graph.spin_until(lambda: hearing.is_ready, TIMEOUT_S)
    subscription = hearing._inlets[0].subscription
    publisher_of(source, KeyValue, "words", QoSProfile(depth=5, reliability=BEST_EFFORT))
    assert graph.spin_until(lambda: hearing._inlets[0].unsuited > 0, TIMEOUT_S)
    assert hearing._inlets[0].subscription is subscription
    reliable.publish(KeyValue(value="hello"))
    assert graph.spin_until(lambda: hearing.heard == ["hello"], TIMEOUT_S)
    assert hearing.asks_for.reliability == RELIABLE


def test_messages_that_the_middleware_has_lost_are_told(graph: Graph) -> None:
    """Those of before the first one that came, too; a latched topic is to deliver the last one only."""
    source = graph.add(Node("source", context=graph.context))
    publishers = {name: publisher_of(source, KeyValue, name, FRAMES_QOS) for name in ("words", "others")}
    few = QoSProfile(depth=3, reliability=RELIABLE)
    hearing = Hearing(graph, few)
    hearing.listen(KeyValue, "others", lambda _: None, LATCHED_QOS)
    assert graph.spin_until(lambda: all(p.get_subscription_count() == 1 for p in publishers.values()), TIMEOUT_S)
    assert graph.spin_until(lambda: hearing.is_ready, TIMEOUT_S)
    for number in range(10):
        for publisher in publishers.values():
            publisher.publish(KeyValue(value=str(number)))
    assert graph.spin_until(lambda: hearing.heard[-1:] == ["9"], TIMEOUT_S)
    account = Account.of_status(hearing.diagnostics().status[0])
    assert account.missed == {"words": 10 - len(hearing.heard)}
    assert account.missed["words"] >= 5
    publishers["words"].publish(KeyValue(value="after"))
    assert graph.spin_until(lambda: hearing.heard[-1] == "after", TIMEOUT_S)
    assert Account.of_status(hearing.diagnostics().status[0]).missed == account.missed


def test_publishers_are_counted_while_a_subscription_is_replaced(graph: Graph, monkeypatch: pytest.MonkeyPatch) -> None:
    """The account, which another thread publishes, counts them at any time."""
    source = graph.add(Node("source", context=graph.context))
    publisher = publisher_of(source, KeyValue, "words", FRAMES_QOS)
    hearing = Hearing(graph, FRAMES_QOS)
    assert graph.spin_until(lambda: hearing.is_ready, TIMEOUT_S)
    inlet, destroy, counts = hearing._inlets[0], hearing.destroy_subscription, list[int]()
    thread = threading.Thread(target=lambda: counts.append(inlet.publishers), daemon=True)

    def destroy_while_asked(subscription: Subscription) -> bool:
        done = destroy(subscription)
        thread.start()
        thread.join(0.2)
        return done

    monkeypatch.setattr(hearing, "destroy_subscription", destroy_while_asked)
    inlet.join(Outlet(publisher), lambda *_: None)
    thread.join(TIMEOUT_S)
    assert counts == [1]
