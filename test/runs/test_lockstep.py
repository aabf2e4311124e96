"""A run step by step: what it waits for, what it does not wait for, and whom it does not play beside."""

from __future__ import annotations

import dataclasses
import errno
import json
import os
import signal
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from helpers import few, publisher_of
from rclpy.node import Node

from sal_height.bag.writer import BagWriter
from sal_height.engine.heights import HeightStage
from sal_height.engine.registry import STAGES
from sal_height.engine.results import Result
from sal_height.engine.stage import Job
from sal_height.errors import UserError
from sal_height.graph import lockstep
from sal_height.graph.lockstep import Lockstep
from sal_height.graph.plan import Execution, Outcome, Plan
from sal_height.messages.types import ChannelFrame, Odometry, SensorInfo
from sal_height.nodes.accounts.account import Account
from sal_height.nodes.simulator import Simulator
from sal_height.nodes.transport.graph import Graph
from sal_height.runs.truth.simulate import fly, run
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


class Counted:
    """A node of which nothing but its counts is there, which tests change."""

    def __init__(self, publishes: Sequence[str] = (), takes: Sequence[str] = ()) -> None:
        self.outlets = [SimpleNamespace(topic=f"/{topic}", published=0) for topic in publishes]
        self.inlets = [SimpleNamespace(topic=f"/{topic}", received=0, missed=0) for topic in takes]
        self.jobs = 0
        self.recorded: dict[str, int] = {}
        self.missed_of: dict[str, int] = {}
        self.told: dict[str, Any] = {}

    def account(self) -> Account:
        missed = {inlet.topic.lstrip("/"): inlet.missed for inlet in self.inlets} | self.missed_of
        return Account(
            received=sum(inlet.received for inlet in self.inlets) or sum(self.recorded.values()),
            missed={topic: count for topic, count in missed.items() if count},
            **self.told,
        )

    def missed(self, topic: str) -> int:
        return self.missed_of.get(topic.lstrip("/"), 0)

    def write_received(self) -> None:
        """All that was received is written."""

    def receive_polled(self) -> None:
        """All that has arrived is received."""

    def announced(self) -> Mapping[str, int]:
        return {}

    def state_calibrations(self, applied_from: Mapping[str, Any]) -> None:
        """There are none."""

    def published(self, topic: str, count: int) -> None:
        (outlet,) = [one for one in self.outlets if one.topic == f"/{topic}"]
        outlet.published = count

    def received(self, topic: str, count: int, missed: int = 0) -> None:
        (inlet,) = [one for one in self.inlets if one.topic == f"/{topic}"]
        inlet.received, inlet.missed = count, missed


def run_of(source: str, recorded: Sequence[str], **nodes: Counted) -> Lockstep:
    """A run of these nodes that has begun."""
    stages = [name for name in nodes if name not in (source, "recorder")]
    plan = Plan(source, stages, list(recorded), Path("bag"), {}, 1)
    found = Lockstep(plan, SimpleNamespace(graph=None, nodes=nodes))  # type: ignore[arg-type]
    found.begin()
    return found


