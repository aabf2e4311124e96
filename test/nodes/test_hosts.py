"""Nodes on several hosts, on a network that loses and delays packets."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import bag_feeder
import pytest
from bag_feeder import BAG, assert_same, read_heights
from helpers import few
from hosts import Hosts, UnavailableError

from sal_height.messages.types import HeightImage
from sal_height.nodes.transport.middleware import PROFILES, settings_for

TIMEOUT_S = 300.0
FRAMES = 16
OURS = {
    **{name: text for name, text in os.environ.items() if not name.startswith(("ROS_", "FASTRTPS_"))},
    "ROS_DOMAIN_ID": "0",
    "ROS_LOG_DIR": os.environ.get("ROS_LOG_DIR", ""),
}
"""Variables of programs on the hosts: discovery as ROS has it by default."""

TESTS = Path(bag_feeder.__file__).parents[1]
MODULES = os.pathsep.join(map(str, (TESTS, TESTS / "nodes", TESTS / "engine", TESTS.parent)))
"""Where programs find the helpers of tests."""

Start = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def hosts() -> Iterator[Hosts]:
    """Three hosts on a network without faults, or the reason why there are none."""
    with ExitStack() as stack:
        try:
            network = stack.enter_context(Hosts(3))
        except UnavailableError as error:
            pytest.skip(str(error))
        yield network


@pytest.fixture
def start(hosts: Hosts) -> Iterator[Start]:
    """Starts a Python program on a host; all are ended after the test."""
    with ExitStack() as stack:

        def start(host: int, *words: Any, **variables: str) -> subprocess.Popen[str]:
            process = hosts.start(host, sys.executable, *words, env=OURS | variables, stdout=subprocess.PIPE)
            stack.enter_context(process)
            stack.callback(process.kill)
            return process

        yield start


BOTH = """
from bag_feeder import NODES
from sal_height.nodes.processing import PROCESSING
from sal_height.nodes.transport.graph import Graph

with Graph() as graph:
    for name in NODES:
        graph.add(PROCESSING[name](context=graph.context))
    graph.spin_until(lambda: False)
