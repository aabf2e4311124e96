"""What is played of a bag at the pace of its sensor: in which order, and when, in the first and in later passes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from air_messages import temperature_at
from played_bag import bag, odometry
from written_bag import frame

from sal_height import messages
from sal_height.bag import qos
from sal_height.bag.played import DwellRange
from sal_height.bag.reader import BagReader
from sal_height.bag.writer import BagWriter
from sal_height.messages import serialize
from sal_height.messages.types import ChannelFrame, Odometry, SensorInfo
from sal_height.nodes.playing.delivery import delivered

NAMES = {
    "/sensor_info": "info",
    "/platform/odometry": "odometry",
    "/phase_history": "frame",
    "/air/temperature": "air",
}


def lasting(dwell: int, channel: int = 0) -> ChannelFrame:
    """A frame whose last pulse is half a second after its first."""
    message = frame(dwell, channel)
    message.pulse_time = [0.0, 0.5]
    return message


def played(
    folder: Path, recorded: Sequence[Any], dwells: DwellRange | None = None, passes: int = 1
) -> list[tuple[str, float, float]]:
    """Kind, time of delivery and stamp of each message, s."""
    reader = BagReader(bag(folder, recorded))
    found = []
    for one, _ in delivered(reader, list(NAMES), dwells or DwellRange(), passes):
        stamp = reader.decode(one.type_name, one.cdr).header.stamp
        found.append((NAMES[one.topic], one.log_time_ns / 1e9, messages.to_ns(stamp) / 1e9))
    return found


def test_odometry_comes_at_its_stamp_and_a_frame_after_its_last_pulse(tmp_path: Path) -> None:
    """Whatever their order in the bag; a description comes after the frame that it follows there."""
    order = [lasting(1), lasting(1, 1), SensorInfo(), lasting(2), *map(odometry, (1.0, 1.5, 1.75, 2.0, 3.0))]
    assert played(tmp_path / "bag", order) == [
        ("odometry", 1.0, 1.0),
        ("odometry", 1.5, 1.5),
        ("info", 1.5, 0.0),  # the first one of the bag
        ("frame", 1.5, 1.0),
        ("frame", 1.5, 1.0),
        ("info", 1.5, 0.0),
        ("odometry", 1.75, 1.75),
        ("odometry", 2.0, 2.0),
        ("frame", 2.5, 2.0),
        ("odometry", 3.0, 3.0),
    ]


def test_the_air_follows_what_is_before_it_in_the_bag_with_stamps_that_go_on(tmp_path: Path) -> None:
    order = [temperature_at(500_000_000, 9.0), *map(odometry, (1.0, 1.5)), lasting(1), temperature_at(10**9, 8.0)]
    found = played(tmp_path / "bag", [*order, lasting(2), odometry(2.5)], passes=2)
    assert [one for one in found if one[0] != "info"] == [
        ("odometry", 1.0, 1.0),
        ("odometry", 1.5, 1.5),
        ("air", 1.5, 0.5),
        ("frame", 1.5, 1.0),
        ("air", 1.5, 1.0),
        ("odometry", 2.5, 2.5),
        ("frame", 2.5, 2.0),
        ("odometry", 3.0, 3.0),
        ("odometry", 3.5, 3.5),
        ("air", 3.5, 2.5),
        ("frame", 3.5, 3.0),
        ("air", 3.5, 3.0),
        ("odometry", 4.5, 4.5),
        ("frame", 4.5, 4.0),
    ]


def test_a_stamp_that_runs_back_is_played_at_once(tmp_path: Path) -> None:
    order = [*map(odometry, (1.0, 3.0, 2.0, 4.0)), lasting(0), lasting(9), lasting(1)]
    found = played(tmp_path / "bag", order)
    assert [(time, stamp) for kind, time, stamp in found if kind == "odometry"] == [(1, 1), (3, 3), (3, 2), (4, 4)]
    assert [(time, stamp) for kind, time, stamp in found if kind == "frame"] == [(0.5, 0), (9.5, 9), (9.5, 1)]
    assert [time for _, time, _ in found] == sorted(time for _, time, _ in found)


def test_stamps_go_on_after_a_pass_by_a_dwell(tmp_path: Path) -> None:
    """Dwells at 1, 2 and 3 s begin anew at 4 s; a description keeps its stamp."""
    order = [odometry(0.75), *(lasting(dwell) for dwell in (1, 2, 3)), odometry(3.6)]
    found = played(tmp_path / "bag", order, passes=3)
    assert [stamp for kind, _, stamp in found if kind == "frame"] == list(range(1, 10))
    assert [time for kind, time, _ in found if kind == "frame"] == [n + 0.5 for n in range(1, 10)]
    assert [stamp for kind, _, stamp in found if kind == "odometry"] == [0.75, 3.6, 3.75, 6.6, 6.75, 9.6]
    assert {stamp for kind, _, stamp in found if kind == "info"} == {0.0}
    assert [time for _, time, _ in found] == sorted(time for _, time, _ in found)


def test_a_pass_begins_after_all_odometry_of_the_one_before(tmp_path: Path) -> None:
    order = [odometry(0.0), lasting(5), lasting(6), odometry(20.0)]
    found = [(kind, stamp) for kind, _, stamp in played(tmp_path / "bag", order, passes=2)]
    again = [(kind, round(stamp - 20.0, 6)) for kind, stamp in found[5:]]
    assert again == [("odometry", 0.0), ("info", -20.0), ("frame", 5.0), ("frame", 6.0), ("odometry", 20.0)]
    assert found[5][1] > found[4][1] == 20.0


def test_every_pass_plays_the_dwells_that_are_chosen(tmp_path: Path) -> None:
    order = [*map(odometry, range(12)), *(lasting(dwell) for dwell in range(10))]
    found = played(tmp_path / "bag", order, DwellRange(4, 5), passes=2)
    assert [stamp for kind, _, stamp in found if kind == "frame"] == [4, 5, 4 + PERIOD_S, 5 + PERIOD_S]
    assert [stamp for kind, _, stamp in found if kind == "odometry"][:5] == [2, 3, 4, 5, 6]


PERIOD_S = 4.000000001
"""Of the dwells 4 and 5 with odometry from 2 to 6 s, after which another pass begins."""


def test_broken_messages_are_left_to_the_player(tmp_path: Path) -> None:
    """They come where they are in the bag, and no pass gives them another stamp."""

    with BagWriter(tmp_path / "bag", {}) as writer:
        writer.add_topic("/platform/odometry", "nav_msgs/msg/Odometry", [qos.FRAMES])
        for number, cdr in enumerate([serialize(odometry(1.0)), b"\0\1\0\0", serialize(Odometry())], 1):
            writer.write("/platform/odometry", cdr, number, number)
    found = list(delivered(BagReader(tmp_path / "bag"), ["/platform/odometry"], DwellRange(), 2))
    assert [one.log_time_ns for one, _ in found[:3]] == [1_000_000_000] * 3
    assert [bool(content.fault) for _, content in found] == [False, True, False] * 2
    assert [len(one.cdr) for one, _ in found] == [len(found[0].recorded.cdr), 4, len(found[0].recorded.cdr)] * 2