def test_a_dwell_is_settled_when_its_heights_are_in_the_map() -> None:
    simulator = Counted(["phase_history", "platform/odometry"])
    compression = Counted(["slc"], ["phase_history", "platform/odometry"])
    monopulse, ml = Counted(["monopulse/height"], ["slc"]), Counted(["ml/height"], ["slc"])
    mapper, recorder = Counted(takes=["monopulse/height"]), Counted()
    run = run_of(
        "simulator",
        ["monopulse/height"],
        simulator=simulator,
        sar_compression=compression,
        monopulse=monopulse,
        ml_height=ml,
        relief_mapper=mapper,
        recorder=recorder,
    )
    assert run.is_settled()
    for happens, follows in (
        (lambda: setattr(simulator, "jobs", 1), lambda: setattr(simulator, "jobs", 0)),
        (lambda: simulator.published("platform/odometry", 9), lambda: compression.received("platform/odometry", 9)),
        (lambda: simulator.published("phase_history", 8), lambda: compression.received("phase_history", 8)),
        (lambda: setattr(compression, "jobs", 1), lambda: setattr(compression, "jobs", 0)),
        (
            lambda: compression.published("slc", 8),
            lambda: (monopulse.received("slc", 8), ml.received("slc", 8)),
        ),
        (
            lambda: (monopulse.published("monopulse/height", 1), mapper.received("monopulse/height", 1)),
            lambda: recorder.recorded.update({"/monopulse/height": 1}),
        ),
        (lambda: monopulse.published("monopulse/height", 2), lambda: mapper.received("monopulse/height", 2)),
        (lambda: setattr(mapper, "jobs", 1), lambda: setattr(mapper, "jobs", 0)),
    ):
        happens()
        recorder.recorded.setdefault("/monopulse/height", 0)
        if mapper.inlets[0].received < monopulse.outlets[0].published:
            recorder.recorded["/monopulse/height"] = monopulse.outlets[0].published
        assert not run.is_settled()
        follows()
        assert run.is_settled()


def test_what_got_lost_on_the_way_is_not_waited_for_and_is_dropped_in_the_end() -> None:
    """As the numbers tell that publishers give their messages."""
    simulator = Counted(["phase_history", "sensor_info"])
    compression, recorder = Counted(["slc"], ["phase_history"]), Counted()
    run = run_of(
        "simulator",
        ["slc", "diagnostics", "sensor_info"],
        simulator=simulator,
        sar_compression=compression,
        recorder=recorder,
    )
    simulator.published("phase_history", 16)
    compression.published("slc", 8)
    compression.received("phase_history", 11, missed=4)
    recorder.recorded["/slc"], recorder.missed_of["slc"] = 6, 1
    recorder.missed_of["diagnostics"] = 5  # which is no loss
    assert not run.is_settled()
    compression.received("phase_history", 11, missed=5)
    assert not run.is_settled()
    recorder.missed_of["slc"] = 2
    assert run.is_settled()
    final = run.final_accounts()
    assert {name: (one.received, one.dropped) for name, one in final.items()} == {
        "simulator": (0, {}),
        "sar_compression": (16, {"lost on the way": 5}),
        "recorder": (8, {"lost on the way": 2}),
    }


def test_a_calibration_is_settled_when_all_have_it_and_is_no_dwell() -> None:
    """Then comes the dwell that it is applied to."""
    player = Counted(["phase_history", "calibration"])
    compression, monopulse = Counted(["slc"], ["phase_history", "calibration"]), Counted(takes=["slc", "calibration"])
    recorder = Counted()
    run = run_of(
        "player", ["calibration"], player=player, sar_compression=compression, monopulse=monopulse, recorder=recorder
    )
    player.told["dwells"] = 1
    player.published("calibration", 2)
    for takes in (
        lambda: compression.received("calibration", 2),
        lambda: monopulse.received("calibration", 2),
        lambda: recorder.recorded.update({"/calibration": 2}),
    ):
        assert not run.is_settled()
        takes()
    assert run.is_settled()
    assert run.played == 1


def test_a_dwell_is_not_settled_before_its_sensor_is_recorded() -> None:
    """A bag that does not say of which sensor it is cannot be replayed."""
    simulator, recorder = Counted(["sensor_info"]), Counted()
    run = run_of("simulator", ["sensor_info"], simulator=simulator, sar_compression=Counted(), recorder=recorder)
    simulator.published("sensor_info", 1)
    assert not run.is_settled()
    recorder.recorded["/sensor_info"] = 1
    assert run.is_settled()


def test_no_dwell_is_asked_for_before_all_nodes_know_the_sensor(
    two_dwells: Preset, tmp_path: Path, monkeypatch: Any
) -> None:
    """Otherwise a dwell may come long before the description of its sensor, and be dropped."""
    events = []
    rehearse, step = HeightStage.rehearse_for, Simulator.step

    def slow(self: HeightStage, sensor: Sensor, settings: Any) -> None:
        threading.Event().wait(1.0)
        rehearse(self, sensor, settings)
        events.append("rehearsed")

    def noted(self: Simulator) -> tuple[bool, str]:
        events.append("step")
        return step(self)

    monkeypatch.setattr(HeightStage, "rehearse_for", slow)
    monkeypatch.setattr(Simulator, "step", noted)
    fly(dataclasses.replace(two_dwells, dwells=1), SEED, tmp_path / "run", {})
    assert events == ["rehearsed", "rehearsed", "step", "step"]


