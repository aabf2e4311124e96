"""The conductor: whom it believes, what it does not wait for, and whom it does not play beside."""

from __future__ import annotations

import dataclasses
import errno
import json
import math
import os
import signal
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from helpers import publisher_of
from rclpy.node import Node

from sal_height.bag.writer import BagWriter
from sal_height.errors import UserError
from sal_height.messages.types import (
    ChannelFrame,
    DiagnosticArray,
    DiagnosticStatus,
    KeyValue,
    NodeAccount,
    Odometry,
    SensorInfo,
)
from sal_height.nodes.account import Account
from sal_height.nodes.graph import Graph
from sal_height.nodes.height import HEIGHT_NODES, HeightNode
from sal_height.nodes.simulator import Simulator
from sal_height.runs import conductor
from sal_height.runs.catalogue import NODES, NodeParameters
from sal_height.runs.conductor import Conductor, Execution, Plan
from sal_height.runs.ensemble import Ensemble
from sal_height.runs.simulate import fly, run
from sal_height.sensor import Sensor
from sal_height.simulation.flight import SimulatedFlight
from sal_height.simulation.preset import Preset

SEED = 3
INPUTS = {"phase_history": ChannelFrame, "sensor_info": SensorInfo, "platform/odometry": Odometry}


@pytest.fixture
def long(two_dwells: Preset) -> Preset:
    """More dwells than any test here plays."""
    return dataclasses.replace(two_dwells, dwells=90)


@pytest.fixture
def beside(domain_id: int) -> Execution:
    """A run in the domain of fixture `graph`, in which somebody else may be."""
    return Execution(domain=domain_id)


def plan_of(stages: list[str], parameters: NodeParameters | None = None, recorded: Sequence[str] = ()) -> Plan:
    return Plan("simulator", stages, list(recorded), Path("bag"), parameters or {}, 1)


def status(name: str, **values: object) -> DiagnosticStatus:
    return DiagnosticStatus(name=name, values=[KeyValue(key=key, value=str(value)) for key, value in values.items()])


def test_diagnostics_of_others_are_ignored(graph: Graph) -> None:
    watching = graph.add(Conductor(plan_of(["monopulse"]), context=graph.context))
    publisher = publisher_of(graph.add(Node("stages", context=graph.context)), DiagnosticArray, "/diagnostics", 10)
    assert graph.spin_until(lambda: publisher.get_subscription_count() == 1, 10)
    ours = [status("recorder", unwritten=0), status("simulator", **{"in": 1, "out": 8, "waiting": 0, "note": "slow"})]
    foreign = [
        status("recorder", state="recording"),
        status("simulator", state="ok", temperature=40),
        status("player", **{"in": 1, "out": 1, "waiting": 0}),
    ]
    end = status("monopulse", **{"in": 8, "out": 1, "waiting": 0, "latency_p50_ms": "nan"})
    publisher.publish(DiagnosticArray(status=[*ours, *foreign, end]))
    assert graph.spin_until(lambda: "monopulse" in watching.accounts, 10)
    assert {name: account.numbers for name, account in watching.accounts.items()} == {
        "recorder": {"unwritten": 0},
        "simulator": {"in": 1, "processed": 0, "out": 8, "waiting": 0, "jobs": 0, "ready": 0},
        "monopulse": {"in": 8, "processed": 0, "out": 1, "waiting": 0, "jobs": 0, "ready": 0},
    }


def test_accounts_of_others_are_ignored(graph: Graph) -> None:
    watching = graph.add(Conductor(plan_of(["monopulse"]), in_steps=True, context=graph.context))
    publisher = publisher_of(graph.add(Node("stages", context=graph.context)), NodeAccount, "/progress", 10)
    assert graph.spin_until(lambda: publisher.get_subscription_count() == 1, 10)
    for account in (
        NodeAccount(node="monopulse", ready=True, latency_p50_ms=math.nan),
        NodeAccount(node="player", received=1),
        NodeAccount(node="monopulse", received=8, ready=True, cpu_s=0.5, latency_p50_ms=math.nan),
        NodeAccount(node="recorder"),
    ):
        publisher.publish(account)
    assert graph.spin_until(lambda: "recorder" in watching.accounts, 10)
    assert watching.accounts.keys() == {"monopulse", "recorder"}
    known = watching.accounts["monopulse"]
    assert (known.received, known.ready, known.cpu_s) == (8, True, 0.5)


