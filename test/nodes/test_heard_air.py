"""The compression in the air that messages tell of: alike with rclpy, whatever comes first, and what it leaves out."""

from __future__ import annotations

from typing import Any

import pytest
from air_messages import air_at, pressure_at, temperature_at
from chain_fixture import DETECTORS, START_NS, TIMEOUT_S, Chain, same_heights
from helpers import assert_one_sentence, publisher_of
from rclpy.node import Node
from rclpy.parameter import Parameter

from sal_height import messages
from sal_height.geometry import height_of
from sal_height.messages.types import ChannelFrame, FluidPressure, HeightImage, Odometry, SensorInfo, Temperature
from sal_height.nodes.processing import PROCESSING
from sal_height.nodes.transport.domain import free_domain
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.quality import LATCHED_QOS
from sal_height.simulation.flight import SimulatedFlight

SECOND = 1_000_000_000
SIZE = {"rows": 46, "cols": 12}
HEARD = {**SIZE, "air": "topics", "map_height_m": 120.0}


def stamp_of(chain: Chain, dwell: int) -> int:
    return messages.to_ns(chain.frames(dwell)[0].header.stamp)


def used_air(chain: Chain, dwell: int) -> dict[str, float]:
    """The air of a dwell, as the provenance of its heights says."""
    stated = messages.stages_of(chain.heights["ml", dwell].provenance.parameters)["sar_compression"]
    beginning = "heard_air."
    return {name.removeprefix(beginning): one for name, one in stated.items() if name.startswith(beginning)}


def rejection(chain: Chain) -> str:
    return str(chain.stages["sar_compression"].last_drop)


def test_heights_are_those_of_the_same_numbers_as_parameters(
    graph: Graph, flight: SimulatedFlight, reference: dict[tuple[str, int], HeightImage]
) -> None:
    """Bit by bit, with a probe on the platform."""
    heard = Chain(graph, flight, 30.0, image=HEARD)
    before = [state for state in flight.platform_states(0) if state.stamp_ns <= flight.phase_history(0).stamp_ns][-1]
    heard.publish(heard.sensor_info(), *air_at(START_NS - 2 * SECOND), *heard.odometry(0), *heard.frames(0))
    heard.await_heights(0)
    assert used_air(heard, 0) == {
        "air_height_m": pytest.approx(120.0 + float(height_of(before.position)), abs=1e-6),
        "air_pressure_pa": 65_000.0,
        "air_temperature_k": 265.65,
    }
    numbers = {**used_air(heard, 0), "air": "measured", "map_height_m": 120.0}
    with free_domain() as domain, Graph(domain) as other:
        stated = Chain(other, flight, 30.0, image={**SIZE, **numbers})
        stated.publish(stated.sensor_info(), *stated.odometry(0), *stated.frames(0))
        stated.await_heights(0)
    for key, image in heard.heights.items():
        assert same_heights(image, stated.heights[key])
        assert not same_heights(image, reference[key]), "air has an effect"
    said = messages.stages_of(heard.heights["ml", 0].provenance.parameters)["sar_compression"]
    assert (said["air"], said["air_temperature_k"]) == ("topics", 288.15), "what was set stays as it was set"


def test_each_dwell_has_the_air_of_its_own_time_however_early_the_next_is_told(
    graph: Graph, flight: SimulatedFlight
) -> None:
    chain = Chain(graph, flight, 30.0, image=HEARD)
    first, second = (stamp_of(chain, dwell) - SECOND for dwell in (0, 1))
    assert first < second
    air = chain.stages["sar_compression"].stage._air
    chain.publish(*air_at(second, celsius=-9.0), *air_at(first, celsius=-8.0), *air_at(first - 1, celsius=-7.0))
    chain.wait(lambda: all(len(air._samples[t]) == 3 for t in ("air/pressure", "air/temperature")), "the air")
    chain.publish(chain.sensor_info())
    for dwell in (0, 1):
        chain.publish(*chain.odometry(dwell), *chain.frames(dwell))
        chain.await_heights(dwell)
    assert [used_air(chain, dwell)["air_temperature_k"] for dwell in (0, 1)] == [265.15, 264.15]


