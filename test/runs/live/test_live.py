"""The graph beside a sensor that does not wait for it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from helpers import few

from sal_height.bag.reader import BagReader
from sal_height.engine.dwells import DwellStage
from sal_height.engine.registry import STAGES
from sal_height.errors import UserError
from sal_height.graph.node_classes import NODES
from sal_height.graph.plan import Execution
from sal_height.runs.live.live import (
    Beginning,
    DwellClock,
    Live,
    Watched,
    core_rate_hz,
    live,
    make_tables,
    warn_of_overload,
)
from sal_height.runs.live.sensor_bag import Feed, record_sensor
from sal_height.runs.replay.bag_replay import replay
from sal_height.simulation import load_preset
from sal_height.simulation.preset import Passes

DWELLS = 3
DEADLINE_S = 600.0


@pytest.fixture(scope="module")
def sensor_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    preset = replace(load_preset("small"), dwells=DWELLS)
    return record_sensor(preset, 1, tmp_path_factory.mktemp("sensor") / "bag")


def heights_of(bag: Path) -> list[tuple[int, str]]:
    """Number of the dwell and values of every height image of `ml`, to the last digit."""
    reader = BagReader(bag)
    images = [reader.decode(m.type_name, m.cdr) for m in reader.messages(["/ml/height"])]
    return [(image.dwell, repr(image.surfaces)) for image in images]


def test_heights_of_a_live_sensor_are_those_of_the_lockstep_run(sensor_bag: Path, tmp_path: Path) -> None:
    """Twenty times slower than the sensor, so that none is left out on a loaded machine; the bag is played anew."""
    seen: list[float] = []
    how = Live(rate=0.05, seconds=3.0, budget_s=30.0)

    def show(watched: Watched) -> None:
        seen.append(watched.elapsed_s)

    watched = live(Feed.of_bag(sensor_bag), tmp_path / "live", {}, how, Execution(), show)
    replay(sensor_bag, tmp_path / "replay", {}, estimators=["ml"], jobs=1)
    lockstep = dict(heights_of(tmp_path / "replay" / "bag"))
    made = heights_of(tmp_path / "live" / "bag")
    assert len(made) > DWELLS
    assert all(values == lockstep[dwell] for dwell, values in made)
    assert [dwell for dwell, _ in made] == [number % DWELLS for number in range(len(made))]
    assert watched.heights
    assert not any(account.dropped for account in watched.accounts.values())
    assert len(seen) >= 3
    report = json.loads((tmp_path / "live" / "report.json").read_text())
    assert report["heights"]["ml/height"] == len(watched.latencies_s["ml/height"])
    assert report["latency_s"]["ml/height"]["p50"] > 0
    assert list(report["start_s"]) == ["tables", "dwells", "ready", "first height"]
    assert 0 < report["start_s"]["tables"] < report["start_s"]["dwells"] < report["start_s"]["ready"]
    assert 0.05 < report["start_s"]["first height"] - report["start_s"]["ready"] < 3.0  # a dwell lasts .2 s


def test_nodes_of_a_live_run_have_nothing_left_to_rehearse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Their settings differ from those that tables are made for by latency budgets alone."""
    sensor, stages = load_preset("small").make_sensor(), ["sar_compression", "ml_height", "relief_tracker"]
    make_tables(sensor, stages, {})
    again: list[object] = []
    for work in ("compression.rehearsed_slc", "heights.rehearse_heights"):
        monkeypatch.setattr(f"sal_height.engine.{work}", lambda *given: again.append(given))
    for name in stages[:2]:
        settings = NODES[name].parameters(latency_budget_s=7.0)
        stage = STAGES[name](settings)
        assert isinstance(stage, DwellStage)
        stage.rehearse_for(sensor, settings)
    assert not again