def test_a_dwell_is_settled_when_its_heights_are_in_the_map(graph: Graph) -> None:
    stages = ["sar_compression", "monopulse", "ml_height", "relief_mapper"]
    plan = plan_of(stages, {"relief_mapper": {"estimator": "monopulse"}}, recorded=["monopulse/height"])
    watching = graph.add(Conductor(plan, context=graph.context))

    def recorded(count: int) -> Account:
        return Account.of_numbers({"unwritten": 0, "recorded./monopulse/height": count})

    before = {
        "recorder": recorded(1),
        "simulator": Account.of_numbers(
            {"in": 0, "waiting": 0, "published./phase_history": 8, "published./platform/odometry": 9}
        ),
        "sar_compression": Account.of_numbers({"in": 8, "waiting": 0, "published./slc": 8}),
        "monopulse": Account.of_numbers({"in": 8, "waiting": 0, "published./monopulse/height": 1}),
        "ml_height": Account.of_numbers({"in": 8, "waiting": 0, "published./ml/height": 0}),
        "relief_mapper": Account.of_numbers({"in": 1, "waiting": 0}),
    }
    watching.accounts = before
    assert watching.settled()
    for name, changed in (
        ("relief_mapper", Account.of_numbers({"in": 0, "waiting": 0})),
        ("relief_mapper", Account.of_numbers({"in": 1, "waiting": 1})),
        ("relief_mapper", Account.of_numbers({"in": 2, "waiting": 0})),
        ("simulator", Account.of_numbers({"in": 1, "waiting": 0, "published./phase_history": 8})),
        ("simulator", Account.of_numbers({"in": 0, "waiting": 0, "published./phase_history": 16})),
        ("recorder", recorded(0)),
    ):
        watching.accounts = {**before, name: changed}
        assert not watching.settled(), (name, changed)


def test_what_got_lost_on_the_way_is_not_waited_for_and_is_dropped_in_the_end(graph: Graph) -> None:
    """As the numbers tell that publishers give their messages."""
    plan = plan_of(["sar_compression"], recorded=["slc", "diagnostics", "sensor_info"])
    watching = graph.add(Conductor(plan, context=graph.context))
    latched = {"recorded./sensor_info": 1, "missed./sensor_info": 1, "missed./diagnostics": 5}  # which is no loss
    watching.accounts = before = {
        "recorder": Account.of_numbers({"unwritten": 0, "recorded./slc": 6, "missed./slc": 2, **latched}),
        "simulator": Account.of_numbers({"in": 0, "waiting": 0, "published./phase_history": 16}),
        "sar_compression": Account.of_numbers(
            {"in": 11, "waiting": 0, "missed./phase_history": 5, "published./slc": 8}
        ),
    }
    assert watching.settled()
    for name, missed in (("recorder", "missed./slc"), ("sar_compression", "missed./phase_history")):
        watching.accounts = {**before, name: Account.of_numbers({**before[name].numbers, missed: 1})}
        assert not watching.settled(), name
    watching.accounts = before
    final = watching.final_accounts()
    assert {name: (one.received, one.dropped) for name, one in final.items()} == {
        "simulator": (0, {}),
        "sar_compression": (16, {"lost on the way": 5}),
        "recorder": (2, {"lost on the way": 2}),
    }


def test_a_calibration_is_settled_when_all_have_it_and_is_no_dwell(graph: Graph) -> None:
    """Then comes the dwell that it is applied to."""
    plan = Plan("player", ["sar_compression", "monopulse"], ["calibration"], Path("bag"), {}, 1)
    watching = graph.add(Conductor(plan, context=graph.context))
    watching._steps = 3
    watching.accounts = before = {
        "recorder": Account.of_numbers({"unwritten": 0, "recorded./calibration": 2}),
        "player": Account.of_numbers(
            {"in": 3, "waiting": 0, "published./phase_history": 8, "calibrations": 2, "dwells": 1}
        ),
        "sar_compression": Account.of_numbers({"in": 8, "waiting": 0, "published./slc": 8, "calibrations": 2}),
        "monopulse": Account.of_numbers({"in": 8, "waiting": 0, "calibrations": 3}),  # and one of another node's
    }
    assert watching.settled()
    assert watching.played == 1
    for name, key in (("recorder", "recorded./calibration"), ("sar_compression", "calibrations")):
        watching.accounts = {**before, name: Account.of_numbers({**before[name].numbers, key: 1})}
        assert not watching.settled(), name