def test_a_dwell_waits_for_the_air(graph: Graph, flight: SimulatedFlight) -> None:
    """With all frames and all odometry there; it is the first message that it gets."""
    chain = Chain(graph, flight, 30.0, image=HEARD)
    node = chain.stages["sar_compression"]
    chain.publish(chain.sensor_info(), *chain.odometry(0), *chain.frames(0), pressure_at(START_NS, 65_000.0))
    last_ns = messages.to_ns(chain.odometry(0)[-1].header.stamp)
    chain.wait(lambda: (node.stage._odometry.span_ns or (0, 0))[1] == last_ns, "the odometry")
    chain.wait(lambda: node.stage._air._samples["air/pressure"], "the pressure")
    chain.wait(lambda: node.tally.summary()["in"] == node.tally.summary()["waiting"] == DETECTORS, "the frames")
    chain.publish(temperature_at(START_NS + SECOND, -7.5))
    chain.await_heights(0)
    assert not chain.dropped("sar_compression")


def test_a_dwell_without_air_is_given_up_and_the_next_one_is_processed(graph: Graph, flight: SimulatedFlight) -> None:
    chain = Chain(graph, flight, 0.5, image=HEARD)
    chain.publish(chain.sensor_info(), pressure_at(START_NS, 65_000.0), *chain.odometry(0), *chain.frames(0))
    chain.await_drops("sar_compression", "no air", DETECTORS)
    assert_one_sentence(rejection(chain), "Dwell 0", "nothing was received on air/temperature;", "set air to standard")
    chain.publish(*air_at(START_NS), *chain.odometry(1), *chain.frames(1))
    chain.await_heights(1)


def test_air_of_long_ago_is_not_used(graph: Graph, flight: SimulatedFlight) -> None:
    chain = Chain(graph, flight, 0.5, image=HEARD)
    chain.publish(chain.sensor_info(), *air_at(START_NS - 90 * SECOND), *chain.odometry(0), *chain.frames(0))
    chain.await_drops("sar_compression", "no air", DETECTORS)
    assert_one_sentence(rejection(chain), "air/pressure is stamped", "s before its first pulse", "(air_max_age_s)")


def test_a_temperature_in_kelvin_is_counted_and_costs_nothing(graph: Graph, flight: SimulatedFlight) -> None:
    chain = Chain(graph, flight, 30.0, image=HEARD)
    node = chain.stages["sar_compression"]
    chain.publish(chain.sensor_info(), *air_at(START_NS - 3 * SECOND), temperature_at(START_NS - 2 * SECOND, 265.65))
    chain.wait(lambda: node.tally.summary().get("ignored.air") == 1, "the wrong one")
    assert_one_sentence(node.last_rejection.removeprefix("air: "), "265.65", "-93.15 to 66.85 degrees Celsius")
    chain.publish(*chain.odometry(0), *chain.frames(0))
    chain.await_heights(0)
    assert used_air(chain, 0)["air_temperature_k"] == 265.65
    assert not chain.dropped("sar_compression")


def test_it_can_be_heard_from_the_next_dwell_on(graph: Graph, flight: SimulatedFlight) -> None:
    """What came before is known then."""
    chain = Chain(graph, flight, 30.0, image={**HEARD, "air": "none"})
    node = chain.stages["sar_compression"]
    chain.publish(chain.sensor_info(), *air_at(START_NS - 2 * SECOND), *chain.odometry(0), *chain.frames(0))
    chain.await_heights(0)
    chain.wait(lambda: node.stage._air._samples["air/temperature"], "the air")
    assert node.set_parameters([Parameter("air", value="topics")])[0].successful
    chain.publish(*chain.odometry(1), *chain.frames(1))
    chain.await_heights(1)
    assert used_air(chain, 0) == {}
    assert used_air(chain, 1)["air_temperature_k"] == 265.65


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
