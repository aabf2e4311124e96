"""What a bag holds of a sensor, as it is played: whole dwells, odometry around them, stamps that go on."""

from __future__ import annotations

from pathlib import Path

import pytest
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message
from sal_height_msgs.msg import ChannelFrame

from sal_height import messages
from sal_height.bag.reader import BagReader
from sal_height.bag.stamps import stamp_ns_of
from sal_height.errors import UserError
from sal_height.nodes.playlist import FRAMES, ODOMETRY, Playlist, restamped

BAG = Path(__file__).parents[2] / "bags" / "version_2"


@pytest.fixture(scope="module")
def playlist() -> Playlist:
    return Playlist.of_bag(BagReader(BAG), 1e9)


@pytest.mark.parametrize("kind", [Odometry, ChannelFrame])
@pytest.mark.parametrize("frame", ["", "map", "a_longer_frame"])
def test_a_message_is_the_same_but_for_its_stamp(kind: type, frame: str) -> None:
    message = kind()
    message.header.frame_id, message.header.stamp = frame, messages.to_stamp(1_699_999_999_900_000_000)
    cdr = serialize_message(message)
    moved = deserialize_message(restamped(cdr, 250_000_000), kind)
    assert messages.to_ns(moved.header.stamp) == stamp_ns_of(restamped(cdr, 250_000_000)) == 1_700_000_000_150_000_000
    moved.header.stamp = message.header.stamp
    assert moved == message


def test_frames_come_after_their_last_pulse_and_odometry_at_its_stamp(playlist: Playlist) -> None:
    assert [item.due_ns for item in playlist.items] == sorted(item.due_ns for item in playlist.items)
    for item in playlist.items:
        late_ns = item.due_ns - stamp_ns_of(item.cdr)
        frame = deserialize_message(item.cdr, ChannelFrame) if item.topic == FRAMES else None
        assert late_ns == (round(frame.pulse_time[-1] * 1e9) if frame else 0)


def test_one_sample_of_odometry_lies_before_the_first_pulse_and_one_after_the_last(playlist: Playlist) -> None:
    odometry = [item.due_ns for item in playlist.items if item.topic == ODOMETRY]
    frames = [(stamp_ns_of(item.cdr), item.due_ns) for item in playlist.items if item.topic == FRAMES]
    first, last = min(start for start, _ in frames), max(end for _, end in frames)
    assert sum(stamp <= first for stamp in odometry) == 1
    assert sum(stamp >= last for stamp in odometry) == 1


def test_repetitions_do_not_overlap(playlist: Playlist) -> None:
    """The flight has two dwells, 11.625 ms apart; what is played must reach a dwell further."""
    odometry = [item.due_ns for item in playlist.items if item.topic == ODOMETRY]
    assert playlist.dwells == 2
    assert playlist.period_ns >= 2 * 11_625_000
    assert playlist.period_ns > odometry[-1] - odometry[0]
    assert playlist.dwell_rate_hz == pytest.approx(2e9 / playlist.period_ns)


def test_a_bag_that_takes_too_much_memory_is_refused() -> None:
    with pytest.raises(UserError, match="holds more than 0 MB of dwells"):
        Playlist.of_bag(BagReader(BAG), 1e5)
