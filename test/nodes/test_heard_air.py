"""Air data that arrive as messages: what is refused, and when a node that needs them is ready."""

from __future__ import annotations

from typing import Any

from air_messages import air_at, temperature_at
from chain_fixture import START_NS, TIMEOUT_S, StageChain
from helpers import assert_one_sentence, publisher_of
from rclpy.node import Node
from rclpy.parameter import Parameter

from sal_height import messages
from sal_height.messages.types import ChannelFrame, FluidPressure, Odometry, SensorInfo, Temperature
from sal_height.nodes.processing import PROCESSING
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.qos import LATCHED_QOS
from sal_height.simulation.flight import SimulatedFlight

SECOND = 1_000_000_000
HEARD = {"rows": 46, "cols": 12, "air": "topics", "map_height_m": 120.0}


def test_a_temperature_in_kelvin_is_counted_and_costs_nothing(flight: SimulatedFlight) -> None:
    chain = StageChain(flight, image=HEARD)
    stage = chain.stages["sar_compression"]
    chain.publish(chain.sensor_info(), *air_at(START_NS - 3 * SECOND), temperature_at(START_NS - 2 * SECOND, 265.65))
    assert stage.counted("ignored.") == {"air": 1}
    assert_one_sentence(stage.last_rejection.removeprefix("air: "), "265.65", "-93.15 to 66.85 degrees Celsius")
    chain.publish(*chain.odometry(0), *chain.frames(0))
    stated = messages.stages_of(chain.heights["ml", 0].provenance.parameters)["sar_compression"]
    assert stated["heard_air.air_temperature_k"] == 265.65
    assert not chain.dropped("sar_compression")


def test_a_node_that_is_to_hear_the_air_is_ready_once_somebody_tells_it(graph: Graph, flight: SimulatedFlight) -> None:
    node = graph.add(
        PROCESSING["sar_compression"](context=graph.context, parameter_overrides=[Parameter("air", value="topics")])
    )
    sensor = graph.add(Node("sensor", context=graph.context))
    kinds: dict[str, Any] = {"platform/odometry": Odometry, "phase_history": ChannelFrame}
    for topic, kind in kinds.items():
        publisher_of(sensor, kind, topic, 10)
    described = messages.sensor_to_message(flight.sensor, messages.to_stamp(START_NS))
    publisher_of(sensor, SensorInfo, "sensor_info", LATCHED_QOS).publish(described)

    def has_all_else() -> bool:
        return node.stage.is_ready and all(inlet.is_connected for inlet in node._inlets)

    assert graph.spin_until(has_all_else, TIMEOUT_S)
    assert not node.is_ready
    publisher_of(sensor, FluidPressure, "air/pressure", 10)
    assert graph.spin_until(lambda: node._inlets_of["air/pressure"].is_connected, TIMEOUT_S)
    assert not node.is_ready
    publisher_of(sensor, Temperature, "air/temperature", 10)
    assert graph.spin_until(lambda: node.is_ready, TIMEOUT_S)
    assert node.set_parameters([Parameter("air", value="none")])[0].successful
