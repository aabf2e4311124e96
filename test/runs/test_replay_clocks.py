"""Replays that do not wait for the graph: at the pace of the sensor, or as fast as it can be published."""

from __future__ import annotations

import dataclasses
import json
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
from helpers import assert_one_sentence

from sal_height.bag.compare import CHANGED
from sal_height.bag.played import DwellRange
from sal_height.bag.reader import ALWAYS, BagReader
from sal_height.bag.topics import stamp_ns_of
from sal_height.commands import main
from sal_height.engine.compression import Compression
from sal_height.engine.results import DwellKey, Result
from sal_height.engine.stage import Job
from sal_height.errors import UserError
from sal_height.graph.ensemble import members_of
from sal_height.graph.plan import DwellChanges, Execution, Plan
from sal_height.nodes.host import StageNode
from sal_height.runs.chain.entry import Part
from sal_height.runs.chain.replay_parameters import ReplayPlan
from sal_height.runs.replay.bag_replay import Playing, replay
from sal_height.runs.truth.simulate import fly
from sal_height.simulation.preset import Preset

HEIGHTS = {"/ml/height", "/monopulse/height", "/tracked/height"}
PACED, BURST = Playing("paced", 0.2), Playing("burst")

FRAMES = 160
"""Of ten passes through two dwells of eight channels; the middleware holds more."""


@pytest.mark.parametrize("playing", [Playing("paced", 4.0), BURST], ids=["paced", "burst"])
def test_heights_are_those_of_lockstep(playing: Playing, recorded: Path, tmp_path: Path) -> None:
    result = replay(recorded / "bag", tmp_path / "out", {}, playing=playing)
    assert result.shortfalls(changed=False) == []
    assert {topic: (one.matched, one.verdict == CHANGED) for topic, one in result.compared.items()} == dict.fromkeys(
        HEIGHTS, (2, False)
    )
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    rate = (playing.rate or 1.0) if playing.clock == "paced" else None
    assert (report["clock"], report["rate"], report["loops"], report["dwells"]) == (playing.clock, rate, 1, 2)
    assert report["estimators"].keys() == {"monopulse", "ml", "tracked"}
    assert report["stages"]["sar_compression"]["in"] == report["stages"]["sar_compression"]["processed"] == 16


def test_a_paced_replay_takes_the_time_of_the_sensor_and_records_in_it(recorded: Path, tmp_path: Path) -> None:
    outcome = replay(recorded / "bag", tmp_path / "out", {}, playing=Playing("paced", 0.02)).outcome
    made = BagReader(tmp_path / "out" / "bag")
    stamps = [stamp_ns_of(m.cdr) for m in made.messages(["/platform/odometry"])]
    duration_s = (max(stamps) - min(stamps)) * 1e-9
    assert outcome.elapsed_s > duration_s / 0.02
    times = [m.log_time_ns for m in made.messages()]
    assert min(stamps) - 1_000_000_000 < min(times) <= max(times) <= max(stamps)


def test_all_nodes_of_a_paced_run_take_the_time_from_the_clock() -> None:
    plan = Plan("player", ["sar_compression", "ml_height"], [], Path("bag"), {"player": {"bag": "b"}}, 1)
    assert not any("use_sim_time" in member.parameters for member in members_of(plan))
    told = members_of(dataclasses.replace(plan, simulated_time=True))
    assert [member.name for member in told] == ["recorder", "ml_height", "sar_compression", "player"]
    assert all(member.parameters["use_sim_time"] is True for member in told)


