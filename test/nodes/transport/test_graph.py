"""A graph is spun for as long as it is asked to be, whatever its nodes do."""

from __future__ import annotations

import time

from rclpy.node import Node
from std_msgs.msg import String

from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.qos import FRAMES_QOS

ENDED_S = 10.0
"""When the messages stop after all, so that a failure ends."""


def test_time_is_over_even_while_messages_never_stop(graph: Graph) -> None:
    """Each word is answered at once by another one: the executor always has something to do."""
    node = graph.add(Node("echo", context=graph.context))
    publisher = node.create_publisher(String, "words", FRAMES_QOS)
    began, heard = time.monotonic(), []

    def answer(word: String) -> None:
        heard.append(word)
        if time.monotonic() - began < ENDED_S:
            publisher.publish(word)

    node.create_subscription(String, "words", answer, FRAMES_QOS)
    assert graph.spin_until(lambda: publisher.get_subscription_count() == 1, ENDED_S)
    for _ in range(8):
        publisher.publish(String(data="word"))
    began = time.monotonic()
    graph.spin_for(0.3)
    assert 0.3 <= time.monotonic() - began < 0.5 * ENDED_S
    assert len(heard) > 100


def test_time_passes_while_nothing_happens(graph: Graph) -> None:
    began = time.monotonic()
    graph.spin_for(0.2)
    assert 0.2 <= time.monotonic() - began < 5.0
