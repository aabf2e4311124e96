"""What can be recovered after a kill, a cut or damage, and that nothing is invented."""

from __future__ import annotations

import shutil
import signal
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import few
from mcap.opcode import Opcode
from mcap.writer import CompressionType, Writer
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import Reader
from std_msgs.msg import String

from sal_height.bag.files import read_index
from sal_height.bag.mcap_file import CHUNK_SIZE
from sal_height.bag.qos import TRANSIENT_LOCAL, Qos
from sal_height.bag.reader import BagReader
from sal_height.bag.salvage import UNKNOWN, recover
from sal_height.bag.writer import BagWriter, Packing
from sal_height.commands import main
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
    process = subprocess.run(command, check=False)  # noqa: S603
    assert process.returncode == -signal.SIGKILL
    with pytest.raises(UserError, match="is cut off"):
        BagReader(tmp_path / "run")
    assert recover(tmp_path / "run", tmp_path / "saved").count == 100
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
        saved = recover(tmp_path / "cut.mcap", out).count
        assert [message.cdr for message in BagReader(out).messages()] == messages[:saved]
        assert saved >= saved_before
        if options.get("compression", CompressionType.NONE) == CompressionType.NONE:
            assert saved == sum(data.index(message) + len(message) <= size for message in messages)
        saved_before = saved
    assert recover(file, tmp_path / "whole").count == 30


def test_a_damaged_chunk_is_left_out_and_accounted_for(tmp_path: Path) -> None:
    """By offset and size, and by the messages that the indexes name; those of the file whole or cut."""
    messages = greetings(30)
    file = tmp_path / "damaged.mcap"
    data = write_mcap(file, messages, chunk_size=5000, compression=CompressionType.NONE)
    chunk = read_index(file).summary.chunk_indexes[0]
    damaged = data.replace(b"number 0", b"number X")  # in the chunk that also describes the topic
    file.write_bytes(damaged)
    recovery = recover(file, tmp_path / "saved")
    assert 20 <= recovery.count < 30
    assert [message.cdr for message in BagReader(tmp_path / "saved").messages()] == messages[-recovery.count :]
    (gap,) = recovery.gaps
    assert (gap.file, gap.offset, gap.size) == (file, chunk.chunk_start_offset, chunk.chunk_length)
    assert gap.lost == recovery.lost == {"/greeting": 30 - recovery.count}
    assert "a damaged chunk (crc" in gap.reason
    assert str(gap).endswith(f"they contained {30 - recovery.count} messages on /greeting.")
    file.write_bytes(damaged[:-1])  # without the index nothing describes the topic
    recovery = recover(file, tmp_path / "cut")
    assert recovery.count == 0
    assert recovery.lost == {UNKNOWN: 30}


@pytest.mark.parametrize("shift", [1, 9, 1000])
def test_behind_a_damaged_length_the_index_finds_the_next_chunk(tmp_path: Path, shift: int) -> None:
    """That of a chunk itself does no harm; behind that of another record the next chunk is found."""
    messages = greetings(30)
    file = tmp_path / "damaged.mcap"
    data = write_mcap(file, messages, chunk_size=5000, compression=CompressionType.NONE)
    first, second, *_ = read_index(file).summary.chunk_indexes
    ends = first.chunk_start_offset + first.chunk_length
    for place, gap in ((first.chunk_start_offset, []), (ends, [(ends, second.chunk_start_offset)])):
        damaged = bytearray(data)
        (length,) = struct.unpack_from("<Q", damaged, place + 1)
        struct.pack_into("<Q", damaged, place + 1, length + shift)
        file.write_bytes(damaged)
        recovery = recover(file, tmp_path / f"saved{place}")
        assert recovery.count == 30
        assert not recovery.lost
        assert [(one.offset, one.offset + one.size) for one in recovery.gaps] == gap
    assert recovery.is_whole is False


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


@pytest.mark.parametrize("cut", [0, 1])
def test_custom_data_and_topics_without_messages_survive(
    cut: int, tmp_path: Path, chunked: tuple[bytes, list[bytes]]
) -> None:
    """Of a whole file, and of one cut off."""
    data, _ = chunked
    (tmp_path / "run.mcap").write_bytes(data[: len(data) - cut])
    recover(tmp_path / "run.mcap", tmp_path / "saved")
    reader = BagReader(tmp_path / "saved")
    assert {name: topic.count for name, topic in reader.topics.items()} == {"/greeting": 20, "/silent": 0}
    assert reader.custom_data == {"parameters": "{}"}


def test_without_chunks_a_damaged_length_ends_the_recovery(tmp_path: Path) -> None:
    messages = greetings(30)
    file = tmp_path / "damaged.mcap"
    data = bytearray(write_mcap(file, messages, use_chunking=False))
    record = data.index(messages[10]) - 22 - 8  # the length precedes the 22 bytes of a message's other fields
    data[record : record + 8] = b"\xff" * 8
    file.write_bytes(data)
    assert recover(file, tmp_path / "saved").count == 10