def test_what_a_burst_overruns_is_dropped_and_counted(
    recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every frame is accounted for, and the dwells that were processed are those of lockstep."""
    values = {"sar_compression": {"max_queued_dwells": 1}}
    process, takes = Compression.process, StageNode.takes
    all_came = threading.Event()

    def held_up(self: Compression, jobs: Sequence[Job]) -> Iterator[Sequence[Result]]:
        assert jobs[0].dwell is None or all_came.wait(600.0)
        return process(self, jobs)

    def noted(self: StageNode, messages: int = 1) -> bool:
        taken = takes(self, messages)
        if isinstance(self.stage, Compression) and self.account().received == FRAMES:
            all_came.set()
        return taken

    monkeypatch.setattr(Compression, "process", held_up)
    monkeypatch.setattr(StageNode, "takes", noted)
    result = replay(recorded / "bag", tmp_path / "out", values, playing=Playing("burst", loops=10))
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    account = report["stages"]["sar_compression"]
    assert report["dwells"] == 20
    assert account["in"] == FRAMES == account["processed"] + sum(account["dropped"].values())
    assert account["dropped"]["queue full"] >= 8
    assert result.outcome.losses
    assert result.shortfalls(changed=False)


def test_passes_go_on_in_time_and_the_first_one_is_compared(recorded: Path, tmp_path: Path) -> None:
    result = replay(recorded / "bag", tmp_path / "out", {}, playing=Playing("paced", 0.1, loops=3))
    assert result.shortfalls(changed=False) == []
    assert {(one.matched, one.missing, one.extra) for one in result.compared.values()} == {(2, 0, 0)}
    made = BagReader(tmp_path / "out" / "bag")
    for topic, count in (("/ml/height", 6), ("/tracked/height", 6), ("/phase_history", 48)):
        stamps = [stamp_ns_of(m.cdr) for m in made.messages([topic])]
        assert len(stamps) == count
        assert stamps == sorted(stamps)
    odometry = [stamp_ns_of(m.cdr) for m in made.messages(["/platform/odometry"])]
    assert odometry == sorted(set(odometry))
    heights = [made.decode(m.type_name, m.cdr) for m in made.messages(["/monopulse/height"])]
    assert [image.dwell for image in heights] == [0, 1] * 3
    assert heights[0].surfaces[0].height == pytest.approx(heights[2].surfaces[0].height, abs=1e-6, nan_ok=True)
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert (report["dwells"], report["loops"], report["comparison"]["passes"]) == (6, 3, 1)


@pytest.mark.thorough
def test_parts_and_entries_are_played_by_any_clock(two_dwells: Preset, tmp_path: Path) -> None:
    fly(dataclasses.replace(two_dwells, dwells=3), 5, tmp_path / "run", {}, Execution(record=["slc"]))
    bag = tmp_path / "run" / "bag"
    for name, part, playing, dwells in (
        ("history", Part(first=1), PACED, 2),
        ("images", Part("slc", last=1), Playing("burst", loops=2), 4),
        ("heights", Part("heights"), PACED, 3),
    ):
        result = replay(bag, tmp_path / name, {}, part=part, playing=playing)
        assert result.shortfalls(changed=False) == [], name
        assert result.outcome.dwells == dwells
        assert result.compared


def test_what_does_not_go_together_is_refused(recorded: Path, tmp_path: Path) -> None:
    for clock, rate, loops, option in (
        ("lockstep", 2.0, 1, "--rate"),
        ("burst", 2.0, 1, "--rate"),
        ("lockstep", None, 2, "--loop"),
    ):
        with pytest.raises(UserError) as error:
            Playing(clock, rate, loops)
        assert_one_sentence(str(error.value), f"Option {option}", f"--clock {clock}")
    words = ["replay", str(recorded / "bag"), "--out", str(tmp_path / "out")]
    assert main([*words, "--rate", "2"]) == 2
    assert main([*words, "--clock", "paced", "--rate", "0"]) == 2
    assert main([*words, "--clock", "burst", "--loop", "0"]) == 2
    assert not (tmp_path / "out").exists()


def test_only_what_happened_before_the_first_dwell_can_be_repeated() -> None:
    def changed_before(dwell: int) -> ReplayPlan:
        changes = [DwellChanges(DwellKey("", dwell, dwell), {"ml_height": {"range_looks": 2}})]
        return ReplayPlan(None, None, {}, {}, changes, [], [], DwellRange(), 3, True, {DwellKey("", 0, 0): ALWAYS})

    Playing("burst", loops=2).check(changed_before(0))
    Playing("burst").check(changed_before(1))
    with pytest.raises(UserError) as error:
        Playing("burst", loops=2).check(changed_before(1))
    assert_one_sentence(str(error.value), "--loop", "before dwell 1", "--param", "--dwells")


@pytest.mark.thorough
def test_the_command_takes_a_clock(recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["replay", str(recorded / "bag"), "--out", str(tmp_path / "out"), "--clock", "paced", "--rate", "0.5"]
    assert main([*words, "--loop", "2"]) == 0
    assert "/ml/height" in capsys.readouterr().out
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert (report["clock"], report["rate"], report["loops"]) == ("paced", 0.5, 2)
