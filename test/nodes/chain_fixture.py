"""The processing nodes among each other, fed by hand."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from helpers import publisher_of
from rclpy.node import Node
from rclpy.parameter import Parameter

from sal_height import messages
from sal_height.messages.plain import is_same
from sal_height.messages.types import ChannelFrame, HeightImage, Odometry, SensorInfo
from sal_height.nodes.host import StageNode
from sal_height.nodes.processing import PROCESSING
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.message_types import subscribe
from sal_height.nodes.transport.quality import FRAMES_QOS, LATCHED_QOS, ODOMETRY_QOS
from sal_height.simulation.flight import SimulatedFlight

START_NS = 1_700_000_000_123_456_789
TIMEOUT_S = 120.0

DETECTORS = 8


ESTIMATORS = {"monopulse": PROCESSING["monopulse"], "ml": PROCESSING["ml_height"]}


class Chain:
    """sar_compression and height nodes in one graph; frames go in by hand, heights are collected."""

    def __init__(
        self,
        graph: Graph,
        flight: SimulatedFlight,
        missing_after_s: float,
        image: Mapping[str, Any] = MappingProxyType({"rows": 46, "cols": 12}),
        heights: Mapping[str, Any] = MappingProxyType({}),
        monopulse: Mapping[str, Any] = MappingProxyType({}),
        ml_height: Mapping[str, Any] = MappingProxyType({}),
        estimators: Mapping[str, type[StageNode]] = MappingProxyType(ESTIMATORS),
        own: Mapping[str, Mapping[str, Any]] = MappingProxyType({}),
    ) -> None:
        """Parameters: `image` of sar_compression, `heights` of all height nodes, the others of one (`own` by name)."""
        self.graph = graph
        self.flight = flight
        self.estimators = tuple(estimators)
        own = {"monopulse": monopulse, "ml": ml_height, **own}

        def overrides(parameters: Mapping[str, Any]) -> dict[str, Any]:
            values = {"timeout_s": missing_after_s, **parameters}
            return {"parameter_overrides": [Parameter(name, value=value) for name, value in values.items()]}

        nodes = [
            PROCESSING["sar_compression"](context=graph.context, **overrides(image)),
            *(
                node(context=graph.context, **overrides({**heights, **own.get(name, {})}))
                for name, node in estimators.items()
            ),
        ]
        self.stages = {node.get_name(): graph.add(node) for node in nodes}
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

    def sensor_info(self) -> SensorInfo:
        return messages.sensor_to_message(self.flight.sensor, messages.to_stamp(START_NS))

    def odometry(self, dwell: int) -> list[Odometry]:
        return [
            messages.state_to_message(state, messages.to_stamp(START_NS + state.stamp_ns))
            for state in self.flight.platform_states(dwell)
        ]

    def frames(self, dwell: int) -> list[ChannelFrame]:
        history = self.flight.phase_history(dwell)
        stamp = messages.to_stamp(START_NS + history.stamp_ns)
        frames = messages.history_to_messages(history, self.flight.sensor, dwell, stamp)
        return [copy.deepcopy(frame) for frame in frames]  # of which each can be spoiled alone

    def await_heights(self, dwell: int) -> None:
        expected = {(name, dwell) for name in self.estimators}
        self.wait(lambda: expected <= set(self.heights), f"the heights of dwell {dwell}")

    def await_drops(self, stage: str, reason: str, count: int) -> None:
        self.wait(lambda: self.dropped(stage).get(reason) == count, f"{count} x {reason!r} in {stage}")

    def dropped(self, stage: str) -> dict[str, int]:
        summary = self.stages[stage].tally.summary()
        return {k.removeprefix("dropped."): int(v) for k, v in summary.items() if k.startswith("dropped.")}

    def accounts(self) -> dict[str, Any]:
        return {name: stage.tally.summary() for name, stage in self.stages.items()}

    def _keep(self, image: HeightImage) -> None:
        self.heights[image.estimator, image.dwell] = image


def next_dwell_is_exact(chain: Chain, reference: dict[tuple[str, int], HeightImage]) -> None:
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
