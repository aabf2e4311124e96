"""Parameters and calibrations that change in flight are replayed as they flew, with nothing but the bag."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import made_offline
import pytest
from chain_fixture import START_NS, Chain
from helpers import publisher_of
from rclpy.node import Node
from rclpy.parameter import Parameter
from test_psf_calibration import calibration_of, faulty

from sal_height import messages
from sal_height.bag.reader import BagReader
from sal_height.engine.results import DwellKey
from sal_height.errors import UserError
from sal_height.messages.types import Calibration as CalibrationMessage
from sal_height.nodes.recording.recorder import Recorder
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.qos import LATCHED_QOS
from sal_height.runs.chain import replay_parameters
from sal_height.runs.chain.entry import Part
from sal_height.runs.chain.recorded_parameters import recorded_parameters
from sal_height.runs.chain.timeline import Timeline, timeline_of
from sal_height.runs.replay.bag_replay import Playing, replay

SENSOR_TOPICS = ["/sensor_info", "/platform/odometry", "/phase_history"]
HEIGHTS = ["/ml/height", "/monopulse/height"]
EQUAL = dict.fromkeys(HEIGHTS, ("equal", 3))
LOOKS = {"range_looks": 1, "azimuth_looks": 3}
"""Not the defaults of the nodes."""

Deed = Callable[[Graph, Chain], None]
"""Something that somebody does in flight."""


def set_looks(_: Graph, chain: Chain) -> None:
    """Set a parameter, and wait until the node has it; `ros2 param set` does no more."""
    node = chain.stages["ml_height"]
    assert all(result.successful for result in node.set_parameters([Parameter("range_looks", value=2)]))


def calibrate(graph: Graph, chain: Chain) -> None:
    """Publish a calibration, and wait until all nodes have it."""
    publisher = next(node for node in graph.nodes if node.get_name() == "calibrator").calibration
    stamp = messages.to_stamp(START_NS)
    before = len(chain.stages["sar_compression"].stage._received._kept)
    scaled = calibration_of(chain.flight, id=f"number {before}", width_factor=1.0 + 0.05 * before, width_sigma=0.01)
    publisher.publish(messages.calibration_to_message(scaled, stamp))
    nodes = [chain.stages[name] for name in ("sar_compression", "ml_height", "monopulse")]
    already = [node.tally.summary().get("calibrations", 0) for node in nodes]
    chain.wait(
        lambda: all(
            node.tally.summary().get("calibrations", 0) > count for node, count in zip(nodes, already, strict=True)
        ),
        "the calibration",
    )


class Calibrator(Node):
    """Somebody who publishes calibrations."""

    def __init__(self, **node_arguments: Any) -> None:
        super().__init__("calibrator", **node_arguments)
        self.calibration = publisher_of(self, CalibrationMessage, "calibration", LATCHED_QOS)


def fly(graph: Graph, flight: Any, folder: Path, deeds: Sequence[Deed | None], topics: Sequence[str] = HEIGHTS) -> Path:
    """Record as many dwells as there are deeds, each of which comes before its dwell."""
    image = {"rows": 46, "cols": 12, "range_window": "rectangular", "calibration": "topic"}
    chain = Chain(graph, faulty(flight), missing_after_s=30.0, image=image, ml_height=LOOKS)
    graph.add(Calibrator(context=graph.context))
    recorded = [*SENSOR_TOPICS, *topics, "/calibration"]
    overrides = [Parameter("topics", value=recorded)]
    recorder = graph.add(Recorder(folder, context=graph.context, parameter_overrides=overrides))
    chain.wait(lambda: recorder.recorded.keys() >= set(recorded), "the recorder")
    asked = {"/sar_compression", "/ml_height", "/monopulse"}
    chain.wait(lambda: recorder._reader._known.keys() >= asked, "the parameters")
    chain.publish(chain.sensor_info())
    sent = {"/platform/odometry": 0, "/phase_history": 0, "/calibration": 0, "/parameter_events": 0}
    for dwell, deed in enumerate(deeds):
        if deed:
            told = recorder.recorded["/calibration"] + recorder.recorded["/parameter_events"]
            deed(graph, chain)
            chain.wait(
                lambda before=told: recorder.recorded["/calibration"] + recorder.recorded["/parameter_events"] > before,
                "what was done to be recorded",
            )
        chain.publish(*chain.odometry(dwell), *chain.frames(dwell))
        chain.await_heights(dwell)
        sent["/platform/odometry"] += len(chain.odometry(dwell))
        sent["/phase_history"] += len(chain.frames(dwell))
        chain.wait(lambda: all(recorder.recorded[topic] >= count for topic, count in sent.items()), "the recorder")
    each = {topic: 8 if topic == "/slc" else 1 for topic in topics}
    chain.wait(lambda: all(recorder.recorded[t] == n * len(deeds) for t, n in each.items()), "products in the bag")
    graph.close()
    return folder


def key(flight: Any, dwell: int) -> DwellKey:
    return DwellKey(faulty(flight).sensor.config_hash, dwell, START_NS + flight.phase_history(dwell).stamp_ns)


def result_of(bag: Path, out: Path, **given: Any) -> dict[str, tuple[bool, int]]:
    compared = replay(bag, out, given, estimators=["ml", "monopulse"]).compared
    return {topic: (one.verdict, one.matched) for topic, one in compared.items()}


def test_what_flew_is_replayed_as_flown(
    graph: Graph, flight: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = fly(graph, flight, tmp_path / "flight", [None, set_looks, calibrate])
    found = timeline_of(BagReader(bag))
    assert list(found.dwells) == [key(flight, dwell) for dwell in range(3)]
    assert [tuple(one) for one in found.changes] == [(key(flight, 1), ("ml_height", "range_looks"), 2, "provenance")]
    assert [tuple(one) for one in found.calibrations] == [(key(flight, 2), "number 0", "provenance")]
    assert (found.missing, found.forgotten) == ([], {})

    assert result_of(bag, tmp_path / "replay") == EQUAL
    report = json.loads((tmp_path / "replay" / "report.json").read_text())
    assert report["changes_in_flight"] == [
        {"dwell": 1, "parameter": "ml_height.range_looks", "value": 2, "source": "provenance"},
        {"dwell": 2, "calibration": "number 0", "source": "provenance"},
    ]
    assert (report["dwells"], report["warnings"]) == (3, [])
    assert report["parameter_sources"]["ml_height"]["range_looks"] == "provenance"
    assert report["parameter_sources"]["relief_tracker"]["estimator"] == "default"

    compared = replay(
        bag, tmp_path / "burst", {}, estimators=["ml", "monopulse"], playing=Playing("burst")
    ).compared  # waits before a change, too
    assert {topic: (one.verdict, one.matched) for topic, one in compared.items()} == EQUAL
    with pytest.raises(UserError, match=r"Option --loop .* before dwell 1;"):
        replay(bag, tmp_path / "loop", {}, playing=Playing("burst", loops=2))

    again = tmp_path / "replay" / "bag"  # which can be replayed in its turn
    assert made_offline.compared(again, tmp_path / "again") == dict.fromkeys(
        [*HEIGHTS, "/tracked/height"], ("equal", 3)
    )

    given = made_offline.compared(bag, tmp_path / "given", ml_height={"range_looks": 2})
    assert given == {**EQUAL, "/ml/height": ("changed", 3)}  # but for the first dwell, for which it was 1
    assert made_offline.compared(bag, tmp_path / "side_by_side", jobs=2) == EQUAL

    monkeypatch.setattr(replay_parameters, "timeline_of", lambda *_: Timeline(found.dwells, found.start))
    assert made_offline.compared(bag, tmp_path / "ignored") == dict.fromkeys(HEIGHTS, ("changed", 3))


def test_what_changed_before_a_part_of_the_bag_holds_in_it(graph: Graph, flight: Any, tmp_path: Path) -> None:
    """The last dwell alone, from images, which were made with a calibration."""
    bag = fly(graph, flight, tmp_path / "flight", [calibrate, set_looks, None], [*HEIGHTS, "/slc"])
    part = Part("slc", first=2)
    compared = replay(bag, tmp_path / "replay", {}, estimators=["ml", "monopulse"], part=part).compared
    assert {t: (one.verdict, one.matched) for t, one in compared.items()} == dict.fromkeys(HEIGHTS, ("equal", 1))
    report = json.loads((tmp_path / "replay" / "report.json").read_text())
    assert (report["dwells"], report["losses"]) == (1, [])
    changes = report["changes_in_flight"]
    assert [(one["dwell"], one.get("calibration"), one.get("value")) for one in changes] == [
        (0, "number 0", None),
        (1, None, 2),
    ]


def test_without_heights_the_order_of_the_bag_says_what_flew(
    graph: Graph, flight: Any, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    bag = fly(graph, flight, tmp_path / "flight", [calibrate, set_looks, calibrate], topics=[])
    parameters = recorded_parameters(BagReader(bag))
    assert parameters["ml_height"]["azimuth_looks"] == LOOKS["azimuth_looks"]
    assert parameters["sar_compression"].items() >= {"range_window": "rectangular", "cols": 12}.items()
    assert not caplog.messages
    found = timeline_of(BagReader(bag))
    assert [tuple(one) for one in found.changes] == [
        (key(flight, 1), ("ml_height", "range_looks"), 2, "parameter event")
    ]
    applied = [(key(flight, 0), "number 0"), (key(flight, 2), "number 1")]
    assert [(one.dwell, one.calibration) for one in found.calibrations] == applied
    assert {one.source for one in found.calibrations} == {"order of the bag"}
    assert found.start["ml_height", "range_looks"] == (1, "parameter event")
