"""Dwells in a node: each is handed over once with what it needs, or dropped for a reason; memory is bounded."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from threading import Event
from typing import Any

import numpy as np
import pytest
from helpers import make_sensor
from rclpy.parameter import Parameter

from sal_height.engine.dwells import (
    EARLY_KEPT,
    GONE_AFTER,
    REHEARSED_BYTES,
    SENSOR_PORT,
    SENSORS_KEPT,
    DwellStage,
    WholeDwell,
)
from sal_height.engine.frame_items import COMPLEX_INT16, Frame
from sal_height.engine.settings import ChannelSettings
from sal_height.engine.stage import DwellKey, Job, Port, Result
from sal_height.errors import Rejected
from sal_height.nodes.host import node_of
from sal_height.nodes.transport.graph import Graph
from sal_height.sensor import Sensor
from sal_height.topics import SENSOR_INFO

SAMPLES = np.ones(1_000_000, np.uint8)
"""Of a frame: 1 MB."""

TIMEOUT_S = 20.0


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
        self.rehearsed: list[str] = []
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

    def rehearse_for(self, sensor: Sensor, settings: Any) -> None:  # noqa: ARG002
        self.rehearsed.append(sensor.name)

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

    def hear(self, dwell: int, *channels: int, sensor: Sensor | None = None, stamp: float | None = None) -> None:
        """Take in frames of a dwell as if they came by the topic; they are a second apart."""
        stamp_ns = round(1e9 * (1000.0 + (dwell if stamp is None else stamp)))
        key = DwellKey((sensor or SENSOR).config_hash, dwell, stamp_ns)
        for channel in channels:
            frame = Frame(key, "", channel, 0, 0, PULSES, PULSES, COMPLEX_INT16, 0.0, SAMPLES, SAMPLES.nbytes)
            assert self.takes()
            self._decide(lambda frame=frame: self.stage.accept("phase_history", frame, time.monotonic()))

    def describe(self, sensor: Sensor) -> None:
        """Take in a sensor description."""
        self._decide(lambda: self.stage.accept(SENSOR_INFO, sensor, time.monotonic()))

    def advance(self) -> None:
        """Let the stage know that time has passed."""
        self._tick()

    def counts(self) -> dict[str, float]:
        """The account without latencies, zeros, and what is of the last minute only; nothing is published."""
        return {k: v for k, v in self.tally.summary().items() if v and not k.startswith(("latency", "last_minute"))}

    def await_counts(self, **wanted: float) -> None:
        """Spin until the account is this one."""
        assert self.graph.spin_until(lambda: self.counts() == wanted, TIMEOUT_S), (self.counts(), wanted)


SENSOR = make_sensor()
PULSES = np.zeros(1)


def other_sensor(number: int) -> Sensor:
    return replace(SENSOR, name=f"sensor {number}", config_hash="")


@pytest.fixture
def gate(graph: Graph) -> Gate:
    stage = Gate(graph)
    stage.describe(SENSOR)
    return stage


def test_a_dwell_is_handed_over_with_what_there_is_when_it_becomes_complete(gate: Gate) -> None:
    gate.stage.supply = None
    gate.hear(0, 0, 1, 2)
    gate.stage.supply = "then"
    gate.advance()
    gate.stage.supply = "later"
    gate.await_counts(**{"in": 3, "processed": 3})
    assert gate.stage.handed == [([0, 1, 2], "then")]


def test_a_dwell_of_a_sensor_that_is_forgotten_is_dropped_for_what_it_waits_for(gate: Gate) -> None:
    gate.stage.supply = None
    gate.hear(0, 0, 1, 2)
    gate.hear(1, 0)
    early = other_sensor(4)
    gate.hear(5, 0, sensor=early)
    for number in range(1, 5):
        gate.describe(other_sensor(number))
        gate.hear(100, 0, sensor=other_sensor(number))
    counts = gate.counts()
    assert counts == {"in": 9, "waiting": 5, "dropped.no supply": 3, "dropped.incomplete dwell": 1}
    gate.stage.supply = "now"
    gate.hear(5, 1, 2, sensor=early)  # the frame that came before its description has been taken in
    lost = {"dropped.no supply": 3, "dropped.incomplete dwell": 1}
    gate.await_counts(**{"in": 11, "processed": 3, "waiting": 4, **lost})


def dropped(gate: Gate) -> dict[str, float]:
    return {name.removeprefix("dropped."): n for name, n in gate.counts().items() if name.startswith("dropped.")}


def overdue_gate(graph: Graph, **parameters: Any) -> Gate:
    """A gate that waits for a very short time only."""
    stage = Gate(graph, timeout_s=0.01, **parameters)
    stage.describe(SENSOR)
    return stage


def test_the_oldest_unfinished_dwell_goes_when_there_are_too_many(gate: Gate) -> None:
    for dwell in range(8):
        gate.hear(dwell, 0)
    assert dropped(gate) == {}
    gate.hear(8, 0)
    assert dropped(gate) == {"buffer full": 1}
    assert "Dwell 0 was the oldest" in gate.last_drop
    assert "waited for channels [1, 2]" in gate.last_drop
    assert "sal-height transport" in gate.last_drop
    gate.hear(1, 1, 2)
    gate.await_counts(**{"in": 11, "processed": 3, "waiting": 7, "dropped.buffer full": 1})


def test_unfinished_dwells_are_bounded_by_memory(graph: Graph) -> None:
    gate = Gate(graph, max_memory_mb=4)
    gate.describe(SENSOR)
    for dwell in range(4):
        gate.hear(dwell, 0)
    assert dropped(gate) == {}
    gate.hear(3, 1)
    assert dropped(gate) == {"buffer full": 1}
    assert "4 MB" in gate.last_drop


def test_messages_without_sensor_info_are_bounded_in_number(graph: Graph) -> None:
    gate = Gate(graph)
    for dwell in range(EARLY_KEPT):
        gate.hear(dwell, 0)
    assert dropped(gate) == {}
    gate.hear(EARLY_KEPT, 0)
    assert dropped(gate) == {"no sensor info": 1}


def test_messages_without_sensor_info_are_bounded_by_memory(graph: Graph) -> None:
    gate = Gate(graph, max_memory_mb=4)
    for dwell in range(6):
        gate.hear(dwell, 0)
    assert dropped(gate) == {"no sensor info": 2}


def test_descriptions_of_sensors_are_bounded(gate: Gate) -> None:
    for number in range(SENSORS_KEPT):
        gate.describe(other_sensor(number))
    gate.hear(1, 0)
    assert gate.counts()["waiting"] == 1  # for a description that is no longer held
    gate.describe(SENSOR)
    gate.hear(1, 1, 2)
    gate.await_counts(**{"in": 3, "processed": 3})


def test_a_sensor_in_use_is_not_pushed_out_by_descriptions_of_others(gate: Gate) -> None:
    gate.hear(0, 0, 1, 2)
    gate.hear(1, 0)
    for number in range(3 * SENSORS_KEPT):
        gate.describe(other_sensor(number))
    gate.hear(1, 1, 2)
    gate.await_counts(**{"in": 6, "processed": 6})
    assert len(gate.stage._sensors) == SENSORS_KEPT


def test_once_frames_have_come_no_other_sensor_is_rehearsed(gate: Gate) -> None:
    gate.hear(0, 0, 1, 2)
    gate.describe(other_sensor(1))
    gate.hear(1, 0, 1, 2)
    gate.await_counts(**{"in": 6, "processed": 6})
    assert gate.stage.rehearsed == [SENSOR.name]


def test_of_many_descriptions_at_once_the_first_and_the_last_are_rehearsed(graph: Graph) -> None:
    gate = Gate(graph)
    gate.stage.may_work.clear()
    gate.describe(SENSOR)
    gate.hear(0, 0, 1, 2)
    assert gate.stage.at_work.wait(TIMEOUT_S)  # the worker has a dwell at hand, and SENSOR is rehearsed
    gate.stage._sensors._used.clear()
    for number in range(5):
        gate.describe(other_sensor(number))
    assert gate.jobs == 2
    gate.stage.may_work.set()
    assert graph.spin_until(lambda: gate.jobs == 0, TIMEOUT_S)
    assert gate.stage.rehearsed == [SENSOR.name, "sensor 0", "sensor 4"]


def test_large_dwells_are_not_rehearsed(graph: Graph) -> None:
    gate = Gate(graph)
    size = SENSOR.dwell_bytes // SENSOR.pulse_count
    for pulses, rehearsed in ((REHEARSED_BYTES // size + 1, []), (REHEARSED_BYTES // size, [SENSOR.name])):
        gate.describe(replace(SENSOR, pulse_count=pulses, config_hash=""))
        assert graph.spin_until(lambda: gate.jobs == 0, TIMEOUT_S)
        assert gate.stage.rehearsed == rehearsed


def test_nothing_is_held_of_sensors_that_are_forgotten(gate: Gate) -> None:
    for number in range(3 * SENSORS_KEPT):
        gate.describe(other_sensor(number))
        gate.hear(number, 0, 1, 2, sensor=other_sensor(number))
        gate.hear(number + 100, 0, sensor=other_sensor(number))
    assert len(gate.stage._sensors) == SENSORS_KEPT
    assert set(gate.stage._assembler._latest_ns) == set(gate.stage._absences) == set(gate.stage._sensors)
    assert {dwell.key.sensor for dwell in gate.stage._assembler.unfinished()} == set(gate.stage._sensors)


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


def test_whole_dwells_that_have_waited_longer_than_the_budget_are_left_out(graph: Graph) -> None:
    gate = Gate(graph, latency_budget_s=0.2)
    gate.describe(SENSOR)
    gate.stage.may_work.clear()
    gate.hear(0, 0, 1, 2)
    assert gate.stage.at_work.wait(TIMEOUT_S)
    gate.stage.supply = "waits too long"
    gate.hear(1, 0, 1, 2)
    began = time.monotonic()
    assert graph.spin_until(lambda: time.monotonic() - began > 0.2, TIMEOUT_S)
    gate.stage.supply = "has just come"
    gate.hear(2, 0, 1, 2)
    gate.stage.may_work.set()
    gate.await_counts(**{"in": 9, "processed": 6, "dropped.overload": 3})
    assert [supplies for _, supplies in gate.stage.handed] == ["supplied", "has just come"]
    assert "more than 0.2 s (latency_budget_s)" in gate.last_drop


def test_without_a_budget_dwells_wait_as_long_as_it_takes(graph: Graph) -> None:
    gate = Gate(graph)
    gate.describe(SENSOR)
    gate.stage.may_work.clear()
    for dwell in range(2):
        gate.hear(dwell, 0, 1, 2)
        assert gate.stage.at_work.wait(TIMEOUT_S)
    began = time.monotonic()
    assert graph.spin_until(lambda: time.monotonic() - began > 0.3, TIMEOUT_S)
    gate.stage.may_work.set()
    gate.await_counts(**{"in": 6, "processed": 6})


def test_an_incomplete_dwell_is_dropped_after_an_idle_wait(graph: Graph) -> None:
    gate = overdue_gate(graph)
    gate.hear(0, 0, 2)
    gate.await_counts(**{"in": 2, "dropped.incomplete dwell": 2})
    assert "channels [1] did not come" in gate.last_drop


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


def test_a_dwell_does_not_time_out_while_its_messages_are_on_their_way(graph: Graph) -> None:
    """One message every 0.05 s, of dwells whose stamps are close to each other: the node is never idle."""
    gate = Gate(graph, timeout_s=0.2)
    gate.describe(SENSOR)
    began = time.monotonic()
    gate.hear(0, 0)
    for message in range(1, 9):
        assert graph.spin_until(lambda m=message: time.monotonic() - began > 0.05 * m, TIMEOUT_S)
        gate.hear(message, 0, stamp=message * 0.01)
    assert time.monotonic() - began > 2 * 0.2
    assert "incomplete dwell" not in dropped(gate)


@pytest.mark.parametrize("stamp", [0.0, 1e6])
def test_a_dwell_is_dropped_once_the_sensor_has_moved_on(graph: Graph, stamp: float) -> None:
    """Also one that is stamped in the far future."""
    gate = Gate(graph, timeout_s=0.2)
    gate.describe(SENSOR)
    began = time.monotonic()
    gate.hear(0, 0, stamp=stamp)
    gate.hear(1, 0, 1, 2)
    assert dropped(gate) == {}  # later by the stamps, but not by the clock on the wall
    while time.monotonic() - began < 0.3:  # a stream that never pauses
        gate.hear(1000 + gate.tally.summary()["in"], 0, 1, 2, stamp=1.0)
    assert dropped(gate)["incomplete dwell"] == 1


@pytest.mark.parametrize(("described_again", "stamp"), [(False, 0.0), (True, 0.0), (False, 1e6)])
def test_a_message_of_an_unknown_sensor_is_dropped_once_the_sensor_has_moved_on(
    graph: Graph, described_again: bool, stamp: float
) -> None:
    """Dwells of a known sensor never pause meanwhile, so that the node is never idle."""
    gate = Gate(graph, timeout_s=0.2)
    gate.describe(SENSOR)
    began = time.monotonic()
    gate.hear(0, 0, sensor=other_sensor(0), stamp=stamp)
    gate.hear(1, 0, 1, 2)
    assert dropped(gate) == {}  # later by the stamps, but not by the clock on the wall
    while "contradicts sensor info" not in dropped(gate) and time.monotonic() - began < TIMEOUT_S:
        if described_again:
            gate.describe(SENSOR)
        gate.hear(1000 + gate.tally.summary()["in"], 0, 1, 2, stamp=1.0)
    assert dropped(gate)["contradicts sensor info"] == 1


def test_a_message_of_an_unknown_sensor_waits_while_the_stamps_stand_still(graph: Graph) -> None:
    gate = Gate(graph, timeout_s=0.2)
    gate.describe(SENSOR)
    began = time.monotonic()
    gate.hear(0, 0, sensor=other_sensor(0))
    while time.monotonic() - began < 0.3:
        gate.hear(1000 + gate.tally.summary()["in"], 0, 1, 2, stamp=0.1)
    assert "contradicts sensor info" not in dropped(gate)


def test_without_a_channel_dwells_proceed_if_that_is_allowed(graph: Graph) -> None:
    gate = overdue_gate(graph, missing_channels="proceed")
    gate.hear(0, 0, 2)
    gate.await_counts(**{"in": 2, "processed": 2, "ignored.missing channels": 1})
    assert gate.stage.handed == [([0, 2], "supplied")]
    assert "without channels [1]" in gate.last_rejection


def test_too_few_channels_are_dropped(graph: Graph) -> None:
    gate = overdue_gate(graph, missing_channels="proceed")
    gate.hear(0, 0)
    gate.await_counts(**{"in": 1, "dropped.incomplete dwell": 1})


def test_a_channel_that_is_gone_is_no_longer_waited_for_until_it_returns(graph: Graph) -> None:
    gate = Gate(graph, missing_channels="proceed", max_unfinished_dwells=1)
    gate.describe(SENSOR)
    for dwell in range(GONE_AFTER + 1):  # each makes its predecessor go
        gate.hear(dwell, 0, 2)
    assert gate.counts()["ignored.missing channels"] == GONE_AFTER + 1  # the last one did not wait
    gate.hear(10, 1, 0)
    gate.await_counts(**{"in": 10, "processed": 8, "waiting": 2, "ignored.missing channels": 4})
    gate.hear(10, 2)
    gate.await_counts(**{"in": 11, "processed": 11, "ignored.missing channels": 4})
    assert gate.stage.handed[-1] == ([0, 1, 2], "supplied")


@pytest.mark.parametrize("part", ["check", "supplies"])
def test_an_error_that_no_input_should_cause_costs_its_message_only(
    gate: Gate, monkeypatch: pytest.MonkeyPatch, part: str
) -> None:
    def fail(*_: Any) -> None:
        raise ZeroDivisionError(part)

    with monkeypatch.context() as broken:
        broken.setattr(gate.stage, part, fail)
        gate.hear(0, 0, 1, 2)
    assert gate.counts()["dropped.internal error"] == 3
    gate.hear(1, 0, 1, 2)
    gate.await_counts(**{"in": 6, "processed": 3, "dropped.internal error": 3})


def test_bytes_that_are_no_message_are_counted_and_end_nothing(gate: Gate) -> None:
    (topic,) = (subscription for subscription in gate.subscriptions if subscription.topic_name == "/phase_history")
    topic.callback(b"no message", {})
    assert gate.counts()["ignored.broken message"] == 1
    gate.describe(SENSOR)
    gate.hear(0, 0, 1, 2)
    gate.await_counts(**{"in": 3, "processed": 3, "ignored.broken message": 1})