def test_no_dwell_is_asked_for_before_all_nodes_know_the_sensor(
    two_dwells: Preset, tmp_path: Path, monkeypatch: Any
) -> None:
    """Otherwise a dwell may come long before the description of its sensor, and be dropped."""
    events = []
    rehearse, step = HeightNode.rehearse, Simulator._step

    def slow(self: HeightNode, sensor: Sensor) -> None:
        threading.Event().wait(1.0)
        rehearse(self, sensor)
        events.append("rehearsed")

    def noted(self: Simulator) -> tuple[bool, str]:
        events.append("step")
        return step(self)

    monkeypatch.setattr(HeightNode, "rehearse", slow)
    monkeypatch.setattr(Simulator, "_step", noted)
    fly(dataclasses.replace(two_dwells, dwells=1), SEED, tmp_path / "run", {})
    assert events == ["rehearsed", "rehearsed", "step", "step"]


def test_a_dwell_is_not_settled_before_its_sensor_is_recorded(graph: Graph) -> None:
    """A bag that does not say of which sensor it is cannot be replayed."""
    watching = graph.add(Conductor(plan_of(["sar_compression"], recorded=["sensor_info"]), context=graph.context))
    others = {"simulator": Account.of_numbers({"published./slc": 0}), "sar_compression": Account.of_numbers({})}
    for count in (0, 1):
        watching.accounts = {**others, "recorder": Account.of_numbers({"recorded./sensor_info": count})}
        assert watching.settled() == bool(count)


