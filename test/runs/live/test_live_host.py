"""The live host: nodes that share a process and workers are nodes as any others, and outlive their workers."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from helpers import few
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.node import Node

from sal_height.bag.compare import EQUAL
from sal_height.bag.reader import BagReader
from sal_height.messages.codec import deserialize
from sal_height.messages.parameters import stages_of
from sal_height.messages.types import ComplexImage, DwellLoss, HeightImage
from sal_height.nodes.parameters import parameter_of
from sal_height.nodes.transport.domain import free_domain
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.message_types import subscribe
from sal_height.nodes.transport.qos import FRAMES_QOS
from sal_height.runs.replay.bag_replay import replay

DEADLINE_S = 300.0


@dataclass
class Seen:
    """What a client of the graph has received."""

    heights: dict[str, list[HeightImage]] = field(default_factory=lambda: {"ml": [], "monopulse": [], "tracked": []})
    images: list[ComplexImage] = field(default_factory=list)
    losses: list[DwellLoss] = field(default_factory=list)


@dataclass
class Flight:
    """A live graph in processes of its own, and a client."""

    program: subprocess.Popen[str]
    out: Path
    graph: Graph
    node: Node
    seen: Seen

    def until(self, condition: Any) -> float:
        """Spin until something is so; the time that it took, s."""
        began = time.monotonic()
        assert self.graph.spin_until(condition, DEADLINE_S)
        return time.monotonic() - began

    def more(self, product: str, count: int = 3) -> float:
        """Wait for further heights; the time that it took, s."""
        wanted = len(self.seen.heights[product]) + count
        return self.until(lambda: len(self.seen.heights[product]) >= wanted)

    def ask(self, kind: type[Any], service: str, request: Any) -> Any:
        """The answer of a service."""
        client = self.node.create_client(kind, service)
        assert client.wait_for_service(DEADLINE_S)
        answer = client.call_async(request)
        self.until(answer.done)
        self.node.destroy_client(client)
        return answer.result()

    def min_channels(self, product: str) -> Any:
        """The parameter with which the last heights were made, as these state it."""
        parameters = stages_of(self.seen.heights[product][-1].provenance.parameters)
        return parameters[{"ml": "ml_height"}.get(product, product)]["min_channels"]

    def workers(self) -> dict[int, str]:
        """Names of the worker processes, by number."""
        return {number: name for number, name in self.processes().items() if name.startswith("worker ")}

    def processes(self) -> dict[int, str]:
        """Names of the processes of the graph, by number."""
        found = {}
        for folder in Path("/proc").glob("[0-9]*"):
            try:
                name, parent = (folder / "comm").read_text().strip(), (folder / "stat").read_text()
                environment = (folder / "environ").read_bytes()
            except OSError:
                continue
            mine = f"ROS_DOMAIN_ID={self.node.context.get_domain_id()}\0".encode() in environment
            if mine and parent.rpartition(") ")[2][0] != "Z":
                found[int(folder.name)] = name
        return found


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Flight]:
    """A slow sensor beside the graph, so that no dwell is left out on a loaded machine."""
    out = tmp_path_factory.mktemp("flight") / "out"
    with free_domain() as domain, Graph(domain) as graph:
        words = ["live", "--preset", "small", "--dwells", "4", "--rate", "0.08", "--budget", "60", "--join"]
        environment = os.environ | {"ROS_DOMAIN_ID": str(domain)}
        with subprocess.Popen(  # noqa: S603 (our own program)
            [sys.executable, "-m", "sal_height", *words, "--record", "phase_history", "--out", str(out)],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        ) as program:
            node, seen = graph.add(Node("client", context=graph.context)), Seen()
            for product, heights in seen.heights.items():
                subscribe(
                    node, HeightImage, f"{product}/height", lambda m, heights=heights: heights.append(m), FRAMES_QOS
                )
            subscribe(node, DwellLoss, "losses", seen.losses.append, FRAMES_QOS)
            flight = Flight(program, out, graph, node, seen)
            for product in seen.heights:
                flight.more(product)
            yield flight
            program.kill()


@pytest.fixture(scope="module")
def parameter_set(flight: Flight) -> None:
    """`ml_height` makes heights with a parameter that was set in flight."""
    request = SetParametersAtomically.Request(parameters=[parameter_of("min_channels", 3).to_parameter_msg()])
    answer = flight.ask(SetParametersAtomically, "ml_height/set_parameters_atomically", request)
    assert answer.result.successful, answer.result.reason
    flight.until(lambda: flight.min_channels("ml") == 3)


@pytest.fixture(scope="module")
def made_inactive(flight: Flight) -> int:
    """Number of heights that monopulse has made while it was inactive; it is active again."""
    made = 0
    for transition in (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_ACTIVATE):
        request = ChangeState.Request(transition=Transition(id=transition))
        assert flight.ask(ChangeState, "monopulse/change_state", request).success
        if transition == Transition.TRANSITION_DEACTIVATE:
            flight.more("ml")
            before = len(flight.seen.heights["monopulse"])
            flight.more("ml", 4)
            made = len(flight.seen.heights["monopulse"]) - before
    flight.more("monopulse")
    return made


@pytest.fixture(scope="module")
def killed(flight: Flight) -> tuple[int, float]:
    """The worker that was killed, whose place another has taken, and the time until the next two heights, s."""
    before = flight.workers()
    assert len(before) >= 1
    worker = min(before)
    flight.more("ml", 1)
    os.kill(worker, signal.SIGKILL)
    seconds = flight.more("ml", 2)
    flight.until(lambda: sorted(flight.workers().values()) == sorted(before.values()))
    return worker, seconds


@pytest.fixture(scope="module")
def recording(
    flight: Flight,
    parameter_set: None,  # noqa: ARG001
    made_inactive: int,  # noqa: ARG001
    killed: tuple[int, float],  # noqa: ARG001
) -> Path:
    """Folder of the record of the flight, with all that happened in it; it has ended."""
    flight.program.send_signal(signal.SIGINT)
    said, _ = flight.program.communicate(timeout=DEADLINE_S)
    assert flight.program.returncode == 0, said
    assert "Traceback" not in said
    return flight.out / "run"


def test_dwells_go_through_all_nodes_and_none_is_lost(flight: Flight) -> None:
    dwells = [image.dwell for image in flight.seen.heights["ml"]]
    assert dwells == [(dwells[0] + number) % 4 for number in range(len(dwells))]
    assert not flight.seen.losses


def test_the_graph_has_all_nodes_each_with_its_services(flight: Flight) -> None:
    wanted = {"sar_compression", "ml_height", "monopulse", "relief_tracker", "relief_mapper", "recorder"}
    flight.until(lambda: wanted <= set(flight.node.get_node_names()))
    services = {name for name, _ in flight.node.get_service_names_and_types()}
    assert {f"/{node}/change_state" for node in wanted - {"recorder"}} <= services


@pytest.mark.skipif(not hasattr(os, "SCHED_BATCH"), reason="this system has no such scheduling")
def test_no_thread_that_a_message_wakes_takes_the_processor_from_the_one_that_publishes(flight: Flight) -> None:
    threads = [task for number in flight.processes() for task in Path(f"/proc/{number}/task").iterdir()]
    receivers = [task for task in threads if (task / "comm").read_text().startswith("dds.shm")]
    assert len({task.parent for task in receivers}) >= 4  # host, player, recorder, and the program that watches
    assert {os.sched_getscheduler(int(task.name)) for task in receivers} == {os.SCHED_BATCH}
    assert {os.sched_getscheduler(number) for number in flight.workers()} == {os.SCHED_BATCH}


def test_images_are_published_to_whoever_subscribes_in_flight(flight: Flight) -> None:
    assert flight.node.count_publishers("slc") == 1
    subscription = subscribe(flight.node, ComplexImage, "slc", flight.seen.images.append, FRAMES_QOS)
    flight.until(lambda: len(flight.seen.images) >= 16)
    assert len({image.channel for image in flight.seen.images[:8]}) == 8
    flight.node.destroy_subscription(subscription)


@pytest.mark.usefixtures("parameter_set")
def test_parameters_of_a_node_can_be_set_in_flight(flight: Flight) -> None:
    assert flight.min_channels("ml") == 3
    assert flight.min_channels("monopulse") == 2


def test_an_inactive_estimator_makes_no_heights_and_the_others_go_on(flight: Flight, made_inactive: int) -> None:
    assert made_inactive == 0
    assert {(loss.node, loss.reason) for loss in flight.seen.losses} == {("monopulse", "inactive")}


def test_a_worker_that_is_killed_costs_its_dwells_and_heights_go_on(flight: Flight, killed: tuple[int, float]) -> None:
    worker, seconds = killed
    assert seconds < 3 + 2 * 0.5  # two dwells last a part of a second each
    assert worker not in flight.workers()
    assert {loss.reason for loss in flight.seen.losses} <= {"inactive", "worker ended"}


def test_the_recorded_heights_are_those_of_the_dwells_and_the_accounts_balance(recording: Path) -> None:
    """After the tests of the flight, which has ended."""
    report = json.loads((recording / "report.json").read_text())
    for name in ("sar_compression", "ml_height", "monopulse", "relief_tracker"):
        counts = report["nodes"][name]
        lost = sum(number for key, number in counts.items() if key.startswith("dropped."))
        assert counts["in"] == counts["processed"] + lost + counts["waiting"], name
    bag = BagReader(recording / "bag")
    heights = [deserialize(m.cdr, HeightImage) for m in bag.messages(["/ml/height"])]
    assert len(heights) > 10
    assert {stages_of(image.provenance.parameters)["ml_height"]["min_channels"] for image in heights} == {2, 3}


@pytest.mark.parametrize("jobs", few(1, [1, None]))
def test_the_flight_is_replayed_as_it_was(recording: Path, jobs: int | None, tmp_path: Path) -> None:
    """With the parameter that was set, the node that was inactive, and the worker that was killed."""
    result = replay(recording / "bag", tmp_path / "out", {}, jobs=jobs)
    assert {topic: one.verdict for topic, one in result.compared.items()} == dict.fromkeys(
        ("/ml/height", "/monopulse/height", "/tracked/height"), EQUAL
    )
    assert result.compared["/tracked/height"].matched > 10
    assert result.shortfalls(changed=False) == []
