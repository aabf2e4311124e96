"""Odometry among real publishers: no executor waits for it if it is much, and dwells have it when they need it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from flown_items import EXACT_ODOMETRY, START_NS, small_flight
from helpers import publisher_of
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.parameter import Parameter

from sal_height import messages
from sal_height.messages import serialize
from sal_height.messages.types import ChannelFrame, Odometry, SensorInfo
from sal_height.nodes import polled
from sal_height.nodes.host import StageNode
from sal_height.nodes.processing import PROCESSING
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.qos import FRAMES_QOS, LATCHED_QOS, ODOMETRY_QOS

TIMEOUT_S = 120.0


class Flight:
    """A compression, and a source that publishes what a dwell needs."""

    def __init__(self, graph: Graph, **parameters: object) -> None:
        values = {"rows": 20, "cols": 8, "air": "none", "timeout_s": 3600.0, **EXACT_ODOMETRY, **parameters}
        overrides = [Parameter(name, value=value) for name, value in values.items()]
        self.graph = graph
        self.node: StageNode = graph.add(
            PROCESSING["sar_compression"](context=graph.context, parameter_overrides=overrides)
        )
        source = graph.add(Node("source", context=graph.context))
        self._sensor = publisher_of(source, SensorInfo, "sensor_info", LATCHED_QOS)
        self._frames = publisher_of(source, ChannelFrame, "phase_history", FRAMES_QOS)
        self._odometry = publisher_of(source, Odometry, "platform/odometry", ODOMETRY_QOS)
        self._sensor.publish(messages.sensor_to_message(small_flight().sensor, messages.to_stamp(0)))
        publishers = self._sensor, self._frames, self._odometry
        self.wait(lambda: all(one.get_subscription_count() == 1 for one in publishers) and self.node.is_ready)

    def wait(self, condition: object) -> None:
        assert self.graph.spin_until(condition, TIMEOUT_S), self.summary()  # type: ignore[arg-type]

    def publish_frames(self) -> None:
        history, stamp = small_flight().phase_history(0), messages.to_stamp(START_NS)
        for frame in messages.history_to_messages(history, small_flight().sensor, 0, stamp):
            self._frames.publish(frame)

    def odometry(self, count: int) -> list[bytes]:
        """Samples around the first dwell, at the same intervals."""
        first, *_, last = small_flight().platform_states(0)
        stamps = np.linspace(first.stamp_ns, last.stamp_ns, count).astype(int).tolist()
        states = [
            replace(first, stamp_ns=stamp, position=first.position + (stamp - first.stamp_ns) * 1e-9 * first.velocity)
            for stamp in stamps
        ]
        return [
            serialize(messages.state_to_message(state, messages.to_stamp(START_NS + state.stamp_ns)))
            for state in states
        ]

    def publish_odometry(self, cdrs: list[bytes]) -> None:
        for cdr in cdrs:
            self._odometry.publish(cdr)
        assert self._odometry.wait_for_all_acked(Duration(seconds=TIMEOUT_S))

    @property
    def is_looking_often(self) -> bool:
        """Whether a timer of the node looks for odometry every few milliseconds."""
        return any(one.timer_period_ns < 5_000_000 and not one.is_canceled() for one in self.node.timers)

    def summary(self) -> dict[str, float]:
        return self.node.tally.summary()

    @property
    def is_waited_for(self) -> bool:
        """Whether an executor waits for odometry, as for all else."""
        topics = [one.topic_name for one in self.node.subscriptions]
        assert {"/phase_history", "/sensor_info"} <= set(topics)
        return "/platform/odometry" in topics


@pytest.fixture(params=[False, True], ids=["waited for", "looked for"])
def flight(request: pytest.FixtureRequest, graph: Graph, monkeypatch: pytest.MonkeyPatch) -> Flight:
    """A flight whose odometry is little, or much from the start."""
    monkeypatch.setattr(polled, "MANY_HZ", -1.0 if request.param else np.inf)
    found = Flight(graph)
    found.wait(lambda: found.is_waited_for is not request.param)
    return found


def test_no_executor_waits_for_odometry_while_it_is_much(graph: Graph, monkeypatch: pytest.MonkeyPatch) -> None:
    """None arrives twice, nor is any lost, when that changes."""
    monkeypatch.setattr(polled, "MEASURED_S", 0.01)
    flight = Flight(graph)
    (inlet,) = [one for one in flight.node.inlets if one.topic == "/platform/odometry"]
    cdrs, sent = flight.odometry(20_000), 0
    for _ in range(3):
        assert flight.is_waited_for
        while flight.is_waited_for:
            flight.publish_odometry(cdrs[sent : sent + 50])
            sent += 50
            graph.spin_for(0.01)
        flight.wait(lambda: flight.is_waited_for)
        flight.publish_odometry(cdrs[sent : sent + 1])  # which an executor waits for
        sent += 1
        flight.wait(lambda sent=sent: inlet.received == sent)
    assert inlet.missed == 0
    assert not any(name.startswith(("odometry.", "ignored")) for name in flight.summary())


@pytest.mark.parametrize("depth", [0, 10])
@pytest.mark.filterwarnings("ignore:A zero depth")
def test_an_executor_waits_for_odometry_that_has_a_short_queue(graph: Graph, depth: int) -> None:
    """More samples than have room would arrive from one look to the next."""
    flight = Flight(graph, **{"qos_overrides./platform/odometry.subscription.depth": depth})
    assert "/platform/odometry" in [one.topic_name for one in flight.node.subscriptions]
    (inlet,) = [one for one in flight.node.inlets if one.topic == "/platform/odometry"]
    flight.publish_frames()
    for number, cdr in enumerate(flight.odometry(20)):
        flight.publish_odometry([cdr])
        flight.wait(lambda number=number: inlet.received == number + 1)
    flight.wait(lambda: flight.summary()["processed"] == 8)


@pytest.mark.parametrize("count", [4, 300])
@pytest.mark.parametrize("frames_first", [True, False])
def test_a_dwell_is_processed_once_its_odometry_has_arrived(flight: Flight, count: int, frames_first: bool) -> None:
    """Before its frames, when nothing but the next dwell looks for it; or after them, when the dwell waits for it."""
    (inlet,) = [one for one in flight.node.inlets if one.topic == "/platform/odometry"]
    cdrs, receive, handed_over = flight.odometry(count), inlet.receive, list[bytes]()
    inlet.receive = lambda cdr: handed_over.append(cdr) or receive(cdr)  # called by an executor
    if frames_first:
        flight.publish_frames()
        flight.publish_odometry(cdrs[: count // 2])
        flight.wait(lambda: inlet.received == count // 2 and flight.summary()["in"] == 8)
        assert flight.summary()["waiting"] == 8
        assert flight.is_looking_often is not flight.is_waited_for
        flight.publish_odometry(cdrs[count // 2 :])
    else:
        flight.publish_odometry(cdrs)
        flight.publish_frames()
    flight.wait(lambda: flight.summary()["processed"] == 8)
    flight.wait(lambda: inlet.received == count)
    assert handed_over == (cdrs if flight.is_waited_for else [])
    assert not flight.is_looking_often
    assert not any(name.startswith(("odometry.", "ignored")) for name in flight.summary())


def test_a_sample_that_arrives_while_others_are_received_follows_them(flight: Flight) -> None:
    """A few are received one by one, and each has the stage decide, before which it accepts what has arrived."""
    taken, cdrs = flight.node._odometry, flight.odometry(4)
    assert taken
    receive = taken._receive

    def receive_later(cdr: bytes) -> None:
        taken._receive = receive
        flight.publish_odometry(cdrs[3:])
        receive(cdr)

    taken._receive = receive_later
    flight.publish_odometry(cdrs[:3])
    flight.publish_frames()
    flight.wait(lambda: flight.summary()["processed"] == 8)
    assert not any(name.startswith("odometry.") for name in flight.summary())


@pytest.mark.parametrize("spoiled", [b"", b"\x00\x01\x00\x00 a message that ends too early"])
def test_a_broken_message_among_others_is_counted_and_costs_none_of_them(flight: Flight, spoiled: bytes) -> None:
    """They are accepted in their order all the same."""
    cdrs = flight.odometry(200)
    flight.publish_odometry([*cdrs[:100], spoiled or cdrs[0][:50], *cdrs[100:]])
    flight.publish_frames()
    flight.wait(lambda: flight.summary()["processed"] == 8)
    counted = {name: count for name, count in flight.summary().items() if name.startswith(("odometry.", "ignored."))}
    assert counted == {"ignored.broken message": 1}


def test_samples_of_other_frames_among_others_are_counted_each(flight: Flight) -> None:
    state = small_flight().platform_states(0)[0]
    other = messages.state_to_message(state, messages.to_stamp(START_NS))
    other.child_frame_id = "wing_tip"
    cdrs = flight.odometry(100)
    flight.publish_odometry([*cdrs[:50], *[serialize(other)] * 3, *cdrs[50:]])
    flight.publish_frames()
    flight.wait(lambda: flight.summary()["processed"] == 8)
    assert flight.summary()["ignored.odometry"] == 3