def test_a_graph_in_which_nothing_moves_is_given_up(two_dwells: Preset, tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr(Conductor, "settled", lambda _: False)
    with pytest.raises(
        UserError, match=r"No node has made progress for 1 s while waiting for what was played from dwell 0 on"
    ):
        run(two_dwells, SEED, tmp_path / "run", {}, Execution(timeout_s=1.0))


def test_a_dwell_may_take_longer_than_the_limit(two_dwells: Preset, tmp_path: Path, monkeypatch: Any) -> None:
    """A node that works all the time is waited for, here for twice the limit."""
    limit_s, took = 1.0, []
    process = HeightNode.process

    def slow(self: HeightNode, *arguments: Any) -> int:
        began = time.monotonic()
        while time.monotonic() < began + 2 * limit_s:
            threading.Event().wait(0.05)  # leaves the processor to the other nodes
        took.append(time.monotonic() - began)
        return process(self, *arguments)

    monkeypatch.setattr(HEIGHT_NODES["monopulse"], "process", slow)
    preset = dataclasses.replace(two_dwells, dwells=1)
    assert fly(preset, SEED, tmp_path / "run", {}, Execution(timeout_s=limit_s)).outcome.dwells == 1
    assert took[0] > limit_s


def test_a_source_that_fails_ends_the_run_with_its_own_sentence(
    two_dwells: Preset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    history = SimulatedFlight.phase_history

    def failing(self: SimulatedFlight, dwell: int) -> Any:
        if dwell:
            raise UserError("The flight has left the scene.")
        return history(self, dwell)

    monkeypatch.setattr(SimulatedFlight, "phase_history", failing)
    with pytest.raises(UserError, match=r"^The flight has left the scene\.$"):
        run(two_dwells, SEED, tmp_path / "run", {})
    report = json.loads((tmp_path / "run" / "report.json").read_text())
    assert report["dwells"] == 1
    assert report["stages"]["ml_height"]["out"] == 1


def test_a_full_disk_ends_the_run_at_once(long: Preset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(self: BagWriter, topic: str, *_: Any) -> None:  # noqa: ARG001
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(BagWriter, "write", refuse)
    with pytest.raises(UserError, match="could not be written to the bag"):
        run(long, SEED, tmp_path / "run", {})
    report = json.loads((tmp_path / "run" / "report.json").read_text())
    assert "could not be written" in report["failed"]
    assert "sar_compression" in report["stages"]


@pytest.mark.parametrize("name", ["preset.yaml", "report.json", "height.png"])
def test_a_file_that_cannot_be_written_is_named(
    name: str, two_dwells: Preset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A folder of that name is in the way."""
    real = conductor.perform

    def perform(*arguments: Any, **keywords: Any) -> conductor.Outcome:
        outcome = real(*arguments, **keywords)
        (tmp_path / "run" / name).mkdir()
        return outcome

    def new_folder(path: Path) -> Path:
        (path / name).mkdir(parents=True)
        return path

    if name == "preset.yaml":
        monkeypatch.setattr("sal_height.runs.simulate.new_folder", new_folder)
    else:
        monkeypatch.setattr("sal_height.runs.simulate.perform", perform)
    preset = dataclasses.replace(two_dwells, dwells=1)
    with pytest.raises(UserError, match=rf"{name} cannot be written: Is a directory\."):
        run(preset, SEED, tmp_path / "run", {})


class Mute(Simulator):
    """A simulator whose step service never answers, for nobody spins the node it is of."""

    def __init__(self, **node_arguments: Any) -> None:
        self.deaf = Node("deaf", context=node_arguments["context"])
        super().__init__(**node_arguments)

    def create_service(self, kind: Any, name: str, callback: Any, **keywords: Any) -> Any:
        deaf = name == "~/step"
        return (
            self.deaf.create_service(kind, "simulator/step", callback)
            if deaf
            else super().create_service(kind, name, callback, **keywords)
        )

    def destroy_node(self) -> None:
        self.deaf.destroy_node()
        super().destroy_node()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_the_wait_for_a_step(
    number: signal.Signals, two_dwells: Preset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    step = Conductor.step

    def interrupted_step(self: Conductor, wait: Any) -> bool:
        signal.raise_signal(number)
        return step(self, wait)

    monkeypatch.setitem(NODES, "simulator", Mute)
    monkeypatch.setattr(Conductor, "step", interrupted_step)
    outcome = run(two_dwells, SEED, tmp_path / "run", {}).outcome
    assert outcome.interrupted
    assert outcome.dwells == 0


def test_a_dead_node_ends_the_wait_for_a_step(
    two_dwells: Preset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    step, dead = Conductor.step, []

    def step_of_the_dead(self: Conductor, wait: Any) -> bool:
        dead.append("simulator")
        return step(self, wait)

    def check(self: Ensemble) -> None:  # noqa: ARG001
        if dead:
            raise UserError("Node simulator ended.")

    monkeypatch.setitem(NODES, "simulator", Mute)
    monkeypatch.setattr(Conductor, "step", step_of_the_dead)
    monkeypatch.setattr(Ensemble, "check", check)
    with pytest.raises(UserError, match="simulator ended"):
        run(two_dwells, SEED, tmp_path / "run", {})


@pytest.mark.parametrize("topic", INPUTS)
def test_a_publisher_of_any_input_is_refused(
    topic: str, graph: Graph, beside: Execution, two_dwells: Preset, tmp_path: Path
) -> None:
    publisher_of(graph.add(Node("other", context=graph.context)), INPUTS[topic], topic, 1)
    with pytest.raises(UserError, match=f"on /{topic} in this ROS domain; .* another domain"):
        run(two_dwells, SEED, tmp_path / "run", {}, beside)


def test_a_simulator_that_idles_is_refused(graph: Graph, beside: Execution, two_dwells: Preset, tmp_path: Path) -> None:
    graph.add(Simulator(context=graph.context))
    with pytest.raises(UserError, match="another domain"):
        run(two_dwells, SEED, tmp_path / "run", {}, beside)


@pytest.mark.parametrize("moment", ["connected", "step"])
def test_a_sensor_that_comes_later_is_refused(
    moment: str, graph: Graph, beside: Execution, long: Preset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As when two runs start together: neither sees the other at first."""
    original, publishers = getattr(Conductor, moment), []

    def with_company(self: Conductor, *arguments: Any) -> Any:
        if not publishers:
            node = graph.add(Node("other", context=graph.context))
            publishers.append(publisher_of(node, ChannelFrame, "phase_history", 1))
        return original(self, *arguments)

    monkeypatch.setattr(Conductor, moment, with_company)
    with pytest.raises(UserError, match="another domain"):
        run(long, SEED, tmp_path / "run", {}, beside)
    assert "another domain" in json.loads((tmp_path / "run" / "report.json").read_text())["failed"]
