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
from bag_feeder import BAG, Feeder, assert_same, read_heights

from sal_height.messages.types import DiagnosticStatus, HeightImage
from sal_height.nodes.processing import PROCESSING
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.worker import WorkerNode

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("cyclonedds") is None,
    reason="cyclonedds is not installed: it has no wheel for this Python or processor",
)

ROOT = Path(__file__).parents[2]
FRAMES = 8
"""Of the first dwell, without whose heights the client sends no other."""


class Nodes:
    """sar_compression and ml_height, on Fast DDS, and what feeds them by rclpy."""

    def __init__(self, graph: Graph) -> None:
        self.compression: WorkerNode = graph.add(PROCESSING["sar_compression"](context=graph.context))
        graph.add(PROCESSING["ml_height"](context=graph.context))
        self.feeder = Feeder(graph)
        self.wait = self.feeder.wait


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


def test_heights_for_a_client_on_another_dds_are_those_for_rclpy(
    domain_id: int, nodes: Nodes, bag_heights: dict[int, HeightImage], tmp_path: Path
) -> None:
    with client(domain_id, tmp_path) as process:
        nodes.wait(lambda: process.poll() is not None, "the client to end")
        assert process.returncode == 0, process.stderr.read()
    assert_same(read_heights(tmp_path), bag_heights)
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
    change: tuple, domain_id: int, nodes: Nodes, bag_heights: dict[int, HeightImage], tmp_path: Path
) -> None:
    folder = definitions_with(tmp_path / "definitions", *change)
    with client(domain_id, tmp_path, "--msg-defs", folder) as process:
        nodes.wait(lambda: nodes.compression.tally.summary().get("ignored.broken message"), "a broken message")
    assert process.returncode != 0
    assert not nodes.feeder.heights
    assert_same(nodes.feeder.heights_of(BAG), bag_heights)


def test_messages_of_another_definition_and_the_same_layout_are_refused(
    domain_id: int, nodes: Nodes, tmp_path: Path
) -> None:
    folder = definitions_with(tmp_path / "definitions", *EXCHANGED)
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
    assert not nodes.feeder.heights
