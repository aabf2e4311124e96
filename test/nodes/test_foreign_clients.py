"""Programs that are not ours and have no ROS feed the nodes, and use what these publish."""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from chain_fixture import same_heights
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rosbags.rosbag2 import Reader
from sal_height_msgs.msg import ChannelFrame, HeightImage, SensorInfo

from sal_height.nodes.domain import free_domain
from sal_height.nodes.graph import Graph
from sal_height.nodes.height import HEIGHT_NODES
from sal_height.nodes.sar_compression import SarCompression
from sal_height.nodes.stage import FRAMES_QOS, LATCHED_QOS, ODOMETRY_QOS, Stage

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("cyclonedds") is None,
    reason="cyclonedds is not installed: it has no wheel for this Python or processor",
)

ROOT = Path(__file__).parents[2]
FRAMES = 16
BAG = ROOT / "bags" / "version_2"
TIMEOUT_S = 60.0
TOPICS = ("/sensor_info", "/platform/odometry", "/phase_history")


class Nodes:
    """sar_compression and ml_height, on Fast DDS."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.compression: Stage = graph.add(SarCompression(context=graph.context))
        self.heights: Stage = graph.add(HEIGHT_NODES["ml_height"](context=graph.context))

    def wait(self, condition, what: str) -> None:
        assert self.graph.spin_until(condition, TIMEOUT_S), f"waited in vain for {what}: {self.accounts()}"

    def accounts(self) -> list[dict]:
        return [node.tally.summary() | {"last": node.last_rejection} for node in (self.compression, self.heights)]


@pytest.fixture
def nodes(graph: Graph) -> Nodes:
    return Nodes(graph)


@contextmanager
def client(domain: int, out: Path, *options: str | Path) -> Iterator[subprocess.Popen[str]]:
    """The client on Cyclone DDS, in a process of its own, which is ended."""
    command = [sys.executable, ROOT / "test/nodes/cyclone_client.py", str(domain), BAG, out, *options]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)  # noqa: S603 (our own program)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


class Feeder:
    """The same by rclpy: keeps the heights, and publishes the bag."""

    def __init__(self, nodes: Nodes) -> None:
        self.heights: list[HeightImage] = []
        self._nodes, self._node = nodes, nodes.graph.add(Node("feeder", context=nodes.graph.context))
        self._node.create_subscription(HeightImage, "ml/height", self.heights.append, FRAMES_QOS)

    def publish(self) -> dict[int, HeightImage]:
        """Heights of the dwells of the bag."""
        kinds = {SensorInfo: LATCHED_QOS, Odometry: ODOMETRY_QOS, ChannelFrame: FRAMES_QOS}
        publishers = {
            topic: self._node.create_publisher(kind, topic, qos)
            for topic, (kind, qos) in zip(TOPICS, kinds.items(), strict=True)
        }
        wait = self._nodes.wait
        wait(lambda: all(p.get_subscription_count() for p in publishers.values()), "the nodes to connect")
        wait(lambda: self._node.count_publishers("ml/height") == 1, "the height node to connect")
        with Reader(BAG) as bag:
            for connection, _, cdr in bag.messages():
                if connection.topic in publishers:
                    publishers[connection.topic].publish(cdr)
        wait(lambda: len(self.heights) == 2, "heights")
        return {image.dwell: image for image in self.heights}


@pytest.fixture(scope="module")
def reference() -> dict[int, HeightImage]:
    """Heights of the bag when rclpy publishes it."""
    with free_domain() as domain, Graph(domain) as graph:
        return Feeder(Nodes(graph)).publish()


def assert_same(heights: dict[int, HeightImage], reference: dict[int, HeightImage]) -> None:
    assert heights.keys() == reference.keys()
    for dwell, image in heights.items():
        assert same_heights(image, reference[dwell])
        assert (image.header, image.provenance) == (reference[dwell].header, reference[dwell].provenance)


def test_heights_for_a_client_on_another_dds_are_those_for_rclpy(
    domain_id: int, nodes: Nodes, reference: dict[int, HeightImage], tmp_path: Path
) -> None:
    with client(domain_id, tmp_path) as process:
        nodes.wait(lambda: process.poll() is not None, "the client to end")
        assert process.returncode == 0, process.stderr.read()
    heights = {int(file.stem): deserialize_message(file.read_bytes(), HeightImage) for file in tmp_path.iterdir()}
    assert_same(heights, reference)
    assert not nodes.compression.source_warning


def definitions_with(folder: Path, name: str, *changes: tuple[str, str]) -> Path:
    """The definitions of the messages, of which one is changed."""
    shutil.copytree(ROOT / "msg_defs" / "msg", folder)
    file = folder / f"{name}.msg"
    text = file.read_text(encoding="utf-8")
    for change in changes:
        assert change[0] in text
        text = text.replace(*change)
    file.write_text(text, encoding="utf-8")
    return folder


WITHOUT_SCALE = ("ChannelFrame", ("float64 scale", ""))
WITHOUT_NAME = ("SensorInfo", ("string name", ""))
EXCHANGED = (
    "ChannelFrame",
    ("float64[] pulse_time", "float64[] REFERENCE_RANGE"),
    ("float64[] reference_range", "float64[] pulse_time"),
    ("REFERENCE_RANGE", "reference_range"),
)
"""Has the same layout: a number is taken for another."""

STRANGE = f"typehash=RIHS01_{64 * '0'};"
"""What a participant of ROS states of a type, where it knows another definition."""


@pytest.mark.parametrize("change", [WITHOUT_SCALE, WITHOUT_NAME], ids=["frames", "sensor"])
def test_messages_of_another_layout_are_counted_and_end_no_node(
    change: tuple, domain_id: int, nodes: Nodes, reference: dict[int, HeightImage], tmp_path: Path
) -> None:
    feeder = Feeder(nodes)
    folder = definitions_with(tmp_path / "definitions", *change)
    with client(domain_id, tmp_path, "--msg-defs", folder) as process:
        nodes.wait(lambda: nodes.compression.tally.summary().get("ignored.broken message"), "a broken message")
    assert process.returncode != 0
    assert not feeder.heights
    assert_same(feeder.publish(), reference)


def test_messages_of_another_definition_and_the_same_layout_are_refused(
    domain_id: int, nodes: Nodes, tmp_path: Path
) -> None:
    folder = definitions_with(tmp_path / "definitions", *EXCHANGED)
    feeder = Feeder(nodes)
    with client(domain_id, tmp_path, "--msg-defs", folder, "--states", STRANGE):
        nodes.wait(lambda: nodes.compression.tally.summary().get("ignored.another definition") == FRAMES, "refusals")
        said = nodes.compression.diagnostics().status[0]
        assert said.level == DiagnosticStatus.WARN
        assert said.message.startswith(
            "A program without a node publishes /phase_history with another definition of "
            "sal_height_msgs/msg/ChannelFrame: build it with the sal_height_msgs of this version. "
        )
    nodes.wait(lambda: not nodes.compression.source_warning, "the client to be gone")
    assert nodes.compression.tally.summary()["in"] == 0
    assert not feeder.heights
