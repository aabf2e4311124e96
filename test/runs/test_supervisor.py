"""Nodes that have ended are started again, and work at the next dwell beside those that went on."""

from __future__ import annotations

import json
import logging
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from helpers import few
from rclpy.node import Node
from std_srvs.srv import Trigger

from sal_height.bag.reader import BagReader
from sal_height.errors import UserError
from sal_height.graph.ensemble import Member
from sal_height.graph.supervisor import FIRST_WAIT_S, LONGEST_WAIT_S, STEADY_S, Supervisor
from sal_height.graph.watch import AccountBook, Watcher
from sal_height.messages.types import HeightImage
from sal_height.nodes.transport.domain import free_domain
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.message_types import subscribe
from sal_height.nodes.transport.qos import FRAMES_QOS

DEADLINE_S = 600.0


@dataclass
class Processes:
    """An ensemble whose processes end when the test says so."""

    processes: dict[str, list[Member]]
    statuses: dict[str, int] = field(default_factory=dict)
    failure: str = ""

    def ended(self) -> dict[str, int]:
        return dict(self.statuses)

    def describe(self, name: str) -> str:
        return f"Node {name}"

    def start_again(self, name: str) -> None:
        if self.failure:
            raise UserError(self.failure)
        self.statuses.pop(name)


def supervised(*members: Member) -> tuple[Supervisor, Processes]:
    processes = Processes({member.name: [member] for member in members})
    supervisor: Any = Supervisor(processes, 0.0)  # type: ignore[arg-type]
    return supervisor, processes


def starts_of(supervisor: Supervisor, processes: Processes, until_s: float) -> list[float]:
    """Times at which a node is started that ends at once, again and again; looked at every 10 ms."""
    times = []
    for tick in range(round(until_s * 100)):
        processes.statuses.setdefault("ml_height", -9)
        if supervisor.look(tick / 100):
            times.append(tick / 100)
    return times


def test_a_node_that_ends_again_and_again_is_waited_for_twice_as_long_each_time() -> None:
    times = starts_of(*supervised(Member("ml_height")), until_s=200.0)
    waits = [later - earlier for earlier, later in zip([0.0, *times], times, strict=False)]
    expected = [min(FIRST_WAIT_S * 2**number, LONGEST_WAIT_S) for number in range(len(waits))]
    assert waits == pytest.approx(expected, abs=0.03)
    assert len(waits) == 11  # six within 31.5 s, and then one every 30 s


def test_a_node_that_has_run_for_long_is_waited_for_as_little_as_the_first_time() -> None:
    supervisor, processes = supervised(Member("ml_height"))
    starts_of(supervisor, processes, until_s=20.0)
    assert supervisor.look(100.0) == ["ml_height"]
    ended = 100.0 + STEADY_S + 1
    processes.statuses["ml_height"] = 1
    assert supervisor.look(ended) == []
    assert supervisor.look(ended + FIRST_WAIT_S - 0.01) == []
    assert supervisor.look(ended + FIRST_WAIT_S) == ["ml_height"]


def test_the_end_of_a_node_and_what_follows_are_told(caplog: pytest.LogCaptureFixture) -> None:
    supervisor, processes = supervised(Member("ml_height"), Member("near", "ml_height"))
    with caplog.at_level(logging.WARNING):
        processes.statuses = {"ml_height": -signal.SIGKILL, "near": 2}
        supervisor.look(1.0)
        processes.failure = "There is no memory."
        supervisor.look(2.0)
    assert [record.getMessage() for record in caplog.records] == [
        "Node ml_height ended by SIGKILL; it is started again in 0.5 s.",
        "Node near ended with status 2, and what it said is above; it is started again in 0.5 s.",
        "Node ml_height could not be started (There is no memory.); it is started again in 1 s.",
        "Node near could not be started (There is no memory.); it is started again in 1 s.",
    ]
    processes.failure = ""
    assert supervisor.look(3.0) == ["ml_height", "near"]


NODES = ["sar_compression", "ml_height", "relief_tracker", "relief_mapper", "recorder", "paced_player"]

PROCESSES = {
    "host": {"live host": "The live host (sar_compression, ml_height, relief_tracker, relief_mapper)", "recorder": ""},
    "separate": {name: "" for name in NODES if name != "paced_player"},
}
"""Processes that are killed, with what messages call them unless it is their node."""

CONFIGURATION = """
namespace: lidar
separate: {separate}
nodes:
  paced_player:
    parameters: {{bag: {bag}, rate: 0.05}}
  sar_compression:
    parameters: {{rows: 96, cols: 12}}
  ml_height:
  relief_tracker:
  relief_mapper:
    parameters: {{estimator: tracked, file: {folder}/map.tif}}
  recorder:
    parameters: {{directory: {folder}/bag, topics: [ml/height]}}
"""


