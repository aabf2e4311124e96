"""Which dwells a replay leaves out, found from the losses and the heights in a bag."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pytest
from written_bag import frame, heights, key, lost, process, told, written

from sal_height.bag.reader import LogTimes
from sal_height.engine.results import DwellKey
from sal_height.engine.stage import RESETS, Reset
from sal_height.graph.plan import AsFlown
from sal_height.runs.chain.as_flown import NOT_MADE, OF_LOAD, FlownDwells, FlownLoss, as_flown, repeated_losses
from sal_height.runs.chain.timeline import timeline_of

STAGES = ["sar_compression", "monopulse", "ml_height", "relief_tracker"]
ALL = range(6)


def plan(
    made: Mapping[str, Iterable[int]],
    losses: Iterable[tuple[str, int, str]] = (),
    given: Iterable[str] = (),
    stages: list[str] = STAGES,
    values: Mapping[str, Any] | None = None,
    recorded: Iterable[int] = ALL,
    **flown: Any,
) -> AsFlown:
    """The plan of up to six dwells of which these have heights, each recorded a second after the dwell began."""
    times = {f"/{name}/height": {key(n): 10**9 * (n + 1) for n in numbers} for name, numbers in made.items()}
    told_losses = [FlownLoss(node, key(number), reason, f"{reason}.") for node, number, reason in losses]
    dwells = {key(number): LogTimes(10**9 * number, 10**9 * number + 1) for number in recorded}
    return as_flown(FlownDwells(times, told_losses, **flown), dwells, stages, values or {}, given)


def left_out(found: AsFlown) -> dict[tuple[str, str], list[int]]:
    return {(one["node"], one["reason"]): one["dwells"] for one in found.report()}


def but(*numbers: int) -> list[int]:
    return [number for number in ALL if number not in numbers]


def test_nothing_is_left_out_of_a_flight_that_made_everything() -> None:
    found = plan({"monopulse": ALL, "ml": ALL, "tracked": ALL})
    assert (left_out(found), found.unrecorded, found.restarted) == ({}, {}, {})


@pytest.mark.parametrize("reason", sorted(OF_LOAD))
def test_a_loss_of_load_is_imposed_at_its_node_and_at_no_other(reason: str) -> None:
    made = {"monopulse": but(1), "ml": but(1, 2), "tracked": but(1, 2, 3)}
    losses = [("sar_compression", 1, reason), ("ml_height", 2, reason), ("relief_tracker", 3, reason)]
    found = plan(made, losses)
    assert left_out(found) == {(node, reason): [number] for node, number, reason in losses}
    assert [(dwell, str(item)) for dwell, item in found.scheduled("ml_height")] == [(key(2), f"{reason}.")]
    assert found.lost_before["ml_height"] == {key(1)}
    assert found.lost_before["relief_tracker"] == {key(1), key(2)}


@pytest.mark.parametrize("reason", ["cannot be processed", "autofocus", "not finite"])
def test_a_loss_of_the_data_is_left_to_the_replay(reason: str) -> None:
    found = plan({"monopulse": but(1), "ml": but(1), "tracked": but(1, 2)}, [
        ("sar_compression", 1, reason), ("relief_tracker", 2, reason)
    ])  # fmt: skip
    assert left_out(found) == {}
    assert (found.unmade["sar_compression"], found.unmade["relief_tracker"]) == ({key(1)}, {key(1), key(2)})


def test_a_loss_of_arrival_is_imposed_unless_the_user_changes_the_node() -> None:
    made, losses = {"ml": but(1), "tracked": but(1)}, [("sar_compression", 1, "odometry gap")]
    stages = ["sar_compression", "ml_height", "relief_tracker"]
    assert left_out(plan(made, losses, stages=stages)) == {("sar_compression", "odometry gap"): [1]}
    assert left_out(plan(made, losses, ["sar_compression"], stages=stages)) == {}


def test_a_single_message_that_was_late_is_no_lost_dwell() -> None:
    found = plan({"ml": but(2), "tracked": but(2)}, [("sar_compression", 1, "late"), ("sar_compression", 2, "late")])
    assert left_out(found) == {("ml_height", NOT_MADE): [2]}


def test_heights_show_that_a_dwell_was_made_in_spite_of_a_loss() -> None:
    """A node that was reset, or its successor, has been given the dwell again."""
    found = plan({"ml": ALL, "tracked": ALL}, [("ml_height", 1, "reset"), ("sar_compression", 2, "ended")])
    assert left_out(found) == {}


def test_without_losses_the_heights_say_which_dwells_were_made() -> None:
    """Also where they were lost on the way from one node to the next."""
    found = plan({"monopulse": but(1), "ml": but(1, 2), "tracked": but(1, 2, 4)})
    assert left_out(found) == {
        ("monopulse", NOT_MADE): [1],
        ("ml_height", NOT_MADE): [1, 2],
        ("relief_tracker", NOT_MADE): [4],
    }


def test_losses_of_a_replay_are_as_flown_if_the_node_did_not_process_the_dwell_in_flight(tmp_path: Path) -> None:
    unmade = plan({"ml": but(5), "tracked": but(4, 5)}).unmade
    assert unmade == {"sar_compression": {key(5)}, "monopulse": set(), "ml_height": {key(5)}, **tracker(4, 5)}
    replayed = [lost("sar_compression", number, "incomplete dwell", 7) for number in (4, 5)]
    replayed += [lost("relief_tracker", 4, "cannot be processed", 1)]
    assert repeated_losses(unmade, written(tmp_path / "bag", replayed)) == {
        ("sar_compression", "incomplete dwell"): 7,
        ("relief_tracker", "cannot be processed"): 1,
    }


def tracker(*numbers: int) -> dict[str, set[DwellKey]]:
    return {"relief_tracker": {key(number) for number in numbers}}


def test_an_estimator_without_recorded_heights_leaves_nothing_out() -> None:
    assert left_out(plan({"ml": but(1), "tracked": but(1)})) == {("ml_height", NOT_MADE): [1]}


def test_heights_that_the_tracker_had_were_made_and_lost_on_the_way_to_the_recorder() -> None:
    found = plan({"monopulse": ALL, "ml": but(1), "tracked": ALL})
    assert (left_out(found), found.unrecorded) == ({}, {"ml": {key(1)}})


@pytest.mark.parametrize(("missed", "is_left_out"), [(0, True), (1, True), (2, False)])
def test_the_count_of_the_recorder_says_whether_it_has_missed_heights(missed: int, is_left_out: bool) -> None:
    found = plan({"ml": ALL, "tracked": but(1, 2)}, unwritten={"/tracked/height": missed})
    assert left_out(found) == ({("relief_tracker", NOT_MADE): [1, 2]} if is_left_out else {})
    assert found.unrecorded == ({} if is_left_out else {"tracked": {key(1), key(2)}})


def test_a_tracker_that_was_started_again_begins_with_the_first_dwell_recorded_after_that() -> None:
    """Estimators keep nothing of the dwells before."""
    started = {"relief_tracker": [3 * 10**9], "ml_height": [3 * 10**9]}
    found = plan({"ml": ALL, "tracked": but(2, 3)}, started=started)
    scheduled = list(found.scheduled("relief_tracker"))
    assert [(dwell, type(item)) for dwell, item in scheduled if isinstance(item, Reset)] == [(key(4), Reset)]
    assert not list(found.scheduled("ml_height"))


def test_a_node_that_was_reset_begins_with_the_dwell_that_the_bag_names() -> None:
    resets = [(name, 3, RESETS) for name in ("relief_tracker", "ml_height")]
    found = plan({"ml": ALL, "tracked": ALL}, resets)
    assert (left_out(found), found.restarted) == ({}, {"relief_tracker": [key(3)]})


@pytest.mark.parametrize(("recorded", "then"), [(but(3), [4]), (but(3, 4), [5]), (range(3), [])])
def test_a_reset_before_a_dwell_that_the_bag_lacks_is_repeated_before_the_next(
    recorded: Iterable[int], then: list[int]
) -> None:
    found = plan({"ml": ALL, "tracked": ALL}, [("relief_tracker", 3, RESETS)], recorded=recorded)
    assert found.restarted.get("relief_tracker", []) == [key(number) for number in then]


def test_a_reset_before_a_dwell_that_does_not_come_as_far_as_its_node_is_repeated_before_the_next() -> None:
    losses = [("relief_tracker", 1, RESETS), ("relief_tracker", 1, "overload"), ("relief_tracker", 3, RESETS)]
    found = plan({"ml": but(3), "tracked": but(1, 3)}, losses, stages=["relief_tracker"])
    assert found.restarted == {"relief_tracker": [key(2), key(4)]}


@pytest.mark.parametrize("has_strips", [False, True])
def test_a_compression_that_was_started_again_begins_a_strip_with_frames_recorded_after_that(has_strips: bool) -> None:
    made, started = {"ml": but(2), "tracked": but(2)}, {"sar_compression": [2 * 10**9]}
    found = plan(made, [("sar_compression", 2, "incomplete dwell")], started=started, has_strips=has_strips)
    assert found.restarted == ({"sar_compression": [key(3)]} if has_strips else {})


@pytest.mark.parametrize("has_strips", [False, True])
def test_a_strip_begins_again_after_the_dwell_that_was_lost_with_its_worker(has_strips: bool) -> None:
    made = {"ml": but(2), "tracked": but(2)}
    found = plan(made, [("sar_compression", 2, "worker ended")], has_strips=has_strips)
    assert set(found.left_out["sar_compression"]) == {key(2)}
    assert found.restarted == ({"sar_compression": [key(3)]} if has_strips else {})


def test_dwells_of_one_number_are_told_apart_by_their_stamps() -> None:
    again = DwellKey("", 0, 10**9)
    dwells = {key(0): LogTimes(0, 1), again: LogTimes(2, 3)}
    flown = FlownDwells({"/ml/height": {again: 4}}, [FlownLoss("ml_height", key(0), "overload", "Too late.")])
    assert as_flown(flown, dwells, ["ml_height"], {}).left_out["ml_height"].keys() == {key(0)}


def test_a_bag_says_what_was_lost_and_which_nodes_were_started_again(tmp_path: Path) -> None:
    recorded = [
        told("relief_tracker", autostart=True),
        process("relief_tracker", 7),
        frame(0),
        heights(0),
        lost("ml_height", 1, "overload"),
        process("relief_tracker", 7),
        process("ml_height", 8),
        process("relief_tracker", 9),
        heights(0, estimator="tracked"),
    ]
    flown = timeline_of(written(tmp_path / "bag", recorded)).flown
    assert {topic: list(dwells) for topic, dwells in flown.made.items()} == {
        "/ml/height": [key(0)],
        "/tracked/height": [key(0)],
    }
    assert flown.losses == [FlownLoss("ml_height", key(1), "overload", "")]
    assert flown.started == {"relief_tracker": [8]}
