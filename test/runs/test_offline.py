"""Heights that are made of a bag without a graph are those of the graph."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import made_offline
import pytest
from helpers import assert_one_sentence
from rewritten_bag import rewritten

from sal_height.bag.compare import CHANGED, EQUAL
from sal_height.bag.namespace import NamespacedReader
from sal_height.bag.reader import BagMessage, BagReader
from sal_height.bag.tolerance import ROUNDING
from sal_height.bag.writer import BagWriter
from sal_height.errors import UserError
from sal_height.messages import serialize
from sal_height.messages.types import Calibration
from sal_height.runs import offline
from sal_height.runs.campaign import Case, plan
from sal_height.runs.flight_record import FlightRecord
from sal_height.runs.replay import replay

BAGS = Path(__file__).parents[2] / "bags"
GOLDEN = sorted(folder.name for folder in BAGS.iterdir() if folder.is_dir() and "version" not in folder.name)


@pytest.mark.parametrize("most_dwells", [1, 2])
def test_the_graph_and_parts_of_a_bag_make_the_same_heights(recorded: Path, tmp_path: Path, most_dwells: int) -> None:
    expected = {f"/{name}/height": (EQUAL, 2) for name in ("ml", "monopulse", "tracked")}
    assert made_offline.compared(recorded / "bag", tmp_path, most_dwells) == expected


@pytest.mark.parametrize("name", GOLDEN)
def test_golden_bags_come_out(name: str, tmp_path: Path) -> None:
    found = made_offline.compared(BAGS / name, tmp_path, tolerances=ROUNDING)
    assert CHANGED not in {verdict for verdict, _ in found.values()}
    assert all(matched > 0 for _, matched in found.values())


def test_parameters_that_are_given_hold(recorded: Path, tmp_path: Path) -> None:
    given = {"ml_height": {"range_looks": 2}, "sar_compression": {"cols": 10}}
    replay(recorded / "bag", tmp_path / "replay", given)
    again = made_offline.make(recorded / "bag", tmp_path, 1, **given)
    assert (again["dwells"], again["images"], again["against_recorded"]) == (2, 6, CHANGED)
    assert set(made_offline.compared(tmp_path / "replay" / "bag", tmp_path / "again").values()) == {(EQUAL, 2)}


def test_a_dwell_without_a_frame_is_counted_and_those_after_it_are_made(recorded: Path, tmp_path: Path) -> None:
    bag = rewritten(
        recorded / "bag",
        tmp_path / "lacking",
        lambda message, number: None if message.topic == "/phase_history" and number == 3 else message,
    )
    row = made_offline.make(bag, tmp_path, 2)
    assert (row["dwells"], row["images"], row["dropped"]) == (2, 3, 1)
    assert row["drops"] == '{"sar_compression: incomplete dwell": 1}'
    assert "Dwell 0: channels [3] are not in the bag." in row["warnings"]
    proceeding = made_offline.make(bag, tmp_path / "proceed", 2, sar_compression={"missing_channels": "proceed"})
    assert (proceeding["images"], proceeding["dropped"]) == (6, 0)


def test_a_broken_frame_is_counted(recorded: Path, tmp_path: Path) -> None:
    bag = rewritten(
        recorded / "bag",
        tmp_path / "broken",
        lambda message, number: (
            message._replace(cdr=message.cdr[:100]) if message.topic == "/phase_history" and number == 3 else message
        ),
    )
    row = made_offline.make(bag, tmp_path, 2)
    assert row["drops"] == '{"sar_compression: broken": 1, "sar_compression: incomplete dwell": 1}'


def test_without_odometry_no_dwell_is_made(recorded: Path, tmp_path: Path) -> None:
    bag = rewritten(
        recorded / "bag",
        tmp_path / "blind",
        lambda message, number: None if message.topic == "/platform/odometry" and number > 0 else message,
    )
    row = made_offline.make(bag, tmp_path, 2)
    assert (row["images"], row["drops"]) == (0, '{"sar_compression: odometry gap": 2}')


def test_odometry_far_from_its_dwells_in_the_bag_is_found(recorded: Path, tmp_path: Path) -> None:
    """As when it was recorded by another program."""
    hour_ns = 3600 * 10**9
    bag = rewritten(
        recorded / "bag",
        tmp_path / "apart",
        lambda message, _: (
            message
            if message.topic == "/platform/odometry"
            else message._replace(log_time_ns=message.log_time_ns + hour_ns)
        ),
    )
    assert set(made_offline.compared(bag, tmp_path).values()) == {(EQUAL, 2)}


def test_what_needs_a_graph_is_refused(recorded: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="mounting_from_tf, which needs a graph"):
        made_offline.make(recorded / "bag", tmp_path, 1, sar_compression={"mounting_from_tf": True})


def test_dwells_that_lack_a_frame_are_not_held_for_ever(recorded: Path, tmp_path: Path) -> None:
    bag = rewritten(
        recorded / "bag",
        tmp_path / "lacking",
        lambda message, number: None if message.topic == "/phase_history" and number % 8 == 3 else message,
    )
    limited = {"sar_compression": {"max_unfinished_dwells": 1}}
    (work,) = plan(Case(bag, tmp_path / "out", {}, limited), 2).works
    reader, held = NamespacedReader(bag, ""), []
    with BagWriter(tmp_path / "made") as out:
        making = offline._Making(work, reader, out)
        for message in reader.messages(["/phase_history", "/platform/odometry"]):
            making.take(message)
            held.append(len(making._assembler.held()))
    assert max(held) == 1
    assert making.losses.dropped == {"sar_compression: incomplete dwell": 1}  # the other one may still come


def of_topic(reader: BagReader, topic: str) -> tuple[BagMessage, Any]:
    """The first message on a topic, and what is in it."""
    recorded = next(reader.messages([topic]))
    return recorded, reader.decode(recorded.type_name, recorded.cdr)


def with_more(bag: Path, folder: Path, *more: BagMessage) -> Path:
    """A bag with more messages, which come before those that are as late."""
    reader = BagReader(bag)
    with BagWriter(folder, reader.custom_data) as out:
        types = {one.topic: one.type_name for one in more}
        for name, type_name in {**types, **{topic.name: topic.type_name for topic in reader.topics.values()}}.items():
            out.add_topic(name, type_name)
        for one in sorted([*more, *reader.messages()], key=lambda message: message.log_time_ns):
            out.write(one.topic, one.cdr, one.log_time_ns, one.publish_time_ns)
    return folder


def test_the_first_of_contradictory_descriptions_stays_in_force_and_those_that_are_none_are_told(
    recorded: Path, tmp_path: Path
) -> None:
    message, info = of_topic(BagReader(recorded / "bag"), "/sensor_info")
    info.waveform.wavelength *= 2
    contradiction = message._replace(cdr=serialize(info), log_time_ns=message.log_time_ns + 1)
    info.waveform.wavelength = math.nan
    bag = with_more(
        recorded / "bag",
        tmp_path / "disputed",
        contradiction,
        message._replace(cdr=serialize(info), log_time_ns=message.log_time_ns + 2),
    )
    assert set(made_offline.compared(bag, tmp_path).values()) == {(EQUAL, 2)}
    (warning,) = json.loads(made_offline.make(bag, tmp_path / "again", 1)["warnings"])
    assert_one_sentence(warning, "contradicts the earlier one")


def test_a_calibration_that_cannot_be_used_is_told(recorded: Path, tmp_path: Path) -> None:
    first, bare = next(BagReader(recorded / "bag").messages()), Calibration(id="bare", config_hash="of nothing")
    times = first.log_time_ns, first.publish_time_ns
    one = BagMessage("/calibration", "sal_height_msgs/msg/Calibration", serialize(bare), *times)
    bag = with_more(recorded / "bag", tmp_path / "uncalibrated", one)
    row = made_offline.make(bag, tmp_path, 1, sar_compression={"calibration": "topic"})
    assert (row["images"], row["dropped"]) == (6, 0)
    assert_one_sentence(json.loads(row["warnings"])[-1], "width factor")


def test_a_bag_without_a_frame_that_can_be_read_is_refused(recorded: Path, tmp_path: Path) -> None:
    bag = rewritten(
        recorded / "bag",
        tmp_path / "mute",
        lambda message, _: message._replace(cdr=b"\0\1\0\0") if message.topic == "/phase_history" else message,
    )
    with pytest.raises(UserError) as error:
        made_offline.make(bag, tmp_path, 1)
    assert_one_sentence(str(error.value), str(bag), "bag check")


def test_a_bag_with_a_strip_among_its_sensors_is_one_part(recorded: Path, tmp_path: Path) -> None:
    message, info = of_topic(BagReader(recorded / "bag"), "/sensor_info")
    info.config_hash, info.mode = "strip", "stripmap"
    bag = with_more(recorded / "bag", tmp_path / "both", message._replace(cdr=serialize(info)))
    assert len(plan(Case(bag, tmp_path / "out", {}, {}), 1).works) == 1
    assert len(plan(Case(recorded / "bag", tmp_path / "out", {}, {}), 1).works) == 2


def test_a_bag_is_read_once_for_its_plan(recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    readings, read = [], FlightRecord._read
    monkeypatch.setattr(FlightRecord, "_read", lambda *given: (readings.append(given), read(*given)))
    assert len(plan(Case(recorded / "bag", tmp_path / "out", {}, {}), 1).works) == 2
    assert len(readings) == 1
