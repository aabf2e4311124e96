"""Recorders that are killed, and disks that fill up or vanish: what was written stays, and what is lost is said.

Three recorders are killed; SAL_HEIGHT_KILLS sets another number.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from programs import RECORDER, Program
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message
from std_msgs.msg import String

from sal_height.bag.reader import BagReader
from sal_height.bag.salvage import recover
from sal_height.messages.types import DiagnosticArray, DiagnosticStatus
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.message_types import subscribe

TIMEOUT_S = 120.0
KILLS = int(os.environ.get("SAL_HEIGHT_KILLS", "3"))
AT_ONCE = 6
FLUSH_S = 0.3
LATE_S = 2.0
"""Longest time from publication to reception, and from the time of a flush to its end, on a busy machine."""

PERIOD_S = 0.005
SMALL_DISK_MB = 4


def recorder(folder: Path, domain_id: int, **parameters: object) -> Program:
    """A recorder of /note in a process of its own."""
    values = {"directory": str(folder), "topics": "[/note]", "node_parameters": "false", **parameters}
    options = [word for name, value in values.items() for word in ("-p", f"{name}:={value}")]
    return Program(RECORDER, "recorder", "--ros-args", *options, domain_id=domain_id)


@pytest.fixture
def publisher(graph: Graph) -> Publisher:
    return graph.add(Node("source", context=graph.context)).create_publisher(String, "/note", 1000)


def await_subscribers(graph: Graph, publisher: Publisher, count: int) -> None:
    assert graph.spin_until(lambda: publisher.get_subscription_count() == count, TIMEOUT_S)


def numbers_in(bag: Path) -> list[int]:
    return [int(deserialize_message(m.cdr, String).data.split()[0]) for m in BagReader(bag).messages(["/note"])]


def publish_until(graph: Graph, publisher: Publisher, published: list[float], end: float) -> None:
    """Publish numbers, and note when."""
    while time.monotonic() < end:
        published.append(time.monotonic())
        publisher.publish(String(data=f"{len(published) - 1} {'x' * 1000}"))
        graph.spin_for(PERIOD_S)


def test_a_killed_recorder_loses_no_more_than_came_since_the_last_flush(
    graph: Graph, publisher: Publisher, domain_id: int, tmp_path: Path
) -> None:
    rng = np.random.default_rng(181)
    published: list[float] = []
    for first in range(0, KILLS, AT_ONCE):
        numbers = range(first, min(first + AT_ONCE, KILLS))
        folders = [tmp_path / f"bag{number}" for number in numbers]
        running = [recorder(folder, domain_id, flush_period_s=FLUSH_S) for folder in folders]
        await_subscribers(graph, publisher, len(running))
        begin, first_number = time.monotonic(), len(published)
        moments = np.sort(rng.uniform(LATE_S + 0.5, LATE_S + 1.0, len(running)))
        for moment, process, folder in zip(moments, running, folders, strict=True):
            publish_until(graph, publisher, published, begin + moment)
            process.kill()
            killed_at = time.monotonic()
            process.communicate()
            recover(folder, tmp_path / "salvaged")
            found = numbers_in(tmp_path / "salvaged")
            shutil.rmtree(tmp_path / "salvaged")
            due = np.searchsorted(published, killed_at - FLUSH_S - LATE_S)
            assert found == list(range(first_number, first_number + len(found)))
            assert found[-1] >= due - 1
        await_subscribers(graph, publisher, 0)


@pytest.fixture
def errors(graph: Graph) -> list[str]:
    """What the recorder says in its diagnostics while it is not well."""
    said: list[str] = []

    def hear(message: DiagnosticArray) -> None:
        said.extend(s.message for s in message.status if s.name == "recorder" and s.level != DiagnosticStatus.OK)

    subscribe(graph.add(Node("watcher", context=graph.context)), DiagnosticArray, "/diagnostics", hear, 100)
    return said


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 4 MB."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={SMALL_DISK_MB}m", "none", str(disk)]
    made = subprocess.run(mount, check=False, capture_output=True, text=True)  # noqa: S603 (our own folder)
    if made.returncode:
        pytest.skip(f"no file system may be mounted here: {made.stderr.strip()}")
    yield disk
    subprocess.run(["umount", "-l", str(disk)], check=True)  # noqa: S603, S607 (our own folder)


def test_a_disk_that_fills_up_keeps_what_was_written_and_the_program_says_so(
    graph: Graph, publisher: Publisher, domain_id: int, small_disk: Path, tmp_path: Path, errors: list[str]
) -> None:
    process = recorder(small_disk / "bag", domain_id)
    await_subscribers(graph, publisher, 1)
    for number in range(3 * SMALL_DISK_MB):
        publisher.publish(String(data=f"{number} {'x' * 500_000}"))
        graph.spin_for(0.02)
    assert graph.spin_until(lambda: bool(errors), TIMEOUT_S)
    assert "messages are not in the bag" in errors[-1]
    assert process.poll() is None  # it goes on, and counts
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=TIMEOUT_S)
    assert process.returncode == 1
    assert "No space left on device" in said
    assert "Traceback" not in said
    recover(small_disk / "bag", tmp_path / "salvaged")
    found = numbers_in(tmp_path / "salvaged")
    assert found == list(range(len(found)))
    assert 0.5 * len(found) > SMALL_DISK_MB - 1.5


def test_a_bag_that_vanishes_is_told_at_the_next_flush(
    graph: Graph, publisher: Publisher, domain_id: int, tmp_path: Path, errors: list[str]
) -> None:
    process = recorder(tmp_path / "bag", domain_id, flush_period_s=0.1)
    await_subscribers(graph, publisher, 1)
    publisher.publish(String(data="0"))
    assert graph.spin_until(lambda: any((tmp_path / "bag").glob("*.mcap")), TIMEOUT_S)
    shutil.rmtree(tmp_path / "bag")
    deadline = time.monotonic() + TIMEOUT_S
    while not errors and time.monotonic() < deadline:
        publisher.publish(String(data="1"))
        graph.spin_for(0.05)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=TIMEOUT_S)
    assert "messages are not in the bag" in errors[-1]
    assert "has been removed" in said
    assert process.returncode == 1
