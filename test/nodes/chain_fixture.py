"""The processing stages among each other, fed by hand: as nodes, or joined by messages without ROS."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from flown_items import history_in
from helpers import publisher_of
from rclpy.node import Node
from rclpy.parameter import Parameter
from stage_graph import StageGraph

from sal_height import messages
from sal_height.engine.heights import height_stage
from sal_height.messages.plain import is_same
from sal_height.messages.types import Calibration, ChannelFrame, HeightImage, Odometry, SensorInfo, TFMessage
from sal_height.nodes.host import StageNode
from sal_height.nodes.processing import PROCESSING
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.message_types import subscribe
from sal_height.nodes.transport.qos import FRAMES_QOS, LATCHED_QOS, ODOMETRY_QOS
from sal_height.simulation.flight import SimulatedFlight

START_NS = 1_700_000_000_123_456_789
TIMEOUT_S = 120.0

DETECTORS = 8


TOPICS = {
    SensorInfo: "sensor_info",
    Odometry: "platform/odometry",
    ChannelFrame: "phase_history",
    Calibration: "calibration",
    TFMessage: "/tf_static",
    **{one.message_type: topic for topic, one in messages.AIR.items()},
}
"""Topics of what is published by the type of the messages."""


class Flown:
    """The messages of a flight, and heights that are made of them.

    Attributes:
        flight: that is flown.
        estimators: names of those that make heights.
        heights: by estimator and dwell.
    """

    flight: SimulatedFlight
    estimators: tuple[str, ...]
    heights: dict[tuple[str, int], HeightImage]

    def sensor_info(self) -> SensorInfo:
        return messages.sensor_to_message(self.flight.sensor, messages.to_stamp(START_NS))

    def odometry(self, dwell: int) -> list[Odometry]:
        return [
            messages.state_to_message(state, messages.to_stamp(START_NS + state.stamp_ns))
            for state in self.flight.platform_states(dwell)
        ]

    def frames(self, dwell: int) -> list[ChannelFrame]:
        history = history_in(self.flight, dwell)
        stamp = messages.to_stamp(START_NS + history.stamp_ns)
        frames = messages.history_to_messages(history, self.flight.sensor, dwell, stamp)
        return [copy.deepcopy(frame) for frame in frames]  # of which each can be spoiled alone

    def publish(self, *messages: Any) -> None:
        """Publish messages on the topics of their types."""
        raise NotImplementedError

    def wait(self, condition: Any, what: str) -> None:
        """Wait until something has happened."""
        raise NotImplementedError

    def accounts(self) -> dict[str, Any]:
        """The account of each stage."""
        raise NotImplementedError

    def fly(self, dwell: int = 0) -> None:
        """Publish the description of the sensor and a dwell, and wait for its heights."""
        self.publish(self.sensor_info(), *self.odometry(dwell), *self.frames(dwell))
        self.await_heights(dwell)

    def await_heights(self, dwell: int) -> None:
        expected = {(name, dwell) for name in self.estimators}
        self.wait(lambda: expected <= set(self.heights), f"the heights of dwell {dwell}")

    def await_drops(self, stage: str, reason: str, count: int) -> None:
        self.wait(lambda: self.dropped(stage).get(reason) == count, f"{count} x {reason!r} in {stage}")

    def dropped(self, stage: str) -> dict[str, int]:
        summary = self.accounts()[stage]
        return {k.removeprefix("dropped."): int(v) for k, v in summary.items() if k.startswith("dropped.")}

    def _keep(self, image: HeightImage) -> None:
        self.heights[image.estimator, image.dwell] = image


class StageChain(Flown):
    """Compression and estimators joined by messages, without ROS; time passes while a test waits.

    Attributes:
        graph: of the stages.
        stages: by name.
    """

    def __init__(
        self,
        flight: SimulatedFlight,
        missing_after_s: float = 0.5,
        image: Mapping[str, Any] = MappingProxyType({"rows": 46, "cols": 12}),
        heights: Mapping[str, Any] = MappingProxyType({}),
        estimators: Sequence[str] = ("monopulse", "ml"),
        own: Mapping[str, Mapping[str, Any]] = MappingProxyType({}),
    ) -> None:
        """Parameters: `image` of sar_compression, in vacuum, `heights` of all estimators, `own` of one by name."""
        self.flight, self.estimators, self.heights = flight, tuple(estimators), {}
        self.graph = StageGraph()
        self.stages = self.graph.hosts
        self.graph.add("sar_compression", timeout_s=missing_after_s, **{"air": "none", **image})
        for name in estimators:
            self.graph.add(height_stage(name).usual_name, timeout_s=missing_after_s, **heights, **own.get(name, {}))

    def publish(self, *messages: Any) -> None:
        for message in messages:
            self.graph.publish(TOPICS[type(message)], message)
        for name in self.estimators:
            for image in self.graph.heard.pop(f"{name}/height", []):
                self._keep(image)

    def wait(self, condition: Any, what: str) -> None:
        self.graph.wait(lambda: self.publish() or condition(), what)

    def accounts(self) -> dict[str, Any]:
        return {name: stage.summary() for name, stage in self.stages.items()}


def heights_of_messages(chain: StageChain) -> HeightImage:
    """The height image that another ml_height, with default settings, makes of the one dwell of images of a chain.

    It reads them from messages, where the chain hands over the images themselves.
    """
    graph = StageGraph()
    graph.add("ml_height")
    graph.publish(TOPICS[SensorInfo], chain.sensor_info())
    graph.publish("slc", *chain.graph.heard["slc"])
    (image,) = graph.heard["ml/height"]
    return image


class Chain(Flown):
    """sar_compression and height nodes in one graph; frames go in by hand, heights are collected."""

    def __init__(
        self,
        graph: Graph,
        flight: SimulatedFlight,
        missing_after_s: float,
        image: Mapping[str, Any] = MappingProxyType({"rows": 46, "cols": 12}),
        heights: Mapping[str, Any] = MappingProxyType({}),
        ml_height: Mapping[str, Any] = MappingProxyType({}),
    ) -> None:
        """Parameters: `image` of sar_compression, in vacuum, `heights` of both height nodes, `ml_height` of one."""
        self.graph = graph
        self.flight = flight
        self.estimators = ("monopulse", "ml")
        parameters = {
            "sar_compression": {"air": "none", **image},
            "monopulse": heights,
            "ml_height": {**heights, **ml_height},
        }
        self.stages: dict[str, StageNode] = {}
        for name, given in parameters.items():
            values = {"timeout_s": missing_after_s, **given}
            overrides = [Parameter(parameter, value=value) for parameter, value in values.items()]
            self.stages[name] = graph.add(PROCESSING[name](context=graph.context, parameter_overrides=overrides))
        self.heights: dict[tuple[str, int], HeightImage] = {}
        self._feeder = graph.add(Node("feeder", context=graph.context))
        self._publishers = {
            SensorInfo: publisher_of(self._feeder, SensorInfo, "sensor_info", LATCHED_QOS),
            Odometry: publisher_of(self._feeder, Odometry, "platform/odometry", ODOMETRY_QOS),
            ChannelFrame: publisher_of(self._feeder, ChannelFrame, "phase_history", FRAMES_QOS),
            **{
                one.message_type: publisher_of(self._feeder, one.message_type, topic, ODOMETRY_QOS)
                for topic, one in messages.AIR.items()
            },
        }
        for name in self.estimators:
            subscribe(self._feeder, HeightImage, f"{name}/height", self._keep, FRAMES_QOS)
        self.wait(lambda: all(p.get_subscription_count() for p in self._publishers.values()), "the nodes to connect")
        self.wait(
            lambda: all(self._feeder.count_publishers(f"{name}/height") == 1 for name in self.estimators),
            "the height nodes to connect",
        )

    def wait(self, condition: Any, what: str) -> None:
        assert self.graph.spin_until(condition, TIMEOUT_S), f"waited in vain for {what}: {self.accounts()}"

    def publish(self, *messages: Any) -> None:
        for message in messages:
            self._publishers[type(message)].publish(message)

    def accounts(self) -> dict[str, Any]:
        return {name: stage.tally.summary() for name, stage in self.stages.items()}


def next_dwell_is_exact(chain: Flown, reference: dict[tuple[str, int], HeightImage]) -> None:
    chain.publish(*chain.odometry(1), *chain.frames(1))
    chain.await_heights(1)
    for name in ("ml", "monopulse"):
        assert same_heights(chain.heights[name, 1], reference[name, 1])
    for summary in chain.accounts().values():
        dropped = sum(value for key, value in summary.items() if key.startswith("dropped."))
        assert summary["in"] == summary["processed"] + dropped + summary["waiting"]


def same_heights(ours: HeightImage, theirs: HeightImage) -> bool:
    """Whether two height images agree value for value."""
    return all(is_same(getattr(ours, name), getattr(theirs, name)) for name in ("grid", "validity", "surfaces"))
