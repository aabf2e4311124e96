"""Faults around a running graph, caused on purpose.

`python -m benchmarks.faults KINDS SEED` does some of FAULTS, separated by commas, to the graph of the ROS domain of the
environment.
"""

from __future__ import annotations

import copy
import multiprocessing
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile

from benchmarks.hostile_messages import hostile
from sal_height.elevation import ESTIMATORS
from sal_height.messages.types import ChannelFrame, ComplexImage, HeightImage, Odometry, SensorInfo
from sal_height.nodes.transport.endpoints import Outlet
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.message_types import class_of, subscribe
from sal_height.nodes.transport.qos import FRAMES_QOS, LATCHED_QOS, ODOMETRY_QOS
from sal_height.settings import settings_of

TOPICS: dict[str, tuple[type, QoSProfile]] = {
    "sensor_info": (SensorInfo, LATCHED_QOS),
    "platform/odometry": (Odometry, ODOMETRY_QOS),
    "phase_history": (ChannelFrame, FRAMES_QOS),
    "slc": (ComplexImage, FRAMES_QOS),
    "ml/height": (HeightImage, FRAMES_QOS),
}

MESSAGES = 200
"""Hostile messages of one fault."""

HOUR_S = 3600
WAIT_S = 5.0
LASTS_S = 2.0


def hostile_messages(topic: str, graph: Graph, rng: np.random.Generator) -> None:
    """Publish messages made of one that was received on `topic`, with fields or bytes spoilt."""
    good, publish = _received(topic, graph)
    for cdr in hostile(good, MESSAGES, rng):
        publish(cdr)
        graph.spin_for(LASTS_S / MESSAGES)


def second_odometry(graph: Graph, _: np.random.Generator) -> None:
    """Publish odometry whose clock is an hour off, beside the true one."""
    good, publish = _received("platform/odometry", graph)
    for number in range(round(100 * LASTS_S)):
        sample = copy.deepcopy(good)
        sample.header.stamp.sec += HOUR_S
        sample.header.stamp.nanosec = number % 100 * 10_000_000
        publish(sample)
        graph.spin_for(0.01)


def other_sensors(graph: Graph, _: np.random.Generator) -> None:
    """Describe eight sensors that do not exist, and publish frames of them."""
    info, describe = _received("sensor_info", graph)
    frame, publish = _received("phase_history", graph)
    for number in range(8):
        info.config_hash = frame.config_hash = f"stranger {number}"
        describe(info)
        publish(frame)
        graph.spin_for(LASTS_S / 8)


def frames_twice(graph: Graph, _: np.random.Generator) -> None:
    """Publish frames that have come once more, as a second source of a channel does."""
    node = graph.add(Node("doubler", context=graph.context))
    publisher = Outlet(node.create_publisher(class_of(ChannelFrame), "phase_history", FRAMES_QOS))
    seen: set[tuple[int, int, int]] = set()

    def repeat(frame: ChannelFrame) -> None:
        key = frame.dwell, frame.channel, frame.header.stamp.nanosec
        if key not in seen:  # its own come back to it
            seen.add(key)
            publisher.publish(frame)

    subscribe(node, ChannelFrame, "phase_history", repeat, FRAMES_QOS)
    graph.spin_for(LASTS_S)


def busy_processors(_: Graph, __: np.random.Generator) -> None:
    """Keep all processors busy."""
    workers = [multiprocessing.get_context("spawn").Process(target=_burn) for _ in range(multiprocessing.cpu_count())]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()


def other_parameters(graph: Graph, _: np.random.Generator) -> None:
    """Set a parameter of ml_height in flight, and set it back."""
    node = graph.add(Node("setter", context=graph.context))
    client = node.create_client(SetParameters, "ml_height/set_parameters")
    graph.spin_until(client.service_is_ready, WAIT_S)
    usual = settings_of(ESTIMATORS["ml"].settings)["min_cnr_db"].default
    for value in (usual + 1.0, usual):
        request = SetParameters.Request(parameters=[Parameter("min_cnr_db", value=value).to_parameter_msg()])
        answer = client.call_async(request)
        graph.spin_until(answer.done, WAIT_S)
        graph.spin_for(LASTS_S / 2)


FAULTS: dict[str, Callable[[Graph, np.random.Generator], None]] = {
    **{
        f"hostile {topic}": lambda graph, rng, topic=topic: hostile_messages(topic, graph, rng)  # type: ignore[misc]
        for topic in TOPICS
    },
    "second odometry": second_odometry,
    "other sensors": other_sensors,
    "frames twice": frames_twice,
    "busy processors": busy_processors,
    "other parameters": other_parameters,
}


def _received(topic: str, graph: Graph) -> tuple[Any, Callable[[Any], None]]:
    """A message that has come on a topic, and a function that publishes others, or their bytes, on it.

    Raises:
        TimeoutError: none has come.
    """
    kind, qos = TOPICS[topic]
    node = graph.add(Node(f"stranger_{len(graph.nodes)}", context=graph.context))
    came: list[Any] = []
    subscription = subscribe(node, kind, topic, came.append, qos)
    publisher = Outlet(node.create_publisher(class_of(kind), topic, qos))
    if not graph.spin_until(lambda: bool(came), WAIT_S):
        raise TimeoutError(f"no message on {topic}")
    node.destroy_subscription(subscription)
    return came[0], publisher.publish


def _burn() -> None:
    end = time.monotonic() + LASTS_S
    while time.monotonic() < end:
        pass


def _main(kinds: str, seed: str) -> None:
    with Graph() as graph:
        for kind in kinds.split(","):
            FAULTS[kind](graph, np.random.default_rng(int(seed)))


if __name__ == "__main__":
    _main(*sys.argv[1:])
