"""Two runs, or two replays of a bag, give the same messages at the same times, byte for byte; by calls, too."""

from __future__ import annotations

import dataclasses
import json
from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest
from helpers import few

from sal_height.bag.reader import BagMessage, BagReader
from sal_height.graph.lockstep import Lockstep
from sal_height.graph.plan import Execution
from sal_height.runs.replay.bag_replay import replay
from sal_height.runs.truth.simulate import START_NS, fly
from sal_height.simulation import Preset, flight_of
from sal_height.topics import SLC

BAGS = Path(__file__).parents[3] / "bags"

ACCOUNTS = ("/diagnostics", "/progress", "/rosout", "/parameter_events")
"""Topics whose messages have the times of a run, and numbers of its processes."""


def raw(bag: Path) -> dict[str, list[BagMessage]]:
    """All messages by topic, in their order."""
    reader, found = BagReader(bag), defaultdict(list)
    for message in reader.messages([topic for topic in reader.topics if topic not in ACCOUNTS]):
        found[message.topic].append(message)
    found["/tf"].sort()  # of several nodes, which publish at the same time
    return dict(found)


def bytes_of(found: dict[str, list[BagMessage]]) -> dict[str, list[bytes]]:
    """The bytes of messages by topic."""
    return {topic: [bytes(message.cdr) for message in messages] for topic, messages in found.items()}


def differing(one: dict[str, list[Any]], other: dict[str, list[Any]]) -> list[str]:
    """Topics whose messages differ, or that only one of two bags has."""
    return sorted(topic for topic in one.keys() | other.keys() if one.get(topic) != other.get(topic))


@pytest.mark.parametrize("name", few(1, ["version_3", "sal_spotlight", "xband_relief", "sal_stripmap"]))
def test_replays_are_equal_byte_for_byte(name: str, tmp_path: Path) -> None:
    """Of all topics but accounts; unknown bytes of padding, or an order that depends on threads, would differ."""
    made = []
    for number, jobs in enumerate((None, None, 1, 1)):
        out = tmp_path / f"{number}"
        replay(BAGS / name, out, {}, Execution(record=[SLC]), jobs=jobs)
        made.append(raw(out / "bag"))
    nodes, nodes_again, calls, calls_again = made
    assert {"/slc", "/phase_history", "/platform/odometry", "/tracked/height"} <= nodes.keys()
    assert differing(nodes, nodes_again) == differing(calls, calls_again) == []
    assert differing(bytes_of(nodes), bytes_of(calls)) == []


def test_a_reset_in_flight_is_repeated(two_dwells: Preset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Through nodes and by calls; the replay of a replay repeats it, too."""
    three_dwells = dataclasses.replace(two_dwells, dwells=3, estimators=("ml",))
    fly(three_dwells, 1, tmp_path / "whole", {})
    announce = Lockstep.announce

    def reset_after_two(run: Lockstep) -> None:
        announce(run)
        if run.played == 2:
            run._stages["relief_tracker"]._reset()

    monkeypatch.setattr(Lockstep, "announce", reset_after_two)
    fly(three_dwells, 1, tmp_path / "flown", {})
    monkeypatch.undo()
    whole, flown = (bytes_of(raw(tmp_path / name / "bag"))["/tracked/height"] for name in ("whole", "flown"))
    assert (flown[:2], flown[2] == whole[2]) == (whole[:2], False)
    for source, name, jobs in (("flown", "nodes", None), ("flown", "calls", 1), ("nodes", "again", 1)):
        outcome = replay(tmp_path / source / "bag", tmp_path / name, {}, jobs=jobs).outcome
        assert bytes_of(raw(tmp_path / name / "bag"))["/tracked/height"] == flown
        assert outcome.losses == outcome.losses_as_flown == []


def test_runs_are_equal_byte_for_byte(two_dwells: Preset, tmp_path: Path) -> None:
    """By nodes and by calls; stamps are those of the flight, and messages of a dwell are recorded when it has ended."""
    for name, jobs in (("a", None), ("b", None), ("calls", 1), ("side_by_side", 2)):
        fly(two_dwells, 1, tmp_path / name, {}, Execution(record=[SLC]), jobs)
    one, other, calls, side_by_side = (raw(tmp_path / name / "bag") for name in ("a", "b", "calls", "side_by_side"))
    assert {"/slc", "/phase_history", "/platform/odometry", "/tracked/height"} <= one.keys()
    assert differing(one, other) == differing(one, calls) == differing(one, side_by_side) == []
    ends = [START_NS + flight_of(two_dwells, 1).dwell_end_ns(dwell) for dwell in range(2)]
    assert [message.log_time_ns for message in one["/tracked/height"]] == ends
    assert {message.log_time_ns for message in one["/phase_history"]} == {*ends}
    assert {message.log_time_ns for message in one["/sensor_info"]} == {START_NS}
    by_nodes, by_calls = (report_of(tmp_path / name) for name in ("a", "calls"))
    assert by_nodes == by_calls
    account = by_nodes["stages"]["ml_height"]
    views = dict.fromkeys(("ml/height", "ml/image", "ml/points", "ml/frame", "tf"), 2)
    assert (account["in"], account["processed"], account["out"], account["published"]) == (16, 16, 2, views)


def report_of(folder: Path) -> dict[str, Any]:
    """The report of a run without its times, topics without messages, and the accounts of simulator and mapper.

    Nodes count a picture of the map, and dwells of the simulator as received.
    """
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    del report["elapsed_s"], report["stages"]["simulator"], report["stages"]["relief_mapper"]
    for stage in report["stages"].values():
        del stage["latency_p50_ms"], stage["latency_p95_ms"]
        stage["published"] = {topic: count for topic, count in stage["published"].items() if count}
    return report
