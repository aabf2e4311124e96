"""Frames of the platform and the sensor on /tf and /tf_static."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from helpers import publisher_of
from instrument_messages import pose_of, twist_of
from rclpy.node import Node
from rclpy.parameter import Parameter

from sal_height import messages
from sal_height.geometry import Mounting, PlatformState
from sal_height.messages import serialize
from sal_height.messages.transforms import platform_transform, sensor_transform
from sal_height.messages.types import Odometry, PoseStamped, SensorInfo, TFMessage, TwistStamped
from sal_height.nodes.processing import PROCESSING
from sal_height.nodes.simulator import Simulator
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.message_types import subscribe
from sal_height.nodes.transport.qos import INSTRUMENT_QOS, ODOMETRY_QOS, TF_STATIC_QOS
from sal_height.simulation.flight import SimulatedFlight
from sal_height.topics import ODOMETRY

TIMEOUT_S = 120.0


class Viewer:
    """What arrives on /tf, /tf_static and of odometry."""

    def __init__(self, graph: Graph) -> None:
        self.moving: list[TFMessage] = []
        self.fixed: list[TFMessage] = []
        self.odometry: list[Odometry] = []
        node = graph.add(Node("viewer", context=graph.context))
        subscribe(node, TFMessage, "/tf", self.moving.append, ODOMETRY_QOS)
        subscribe(node, TFMessage, "/tf_static", self.fixed.append, TF_STATIC_QOS)
        subscribe(node, Odometry, "platform/odometry", self.odometry.append, ODOMETRY_QOS)


def simulator(graph: Graph, **values: Any) -> Simulator:
    overrides = [Parameter(name, value=value) for name, value in {"preset": "small", "period_s": 0.0, **values}.items()]
    return graph.add(Simulator(context=graph.context, parameter_overrides=overrides))


def test_the_platform_is_on_tf_as_odometry_states_it_and_the_sensor_on_tf_static(graph: Graph) -> None:
    viewer = Viewer(graph)
    source = simulator(graph)
    assert graph.spin_until(lambda: source._tf._moving.subscribers and source._outlets[ODOMETRY].subscribers, TIMEOUT_S)
    source.step()
    assert graph.spin_until(lambda: viewer.fixed and source.jobs == 0 and len(viewer.odometry) > 1, TIMEOUT_S)
    assert graph.spin_until(lambda: len(viewer.moving) == len(viewer.odometry), TIMEOUT_S)
    for transforms, odometry in zip(viewer.moving, viewer.odometry, strict=True):
        (one,) = transforms.transforms
        assert (one.header.frame_id, one.child_frame_id) == ("map", "base_link")
        assert serialize(one.header) == serialize(odometry.header)
        assert serialize(one.transform.rotation) == serialize(odometry.pose.pose.orientation)
        place, position = one.transform.translation, odometry.pose.pose.position
        assert (place.x, place.y, place.z) == (position.x, position.y, position.z)
    ((fixed,),) = (message.transforms for message in viewer.fixed)
    assert (fixed.header.frame_id, fixed.child_frame_id) == ("base_link", source.flight.sensor.mounting.frame_id)


def test_a_source_leaves_the_frames_to_others_if_it_is_asked_to(graph: Graph) -> None:
    source = simulator(graph, publish_tf=False)
    assert not {"/tf", "/tf_static"} & {outlet.topic for outlet in source.outlets}


@pytest.mark.parametrize("publish_tf", [False, True])
def test_navigation_publishes_the_frame_of_the_platform_only_where_it_is_asked_to(
    publish_tf: bool, graph: Graph, flight: SimulatedFlight
) -> None:
    viewer = Viewer(graph)
    overrides = [Parameter("publish_tf", value=publish_tf)] if publish_tf else []
    node = graph.add(PROCESSING["navigation"](context=graph.context, parameter_overrides=overrides))
    assert ("/tf" in {outlet.topic for outlet in node.outlets}) == publish_tf
    if not publish_tf:
        return
    assert graph.spin_until(lambda: all(one.subscribers for one in node.outlets if one.topic == "/tf"), TIMEOUT_S)
    instruments = graph.add(Node("instruments", context=graph.context))
    poses = publisher_of(instruments, PoseStamped, "platform/pose", INSTRUMENT_QOS)
    twists = publisher_of(instruments, TwistStamped, "platform/twist", INSTRUMENT_QOS)
    state: PlatformState
    for state in flight.platform_states(0):
        moved = replace(state, stamp_ns=state.stamp_ns + 10**12)
        twists.publish(twist_of(moved, "map"))
        poses.publish(pose_of(moved))
    assert graph.spin_until(lambda: viewer.moving and viewer.odometry, TIMEOUT_S)
    assert serialize(viewer.moving[0]) == serialize(platform_transform(viewer.odometry[0]))


def test_a_sensor_without_a_frame_of_its_own_has_no_transform(flight: SimulatedFlight) -> None:
    for name, count in (("pod", 1), ("base_link", 0)):
        sensor = replace(flight.sensor, mounting=Mounting(name, (0.1, 0.2, 0.3)))
        info: SensorInfo = messages.sensor_to_message(sensor, messages.to_stamp(5))
        transforms = sensor_transform(info).transforms
        assert len(transforms) == count
        assert all(one.transform.translation.z == 0.3 for one in transforms)
