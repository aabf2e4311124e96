"""A bag of nodes that fell behind gives what they made, value for value: through nodes and by calls."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from helpers import few
from rewritten_bag import copied

from sal_height.bag.compare import EQUAL
from sal_height.bag.reader import BagReader
from sal_height.commands import main
from sal_height.graph.plan import Execution
from sal_height.runs.chain.as_flown import OF_LOAD
from sal_height.runs.live.live import Live, Watched, live
from sal_height.runs.live.sensor_bag import Feed, record_sensor
from sal_height.runs.replay.bag_replay import replay
from sal_height.simulation import load_preset

DEADLINE_S = 600.0
TOPICS = {"/ml/height", "/monopulse/height", "/tracked/height"}


@pytest.fixture(scope="module")
def overloaded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Bag of a flight of three dwells, again and again, of which a slow compression leaves out most."""
    folder = tmp_path_factory.mktemp("overload")
    sensor = record_sensor(replace(load_preset("small"), dwells=3), 1, folder / "sensor")

    def end_once_some_are_tracked(watched: Watched) -> None:
        dropped = sum(watched.accounts["sar_compression"].dropped.values()) if watched.accounts else 0
        if dropped and len(watched.latencies_s["tracked/height"]) >= 5:
            raise KeyboardInterrupt

    recorded = Execution(record=["phase_history", "losses"])
    slow = {"sar_compression": {"rows": 200, "cols": 30, "former": "backprojection"}}
    how = Live(rate=0.5, seconds=DEADLINE_S, budget_s=1.0)
    watched = live(Feed.of_bag(sensor), folder / "live", slow, how, recorded, end_once_some_are_tracked)
    assert watched.elapsed_s < DEADLINE_S
    return folder / "live" / "bag"


@pytest.fixture(scope="module")
def without_losses(overloaded: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same as an older recorder left it."""
    messages = [one for one in BagReader(overloaded).messages() if one.topic != "/losses"]
    return copied(overloaded, tmp_path_factory.mktemp("older") / "bag", messages)


@pytest.mark.parametrize("jobs", few(1, [1, 2, None]))
def test_a_flight_in_overload_is_replayed_as_it_was(overloaded: Path, jobs: int | None, tmp_path: Path) -> None:
    result = replay(overloaded, tmp_path / "out", {}, jobs=jobs)
    assert {topic: one.verdict for topic, one in result.compared.items()} == dict.fromkeys(TOPICS, EQUAL)
    assert result.compared["/tracked/height"].matched >= 5
    assert result.shortfalls(changed=False) == []
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    dropped = report["stages"]["sar_compression"]["dropped"]
    assert dropped.keys() & OF_LOAD  # others are of the data, as where the recording cuts off the odometry of a dwell
    assert {(one["node"], one["reason"]) for one in report["left_out_in_flight"]} >= {
        ("sar_compression", reason) for reason in dropped.keys() & OF_LOAD - {"incomplete dwell"}
    }
    assert any("left out" in sentence for sentence in report["losses_as_flown"])


def test_without_losses_the_recorded_heights_say_what_was_made(
    without_losses: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    assert main(["replay", str(without_losses), "--jobs", "1", "--out", str(tmp_path / "out")]) == 0
    assert "Node ml_height left out " in capsys.readouterr().out
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert {one["verdict"] for one in report["comparison"]["topics"].values()} == {"equal"}
    (said,) = [one.getMessage() for one in caplog.records if "no message on topic losses" in one.getMessage()]
    assert "ml_height" in said
    assert "`sal-height batch` processes all dwells" in said


def test_a_last_dwell_without_heights_is_left_out(recorded: Path, tmp_path: Path) -> None:
    messages = list(BagReader(recorded / "bag").messages())
    last = {one.topic: one for one in messages if one.topic in TOPICS}
    lacking = copied(recorded / "bag", tmp_path / "lacking", [one for one in messages if one not in last.values()])
    result = replay(lacking, tmp_path / "out", {}, jobs=1)
    assert {topic: one.matched for topic, one in result.compared.items()} == dict.fromkeys(TOPICS, 1)
    assert result.shortfalls(changed=False) == []
    assert result.outcome.losses_as_flown == [
        "Node monopulse left out 8 messages as in flight (not made in flight).",
        "Node ml_height left out 8 messages as in flight (not made in flight).",
    ]


def test_a_lost_dwell_with_heights_is_missed(recorded: Path, tmp_path: Path) -> None:
    """Its frames are not in the bag: what nodes had cannot be made again, and the status says so."""
    messages = list(BagReader(recorded / "bag").messages())
    first = next(one for one in messages if one.topic == "/phase_history")
    torn = copied(recorded / "bag", tmp_path / "torn", [one for one in messages if one is not first])
    said = replay(torn, tmp_path / "out", {}, jobs=1).shortfalls(changed=False)
    assert "Node sar_compression dropped 7 messages (incomplete dwell)." in said
    assert "Topic /ml/height misses 1 image and has 0 more than recorded." in said
