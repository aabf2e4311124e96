"""Bags of several files, and compressed ones: every file travels alone, and all are one bag."""

from __future__ import annotations

import gc
import signal
import subprocess
import sys
import weakref
from itertools import pairwise
from pathlib import Path

import pytest
import yaml
from mcap.reader import make_reader
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from std_msgs.msg import String

from sal_height.bag.mcap_file import CHUNK_SIZE, COMPRESSIONS
from sal_height.bag.qos import TRANSIENT_LOCAL, Qos
from sal_height.bag.reader import BagReader
from sal_height.bag.salvage import recover
from sal_height.bag.writer import BagWriter, Packing

STRING = "std_msgs/msg/String"
LATCHED = Qos(depth=1, durability=TRANSIENT_LOCAL)
DEEP = Qos(depth=2, durability=TRANSIENT_LOCAL)
SECOND = 1_000_000_000

MESSAGES = 10
SIZE = CHUNK_SIZE  # of each: every message is a chunk


def text(data: str) -> bytes:
    return serialize_message(String(data=data))


def write_bag(folder: Path, packing: Packing) -> Path:
    """Ten messages of a chunk each, a second apart; latched ones before the first and the sixth."""
    with BagWriter(folder, {"preset": "small"}, packing) as bag:
        bag.add_topic("/info", STRING, [LATCHED])
        bag.add_topic("/frames", STRING, [LATCHED])
        bag.add_topic("/notes", STRING, [DEEP, LATCHED])
        bag.add_topic("/samples", STRING, [LATCHED, Qos(depth=9)])  # not all publishers keep theirs
        bag.write("/notes", text("zero"), 0, 0)
        for second in range(MESSAGES):
            now = second * SECOND
            if second in (0, 5):
                bag.write("/info", text(f"info {second}"), now, now + 7)
                for number in range(3):
                    bag.write("/notes", text(f"note {second} {number}"), now, now)
            bag.write("/samples", text(str(second) * SIZE), now, now)
    return folder


@pytest.fixture
def split(tmp_path: Path) -> Path:
    """A bag whose files hold three messages each, by their size."""
    return write_bag(tmp_path / "split", Packing(split_bytes=3 * SIZE))


def messages_of(file: Path) -> list[tuple[str, str, int, int]]:
    """Topic, text, log and publish time of what mcap finds in a file, in its order."""
    with file.open("rb") as stream:
        return [
            (channel.topic, deserialize_message(m.data, String).data[:8], m.log_time, m.publish_time)
            for _, channel, m in make_reader(stream, validate_crcs=True).iter_messages()
        ]


def test_a_bag_is_cut_by_size(split: Path) -> None:
    files = sorted(split.glob("*.mcap"))
    assert [file.name for file in files] == [f"split_{number}.mcap" for number in range(4)]
    counts = [sum(topic == "/samples" for topic, *_ in messages_of(file)) for file in files]
    assert counts == [3, 3, 3, 1]


