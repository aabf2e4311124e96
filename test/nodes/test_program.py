"""The loop of a node's program."""

from __future__ import annotations

import threading

from rclpy.node import Node
from std_msgs.msg import Empty

from sal_height.nodes.program import _spin
from sal_height.nodes.transport.graph import Graph

FAR_TOO_MANY = 200_000


def test_a_node_for_which_messages_always_wait_ends(graph: Graph) -> None:
    node = Node("busy", context=graph.context)
    graph.executor.add_node(node)
    publisher, stop, received = node.create_publisher(Empty, "again", 10), threading.Event(), 0

    def publish_again(message: Empty) -> None:
        nonlocal received
        received += 1
        if received == 1000:
            stop.set()
        if received < FAR_TOO_MANY:
            publisher.publish(message)
            publisher.publish(message)

    node.create_subscription(Empty, "again", publish_again, 10)
    publisher.publish(Empty())
    assert not _spin(graph.executor, node, stop)
    assert 1000 <= received < FAR_TOO_MANY
    graph.executor.remove_node(node)
    node.destroy_node()