def test_type_hash_qos_and_times_survive(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "run") as writer:
        writer.add_topic("/greeting", STRING)
        writer.write("/greeting", greetings(1)[0], 5, 3)
    assert recover(tmp_path / "run", tmp_path / "saved").count == 1
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
        recover(text, tmp_path / "out")
    with pytest.raises(UserError, match="has the profile 'ros1'"):
        recover(ros1, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_bag_is_not_salvaged_into_itself(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "run") as writer:
        writer.add_topic("/greeting", STRING)
    with pytest.raises(UserError, match="is not empty"):
        recover(tmp_path / "run", tmp_path / "run")


def test_of_a_file_without_checksums_nothing_is_missed(tmp_path: Path) -> None:
    """As rosbag2 writes with noChunkCRC."""
    messages = greetings(30)
    file = tmp_path / "plain.mcap"
    data = write_mcap(file, messages, chunk_size=5000, compression=CompressionType.NONE, enable_crcs=False)
    recovery = recover(file, tmp_path / "whole")
    assert (recovery.count, recovery.is_whole) == (30, True)
    file.write_bytes(data[: len(data) // 2])
    cut = recover(file, tmp_path / "cut")
    assert 10 < cut.count < 20
    (gap,) = cut.gaps
    assert gap.reason == "the file ends within a chunk"
    assert gap.offset + gap.size == len(data) // 2
    assert gap.size < len(messages[0]) + 100


def mixed_bag(folder: Path, compression: str) -> tuple[bytes, set[tuple[str, bytes, int, int]]]:
    """A small bag of two topics, a latched one among them, in two dozen chunks: bytes of its file, and its messages."""
    latched = [Qos(depth=1, durability=TRANSIENT_LOCAL)]
    with BagWriter(folder, {"parameters": "{}"}, Packing(compression)) as writer:
        writer.add_topic("/notes", STRING, latched)
        writer.add_topic("/greeting", STRING)
        for i in range(60):
            topic = "/notes" if i % 20 == 0 else "/greeting"
            writer.write(topic, serialize_message(String(data=f"number {i}" * (1 + i % 7))), 1000 + i, 990 + i)
            if i % 3 == 2:
                writer.flush()
    (file,) = folder.glob("*.mcap")
    messages = {(m.topic, m.cdr, m.log_time_ns, m.publish_time_ns) for m in BagReader(folder).messages()}
    return file.read_bytes(), messages


def saved_by_command(data: bytes, tmp_path: Path) -> tuple[int, set[tuple[str, bytes, int, int]], int]:
    """Status of `sal-height bag recover` on a file with these bytes, the messages in the new bag, and their number."""
    out, file = tmp_path / "out", tmp_path / "damaged.mcap"
    shutil.rmtree(out, ignore_errors=True)
    file.write_bytes(data)
    status = main(["bag", "recover", str(file), "--out", str(out)])
    if status == 2:
        assert not out.exists() or not list(BagReader(out).messages())
        return status, set(), 0
    found = [(m.topic, m.cdr, m.log_time_ns, m.publish_time_ns) for m in BagReader(out).messages()]
    return status, set(found), len(found)


@pytest.mark.parametrize("compression", few(1, ["none", "zstd"]))
def test_wherever_a_file_is_cut_what_precedes_the_cut_is_recovered(compression: str, tmp_path: Path) -> None:
    """Status 2 where there is no beginning of a bag, 1 where a record is cut, 0 if what lacks is the index alone."""
    data, messages = mixed_bag(tmp_path / "bag", compression)
    index = read_index(tmp_path / "bag" / "bag_0.mcap")
    starts = [chunk.chunk_start_offset for chunk in index.summary.chunk_indexes]
    ends = [start + chunk.chunk_length for start, chunk in zip(starts, index.summary.chunk_indexes, strict=True)]
    saved_before, statuses = 0, set()
    for size in sorted({*np.linspace(0, len(data), 180, dtype=int).tolist(), *ends}):
        status, found, count = saved_by_command(data[:size], tmp_path)
        assert found <= messages
        assert count == len(found)
        assert count >= max(saved_before, 3 * sum(end <= size for end in ends))
        saved_before = count
        statuses.add(status)
        if status == 2:
            assert size < 8
        if size in ends or size == len(data):
            assert status == 0
        if any(start < size < end for start, end in zip(starts, ends, strict=True)):
            assert status == 1
    assert saved_before == len(messages)
    assert statuses == {0, 1, 2}


@pytest.mark.parametrize("compression", few(1, ["none", "lz4"]))
def test_whatever_byte_is_damaged_no_message_is_changed_and_the_account_is_right(
    compression: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two hundred and forty bytes in all; one chunk of three messages is lost at most, and status 1 says so."""
    data, messages = mixed_bag(tmp_path / "bag", compression)
    known = set(BagReader(tmp_path / "bag").topics)
    rng = np.random.default_rng(7)
    lossless = refused = 0
    for _ in range(120):
        damaged = bytearray(data)
        damaged[rng.integers(len(data))] ^= rng.integers(1, 256)
        status, found, count = saved_by_command(bytes(damaged), tmp_path)
        said = capsys.readouterr()
        if status == 2:  # the first bytes no longer say that it is a bag of ROS 2
            refused += 1
            assert said.err.count("\n") == 1
            continue
        assert found <= messages
        assert count == len(found) >= len(messages) - 3
        reader = BagReader(tmp_path / "out")
        assert reader.custom_data in ({"parameters": "{}"}, {})
        assert set(reader.topics) <= known
        assert f"{count} messages recovered" in said.out
        if count < len(messages):
            assert status == 1
        lossless += status == 0
        lost = sum(int(line.split()[2]) for line in said.out.splitlines() if line.startswith("/"))
        assert lost == len(messages) - count
    assert refused <= 3
    assert 24 < lossless < 117


@pytest.mark.parametrize("compression", ["lz4", "zstd"])
@pytest.mark.parametrize("part", [0.0, 0.5])
def test_a_chunk_that_cannot_be_decompressed_is_left_out(
    part: float, compression: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One byte is damaged of the compressed records: the first of all, and one in the middle."""
    data, messages = mixed_bag(tmp_path / "bag", compression)
    chunk = read_index(tmp_path / "bag" / "bag_0.mcap").summary.chunk_indexes[5]
    damaged = bytearray(data)
    damaged[chunk.chunk_start_offset + chunk.chunk_length - round((1 - part) * chunk.compressed_size)] ^= 0xFF
    status, found, count = saved_by_command(bytes(damaged), tmp_path)
    assert (status, count, len(found)) == (1, len(messages) - 3, len(messages) - 3)
    assert found <= messages
    assert f"{count} messages recovered" in capsys.readouterr().out


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
@pytest.mark.parametrize("shift", [-30, -1, 1, 1000, 10**6, 2**62])
def test_behind_a_damaged_length_the_next_chunk_is_found_without_an_index(
    tmp_path: Path, shift: int, compression: str
) -> None:
    """As of a recorder that was killed; at most the three messages are lost of the chunk whose length is damaged."""
    data, messages = mixed_bag(tmp_path / "bag", compression)
    chunks = read_index(tmp_path / "bag" / "bag_0.mcap").summary.chunk_indexes
    killed = data[: chunks[-1].chunk_start_offset + chunks[-1].chunk_length - 1]
    of_chunk, of_index = chunks[5].chunk_start_offset, chunks[5].chunk_start_offset + chunks[5].chunk_length
    cut = 3 if compression != "none" else 1
    for place, lost in ((of_chunk, cut + 3), (of_index, cut)):
        damaged = bytearray(killed)
        (length,) = struct.unpack_from("<Q", damaged, place + 1)
        struct.pack_into("<Q", damaged, place + 1, max(0, length + shift))
        status, found, count = saved_by_command(bytes(damaged), tmp_path)
        assert status == 1
        assert found <= messages
        assert len(messages) - lost <= count <= len(messages) - cut


def test_what_damage_makes_of_a_chunk_is_no_message(tmp_path: Path) -> None:
    """Without the index: an opcode that says that a chunk is a message, and a chunk whose checksum says there is none.

    The chunk begins with its first log time, 1: as a message it would be of channel 1.
    """
    messages = greetings(30)
    file = tmp_path / "damaged.mcap"
    data = write_mcap(file, messages, chunk_size=5000, compression=CompressionType.NONE)
    first, second, *_ = (chunk.chunk_start_offset for chunk in read_index(file).summary.chunk_indexes)
    start = struct.unpack_from("<Q", data, second + 9)[0]
    disguised = bytearray(data)
    disguised[second] = Opcode.MESSAGE
    struct.pack_into("<H", disguised, second + 9, 1)
    unchecked = bytearray(data.replace(f"number {start}.".encode(), f"number {start}?".encode()))
    struct.pack_into("<I", unchecked, second + 9 + 24, 0)
    for number, damaged in enumerate((disguised, unchecked)):
        file.write_bytes(damaged[:-1])
        recovery = recover(file, tmp_path / str(number))
        found = [message.cdr for message in BagReader(tmp_path / str(number)).messages()]
        assert set(found) < set(messages)
        assert found[:start] == messages[:start]
        assert [gap.offset for gap in recovery.gaps] == [second]
    assert first < second
