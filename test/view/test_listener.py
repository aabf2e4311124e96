"""Listening to a live graph: any quality of service is received, and nobody waits for a viewer that is slow."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable

import pytest
from helpers import publisher_of
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from sal_height.messages.types import ComplexImage, DiagnosticArray, HeightImage, Odometry
from sal_height.nodes.transport.graph import Graph
from sal_height.view.drawings import ReceivedMessage
from sal_height.view.listener import ITEM_BYTES, LOST, TOO_SLOW, Listener

TIMEOUT_S = 120.0

LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
RELIABLE = QoSProfile(depth=256, reliability=ReliabilityPolicy.RELIABLE)

SENSOR = {
    "/uav1/ml/height": (HeightImage, RELIABLE),
    "/uav1/slc": (ComplexImage, BEST_EFFORT),
    "/uav1/platform/odometry": (Odometry, LATCHED),
    "/diagnostics": (DiagnosticArray, RELIABLE),
}


def received_within(listener: Listener, enough: Callable[[], bool], take: Callable[[ReceivedMessage], None]) -> None:
    """Take what is received until it is enough."""
    deadline = time.monotonic() + TIMEOUT_S
    while not enough():
        assert time.monotonic() < deadline, listener.topics
        if received := listener.received():
            take(received)


def test_sensors_of_a_namespace_are_received_whatever_their_quality_of_service(graph: Graph, domain_id: int) -> None:
    source = graph.add(Node("source", context=graph.context))
    others = {"/uav2/ml/height": (HeightImage, RELIABLE), "/uav1/phase": (Odometry, RELIABLE)}
    publishers = {t: publisher_of(source, kind, t, qos) for t, (kind, qos) in (SENSOR | others).items()}
    got: Counter[str] = Counter()

    def take(received: ReceivedMessage) -> None:
        assert isinstance(received.read(), object)
        assert abs(received.received_ns - time.time_ns()) < TIMEOUT_S * 1e9
        got[received.topic] += 1

    def publish_until_all_are_received() -> bool:
        for topic, publisher in publishers.items():
            publisher.publish((SENSOR | others)[topic][0]())
        graph.spin_until(lambda: True)
        return set(got) >= set(SENSOR)

    with Listener("uav1", 1_000_000, domain_id) as listener:
        received_within(listener, publish_until_all_are_received, take)
        assert listener.topics == sorted(SENSOR)
    assert set(got) == set(SENSOR)


def test_a_viewer_that_takes_nothing_costs_the_oldest_messages_and_the_publisher_no_time(
    graph: Graph, domain_id: int
) -> None:
    source = graph.add(Node("source", context=graph.context))
    publisher = publisher_of(source, HeightImage, "ml/height", RELIABLE)
    image = HeightImage(validity=bytes(20_000))
    count, room = 200, 10
    with Listener("", room * (20_000 + 2 * ITEM_BYTES), domain_id) as listener:
        assert graph.spin_until(lambda: publisher.get_subscription_count() == 1, TIMEOUT_S)
        began = time.monotonic()
        for dwell in range(count):
            image.dwell = dwell
            publisher.publish(image)
        took_s = time.monotonic() - began

        def left_out(reason: str) -> int:
            return listener.left_out.get(("/ml/height", reason), 0)

        assert graph.spin_until(lambda: left_out(TOO_SLOW) + left_out(LOST) >= count - room - 1, TIMEOUT_S), (
            listener.left_out
        )
        dwells: list[int] = []
        received_within(
            listener,
            lambda: bool(dwells) and dwells[-1] == count - 1,
            lambda received: dwells.append(received.read().dwell),
        )
    assert took_s < TIMEOUT_S / 4
    assert dwells == sorted(dwells)
    assert len(dwells) <= room + 1
    assert len(dwells) + left_out(TOO_SLOW) + left_out(LOST) == count


@pytest.mark.parametrize("entered", [True, False])
def test_a_listener_ends_whether_it_was_used_or_not(entered: bool, domain_id: int) -> None:
    listener = Listener("", 1000, domain_id)
    if entered:
        with listener:
            assert listener.received() is None
    else:
        listener.graph.close()
    assert not listener.graph.context.ok()
