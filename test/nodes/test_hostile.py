"""No message ends a node or makes it fail in a way nobody has thought of; the next good dwell is exact."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chain_fixture import DETECTORS, START_NS, Chain, next_dwell_is_exact
from helpers import few, publisher_of
from instrument_messages import fix_at, imu_at, pose_of, twist_of
from rclpy.node import Node
from rclpy.parameter import Parameter
from rosbags.rosbag2 import Reader

from benchmarks.hostile_messages import feed, hostile
from sal_height import messages
from sal_height.calibration import Calibration
from sal_height.geometry import Origin
from sal_height.messages import serialize
from sal_height.messages.types import ComplexImage, HeightImage
from sal_height.nodes.processing import PROCESSING
from sal_height.nodes.recording.recorder import Recorder
from sal_height.nodes.transport.domain import free_domain
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.message_types import subscribe
from sal_height.nodes.transport.qos import FRAMES_QOS
from sal_height.nodes.worker import WorkerNode
from sal_height.simulation import SimulatedFlight

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")
"""Numbers that nobody expects overflow; what matters is what becomes of them."""

TIMES = int(os.environ.get("SAL_HEIGHT_HOSTILE", "1"))
"""So many times as many messages as usual: SAL_HEIGHT_HOSTILE=50 .venv/bin/pytest test/nodes/test_hostile.py"""

TIMEOUT_S = 120.0
AT_ONCE = 10
SEEDS = few(1, [1, 2])


@pytest.fixture(scope="session")
def good(flight: SimulatedFlight) -> dict[str, Any]:
    """A good message of every topic of the chain."""
    with free_domain() as domain, Graph(domain) as graph:
        chain = Chain(graph, flight, missing_after_s=30.0)
        images: list[ComplexImage] = []
        listener = graph.add(Node("listener", context=graph.context))
        subscribe(listener, ComplexImage, "slc", images.append, FRAMES_QOS)
        assert graph.spin_until(lambda: listener.count_publishers("slc") == 1, TIMEOUT_S)
        chain.publish(chain.sensor_info(), *chain.odometry(0), *chain.frames(0))
        chain.await_heights(0)
        chain.wait(lambda: bool(images), "an image")
        heights = chain.heights["ml", 0]
    sigmas = {f"{what}_sigma": np.zeros(DETECTORS) for what in ("response", "gain", "phase")}
    response = np.ones((DETECTORS, flight.sensor.sample_count), np.complex128)
    calibration = Calibration(flight.sensor.config_hash, response=response, dwells=1, **sigmas)
    return {
        "/sensor_info": chain.sensor_info(),
        "/platform/odometry": chain.odometry(0)[1],
        "/phase_history": chain.frames(0)[1],
        "/slc": images[0],
        "/ml/height": heights,
        "/calibration": messages.calibration_to_message(calibration, messages.to_stamp(START_NS)),
    }


def assert_nothing_unexpected(*nodes: WorkerNode) -> None:
    for node in nodes:
        counts = node.tally.summary()
        assert not {"ignored.internal error", "dropped.internal error"} & set(counts), node.last_rejection


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("topic", ["/sensor_info", "/platform/odometry", "/phase_history", "/slc", "/calibration"])
def test_hostile_messages_cost_no_good_dwell(
    topic: str, seed: int, good: dict[str, Any], chain: Chain, reference: dict[tuple[str, int], HeightImage]
) -> None:
    chain.publish(chain.sensor_info(), *chain.odometry(0), *chain.frames(0))
    chain.await_heights(0)
    for cdr in hostile(good[topic], 400 * TIMES, np.random.default_rng(seed)):
        for node in chain.stages.values():
            feed(node, topic, cdr)
    chain.wait(lambda: not any(node.jobs for node in chain.stages.values()), "the nodes to finish")
    assert_nothing_unexpected(*chain.stages.values())
    chain.publish(*chain.odometry(0))  # two hostile samples may have looked like a clock that starts anew
    next_dwell_is_exact(chain, reference)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(
    "node_type", [PROCESSING["relief_tracker"], PROCESSING["relief_mapper"], PROCESSING["ground_mapper"]]
)
def test_hostile_heights_do_not_make_a_node_fail(
    node_type: type[WorkerNode], seed: int, good: dict[str, Any], graph: Graph
) -> None:
    parameters = [Parameter("max_cells", value=100_000)] if node_type is not PROCESSING["relief_tracker"] else []
    node = graph.add(node_type(context=graph.context, parameter_overrides=parameters))
    for cdr in hostile(good["/ml/height"], 100 * TIMES, np.random.default_rng(seed)):
        feed(node, "/ml/height", cdr)
        assert graph.spin_until(lambda: not node.jobs, TIMEOUT_S)
    before = node.tally.summary()["processed"]
    feed(node, "/ml/height", serialize(good["/ml/height"]))
    assert graph.spin_until(lambda: node.tally.summary()["processed"] == before + 1, TIMEOUT_S), node.last_rejection
    assert_nothing_unexpected(node)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("topic", ["/sensor_info", "/slc"])
def test_hostile_images_do_not_make_the_calibration_fail(
    topic: str, seed: int, good: dict[str, Any], graph: Graph
) -> None:
    parameters = [Parameter("dwell_step", value=1), Parameter("dwells", value=2), Parameter("timeout_s", value=0.05)]
    node = graph.add(PROCESSING["psf_calibration"](context=graph.context, parameter_overrides=parameters))
    feed(node, "/sensor_info", serialize(good["/sensor_info"]))
    for cdr in hostile(good[topic], 400 * TIMES, np.random.default_rng(seed)):
        feed(node, topic, cdr)
    assert graph.spin_until(lambda: not node.jobs, TIMEOUT_S)
    assert_nothing_unexpected(node)
    before = node.tally.summary()["in"]
    for channel in range(DETECTORS):  # of a dwell that nobody has spoilt
        image = good["/slc"]
        image.dwell, image.channel = 60_000, channel
        feed(node, "/slc", serialize(image))
    assert graph.spin_until(lambda: node.tally.summary()["waiting"] == 0, TIMEOUT_S)
    assert node.tally.summary()["in"] == before + DETECTORS
    assert_nothing_unexpected(node)


def test_hostile_messages_are_recorded_as_they_are(good: dict[str, Any], graph: Graph, tmp_path: Path) -> None:
    """The recorder decodes nothing; what it has written is read by others."""
    recorder = graph.add(Recorder(tmp_path / "bag", context=graph.context))
    feeder = graph.add(Node("feeder", context=graph.context))
    rng = np.random.default_rng(5)
    publishers = {topic: publisher_of(feeder, type(message), topic, 1000) for topic, message in good.items()}
    assert graph.spin_until(lambda: recorder.recorded.keys() >= publishers.keys(), TIMEOUT_S)
    assert graph.spin_until(lambda: all(p.get_subscription_count() for p in publishers.values()), TIMEOUT_S)
    sent = {topic: list(hostile(good[topic], 100 * TIMES, rng)) for topic in publishers}
    for topic, messages_sent in sent.items():
        for first in range(0, len(messages_sent), AT_ONCE):
            for cdr in messages_sent[first : first + AT_ONCE]:
                publishers[topic].publish(cdr)
            until = min(first + AT_ONCE, len(messages_sent))
            assert graph.spin_until(lambda topic=topic, n=until: recorder.recorded[topic] >= n, TIMEOUT_S)
    recorder.close_bag()
    assert (recorder.unwritten, recorder.dropped, recorder.failures) == (0, 0, 0)
    with Reader(tmp_path / "bag") as reader:
        read = {topic: [cdr for one, _, cdr in reader.messages() if one.topic == topic] for topic in sent}
    assert read == sent


@pytest.mark.parametrize("source", ["pose", "fix"])
def test_hostile_instruments_do_not_make_navigation_fail(source: str, graph: Graph, flight: SimulatedFlight) -> None:
    parameters = [Parameter("position", value=source), Parameter("origin_latitude_deg", value=48.1)]
    parameters.append(Parameter("origin_longitude_deg", value=11.3))
    node = graph.add(PROCESSING["navigation"](context=graph.context, parameter_overrides=parameters))
    state = flight.platform_states(0)[-1]
    topics = {"/platform/twist": twist_of(state, "map")}
    if source == "pose":
        topics["/platform/pose"] = pose_of(state)
    else:
        topics |= {"/platform/fix": fix_at(0.0, 48.1), "/platform/imu": imu_at(0.0)}
    rng = np.random.default_rng(4)
    for topic, message in topics.items():
        for cdr in hostile(message, 400 * TIMES, rng):
            feed(node, topic, cdr)
    assert_nothing_unexpected(node)
    assert set(node.tally.summary()) > {"in", "processed", "out"}


def test_hostile_origins_do_not_make_mappers_fail(graph: Graph) -> None:
    """Some are of other places of the earth, which the map is laid to, as UTM may be."""
    origin = messages.origin_to_message(Origin(0.84, 0.2, 560.0), messages.to_stamp(5), "map")
    mappers = [
        graph.add(node(context=graph.context)) for node in (PROCESSING["relief_mapper"], PROCESSING["ground_mapper"])
    ]
    rng = np.random.default_rng(6)
    for cdr in hostile(origin, 40 * TIMES, rng):
        for mapper in mappers:
            feed(mapper, "/map_origin", cdr)
    for mapper in mappers:
        assert_nothing_unexpected(mapper)
        assert mapper.tally.summary()["ignored.wrong origin"] > 0