def test_a_bag_is_cut_by_time(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "split", Packing(split_ns=4 * SECOND))
    seconds = [
        [log_ns // SECOND for topic, _, log_ns, _ in messages_of(file) if topic == "/samples"]
        for file in sorted(bag.glob("*.mcap"))
    ]
    assert seconds == [[0, 1, 2, 3], [4, 5, 6, 7], [8, 9]]


def test_every_file_begins_with_the_last_latched_messages(split: Path) -> None:
    """As many as the publishers hold: one of the topic with one publisher, three of that with two."""
    second, third = (messages_of(split / f"split_{number}.mcap") for number in (1, 2))
    notes = [("/notes", f"note 0 {number}", 3 * SECOND, 0) for number in range(3)]
    assert second[:4] == [("/info", "info 0", 3 * SECOND, 7), *notes]
    assert second[4][:2] == ("/samples", "3" * 8)
    assert third[0] == ("/info", "info 5", 6 * SECOND, 5 * SECOND + 7)
    assert [entry[1] for entry in third[1:4]] == [f"note 5 {number}" for number in range(3)]


def test_the_files_together_hold_each_message_once(split: Path) -> None:
    reader = BagReader(split)
    assert {name: topic.count for name, topic in reader.topics.items()} == {
        "/info": 2,
        "/frames": 0,
        "/notes": 7,
        "/samples": MESSAGES,
    }
    found = [deserialize_message(m.cdr, String).data[:8] for m in reader.messages(["/info", "/notes"])]
    assert sorted(found) == sorted(
        ["info 0", "info 5", "zero", *(f"note {second} {number}" for second in (0, 5) for number in range(3))]
    )
    assert reader.message_count == len(list(reader.messages()))


def test_a_file_alone_holds_what_it_needs(split: Path) -> None:
    reader = BagReader(split / "split_3.mcap")
    assert reader.custom_data == {"preset": "small"}
    assert [deserialize_message(m.cdr, String).data for m in reader.messages(["/info"])] == ["info 5"]
    assert reader.topics["/info"].count == 1


def test_rosbags_reads_the_files_as_one_bag(split: Path) -> None:
    with Reader(split) as reader:
        assert (reader.start_time, reader.end_time) == (0, (MESSAGES - 1) * SECOND + 1)
        assert reader.message_count == 9 + MESSAGES + 3 * 4  # four latched ones are repeated in three files
    with AnyReader([split]) as reader:
        samples = [
            reader.deserialize(raw, c.msgtype).data[0] for c, _, raw in reader.messages() if c.topic == "/samples"
        ]
    assert samples == [str(second) for second in range(MESSAGES)]


def test_metadata_yaml_describes_every_file(split: Path) -> None:
    information = yaml.safe_load((split / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert information["relative_file_paths"] == [f"split_{number}.mcap" for number in range(4)]
    for entry in information["files"]:
        times = [log_ns for _, _, log_ns, _ in messages_of(split / entry["path"])]
        assert entry["message_count"] == len(times)
        assert entry["starting_time"]["nanoseconds_since_epoch"] == min(times)
        assert entry["duration"]["nanoseconds"] == max(times) - min(times)
    assert information["message_count"] == sum(entry["message_count"] for entry in information["files"])
    counted = {t["topic_metadata"]["name"]: t["message_count"] for t in information["topics_with_message_count"]}
    assert counted == {"/info": 5, "/frames": 0, "/notes": 16, "/samples": MESSAGES}


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_compressed_bags_hold_the_same(tmp_path: Path, compression: str) -> None:
    plain = list(BagReader(write_bag(tmp_path / "plain", Packing())).messages())
    folder = write_bag(tmp_path / "packed", Packing(compression))
    assert list(BagReader(folder).messages()) == plain
    with AnyReader([folder]) as reader:
        assert [raw for _, _, raw in reader.messages()] == [message.cdr for message in plain]
    size = (folder / "packed_0.mcap").stat().st_size
    assert (size < MESSAGES * SIZE / 10) == (compression != "none")


def test_a_bag_whose_last_file_is_cut_is_salvaged_without_repetitions(split: Path, tmp_path: Path) -> None:
    (split / "metadata.yaml").unlink()
    last = split / "split_3.mcap"
    last.write_bytes(last.read_bytes()[: last.stat().st_size // 2])
    before = [m for m in BagReader(write_bag(tmp_path / "whole", Packing())).messages() if m.log_time_ns < 9 * SECOND]
    count = recover(split, tmp_path / "salvaged").count
    assert list(BagReader(tmp_path / "salvaged").messages()) == before
    assert count == len(before)


def test_without_the_file_before_a_repeated_message_is_kept(split: Path, tmp_path: Path) -> None:
    recover(split / "split_1.mcap", tmp_path / "salvaged")
    reader = BagReader(tmp_path / "salvaged")
    assert [deserialize_message(m.cdr, String).data for m in reader.messages(["/info"])] == ["info 0", "info 5"]


def test_nothing_is_held_of_files_that_are_finished(tmp_path: Path) -> None:
    """Each has an index of its messages, which grows with the recording."""
    with BagWriter(tmp_path / "bag", packing=Packing(split_ns=1)) as bag:
        bag.add_topic("/samples", STRING)
        writers = []
        for second in range(5):
            bag.write("/samples", text("x"), second, second)
            writers.append(weakref.ref(bag._file))
        gc.collect()
        assert [writer() is not None for writer in writers] == [False] * 4 + [True]


KILLED = f"""
import os, signal, sys
from pathlib import Path
sys.path.insert(0, {str(Path(__file__).parent)!r})
import test_splits
from sal_height.bag.writer import BagWriter, Packing
class Killed(BagWriter):
    def close(self):
        self.flush()
        os.kill(os.getpid(), signal.SIGKILL)
test_splits.BagWriter = Killed
test_splits.write_bag(Path(sys.argv[1]), Packing(split_bytes=3 * test_splits.SIZE))
"""


def test_finished_files_of_a_killed_process_are_whole(tmp_path: Path) -> None:
    folder = tmp_path / "killed"
    done = subprocess.run([sys.executable, "-c", KILLED, str(folder)], check=False)  # noqa: S603 (our own program)
    assert done.returncode == -signal.SIGKILL
    for number in range(3):
        assert BagReader(folder / f"killed_{number}.mcap").topics["/samples"].count == 3
    recover(folder, tmp_path / "salvaged")
    times = [m.log_time_ns for m in BagReader(tmp_path / "salvaged").messages(["/samples"])]
    assert times == [second * SECOND for second in range(MESSAGES)]
    assert all(earlier < later for earlier, later in pairwise(times))
