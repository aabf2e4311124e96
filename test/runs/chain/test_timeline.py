"""What happened in a flight, found from what its bag says."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from written_bag import calibration, changed, frame, heights, key, told, written

from sal_height.messages.types import SensorInfo
from sal_height.runs.chain.timeline import Timeline, timeline_of

LOOKS = ("ml_height", "range_looks")


def found(tmp_path: Path, *recorded: Any) -> Timeline:
    return timeline_of(written(tmp_path / "bag", recorded))


def looks(dwell: int, value: int, name: str = "") -> Any:
    return heights(dwell, name, ml_height={"range_looks": value})


def changes(timeline: Timeline) -> list[tuple[int, int, str]]:
    assert {one.parameter for one in timeline.changes} <= {LOOKS}
    assert all(one.dwell == key(one.dwell.number) for one in timeline.changes)
    return [(one.dwell.number, one.value, one.source) for one in timeline.changes]


def applied(timeline: Timeline) -> list[tuple[int, str, str]]:
    return [(one.dwell.number, one.calibration, one.source) for one in timeline.calibrations]


def test_heights_say_from_which_dwell_on_a_parameter_is_another(tmp_path: Path) -> None:
    flight = found(
        tmp_path, *(m for dwell, value in enumerate((4, 4, 2, 2, 4)) for m in (frame(dwell), looks(dwell, value)))
    )
    assert list(flight.dwells) == [key(dwell) for dwell in range(5)]
    assert flight.start == {LOOKS: (4, "provenance")}
    assert changes(flight) == [(2, 2, "provenance"), (4, 4, "provenance")]


@pytest.mark.parametrize(("before_the_last_frame", "dwell"), [(True, 1), (False, 2)])
def test_without_heights_a_parameter_holds_for_dwells_that_were_not_complete(
    before_the_last_frame: bool, dwell: int, tmp_path: Path
) -> None:
    last, event = frame(1, 1), changed("ml_height", range_looks=2)
    order = (event, last) if before_the_last_frame else (last, event)
    flight = found(tmp_path, told("ml_height", range_looks=4), frame(0), frame(1), *order, frame(2))
    assert flight.start == {LOOKS: (4, "parameter event")}
    assert changes(flight) == [(dwell, 2, "parameter event")]


def test_heights_are_believed_more_than_the_order_of_the_bag(tmp_path: Path) -> None:
    """The node still worked on a dwell that was complete when the parameter was set, and on one that came then."""
    event = changed("ml_height", range_looks=2)
    dwells = [frame(0), looks(0, 4), event, frame(1), looks(1, 4), frame(2), looks(2, 2)]
    flight = found(tmp_path, told("ml_height", range_looks=4), *dwells)
    assert flight.start == {LOOKS: (4, "provenance")}
    assert changes(flight) == [(2, 2, "provenance")]


def test_between_heights_the_order_of_the_bag_decides(tmp_path: Path) -> None:
    """Dwell 1 was dropped; of dwell 3, which was too, nobody said anything."""
    event = changed("ml_height", range_looks=2)
    flight = found(
        tmp_path, frame(0), looks(0, 4), event, frame(1), frame(2), looks(2, 2), frame(3), frame(4), looks(4, 2)
    )
    assert changes(flight) == [(1, 2, "parameter event")]


def test_what_no_heights_have_shown_yet_holds_for_the_next_dwell_without_heights(tmp_path: Path) -> None:
    event = changed("ml_height", range_looks=2)
    flight = found(tmp_path, frame(0), looks(0, 4), event, frame(1), looks(1, 4), frame(2), frame(3), looks(3, 4))
    assert changes(flight) == [(2, 2, "parameter event"), (3, 4, "provenance")]


def test_a_node_that_was_asked_late_had_its_parameters_all_the_time(tmp_path: Path) -> None:
    for number, order in enumerate(
        ((frame(0), frame(1), told("ml_height", range_looks=2)), (frame(0), told("ml_height", range_looks=2), frame(1)))
    ):
        flight = found(tmp_path / str(number), *order)
        assert flight.start == {LOOKS: (2, "parameter event")}
        assert not flight.changes


def test_what_was_set_before_anybody_asked_was_another_value_before(tmp_path: Path) -> None:
    for number, after in enumerate(((), (looks(1, 2),))):
        flight = found(tmp_path / str(number), frame(0), changed("ml_height", range_looks=2), frame(1), *after)
        assert flight.start == {}
        assert changes(flight) == [(1, 2, "provenance" if after else "parameter event")]


def test_parameters_that_do_not_exist_today_are_told(tmp_path: Path) -> None:
    made = {"range_looks": 2, "of_yesterday": 1, "channels_left_out": [3], "prior.sigma": 1.0}
    said = {"range_looks": 2, "use_sim_time": False, "qos_overrides./slc.depth": 1, "said": 1}
    flight = found(
        tmp_path,
        told("ml_height", **said),
        told("their_node", gain=1.0),
        frame(0),
        heights(0, ml_height=made, old_height={"looks": 2}),
    )
    assert flight.forgotten == {
        ("ml_height", "said"): "parameter event",
        ("ml_height", "of_yesterday"): "provenance",
        ("old_height", "looks"): "provenance",
    }


def test_paths_in_the_provenance_are_apart_unless_nodes_state_them(tmp_path: Path) -> None:
    """What is no path is a value like any other, and the latency budget is none."""
    made = {"terrain": "a.tif", "targets": "", "latency_budget_s": 1.0}
    said = [frame(0), heights(0, height_adjuster=made, sar_compression={"calibration": "topic"})]
    flight = found(tmp_path / "alone", *said)
    assert flight.files == {("height_adjuster", "terrain"): "a.tif"}
    assert flight.start == {
        ("height_adjuster", "targets"): ("", "provenance"),
        ("sar_compression", "calibration"): ("topic", "provenance"),
    }
    stated = found(tmp_path / "stated", told("height_adjuster", **made), *said)
    assert stated.start == {**flight.start, ("height_adjuster", "terrain"): ("a.tif", "parameter event")}
    assert not stated.changes


def test_a_calibration_comes_before_the_dwell_that_names_it(tmp_path: Path) -> None:
    """It was heard before dwell 1, which was complete by then for the node."""
    flight = found(
        tmp_path,
        *(frame(0), looks(0, 1), calibration("first"), frame(1), looks(1, 1)),
        *(frame(2), looks(2, 1, "first"), calibration("second"), frame(3), frame(4), looks(4, 1, "second")),
    )
    assert applied(flight) == [(2, "first", "provenance"), (3, "second", "order of the bag")]


def test_calibrations_that_nobody_applied_are_left_out(tmp_path: Path) -> None:
    flight = found(tmp_path, calibration("made beside"), frame(0), looks(0, 1), frame(1), looks(1, 1))
    assert (flight.calibrations, flight.missing) == ([], [])


@pytest.mark.parametrize(("made", "wanted"), [(1, [(1, "of another day", "order of the bag")]), (2, [])])
def test_a_calibration_that_was_refused_is_not_applied_to_a_dwell_without_heights(
    tmp_path: Path, made: int, wanted: list[tuple[int, str, str]]
) -> None:
    """A dwell may have been complete before the calibration arrived; the second one that was made tested it."""
    shown = [message for dwell in range(made) for message in (frame(dwell), looks(dwell, 1))]
    flight = found(tmp_path, calibration("of another day", ""), *shown, *map(frame, range(made, 4)))
    assert applied(flight) == wanted


def test_a_calibration_that_the_bag_lacks_is_told_once(tmp_path: Path) -> None:
    info = SensorInfo(calibration_id="the sensor's own")
    flight = found(
        tmp_path,
        *(info, frame(0), looks(0, 1, "the sensor's own")),
        *(m for dwell in (1, 2) for m in (frame(dwell), looks(dwell, 1, "lost"))),
    )
    assert [(one.dwell.number, one.calibration) for one in flight.missing] == [(1, "lost")]
    assert not flight.calibrations


def test_every_sensor_has_a_calibration_of_its_own(tmp_path: Path) -> None:
    names = ["one", "other", "one", "other"]
    flight = found(
        tmp_path,
        *(calibration("one", "sensor 1"), calibration("other", "sensor 2")),
        *(m for dwell, name in enumerate(names) for m in (frame(dwell), looks(dwell, 1, name))),
    )
    assert applied(flight) == [(0, "one", "provenance"), (1, "other", "provenance")]


def test_a_bag_of_a_sensor_alone_says_nothing(tmp_path: Path) -> None:
    assert found(tmp_path, frame(0), frame(1)) == Timeline()