def test_a_graph_in_which_nothing_moves_is_given_up(two_dwells: Preset, tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr(Lockstep, "is_settled", lambda _: False)
    with pytest.raises(
        UserError, match=r"No node has made progress for 1 s while waiting for what was played from dwell 0 on"
    ):
        run(two_dwells, SEED, tmp_path / "run", {}, Execution(timeout_s=1.0))


def test_a_dwell_may_take_longer_than_the_limit(two_dwells: Preset, tmp_path: Path, monkeypatch: Any) -> None:
    """A node that works all the time is waited for, here for twice the limit."""
    limit_s, took = 1.0, []
    process = HeightStage.process

    def slow(self: HeightStage, jobs: Sequence[Job]) -> Iterator[Sequence[Result]]:
        began = time.monotonic()
        while time.monotonic() < began + 2 * limit_s:
            threading.Event().wait(0.05)  # leaves the processor to the other nodes
        took.append(time.monotonic() - began)
        return process(self, jobs)

    monkeypatch.setattr(STAGES["monopulse"], "process", slow)
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


@pytest.mark.parametrize("name", few(1, ["preset.yaml", "report.json", "height.png"]))
def test_a_file_that_cannot_be_written_is_named(
    name: str, two_dwells: Preset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A folder of that name is in the way."""
    real = lockstep.perform

    def perform(*arguments: Any, **keywords: Any) -> Outcome:
        outcome = real(*arguments, **keywords)
        (tmp_path / "run" / name).mkdir()
        return outcome

    def new_folder(path: Path) -> Path:
        (path / name).mkdir(parents=True)
        return path

    if name == "preset.yaml":
        monkeypatch.setattr("sal_height.runs.truth.simulate.new_folder", new_folder)
    else:
        monkeypatch.setattr("sal_height.runs.truth.simulate.perform", perform)
    preset = dataclasses.replace(two_dwells, dwells=1)
    with pytest.raises(UserError, match=rf"{name} cannot be written: Is a directory\."):
        run(preset, SEED, tmp_path / "run", {})


@pytest.mark.parametrize("number", few(1, [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]))
def test_a_signal_ends_the_wait_for_a_step(
    number: signal.Signals, two_dwells: Preset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Which never ends by itself, for the source publishes nothing."""
    stepped = []

    def interrupted_step(self: Lockstep) -> bool:  # noqa: ARG001
        stepped.append(number)
        signal.raise_signal(number)
        return True

    monkeypatch.setattr(Lockstep, "step", interrupted_step)
    monkeypatch.setattr(Lockstep, "is_settled", lambda _: not stepped)
    outcome = run(two_dwells, SEED, tmp_path / "run", {}).outcome
    assert outcome.interrupted
    assert outcome.dwells == 0
    assert len(stepped) == 1


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


@pytest.mark.parametrize("moment", few(1, ["step", "is_ready"]))
def test_a_sensor_that_comes_later_is_refused(
    moment: str, graph: Graph, beside: Execution, long: Preset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As when two runs start together: neither sees the other at first."""
    original, publishers = getattr(Lockstep, moment), []

    def with_company(self: Lockstep, *arguments: Any) -> Any:
        if not publishers:
            node = graph.add(Node("other", context=graph.context))
            publishers.append(publisher_of(node, ChannelFrame, "phase_history", 1))
        return original(self, *arguments)

    monkeypatch.setattr(Lockstep, moment, with_company)
    with pytest.raises(UserError, match="another domain"):
        run(long, SEED, tmp_path / "run", {}, beside)
    assert "another domain" in json.loads((tmp_path / "run" / "report.json").read_text())["failed"]
