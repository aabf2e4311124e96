"""What can be recovered after a kill, a cut or damage, and that nothing is invented."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import Reader
from std_msgs.msg import String

from sal_height.bag.file_writer import CHUNK_SIZE
from sal_height.bag.reader import BagReader
from sal_height.bag.salvage import salvage
from sal_height.bag.writer import BagWriter
from sal_height.errors import UserError

STRING = "std_msgs/msg/String"

KILLED = """
import os, signal, sys
from pathlib import Path
from rclpy.serialization import serialize_message
from std_msgs.msg import String
from sal_height.bag.writer import BagWriter

writer = BagWriter(Path(sys.argv[1]))
writer.add_topic("/greeting", "std_msgs/msg/String")
for i in range(100):
    writer.write("/greeting", serialize_message(String(data=f"number {i}")), i, i)
writer.flush()
writer.write("/greeting", serialize_message(String(data="not flushed")), 100, 100)
os.kill(os.getpid(), signal.SIGKILL)
"""


def greetings(count: int) -> list[bytes]:
    return [serialize_message(String(data=f"number {i}" + "." * 1000)) for i in range(count)]


def write_mcap(file: Path, messages: list[bytes], **options: Any) -> bytes:
    with file.open("wb") as stream:
        writer = Writer(stream, **options)
        writer.start(profile="ros2")
        schema = writer.register_schema(STRING, "ros2msg", b"string data")
        channel = writer.register_channel("/greeting", "cdr", schema)
        for i, message in enumerate(messages):
            writer.add_message(channel, i, message, i)
        writer.finish()
    return file.read_bytes()


def test_everything_flushed_before_a_kill_is_recovered(tmp_path: Path) -> None:
    command = [sys.executable, "-c", KILLED, str(tmp_path / "run")]
    process = subprocess.run(command, check=False, timeout=60)  # noqa: S603
    assert process.returncode == -signal.SIGKILL
    with pytest.raises(UserError, match="is cut off"):
        BagReader(tmp_path / "run")
    assert salvage(tmp_path / "run", tmp_path / "saved") == 100
    reader = BagReader(tmp_path / "saved")
    texts = [reader.decode(message.type_name, message.cdr).data for message in reader.messages()]
    assert texts == [f"number {i}" for i in range(100)]
    with Reader(tmp_path / "saved") as foreign:
        assert foreign.message_count == 100


@pytest.mark.parametrize(
    "options",
    [
        {"compression": CompressionType.NONE, "chunk_size": 5000},
        {"compression": CompressionType.NONE, "chunk_size": CHUNK_SIZE},
        {"compression": CompressionType.ZSTD, "chunk_size": 5000},
        {"compression": CompressionType.LZ4, "chunk_size": 5000},
        {"use_chunking": False},
    ],
)
def test_a_cut_file_gives_the_messages_before_the_cut(tmp_path: Path, options: dict[str, Any]) -> None:
    messages = greetings(30)
    file = tmp_path / "whole.mcap"
    data = write_mcap(file, messages, **options)
    saved_before = 0
    for number, size in enumerate(range(1, len(data) + 1, 997)):
        (tmp_path / "cut.mcap").write_bytes(data[:size])
        out = tmp_path / f"saved{number}"
        saved = salvage(tmp_path / "cut.mcap", out)
        assert [message.cdr for message in BagReader(out).messages()] == messages[:saved]
        assert saved >= saved_before
        if options.get("compression", CompressionType.NONE) == CompressionType.NONE:
            assert saved == sum(data.index(message) + len(message) <= size for message in messages)
        saved_before = saved
    assert salvage(file, tmp_path / "whole") == 30


def test_a_damaged_chunk_is_left_out_with_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    messages = greetings(30)
    file = tmp_path / "damaged.mcap"
    data = write_mcap(file, messages, chunk_size=5000, compression=CompressionType.NONE)
    file.write_bytes(data.replace(b"number 0", b"number X"))  # in the chunk that also describes the topic
    saved = salvage(file, tmp_path / "saved")
    assert 20 <= saved < 30
    assert [message.cdr for message in BagReader(tmp_path / "saved").messages()] == messages[-saved:]
    (warning,) = caplog.messages
    assert "A damaged chunk of" in warning


@pytest.fixture(scope="module")
def chunked(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, list[bytes]]:
    """A file of BagWriter with custom data, a topic without messages and four chunks of five messages; the messages."""
    folder = tmp_path_factory.mktemp("chunked") / "run"
    messages = [serialize_message(String(data=f"number {i}")) for i in range(20)]
    with BagWriter(folder, {"parameters": "{}"}) as writer:
        for topic in ("/greeting", "/silent"):
            writer.add_topic(topic, STRING)
        for i, message in enumerate(messages):
            writer.write("/greeting", message, i, i)
            if i % 5 == 4:
                writer.flush()
    return (folder / "run_0.mcap").read_bytes(), messages


def test_any_flipped_bit_costs_one_chunk_at_most_and_invents_nothing(
    tmp_path: Path, chunked: tuple[bytes, list[bytes]]
) -> None:
    """Except in the few bytes whose damage hides the rest: the lengths of the chunks, which no checksum protects."""
    data, messages = chunked
    rng = np.random.default_rng(14)
    saved, refused = [], 0
    for number in range(120):
        damaged = bytearray(data)
        damaged[rng.integers(len(data))] ^= 1 << rng.integers(8)
        (tmp_path / "damaged.mcap").write_bytes(damaged)
        out = tmp_path / str(number)
        try:
            count = salvage(tmp_path / "damaged.mcap", out)
        except UserError:  # the first bytes no longer say that it is a bag of ROS 2
            refused += 1
            continue
        reader = BagReader(out)
        found = [message.cdr for message in reader.messages()]
        saved.append(count)
        assert count == len(found)
        assert set(found) <= set(messages)
        assert set(reader.topics) <= {"/greeting", "/silent"}
        assert reader.custom_data in ({"parameters": "{}"}, {})
    assert refused + sum(count < 15 for count in saved) <= 5
    assert sum(count == 20 for count in saved) > 40


@pytest.mark.parametrize("cut", [0, 1])
def test_custom_data_and_topics_without_messages_survive(
    cut: int, tmp_path: Path, chunked: tuple[bytes, list[bytes]]
) -> None:
    """Of a whole file, and of one cut off."""
    data, _ = chunked
    (tmp_path / "run.mcap").write_bytes(data[: len(data) - cut])
    salvage(tmp_path / "run.mcap", tmp_path / "saved")
    reader = BagReader(tmp_path / "saved")
    assert {name: topic.count for name, topic in reader.topics.items()} == {"/greeting": 20, "/silent": 0}
    assert reader.custom_data == {"parameters": "{}"}


def test_a_damaged_length_ends_the_recovery(tmp_path: Path) -> None:
    messages = greetings(30)
    file = tmp_path / "damaged.mcap"
    data = bytearray(write_mcap(file, messages, use_chunking=False))
    record = data.index(messages[10]) - 22 - 8  # the length precedes the 22 bytes of a message's other fields
    data[record : record + 8] = b"\xff" * 8
    file.write_bytes(data)
    assert salvage(file, tmp_path / "saved") == 10


def test_type_hash_qos_and_times_survive(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "run") as writer:
        writer.add_topic("/greeting", STRING)
        writer.write("/greeting", greetings(1)[0], 5, 3)
    assert salvage(tmp_path / "run", tmp_path / "saved") == 1
    original, saved = BagReader(tmp_path / "run"), BagReader(tmp_path / "saved")
    assert saved.topics == original.topics
    assert list(saved.messages()) == list(original.messages())


def test_what_is_not_an_mcap_of_ros2_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    text, ros1 = tmp_path / "text.mcap", tmp_path / "ros1.mcap"
    text.write_text("no bag at all, but long enough")
    with ros1.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros1")
        writer.finish()
    with pytest.raises(UserError, match="is not an MCAP file"):
        salvage(text, tmp_path / "out")
    with pytest.raises(UserError, match="has the profile 'ros1'"):
        salvage(ros1, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_bag_is_not_salvaged_into_itself(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "run") as writer:
        writer.add_topic("/greeting", STRING)
    with pytest.raises(UserError, match="is not empty"):
        salvage(tmp_path / "run", tmp_path / "run")
