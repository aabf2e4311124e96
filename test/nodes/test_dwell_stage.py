"""Dwells in a node: each is handed over once with what it needs, or dropped for a reason; memory is bounded."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from helpers import make_sensor
from rclpy.parameter import Parameter
from sal_height_msgs.msg import DetectorFrame

from sal_height import messages
from sal_height.errors import Rejected
from sal_height.nodes.dwell_stage import DwellStage
from sal_height.nodes.graph import Graph
from sal_height.nodes.sar_compression import Parameters
from sal_height.sensor import Sensor

CHANNELS = 3
TIMEOUT_S = 20.0


class Gate(DwellStage):
    """A stage whose dwells are supplied when the test says so, and which keeps what it is handed."""

    parameters = Parameters

    def __init__(self, graph: Graph, **parameters: Any) -> None:
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        self.supply: Any = "supplied"
        self.processed: list[tuple[list[int], Any]] = []
        super().__init__("gate", DetectorFrame, "phase_history", context=graph.context, parameter_overrides=overrides)
        graph.add(self)
        self.graph = graph

    def check(self, message: DetectorFrame, sensor: Sensor) -> None:
        """Every frame will do."""

    def supplies(self, dwell: list[Any], _: Sensor) -> Any:
        if self.supply is None:
            raise Rejected("no supply", f"Dwell {dwell[0].dwell}: nothing was supplied.")
        return self.supply

    def process(self, dwell: list[Any], _: Sensor, supplies: Any) -> int:
        self.processed.append(([frame.detector for frame in dwell], supplies))
        return len(dwell)

    def hear(self, dwell: int, *channels: int, sensor: Sensor | None = None, stamp: float | None = None) -> None:
        """Take in frames of a dwell as if they came by the topic; they are a second apart."""
        for channel in channels:
            frame = DetectorFrame(dwell=dwell, detector=channel, config_hash=(sensor or SENSOR).config_hash)
            frame.header.stamp = messages.to_stamp(round(1e9 * (1000.0 + (dwell if stamp is None else stamp))))
            self._on_message(frame)

    def describe(self, sensor: Sensor) -> None:
        """Take in a sensor description."""
        self._on_sensor_info(messages.sensor_to_message(sensor, messages.to_stamp(0)))

    def counts(self) -> dict[str, float]:
        """The account without latencies and zeros."""
        return {k: v for k, v in self.tally.summary().items() if v and not k.startswith("latency")}

    def await_counts(self, **counts: float) -> None:
        """Spin until the account is this one."""
        wanted = {name.replace("dropped_", "dropped."): value for name, value in counts.items()}
        assert self.graph.spin_until(lambda: self.counts() == wanted, TIMEOUT_S), (self.counts(), wanted)


SENSOR = make_sensor()


def other_sensor(number: int) -> Sensor:
    return replace(SENSOR, name=f"sensor {number}", config_hash="")


@pytest.fixture
def gate(graph: Graph) -> Gate:
    stage = Gate(graph)
    stage.describe(SENSOR)
    return stage


def test_a_dwell_is_handed_over_with_what_there_is_when_it_becomes_complete(gate: Gate) -> None:
    gate.supply = None
    gate.hear(0, 0, 1, 2)
    gate.supply = "then"
    gate.advance()
    gate.supply = "later"
    gate.await_counts(**{"in": 3, "processed": 3, "out": 3})
    assert gate.processed == [([0, 1, 2], "then")]


def test_a_dwell_of_a_sensor_that_is_forgotten_is_dropped_for_what_it_waits_for(gate: Gate) -> None:
    gate.supply = None
    gate.hear(0, 0, 1, 2)
    gate.hear(1, 0)
    early = other_sensor(4)
    gate.hear(5, 0, sensor=early)
    for number in range(1, 5):
        gate.describe(other_sensor(number))
    counts = gate.counts()
    assert counts == {"in": 5, "waiting": 1, "dropped.no supply": 3, "dropped.incomplete dwell": 1}
    gate.supply = "now"
    gate.hear(5, 1, 2, sensor=early)  # the frame that came before its description has been taken in
    gate.await_counts(**{"in": 7, "processed": 3, "out": 3, "dropped.no supply": 3, "dropped.incomplete dwell": 1})
