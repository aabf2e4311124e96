"""The sensor's place on the platform comes from /tf_static, through whatever frames lie between."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from chain_fixture import DETECTORS, START_NS, Chain, StageChain, same_heights
from helpers import publisher_of
from rclpy.node import Node
from scipy.spatial.transform import Rotation

from sal_height import messages
from sal_height.geometry import Mounting
from sal_height.messages.types import HeightImage, Quaternion, SensorInfo, TFMessage, TransformStamped, Vector3
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.qos import TF_STATIC_QOS
from sal_height.simulation import SimulatedFlight

IMAGE = {"rows": 46, "cols": 12}


def transform(
    parent: str, child: str, shift: tuple[float, float, float] = (0.0, 0.0, 0.0), turn: Rotation | None = None
) -> TransformStamped:
    made = TransformStamped(child_frame_id=child)
    made.header.frame_id = parent
    made.transform.translation = Vector3(**dict(zip("xyz", shift, strict=True)))
    turn = turn or Rotation.identity()
    made.transform.rotation = Quaternion(**dict(zip("xyzw", turn.as_quat().tolist(), strict=True)))
    return made


def mounted(flight: SimulatedFlight, mounting: Mounting) -> SensorInfo:
    """The description of the sensor with that mounting."""
    return messages.sensor_to_message(replace(flight.sensor, mounting=mounting), messages.to_stamp(START_NS))


def heights_with(flight: SimulatedFlight, mounting: Mounting) -> HeightImage:
    """Heights of a dwell whose sensor is described with a mounting, which counts."""
    chain = StageChain(flight)
    chain.publish(mounted(flight, mounting), *chain.odometry(0), *chain.frames(0))
    return chain.heights["ml", 0]


def test_heights_are_those_of_the_same_mounting_in_sensor_info(flight: SimulatedFlight) -> None:
    """Not those of sensor_info, which says something else here."""
    chain = StageChain(flight, image={**IMAGE, "mounting_from_tf": True})
    turn, arm = Rotation.from_euler("x", 2e-5), (0.3, -0.2, 0.1)
    chain.publish(TFMessage(transforms=[transform("base_link", "pod", arm), transform("pod", "sensor", turn=turn)]))
    chain.publish(mounted(flight, Mounting()), *chain.odometry(0), *chain.frames(0))
    made = chain.heights["ml", 0]
    assert same_heights(made, heights_with(flight, Mounting("sensor", arm, tuple(turn.as_quat().tolist()))))
    assert not same_heights(made, heights_with(flight, Mounting()))


def test_a_dwell_waits_for_the_frame_of_its_sensor(graph: Graph, flight: Any) -> None:
    chain = Chain(graph, flight, missing_after_s=3600.0, image={**IMAGE, "mounting_from_tf": True})
    chain.publish(chain.sensor_info(), *chain.odometry(0), *chain.frames(0))
    node = chain.stages["sar_compression"]
    chain.wait(lambda: node.tally.summary()["waiting"] == DETECTORS, "the frames")
    assert not node.is_ready
    broadcaster = graph.add(Node("broadcaster", context=graph.context))
    publisher = publisher_of(broadcaster, TFMessage, "/tf_static", TF_STATIC_QOS)
    publisher.publish(TFMessage(transforms=[transform("base_link", "sensor")]))
    chain.await_heights(0)