@dataclass
class Program:
    """`sal-height live CONFIG --supervise`, and the heights that come from it."""

    process: subprocess.Popen[str]
    graph: Graph
    folder: Path
    stamps: dict[str, list[int]]
    mode: str = "host"
    book: AccountBook = field(default_factory=AccountBook)

    def wait_for(self, condition: Callable[[], bool]) -> None:
        ended = self.process.poll
        assert self.graph.spin_until(lambda: condition() or ended() is not None, DEADLINE_S), self.what_happened()
        assert condition(), self.what_happened()

    def await_new(self, topic: str, number: int = 1) -> None:
        """Wait until so many more messages have come."""
        wanted = len(self.stamps[topic]) + number
        self.wait_for(lambda: len(self.stamps[topic]) >= wanted)

    @property
    def recorded(self) -> int:
        """Number of heights that all processes of the recorder have written."""
        return self.book.entries["lidar/recorder"].account.recorded.get("lidar/ml/height", 0)

    def node(self, name: str) -> int:
        """Number of the process of a node; 0: there is none."""
        found = [] if self.process.poll() is not None else children(self.process.pid)
        return next((pid for pid in found if name in command_of(pid)), 0)

    def kill(self, name: str) -> int:
        """End the process of a node by SIGKILL; returns its number."""
        killed = self.node(name)
        assert killed, self.what_happened()  # number 0 would be all processes of the tests themselves
        os.kill(killed, signal.SIGKILL)
        return killed

    def what_happened(self) -> str:
        """How the program ended and what it said, if it has ended."""
        if self.process.poll() is None:
            return f"The program runs, with the processes {list(map(command_of, children(self.process.pid)))}."
        said, errors = self.process.communicate()
        return f"The program ended with status {self.process.returncode}:\n{said}\n{errors}"


def children(parent: int) -> list[int]:
    return [int(pid) for pid in Path(f"/proc/{parent}/task/{parent}/children").read_text().split()]


def command_of(pid: int) -> str:
    """Name and arguments of a process: one that was forked has those of the program, and the name of its node."""
    folder = Path(f"/proc/{pid}")
    try:
        name, words = (folder / "comm").read_text(), (folder / "cmdline").read_text().split("\0")
    except (FileNotFoundError, ProcessLookupError):
        return ""
    return name if "live" in words else " ".join(words)


