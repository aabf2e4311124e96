"""The shared memory that nodes of this machine hand messages over by."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from sal_height.commands import main
from sal_height.nodes.transport.middleware import ENOUGH, LEAST, PROFILES, segment_bytes, settings_for

PROGRAM = """
import os
from sal_height.nodes.transport.graph import Graph
from rclpy.node import Node
from sal_height.nodes.transport.domain import free_domain
with free_domain() as domain, Graph(domain) as graph:
    graph.add(Node("one", context=graph.context))
    mapped = [line.split() for line in open("/proc/self/maps") if "/dev/shm/fastrtps" in line]
    sizes = [int(end, 16) - int(begin, 16) for begin, end in (line[0].split("-") for line in mapped)]
    print(max(sizes))
    print(os.environ.get("FASTRTPS_DEFAULT_PROFILES_FILE", ""))
"""


def run_program(**variables: str) -> tuple[int, str]:
    """Bytes of the largest piece of shared memory of a process with one node, and the file of settings it used."""
    environment = {**{k: v for k, v in os.environ.items() if k != PROFILES}, **variables}
    result = subprocess.run(  # noqa: S603 (our own program)
        [sys.executable, "-c", PROGRAM], env=environment, check=True, capture_output=True, text=True
    )
    size, file = result.stdout.splitlines()[-2:] if result.stdout.count("\n") > 1 else (result.stdout.strip(), "")
    return int(size), file


def test_a_process_takes_shared_memory_for_dwells_and_leaves_no_file() -> None:
    size, file = run_program()
    assert size >= ENOUGH
    assert file.endswith("fastdds.xml")
    assert not Path(file).exists()


def test_a_publisher_takes_as_much_by_the_settings_that_the_command_prints(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["transport", "--dwell-mb", "42"]) == 0
    file = tmp_path / "fastdds.xml"
    file.write_text(capsys.readouterr().out, encoding="utf-8")
    size, used = run_program(FASTRTPS_DEFAULT_PROFILES_FILE=str(file))
    assert used == str(file)
    assert 84e6 <= size < 90e6


def test_packets_are_small_if_the_network_loses_many(capsys: pytest.CaptureFixture[str]) -> None:
    sizes = []
    for options in ([], ["--packet-bytes", "1400"]):
        assert main(["transport", *options]) == 0
        sizes.append(capsys.readouterr().out.count("<maxMessageSize>1400</maxMessageSize>"))
    assert sizes == [0, 1]


@pytest.mark.parametrize("packet_bytes", [1400, 9000])
def test_messages_travel_in_packets_of_the_stated_size(packet_bytes: int) -> None:
    """Of the participant; pieces of shared memory stay as they are."""
    bare, sized = (
        re.findall(r"<maxMessageSize>(\d+)<", settings_for(0, packet_bytes=size)) for size in (0, packet_bytes)
    )
    assert sorted(sized) == sorted([*bare, str(packet_bytes)])


@pytest.mark.parametrize(("dwell_mb", "fewest"), [(0, 60), (100, 60)])
def test_pieces_of_messages_are_far_smaller_than_what_no_message_fills(dwell_mb: float, fewest: int) -> None:
    """Of each 1024 bytes 32 are in reserve; with 6 of the largest pieces in it, senders fell silent for good."""
    sizes = dict(re.findall(r"<(segment_size|maxMessageSize)>(\d+)<", settings_for(int(dwell_mb * 1e6))))
    reserve = int(sizes["segment_size"]) / 32
    assert reserve / int(sizes["maxMessageSize"]) > fewest


def test_settings_of_the_user_are_kept() -> None:
    size, file = run_program(FASTRTPS_DEFAULT_PROFILES_FILE="/nowhere/mine.xml")
    assert file == "/nowhere/mine.xml"
    assert size < LEAST


@pytest.mark.parametrize(
    ("dwell_mb", "free_mb", "segment_mb"),
    [
        (0, 24_000, 64),
        (2.1, 24_000, 64),
        (134, 24_000, 268),
        (134, 1_600, 100),
        (0, 64, 4),
        (0, 63, None),
    ],
)
def test_the_shared_memory_holds_two_dwells_if_there_is_room(
    dwell_mb: float, free_mb: float, segment_mb: float | None
) -> None:
    segment = segment_bytes(int(dwell_mb * 1e6), int(free_mb * 1e6))
    assert segment == (None if segment_mb is None else int(segment_mb * 1e6))
