"""What a bag holds of a sensor, as it is played: whole dwells, odometry around them, stamps that go on."""

from __future__ import annotations

from pathlib import Path

import pytest
from air_messages import temperature_at

from sal_height import messages
from sal_height.bag.reader import BagReader
from sal_height.bag.stamps import stamp_ns_of
from sal_height.bag.writer import BagWriter
from sal_height.errors import UserError
from sal_height.messages import deserialize, serialize
from sal_height.messages.types import ChannelFrame, Odometry
from sal_height.nodes.playing.playlist import FRAMES, ODOMETRY, Playlist, _period, restamped

BAG = Path(__file__).parents[3] / "bags" / "version_3"


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
    assert [item.due_ns for item in playlist.items] == sorted(item.due_ns for item in playlist.items)
    for item in playlist.items:
        late_ns = item.due_ns - stamp_ns_of(item.cdr)
        frame = deserialize(item.cdr, ChannelFrame) if item.topic == FRAMES else None
        assert late_ns == (round(frame.pulse_time[-1] * 1e9) if frame else 0)


def test_one_sample_of_odometry_lies_before_the_first_pulse_and_one_after_the_last(playlist: Playlist) -> None:
    odometry = [item.due_ns for item in playlist.items if item.topic == ODOMETRY]
    frames = [(stamp_ns_of(item.cdr), item.due_ns) for item in playlist.items if item.topic == FRAMES]
    first, last = min(start for start, _ in frames), max(end for _, end in frames)
    assert sum(stamp <= first for stamp in odometry) == 1
    assert sum(stamp >= last for stamp in odometry) == 1


def test_the_air_comes_at_its_stamp_after_what_the_first_dwell_needs(tmp_path: Path, playlist: Playlist) -> None:
    """That is stamped so that it is used for it in later passes, too; what comes after the last dwell is left out."""
    begin_ns, end_ns = (item.due_ns for item in (playlist.items[0], playlist.items[-1]))
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
    air = [(item.due_ns, item.cdr) for item in items if item.topic == "air/temperature"]
    expected = [(begin_ns, used_ns, 1), (begin_ns, used_ns + 5, 2), (first_ns, first_ns, 3), (end_ns, end_ns, 4)]
    assert air == [(due, serialize(temperature_at(stamp, number))) for due, stamp, number in expected]
    assert [item for item in items if item.topic != "air/temperature"] == playlist.items


def test_repetitions_do_not_overlap(playlist: Playlist) -> None:
    """The flight has two dwells, 11.625 ms apart; what is played must reach a dwell further."""
    odometry = [item.due_ns for item in playlist.items if item.topic == ODOMETRY]
    assert playlist.dwells == 2
    assert playlist.period_ns >= 2 * 11_625_000
    assert playlist.period_ns > odometry[-1] - odometry[0]
    assert playlist.dwell_rate_hz == pytest.approx(2e9 / playlist.period_ns)


@pytest.mark.parametrize(
    ("starts_s", "period_s"), [([0.0], 1.0), ([0.0, 2.0, 4.0], 6.0), ([0.0, 2.0, 30.0, 32.0], 60.0)]
)
def test_passes_begin_anew_after_a_turn(starts_s: list[float], period_s: float) -> None:
    """The platform is at the other end of its flight then, as it is between passes."""
    starts = [round(1e9 * start) for start in starts_s]
    assert _period(starts, [0, starts[-1] + 999_999_999]) == round(1e9 * period_s)


def test_a_bag_that_takes_too_much_memory_is_refused() -> None:
    with pytest.raises(UserError, match="holds more than 0 MB of dwells"):
        Playlist.of_bag(BagReader(BAG), 1e5)
