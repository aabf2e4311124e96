"""Messages of the chunks of a file: in the order of the mcap package, and none of a damaged chunk."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import SeekingReader
from mcap.stream_reader import CRCValidationError

from sal_height.bag.chunks import messages_in_order
from sal_height.bag.files import read_index
from sal_height.bag.mcap_file import McapFile


def written(path: Path, compression: str) -> None:
    """Two topics in chunks that overlap in time, with many messages of one time."""
    rng = np.random.default_rng(0)
    with io.FileIO(path, "x") as stream:
        file = McapFile(stream, compression, "ros2", "test")
        schema = file.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channels = [file.register_channel(f"/{name}", "cdr", schema, {}) for name in "ab"]
        for number in range(60):
            file.add_message(channels[number % 2], number // 10 * 10 + int(rng.integers(20)), bytes([number]) * 40, 0)
            if number % 7 == 0:
                file.flush()
        file.finish()


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
@pytest.mark.parametrize("topics", [{"/a", "/b"}, {"/b"}])
@pytest.mark.parametrize(("first_ns", "last_ns"), [(0, 1000), (22, 40)])
def test_the_order_is_that_of_the_mcap_package(
    tmp_path: Path, compression: str, topics: set[str], first_ns: int, last_ns: int
) -> None:
    path = tmp_path / "file.mcap"
    written(path, compression)
    summary = read_index(path).summary
    channels = {number for number, channel in summary.channels.items() if channel.topic in topics}
    with path.open("rb") as stream:
        found = [(one.log_time, one.data) for one in messages_in_order(stream, summary, channels, first_ns, last_ns)]
        stream.seek(0)
        reader = SeekingReader(stream, validate_crcs=True)
        theirs = reader.iter_messages(topics, starting_at=first_ns, ending_at=last_ns)
        assert found == [(message.log_time, message.data) for _, _, message in theirs]
    assert len(found) > 5
    assert last_ns == 1000 or {first_ns, last_ns} <= {time_ns for time_ns, _ in found}


def test_one_wrong_bit_is_found(tmp_path: Path) -> None:
    path = tmp_path / "file.mcap"
    written(path, "none")
    summary = read_index(path).summary
    damaged = bytearray(path.read_bytes())
    damaged[damaged.index(bytes([20]) * 40) + 7] ^= 1
    with pytest.raises(CRCValidationError):
        list(messages_in_order(io.BytesIO(damaged), summary, summary.channels.keys(), 0, 1000))
