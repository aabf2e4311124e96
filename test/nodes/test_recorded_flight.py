"""What a recorder beside running nodes has recorded is replayed as it flew, with nothing but the bag."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from chain_fixture import TIMEOUT_S, Chain
from rclpy.parameter import Parameter

from sal_height.bag.compare import EQUAL
from sal_height.bag.reader import BagReader
from sal_height.nodes.recording.recorder import Recorder
from sal_height.nodes.transport.graph import Graph
from sal_height.runs.chain.recorded_parameters import recorded_parameters
from sal_height.runs.replay.bag_replay import replay

SENSOR_TOPICS = ["/sensor_info", "/platform/odometry", "/phase_history"]
HEIGHTS = ["/ml/height", "/monopulse/height"]
LOOKS = {"range_looks": 1, "azimuth_looks": 3}
"""Not the defaults of the nodes."""


def fly(graph: Graph, flight: Any, folder: Path, topics: list[str]) -> Path:
    """Record two dwells beside nodes that do not have their default parameters."""
    image = {"rows": 46, "cols": 12, "range_window": "rectangular"}
    chain = Chain(graph, flight, missing_after_s=30.0, image=image, ml_height=LOOKS)
    overrides = [Parameter("topics", value=topics)]
    recorder = graph.add(Recorder(folder, context=graph.context, parameter_overrides=overrides))
    assert graph.spin_until(lambda: recorder.recorded.keys() >= set(topics), TIMEOUT_S)
    asked = {"/sar_compression", "/ml_height", "/monopulse"}
    assert graph.spin_until(lambda: recorder._reader._known.keys() >= asked, TIMEOUT_S)
    chain.publish(chain.sensor_info())
    for dwell in range(2):
        chain.publish(*chain.odometry(dwell), *chain.frames(dwell))
        chain.await_heights(dwell)
    sent = len(chain.odometry(0)) + len(chain.odometry(1))
    assert graph.spin_until(lambda: recorder.recorded["/platform/odometry"] == sent, TIMEOUT_S)
    assert graph.spin_until(lambda: all(recorder.recorded[t] == 2 for t in topics if t in HEIGHTS), TIMEOUT_S)
    graph.close()
    return folder


def test_the_heights_are_those_of_the_flight(graph: Graph, flight: Any, tmp_path: Path) -> None:
    bag = fly(graph, flight, tmp_path / "flight", [*SENSOR_TOPICS, *HEIGHTS])
    compared = replay(bag, tmp_path / "replay", {}, estimators=["ml", "monopulse"]).compared
    assert {topic: (result.verdict == EQUAL, result.matched) for topic, result in compared.items()} == dict.fromkeys(
        HEIGHTS, (True, 2)
    )


def test_parameters_are_in_a_bag_without_heights(
    graph: Graph, flight: Any, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    bag = fly(graph, flight, tmp_path / "flight", SENSOR_TOPICS)
    found = recorded_parameters(BagReader(bag))
    assert {name: found["ml_height"][name] for name in LOOKS} == LOOKS
    assert found["sar_compression"]["range_window"] == "rectangular"
    assert found["sar_compression"]["cols"] == 12
    assert not caplog.messages