@pytest.mark.parametrize("broken", ["ml_height", "relief_tracker"])
def test_it_is_left_to_a_node_to_say_why_it_cannot_start(broken: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise UserError("Settings contradict each other.")

    monkeypatch.setattr(STAGES[broken], "__init__", refuse)
    make_tables(load_preset("small").make_sensor(), ["ml_height", "relief_tracker"], {})


def test_adjusted_heights_of_a_preset_are_made_if_asked_for(tmp_path: Path) -> None:
    asked = replace(load_preset("small"), dwells=1, estimators=("ml", "adjusted"))
    assert Feed.simulated(asked, 1, tmp_path / "sensor").nodes == ["ml_height", "height_adjuster"]


@pytest.mark.thorough
def test_adjusted_heights_are_made_live_if_asked_for(sensor_bag: Path, tmp_path: Path) -> None:
    """Of a bag, which holds none: one of every dwell, and the map is made of them."""

    def end_once_both_are_seen(watched: Watched) -> None:
        if min(len(values) for values in watched.latencies_s.values()) >= DWELLS:
            raise KeyboardInterrupt

    feed = Feed.of_bag(sensor_bag, ("ml", "adjusted"))
    how = Live(rate=0.05, seconds=DEADLINE_S, budget_s=30.0)
    watched = live(feed, tmp_path / "live", {}, how, Execution(), end_once_both_are_seen)
    assert watched.elapsed_s < DEADLINE_S
    assert list(watched.latencies_s) == ["ml/height", "adjusted/height", "tracked/height"]
    assert not any(account.dropped for account in watched.accounts.values())
    parameters = json.loads((tmp_path / "live" / "report.json").read_text())["parameters"]
    assert parameters["relief_mapper"]["estimator"] == "adjusted"


def test_at_overload_whole_dwells_are_left_out_and_the_others_come_in_time(sensor_bag: Path, tmp_path: Path) -> None:
    """A compression that takes more time than there is: every frame that came is accounted for."""
    slow = {"sar_compression": {"rows": 200, "cols": 30, "former": "backprojection"}}

    def end_once_both_are_seen(watched: Watched) -> None:
        account = watched.accounts["sar_compression"]
        if account.dropped and account.processed > 0:
            raise KeyboardInterrupt

    watched = live(
        Feed.of_bag(sensor_bag), tmp_path / "live", slow, Live(1.0, DEADLINE_S), Execution(), end_once_both_are_seen
    )
    account = watched.accounts["sar_compression"]
    assert watched.elapsed_s < DEADLINE_S
    assert set(account.dropped) <= {"overload", "queue full", "buffer full"}
    assert account.received == account.processed + sum(account.dropped.values()) + account.waiting
    assert account.processed > 0


def test_the_speed_of_passes_is_tested_too(tmp_path: Path) -> None:
    """Between passes odometry tells nothing of the turn."""
    preset = load_preset("small")
    passes = replace(preset, dwells=4, flight=replace(preset.flight, passes=Passes(2, 60.0)))
    feed = Feed.of_bag(record_sensor(passes, 1, tmp_path / "bag"))
    assert 0.5 < core_rate_hz(feed.playlist(), feed.sensor, ["sar_compression", "ml_height"], feed.parameters, 1) < 1e4


def test_a_machine_that_is_too_slow_is_said_to_be(sensor_bag: Path, caplog: pytest.LogCaptureFixture) -> None:
    feed = Feed.of_bag(sensor_bag)
    stages = ["sar_compression", "monopulse", "ml_height", "relief_tracker"]
    one, two = (core_rate_hz(feed.playlist(), feed.sensor, stages, feed.parameters, number) for number in (1, 2))
    assert 0.5 < one < 1e4
    assert two / one == pytest.approx(2.0, rel=0.9)
    warn_of_overload(86.0, 85.9, 2)
    assert not caplog.records
    warn_of_overload(40.0, 86.0, 2)
    assert "can process at most 40 dwells/s, and the sensor delivers 86" in caplog.text


PRELUDE = """
import os, signal, sys
from dataclasses import replace
from pathlib import Path
from sal_height.workers.processes import use_one_thread
use_one_thread()
from sal_height.bag.reader import BagReader
from sal_height.errors import UserError
from sal_height.runs.live import sensor_bag
from sal_height.runs.live.sensor_bag import Feed, record_sensor
from sal_height.simulation import load_preset
preset = replace(load_preset("small"), dwells=2)
def feed(name="bag"):
    return Feed.simulated(preset, 1, Path(sys.argv[1]) / name)
"""


def program(code: str, folder: Path) -> subprocess.Popen[str]:
    """A program that simulates a sensor in a process of its own, which no test can: it has threads."""
    command = [sys.executable, "-c", PRELUDE + code, str(folder)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)  # noqa: S603


def test_a_sensor_that_is_simulated_meanwhile_is_known_as_its_bag_is_and_its_failure_is_told(
    tmp_path: Path,
) -> None:
    code = """
made = feed()
assert made.simulation is not None
playlist = made.playlist()
read = Feed.of_bag(made.bag)
assert (made.nodes, made.parameters, made.custom_data) == (read.nodes, read.parameters, read.custom_data)
assert repr(made.sensor) == repr(read.sensor)
print(playlist.dwells, flush=True)
def fail(*_):
    raise UserError("The disk is full.")
def die(*_):
    os.kill(os.getpid(), signal.SIGKILL)
for sensor_bag.record_sensor in (fail, die):
    try:
        feed(sensor_bag.record_sensor.__name__).playlist()
    except UserError as error:
        print(error, flush=True)
"""
    said, errors = program(code, tmp_path).communicate(timeout=DEADLINE_S)
    ended = [f"The simulation of the sensor ended with status {status}; its message is above." for status in (2, -9)]
    assert said.splitlines() == ["2", *ended], errors
    assert errors.endswith("\nThe disk is full.\n")


@pytest.mark.parametrize("number", few(1, [signal.SIGKILL, signal.SIGTERM, signal.SIGINT]))
def test_a_simulation_ends_with_its_program(number: signal.Signals, tmp_path: Path) -> None:
    """The end of its output says that both have ended: it is open as long as one of them lives."""
    code = """
def last(*_):
    print("simulating", flush=True)
    while True:
        signal.pause()
sensor_bag.record_sensor = last
feed().playlist()
"""
    running = program(code, tmp_path)
    assert running.stdout is not None
    assert running.stdout.readline() == "simulating\n"
    os.kill(running.pid, number)
    said, _ = running.communicate(timeout=DEADLINE_S)
    assert said == ""
    assert running.returncode == -number


def test_an_interrupt_at_the_begin_of_a_simulation_is_not_lost(tmp_path: Path) -> None:
    """It comes while Python runs its hooks of a fork, which lose what a handler raises."""
    code = """
def last(*_):
    while True:
        signal.pause()
sensor_bag.record_sensor = last
os.register_at_fork(after_in_parent=lambda: os.kill(os.getpid(), signal.SIGINT))
feed().playlist()
"""
    running = program(code, tmp_path)
    running.communicate(timeout=DEADLINE_S)
    assert running.returncode == -signal.SIGINT


def test_a_flight_beside_its_scene_is_refused_before_it_is_simulated(tmp_path: Path) -> None:
    beside = replace(load_preset("small"), dwells=1_000_000)
    with pytest.raises(UserError, match="terrain"):
        Feed.simulated(beside, 1, tmp_path / "bag")
    assert not list(tmp_path.iterdir())


class Asked:
    """A conductor of which a sensor is asked to start; it answers at once, if at all.

    Attributes:
        answers: results to come, one for each question; None: no answer.
        questions: number of times that it was asked.
    """

    def __init__(self, *answers: tuple[bool, str] | None) -> None:
        self.answers, self.questions = list(answers), 0

    def ask(self) -> SimpleNamespace:
        answer = self.answers[self.questions]
        self.questions += 1
        result = answer and SimpleNamespace(success=answer[0], message=answer[1])
        return SimpleNamespace(done=lambda: result is not None, result=lambda: result)


def test_a_sensor_is_asked_to_start_until_it_does_and_again_after_its_node_was_restarted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Once a second: it is absent at first, then not ready. The clock begins as it answers."""
    now_s = [0.0]
    monkeypatch.setattr("sal_height.runs.live.live.time", SimpleNamespace(monotonic=lambda: now_s[0]))
    asked, clock = Asked(None, (False, "not ready"), (True, "1234"), (True, "5678")), DwellClock(1.0, 0.0)
    beginning = Beginning(asked, clock)  # type: ignore[arg-type]

    def at(seconds: float) -> tuple[bool, int, int]:
        now_s[0] = seconds
        return beginning.has_begun(), asked.questions, clock.begin_ns

    found = [at(seconds) for seconds in (100.0, 100.5, 101.1, 102.2, 102.3, 110.0)]
    assert found == [(False, 1, 0), (False, 1, 0), (False, 2, 0), (False, 3, 0), (True, 3, 1234), (True, 3, 1234)]
    beginning.forget()
    assert at(110.1) == (False, 4, 1234)
    assert at(110.2) == (True, 4, 5678)