@contextmanager
def live(domain: int, *words: object) -> Iterator[subprocess.Popen[str]]:
    """`sal-height live --supervise`, which is killed at the end if it still runs."""
    command = [sys.executable, "-m", "sal_height", "live", *map(str, words), "--supervise", "--domain", str(domain)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:  # noqa: S603
        try:
            yield process
        finally:
            process.kill()


@pytest.fixture(scope="module", params=few(1, ["host", "separate"]))
def program(
    request: pytest.FixtureRequest, recorded: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Program]:
    folder = tmp_path_factory.mktemp("supervised")
    file = folder / "flight.yaml"
    file.write_text(CONFIGURATION.format(bag=recorded / "bag", folder=folder, separate=request.param == "separate"))
    with free_domain() as domain, Graph(domain) as graph, live(domain, file) as process:
        stamps: dict[str, list[int]] = {"ml/height": [], "tracked/height": []}
        node = graph.add(_listener(graph, stamps, "/lidar"))
        begin(graph, node)
        book = AccountBook()
        graph.add(Watcher(book, context=graph.context))
        started = Program(process, graph, folder, stamps, request.param, book)
        started.wait_for(lambda: len(book.entries) == len(NODES))  # from now on the program counts their processes
        started.await_new("tracked/height")
        yield started


def _listener(graph: Graph, stamps: dict[str, list[int]], namespace: str) -> Node:
    node = Node("listener", context=graph.context)

    def keeper(topic: str) -> Callable[[HeightImage], None]:
        def keep(message: HeightImage) -> None:
            stamps[topic].append(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)

        return keep

    for topic in stamps:
        subscribe(node, HeightImage, f"{namespace}/{topic}", keeper(topic), FRAMES_QOS)
    return node


def begin(graph: Graph, node: Node) -> None:
    """Have the sensor deliver: a node that has just been started may not take the first call."""
    client = node.create_client(Trigger, "/lidar/paced_player/start")
    answers: list[Any] = []

    def begun() -> bool:
        return any(answer.done() and answer.result().success for answer in answers)

    for _ in range(60):
        if client.service_is_ready():
            answers.append(client.call_async(Trigger.Request()))
        if graph.spin_until(begun, 1.0):
            return
    raise AssertionError("the sensor does not begin")


def test_a_process_that_is_killed_works_again_beside_the_others(program: Program) -> None:
    for name in PROCESSES[program.mode]:
        others = {other: program.node(other) for other in PROCESSES[program.mode] if other != name}
        program.await_new("tracked/height")
        killed = program.kill(name)
        program.wait_for(lambda name=name, killed=killed: program.node(name) not in (0, killed))
        again = program.node(name)
        program.await_new("tracked/height", 2)
        program.await_new("ml/height", 2)
        recorded = program.recorded
        program.wait_for(lambda recorded=recorded: program.recorded > recorded)
        assert program.node(name) == again
        assert {other: program.node(other) for other in others} == others


def test_a_sensor_that_is_started_anew_is_followed(program: Program) -> None:
    """Its dwells are numbered from 0 again, and stamped later."""
    last = max(program.stamps["tracked/height"])
    killed = program.kill("paced_player")
    program.wait_for(lambda: program.node("paced_player") not in (0, killed))
    begin(program.graph, program.graph.nodes[0])
    program.await_new("tracked/height", 3)
    assert min(program.stamps["tracked/height"][-2:]) > last


def test_at_the_end_files_are_whole_and_restarts_are_told(program: Program) -> None:
    """It comes last: it ends the program. Each bag holds what its recorder was there for, and the map its heights.

    Lists of processes show the nodes by their names, also those that were started again.
    """
    never = threading.Event()
    program.await_new("ml/height")
    never.wait(1.2)  # the recorder hands what it has to the system within a second
    mapper = program.book.entries["lidar/relief_mapper"]
    before = mapper.account.processed
    names = {Path(f"/proc/{pid}/comm").read_text().strip() for pid in children(program.process.pid)}
    assert names == {name[:15] for name in (*PROCESSES[program.mode], "paced_player")}
    program.wait_for(lambda: mapper.account.processed > before)
    program.process.send_signal(signal.SIGINT)
    said, errors = program.process.communicate(timeout=DEADLINE_S)
    assert program.process.returncode == 0, errors
    for name, called in {**PROCESSES[program.mode], "paced_player": ""}.items():
        assert f"{called or f'Node {name}'} ended by SIGKILL; it is started again in 0.5 s." in errors
    for name in NODES:
        assert f"\n{name} was started 2 times." in said
    assert "Traceback" not in errors
    recorded = BagReader(program.folder / "bag_2")
    assert sum(1 for _ in recorded.messages(["/lidar/ml/height"])) > 0
    assert (program.folder / "map.tif").is_file()


@pytest.mark.thorough
def test_a_played_sensor_begins_anew_after_its_node_was_killed(recorded: Path, tmp_path: Path) -> None:
    """`live` asks it to, and says in the report how many processes each node has had."""
    heights = tmp_path / "out" / "run" / "bag" / "bag_0.mcap"
    words = ["--bag", recorded / "bag", "--rate", 0.05, "--out", tmp_path / "out"]
    with free_domain() as domain, Graph(domain) as graph, live(domain, *words) as process:
        stamps: dict[str, list[int]] = {"tracked/height": []}
        graph.add(_listener(graph, stamps, ""))
        running = Program(process, graph, tmp_path, stamps)
        running.await_new("tracked/height", 2)
        running.kill("paced_player")
        running.wait_for(lambda: running.node("paced_player") == 0)
        running.wait_for(lambda: running.node("paced_player") != 0)
        running.await_new("tracked/height", 3)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 0, errors
    assert heights.is_file()
    report = json.loads((tmp_path / "out" / "run" / "report.json").read_text())
    processes = {name: node["processes"] for name, node in report["nodes"].items()}
    assert processes.pop("paced_player") == 2
    assert set(processes.values()) == {1}
    assert report["heights"]["tracked/height"] >= 5


@pytest.mark.thorough
def test_a_node_that_is_killed_before_it_has_come_up_is_started_again(tmp_path: Path) -> None:
    file = tmp_path / "flight.yaml"
    file.write_text("{separate: true, nodes: {ml_height: , monopulse: }}")
    with free_domain() as domain, Graph(domain) as graph, live(domain, file) as process:
        node = graph.add(Node("watcher", context=graph.context))
        program = Program(process, graph, tmp_path, {})
        program.wait_for(lambda: program.node("ml_height") != 0)
        program.kill("ml_height")
        program.wait_for(lambda: program.node("ml_height") == 0)
        program.wait_for(lambda: ("ml_height", "/") in node.get_node_names_and_namespaces())
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 1, errors
    assert "Node ml_height ended by SIGKILL; it is started again in 0.5 s." in errors
    assert "No node has processed or recorded anything; the table says what each waits for." in errors


def test_a_node_that_refuses_its_parameters_is_not_started_again(tmp_path: Path) -> None:
    file = tmp_path / "flight.yaml"
    file.write_text("nodes: {ml_height: {parameters: {range_looks: -3}}, monopulse: }")
    with free_domain() as domain, live(domain, file) as process:
        _, errors = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 2
    assert "started again" not in errors
    assert "range_looks" in errors
