"""A stage in a node: what waits for the worker is bounded, time-outs go by its clock, and errors end nothing."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from threading import Event
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers import make_sensor
from rclpy.parameter import Parameter

from sal_height.engine.dwells import SENSOR_PORT, DwellStage, WholeDwell
from sal_height.engine.frame_items import COMPLEX_INT16, Frame
from sal_height.engine.results import DwellKey, Result
from sal_height.engine.settings import ChannelSettings
from sal_height.engine.stage import Job, Port
from sal_height.errors import Rejected
from sal_height.nodes import worker
from sal_height.nodes.host import node_of
from sal_height.nodes.transport.graph import Graph
from sal_height.sensor import Sensor
from sal_height.topics import SENSOR_INFO

SAMPLES = np.ones(1_000_000, np.uint8)
"""Of a frame: 1 MB."""

TIMEOUT_S = 120.0


class GateStage(DwellStage):
    """A stage whose dwells are supplied when the test says so, and which keeps what it is handed."""

    usual_name = "gate"
    about = "Keeps what it is handed."
    settings = ChannelSettings
    dwell_port = "phase_history"

    def __init__(self, *arguments: Any, **others: Any) -> None:
        super().__init__(*arguments, **others)
        self.supply: Any = "supplied"
        self.handed: list[tuple[list[int], Any]] = []
        self.may_work, self.at_work = Event(), Event()
        self.may_work.set()

    @classmethod
    def inputs(cls, settings: Any) -> Sequence[Port]:  # noqa: ARG003
        return [SENSOR_PORT, Port(cls.dwell_port, Frame, "frames", per_channel=True, counted=True)]

    @classmethod
    def outputs(cls, settings: Any) -> Sequence[Port]:  # noqa: ARG003
        return []

    def check(self, message: Frame, sensor: Sensor) -> None:
        """Every frame will do."""

    def supplies(self, key: DwellKey, messages: Any, sensor: Sensor) -> Any:  # noqa: ARG002
        if self.supply is None:
            raise Rejected("no supply", f"Dwell {key.number}: nothing was supplied.")
        return self.supply

    def work_on(self, whole: WholeDwell, job: Job) -> Iterator[Result]:  # noqa: ARG002
        self.at_work.set()
        assert self.may_work.wait(TIMEOUT_S)
        assert [frame.channel for frame in whole.messages] == list(range(SENSOR.detector_count))
        self.handed.append(([frame.channel for frame in whole.messages if frame.samples.any()], whole.supplies))
        yield from ()


class Gate(node_of(GateStage)):  # type: ignore[misc]
    """The node of the stage."""

    def __init__(self, graph: Graph, **parameters: Any) -> None:
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        super().__init__(context=graph.context, parameter_overrides=overrides)
        graph.add(self)
        self.graph = graph

    def hear(self, dwell: int, *channels: int) -> None:
        """Accept frames of a dwell as if they arrived on the topic; dwells are a second apart."""
        key = DwellKey(SENSOR.config_hash, dwell, 1_000_000_000 * (1000 + dwell))
        for channel in channels:
            frame = Frame(key, "", channel, 0, 0, PULSES, PULSES, COMPLEX_INT16, 0.0, SAMPLES, SAMPLES.nbytes)
            assert self.takes()
            self._decide(lambda frame=frame: self.stage.accept("phase_history", frame, time.monotonic()))

    def describe(self, sensor: Sensor) -> None:
        """Take in a sensor description."""
        self._decide(lambda: self.stage.accept(SENSOR_INFO, sensor, time.monotonic()))

    def counts(self) -> dict[str, float]:
        """The account without latencies, zeros, and what is of the last minute only; nothing is published."""
        return {k: v for k, v in self.tally.summary().items() if v and not k.startswith(("latency", "last_minute"))}

    def await_counts(self, **wanted: float) -> None:
        """Spin until the account is this one."""
        assert self.graph.spin_until(lambda: self.counts() == wanted, TIMEOUT_S), (self.counts(), wanted)


SENSOR = make_sensor()
PULSES = np.zeros(1)


@pytest.fixture
def gate(graph: Graph) -> Gate:
    stage = Gate(graph)
    stage.describe(SENSOR)
    return stage


def dropped(gate: Gate) -> dict[str, float]:
    return {name.removeprefix("dropped."): n for name, n in gate.counts().items() if name.startswith("dropped.")}


def overdue_gate(graph: Graph, **parameters: Any) -> Gate:
    """A gate that waits for a very short time only."""
    stage = Gate(graph, timeout_s=0.01, **parameters)
    stage.describe(SENSOR)
    return stage


@pytest.mark.parametrize(("policy", "kept"), [("newest", [1, 2, 3]), ("oldest", [1, 4, 5])])
def test_dwells_that_wait_for_processing_are_bounded(graph: Graph, policy: str, kept: list[int]) -> None:
    gate = Gate(graph, max_queued_dwells=2, queue_policy=policy)
    gate.describe(SENSOR)
    gate.stage.may_work.clear()
    for dwell in range(1, 6):
        gate.stage.supply = dwell
        gate.hear(dwell, 0, 1, 2)
        assert gate.stage.at_work.wait(TIMEOUT_S)  # the first is at work, and none of those that wait
    assert dropped(gate) == {"queue full": 6}
    assert f"the {policy} dwell was dropped" in gate.last_drop
    gate.stage.may_work.set()
    gate.await_counts(**{"in": 15, "processed": 9, "dropped.queue full": 6})
    assert [supplies for _, supplies in gate.stage.handed] == kept


def test_dwells_that_wait_for_processing_are_bounded_by_memory(graph: Graph) -> None:
    gate = Gate(graph, max_memory_mb=7)
    gate.describe(SENSOR)
    gate.stage.may_work.clear()
    for dwell in range(1, 5):  # 3 MB each
        gate.hear(dwell, 0, 1, 2)
        assert gate.stage.at_work.wait(TIMEOUT_S)
    assert dropped(gate) == {"queue full": 3}
    gate.stage.may_work.set()
    gate.await_counts(**{"in": 12, "processed": 9, "dropped.queue full": 3})


@pytest.mark.parametrize(("budget_s", "kept"), [(0.2, [0, 2]), (0.0, [0, 1, 2])])
def test_whole_dwells_that_have_waited_longer_than_the_budget_are_left_out(
    graph: Graph, monkeypatch: pytest.MonkeyPatch, budget_s: float, kept: list[int]
) -> None:
    """Without a budget they wait as long as it takes."""
    clock = SimpleNamespace(now=0.0)
    monkeypatch.setattr(worker, "time", SimpleNamespace(monotonic=lambda: clock.now))
    gate = Gate(graph, latency_budget_s=budget_s)
    gate.describe(SENSOR)
    gate.stage.may_work.clear()
    for dwell in range(3):
        clock.now = (0.0, 0.0, 0.3)[dwell]
        gate.stage.supply = dwell
        gate.hear(dwell, 0, 1, 2)
        assert gate.stage.at_work.wait(TIMEOUT_S)
    gate.stage.may_work.set()
    lost = {"dropped.overload": 3} if budget_s else {}
    gate.await_counts(**{"in": 9, "processed": 3 * len(kept), **lost})
    assert [supplies for _, supplies in gate.stage.handed] == kept
    assert ("more than 0.2 s (latency_budget_s)" in gate.last_drop) == bool(budget_s)


def test_an_incomplete_dwell_is_dropped_after_an_idle_wait(graph: Graph) -> None:
    gate = overdue_gate(graph)
    gate.hear(0, 0, 2)
    gate.await_counts(**{"in": 2, "dropped.incomplete dwell": 2})
    assert "channels [1] did not arrive" in gate.last_drop


def test_a_dwell_does_not_time_out_while_the_node_is_working(graph: Graph) -> None:
    """The clock on the wall passes the timeout ten times over meanwhile."""
    gate = overdue_gate(graph)
    gate.stage.may_work.clear()
    gate.hear(0, 0, 1, 2)
    assert gate.stage.at_work.wait(TIMEOUT_S)
    gate.hear(1, 0)
    began = time.monotonic()
    assert graph.spin_until(lambda: time.monotonic() - began > 0.3, TIMEOUT_S)
    assert dropped(gate) == {}
    gate.hear(1, 1, 2)
    gate.stage.may_work.set()
    gate.await_counts(**{"in": 6, "processed": 6})


def test_bytes_that_are_no_message_are_counted_and_end_nothing(gate: Gate) -> None:
    (topic,) = (subscription for subscription in gate.subscriptions if subscription.topic_name == "/phase_history")
    topic.callback(b"no message", {})
    assert gate.counts()["ignored.broken message"] == 1
    gate.describe(SENSOR)
    gate.hear(0, 0, 1, 2)
    gate.await_counts(**{"in": 3, "processed": 3, "ignored.broken message": 1})
