"""Files of `McapFile`: the bytes of the mcap package's Writer, and memory that is given back while one is written."""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from sal_height.bag.mcap_file import CHUNK_SIZE, McapFile
from sal_height.bag.reader import BagReader
from sal_height.bag.writer import BagWriter

STRING = "std_msgs/msg/String"

TYPES = {"none": CompressionType.NONE, "lz4": CompressionType.LZ4, "zstd": CompressionType.ZSTD}


def write_all(file: Any) -> None:
    """Messages of three topics, empty, small and larger than a chunk, their times in no order; metadata between."""
    rng = np.random.default_rng(0)
    file.add_metadata("first", {"a": "b"})
    schema = file.register_schema(STRING, "ros2msg", b"string data")
    channels = [file.register_channel(f"/{name}", "cdr", schema, {"name": name}) for name in "abc"]
    for number in range(100):
        size = (0, 1, 4000, CHUNK_SIZE // 3, CHUNK_SIZE, 3 * CHUNK_SIZE)[int(rng.integers(6)) if number % 9 == 0 else 2]
        file.add_message(channels[number % 3], int(rng.integers(1000)), rng.bytes(size), number, number % 2)
        if number == 50:
            file.flush()
            file.add_metadata("middle", {})
    file.register_channel("/late", "cdr", file.register_schema("std_msgs/msg/Bool", "ros2msg", b"bool data"), {})
    file.flush()
    file.add_metadata("last", {"c": "d"})
    file.finish()


@pytest.mark.parametrize("write", [write_all, lambda file: file.finish()], ids=["messages", "empty"])
@pytest.mark.parametrize("compression", TYPES)
def test_its_bytes_are_those_of_the_mcap_package(
    tmp_path: Path, compression: str, write: Callable[[Any], None]
) -> None:
    theirs, path = io.BytesIO(), tmp_path / "ours.mcap"
    writer = Writer(theirs, chunk_size=CHUNK_SIZE, compression=TYPES[compression])
    writer.start("ros2", "test")
    write(writer)
    with io.FileIO(path, "x") as stream:
        file = McapFile(stream, compression, "ros2", "test")
        write(file)
    assert file.size == path.stat().st_size
    assert path.read_bytes() == theirs.getvalue()


def test_all_is_written_where_the_system_accepts_a_part_of_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As Linux does when a disk has room for no more, or after 2 GB."""
    accepted = iter(range(1, 1_000_000, 777))
    write, whole, cut = os.writev, tmp_path / "whole.mcap", tmp_path / "cut.mcap"

    def write_some(file: int, parts: Sequence[bytes]) -> int:
        return os.write(file, b"".join(parts)[: next(accepted)])

    for path, accept in ((whole, write), (cut, write_some)):
        monkeypatch.setattr(os, "writev", accept)
        with io.FileIO(path, "x") as stream:
            write_all(McapFile(stream, "none", "ros2", "test"))
    assert cut.read_bytes() == whole.read_bytes()


def test_many_small_messages_are_written_together(tmp_path: Path) -> None:
    """A chunk of them has more parts than a system accepts at once."""
    with BagWriter(tmp_path / "run") as bag:
        bag.add_topic("/bytes", STRING)
        for number in range(3000):
            bag.write("/bytes", bytes([number % 256]), number, number)
    found = BagReader(tmp_path / "run").recorded_messages()
    assert [message.cdr[0] for message in found] == [number % 256 for number in range(3000)]


def test_memory_of_what_the_disk_has_is_given_back(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "run") as bag, bag.file.open("rb") as stream:
        bag.add_topic("/bytes", STRING)
        bag.write("/bytes", bytes(2 * CHUNK_SIZE), 0, 0)
        assert is_in_memory(stream.fileno())
        os.fdatasync(stream.fileno())
        bag.give_back()
        if is_in_memory(stream.fileno()):
            os.posix_fadvise(stream.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
            assert is_in_memory(stream.fileno()), "the writer has not given it back"
            pytest.skip("files of this folder are always in memory")
    bag.give_back()  # nothing more


def is_in_memory(file: int) -> bool:
    """True if a part of the start of a file can be read without its disk."""
    try:
        return os.preadv(file, [bytearray(1000)], CHUNK_SIZE // 2, os.RWF_NOWAIT) > 0
    except BlockingIOError:
        return False
