"""Messages to play: of a whole bag as its sensor delivered it, and of whole dwells in memory; in one pass or more."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from air_messages import temperature_at
from played_bag import bag, odometry
from written_bag import frame

from sal_height import messages
from sal_height.bag import qos
from sal_height.bag.played import DwellRange
from sal_height.bag.reader import BagReader
from sal_height.bag.topics import stamp_ns_of
from sal_height.bag.writer import BagWriter
from sal_height.errors import UserError
from sal_height.messages import deserialize, serialize
from sal_height.messages.types import ChannelFrame, Odometry, SensorInfo
from sal_height.nodes.playing.playlist import (
    FRAMES,
    ODOMETRY,
    SHORTEST_WAIT_S,
    PacedClock,
    Playlist,
    _period,
    delivered,
    restamped,
)

BAG = Path(__file__).parents[3] / "bags" / "version_3"

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
    """Dwells at 1, 2 and 3 s start again at 4 s; a description keeps its stamp."""
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


@pytest.fixture(scope="module")
def playlist() -> Playlist:
    return Playlist.of_bag(BagReader(BAG), 1e9)


@pytest.mark.parametrize("kind", [Odometry, ChannelFrame])
@pytest.mark.parametrize("frame", ["", "map", "a_longer_frame"])
def test_a_message_is_the_same_but_for_its_stamp(kind: type, frame: str) -> None:
    message = kind()
    message.header.frame_id, message.header.stamp = frame, messages.to_stamp(1_699_999_999_900_000_000)
    cdr = serialize(message)
    moved = deserialize(restamped(cdr, 250_000_000), kind)
    assert messages.to_ns(moved.header.stamp) == stamp_ns_of(restamped(cdr, 250_000_000)) == 1_700_000_000_150_000_000
    moved.header.stamp = message.header.stamp
    assert moved == message


def test_frames_come_after_their_last_pulse_and_odometry_at_its_stamp(playlist: Playlist) -> None:
    assert [item.log_time_ns for item in playlist.items] == sorted(item.log_time_ns for item in playlist.items)
    for item in playlist.items:
        late_ns = item.log_time_ns - stamp_ns_of(item.cdr)
        frame = deserialize(item.cdr, ChannelFrame) if item.topic == FRAMES else None
        assert late_ns == (round(frame.pulse_time[-1] * 1e9) if frame else 0)


def test_one_sample_of_odometry_lies_before_the_first_pulse_and_one_after_the_last(playlist: Playlist) -> None:
    samples = [item.log_time_ns for item in playlist.items if item.topic == ODOMETRY]
    frames = [(stamp_ns_of(item.cdr), item.log_time_ns) for item in playlist.items if item.topic == FRAMES]
    first, last = min(start for start, _ in frames), max(end for _, end in frames)
    assert sum(stamp <= first for stamp in samples) == 1
    assert sum(stamp >= last for stamp in samples) == 1


def test_the_air_comes_at_its_stamp_after_what_the_first_dwell_needs(tmp_path: Path, playlist: Playlist) -> None:
    """That is stamped so that it is used for it in later passes, too; what comes after the last dwell is left out."""
    begin_ns, end_ns = (item.log_time_ns for item in (playlist.items[0], playlist.items[-1]))
    first_ns = min(stamp_ns_of(item.cdr) for item in playlist.items if item.topic == FRAMES)
    used_ns = first_ns - 1_000_000_000
    stamps = [used_ns - 30_000_000_000, used_ns - 20_000_000_000, used_ns + 5, first_ns, end_ns, end_ns + 1]
    with BagWriter(tmp_path / "bag") as bag:
        for name, topic in BagReader(BAG).topics.items():
            bag.add_topic(name, topic.type_name)
        bag.add_topic("/air/temperature", "sensor_msgs/msg/Temperature")
        for number, stamp_ns in enumerate(stamps):
            bag.write("/air/temperature", serialize(temperature_at(stamp_ns, number)), 1, 1)
        for one in BagReader(BAG).messages():
            bag.write(one.topic, one.cdr, one.log_time_ns, one.publish_time_ns)
    items = Playlist.of_bag(BagReader(tmp_path / "bag"), 1e9).items
    air = [(item.log_time_ns, item.cdr) for item in items if item.topic == "air/temperature"]
    expected = [(begin_ns, used_ns, 1), (begin_ns, used_ns + 5, 2), (first_ns, first_ns, 3), (end_ns, end_ns, 4)]
    assert air == [(due, serialize(temperature_at(stamp, number))) for due, stamp, number in expected]
    assert [item for item in items if item.topic != "air/temperature"] == playlist.items


def test_repetitions_do_not_overlap(playlist: Playlist) -> None:
    """The flight has two dwells, 11.625 ms apart; what is played must reach a dwell further."""
    samples = [item.log_time_ns for item in playlist.items if item.topic == ODOMETRY]
    assert playlist.dwells == 2
    assert playlist.period_ns >= 2 * 11_625_000
    assert playlist.period_ns > samples[-1] - samples[0]
    assert playlist.dwell_rate_hz == pytest.approx(2e9 / playlist.period_ns)


@pytest.mark.parametrize(
    ("starts_s", "period_s"), [([0.0], 1.0), ([0.0, 2.0, 4.0], 6.0), ([0.0, 2.0, 30.0, 32.0], 60.0)]
)
def test_passes_start_again_after_a_turn(starts_s: list[float], period_s: float) -> None:
    """The platform is at the other end of its flight then, as it is between passes."""
    starts = [round(1e9 * start) for start in starts_s]
    assert _period(starts, starts[-1] + 999_999_999) == round(1e9 * period_s)


def test_a_bag_that_takes_too_much_memory_is_refused() -> None:
    with pytest.raises(UserError, match="holds more than 0 MB of dwells"):
        Playlist.of_bag(BagReader(BAG), 1e5)


class Waits(threading.Event):
    """An event that keeps for how long it was waited for, s."""

    def __init__(self) -> None:
        super().__init__()
        self.waited_s: list[float] = []

    def wait(self, timeout: float | None = None) -> bool:
        self.waited_s.append(timeout or 0.0)
        return super().wait(timeout)


def test_what_is_due_in_quick_succession_is_waited_for_together_and_never_early() -> None:
    """To wake up for each message takes longer than to publish it."""
    clock = PacedClock(1000, rate=2.0, began=(began := time.monotonic()))
    clock._ending = waits = Waits()
    for number in range(100):
        assert clock.wait_until(1000 + 200_000 * number)
        assert time.monotonic() >= began + 1e-4 * number
    assert waits.waited_s
    assert min(waits.waited_s) >= SHORTEST_WAIT_S
    assert len(waits.waited_s) <= 1e-4 * 100 / SHORTEST_WAIT_S
    clock.end()
    assert not clock.wait_until(10**10)