"""
"""Program of both nodes."""


def start_both(start: Start, **variables: str) -> None:
    """Start both nodes on the second host."""
    start(1, "-c", BOTH, PYTHONPATH=MODULES, **variables)


def start_node(start: Start, host: int, name: str, **variables: str) -> subprocess.Popen[str]:
    return start(host, Path(sys.prefix, "bin", f"sal-height-{name}"), **variables)


def feed(start: Start, out: Path, *options: str, **variables: str) -> dict[str, dict[str, float]]:
    """The accounts of all nodes after a bag was published from the first host."""
    process = start(0, bag_feeder.__file__, BAG, out, *options, PYTHONPATH=MODULES, **variables)
    assert process.wait(TIMEOUT_S) == 0
    return {file.stem: json.loads(file.read_text(encoding="utf-8")) for file in out.glob("*.json")}


def dropped(account: dict[str, float]) -> dict[str, float]:
    lost = {name: count for name, count in account.items() if name.startswith(("dropped.", "ignored."))}
    return {name: count for name, count in lost.items() if not name.endswith("of unknown accuracy")}


def assert_nothing_is_lost(accounts: dict[str, dict[str, float]]) -> None:
    for name in ("sar_compression", "ml_height"):
        assert (accounts[name]["in"], accounts[name]["processed"], dropped(accounts[name])) == (FRAMES, FRAMES, {})


def test_reliable_topics_lose_nothing_on_a_network_that_does(
    hosts: Hosts, start: Start, bag_heights: dict[int, HeightImage], tmp_path: Path
) -> None:
    """Nodes on three hosts; tests below have two of them on one."""
    hosts.loss, hosts.delay_s = 0.02, 0.02
    start_node(start, 1, "sar_compression")
    start_node(start, 2, "ml_height")
    accounts = feed(start, tmp_path)
    assert hosts.lost > 0
    assert_same(read_heights(tmp_path), bag_heights)
    assert_nothing_is_lost(accounts)


@pytest.mark.thorough
def test_small_packets_bring_all_over_a_network_that_loses_every_tenth(
    hosts: Hosts, start: Start, bag_heights: dict[int, HeightImage], tmp_path: Path
) -> None:
    hosts.loss, hosts.delay_s = 0.1, 0.05
    profile = tmp_path / "fastdds.xml"
    profile.write_text(settings_for(0, packet_bytes=1400), encoding="utf-8")
    variables = {PROFILES: str(profile)}
    start_both(start, **variables)
    accounts = feed(start, tmp_path, **variables)
    assert hosts.lost > 0.05 * hosts.delivered
    assert_same(read_heights(tmp_path), bag_heights)
    assert_nothing_is_lost(accounts)


@pytest.mark.parametrize("way", few(1, ["peers", "server"]))
def test_hosts_find_each_other_without_multicast(
    way: str, hosts: Hosts, start: Start, bag_heights: dict[int, HeightImage], tmp_path: Path
) -> None:
    hosts.has_multicast = False
    variables = {"ROS_DISCOVERY_SERVER": "10.77.0.1:11811"}
    if way == "peers":
        variables = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_STATIC_PEERS": "10.77.0.1;10.77.0.2"}
    else:
        server = Path(sys.prefix, "bin", "fast-discovery-server")
        start(0, "-c", f"import os; os.execv({str(server)!r}, ['server', '-i', '0', '-l', '10.77.0.1', '-p', '11811'])")
    start_both(start, **variables)
    assert_nothing_is_lost(feed(start, tmp_path, **variables))
    assert_same(read_heights(tmp_path), bag_heights)


@pytest.mark.thorough
def test_frames_that_are_lost_for_good_are_accounted_for(hosts: Hosts, start: Start, tmp_path: Path) -> None:
    hosts.loss, hosts.delay_s = 0.04, 0.02
    start_both(start)
    accounts = feed(start, tmp_path, "best_effort")
    compression, heights = accounts["sar_compression"], accounts["ml_height"]
    assert 0 < compression["in"] < FRAMES
    assert compression["in"] == compression["processed"] + sum(dropped(compression).values())
    assert compression["dropped.incomplete dwell"] > 0
    assert heights["in"] == heights["processed"] == compression["processed"]
    assert len(read_heights(tmp_path)) == heights["published./ml/height"]


NODE = """
import sys
from rclpy.node import Node
from sal_height.nodes.transport.graph import Graph

with Graph() as graph:
    graph.add(Node(sys.argv[1], context=graph.context))
    graph.spin_until(lambda: False)
"""
"""Program of a node that does nothing, in a context like that of all nodes."""

LIST_NODES = """
import rclpy, sys
rclpy.init()
node, seen = rclpy.create_node("looking"), set()
while True:
    rclpy.spin_once(node, timeout_sec=0.05)
    for name in set(node.get_node_names()) - seen:
        seen.add(name)
        print(name, flush=True)
"""


def names_until(process: subprocess.Popen[str], *last: str) -> set[str]:
    """Names of nodes that a process has seen until it has seen the last ones."""
    assert process.stdout is not None
    seen: set[str] = set()
    limit = threading.Timer(TIMEOUT_S, process.kill)
    limit.start()
    while not seen >= set(last):
        line = process.stdout.readline()
        assert line, f"the program has ended, or has seen only {seen}"
        seen.add(line.strip())
    limit.cancel()
    return seen


def test_nodes_that_keep_to_their_host_are_found_there_and_nowhere_else(hosts: Hosts, start: Start) -> None:
    assert hosts.loss == 0
    start(0, "-c", NODE, "local", PYTHONPATH=MODULES, ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
    start(0, "-c", NODE, "open", PYTHONPATH=MODULES)
    names_until(start(0, "-c", LIST_NODES), "local", "open")
    elsewhere = start(1, "-c", LIST_NODES, ROS_STATIC_PEERS="10.77.0.1")
    seen = names_until(elsewhere, "open")
    start(0, "-c", NODE, "late", PYTHONPATH=MODULES)
    seen |= names_until(elsewhere, "late")
    assert seen == {"looking", "open", "late"}
