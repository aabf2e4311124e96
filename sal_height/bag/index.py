"""The index of an MCAP file: its content and the reception of its messages, without reading the messages."""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import ChunkIndex, Header, Statistics
from mcap.stream_reader import StreamReader
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from sal_height.bag.files import check_profile, check_start, check_summary_crc
from sal_height.bag.salvage import HEAD
from sal_height.errors import UserError
from sal_height.numeric import I64

_MESSAGE_INDEX_HEAD = struct.Struct("<HI")
"""Channel of a message index, and bytes of its entries."""

_ENTRY = np.dtype([("log_time", "<u8"), ("offset", "<u8")])


@dataclass(frozen=True)
class FileIndex:
    """The index of a complete file.

    Attributes:
        path: path of the file.
        size: size of the file, bytes.
        summary: schemas, channels and chunks.
        statistics: counts and times of all messages.
        records: metadata records by name.
    """

    path: Path
    size: int
    summary: Summary
    statistics: Statistics
    records: Mapping[str, Mapping[str, str]]


def read_index(file: Path) -> FileIndex:
    """Read the index of a file.

    Raises:
        UserError: it cannot be read, or it is not a complete file of ROS 2.
    """
    try:
        with file.open("rb") as stream:
            _check_complete(file, stream)
            summary, statistics = _read_summary(file, stream)
            return FileIndex(file, file.stat().st_size, summary, statistics, _read_records(file, stream))
    except OSError as error:
        raise UserError(f"File {file} cannot be read: {error.strerror}.") from error


def read_log_times(index: FileIndex) -> dict[str, I64] | None:
    """Reception of the messages of each topic, ns, in order; topics without messages are left out.

    Only the message indexes are read, which follow each chunk.

    Returns:
        Log times by topic; None if the file has no message indexes, or they do not have all messages.

    Raises:
        UserError: the file is damaged or cannot be read.
    """
    found: dict[str, list[I64]] = defaultdict(list)
    try:
        with index.path.open("rb", buffering=0) as stream:
            for chunk in index.summary.chunk_indexes:
                for channel_id, entries in read_message_indexes(stream, chunk):
                    log_times = entries["log_time"].astype(np.int64)
                    found[index.summary.channels[channel_id].topic].append(log_times)
    except OSError as error:
        raise UserError(f"File {index.path} cannot be read: {error.strerror}.") from error
    except (McapError, struct.error, KeyError, ValueError) as error:
        raise damaged(index.path, error) from error
    times = {topic: np.sort(np.concatenate(parts)) for topic, parts in found.items()}
    complete = sum(len(one) for one in times.values()) == index.statistics.message_count
    return times if complete else None


def read_message_indexes(stream: BinaryIO, chunk: ChunkIndex) -> Iterator[tuple[int, NDArray[np.void]]]:
    """Channel of each message index of a chunk, and its entries: fields `log_time` (ns) and `offset` (bytes).

    Raises:
        McapError, struct.error, ValueError: they are absent where the index of the file states them.
    """
    stream.seek(chunk.chunk_start_offset + chunk.chunk_length)
    block = stream.read(chunk.message_index_length)
    place = 0
    while place < len(block):
        opcode, length = HEAD.unpack_from(block, place)
        body = place + HEAD.size
        channel_id, size = _MESSAGE_INDEX_HEAD.unpack_from(block, body)
        if opcode != Opcode.MESSAGE_INDEX or size != length - _MESSAGE_INDEX_HEAD.size:
            raise McapError(
                f"there is no message index at byte {chunk.chunk_start_offset + chunk.chunk_length + place}"
            )
        yield channel_id, np.frombuffer(block, _ENTRY, size // _ENTRY.itemsize, body + _MESSAGE_INDEX_HEAD.size)
        place = body + length


def damaged(file: Path, error: Exception) -> UserError:
    """The message on a file that is damaged."""
    return UserError(f"File {file} is damaged ({error or type(error).__name__}); {_remedy(file)} recovers the rest.")


def _check_complete(file: Path, stream: BinaryIO) -> None:
    magic_size = len(MCAP0_MAGIC)
    check_start(file, stream.read(magic_size))
    stream.seek(max(magic_size, file.stat().st_size - magic_size))
    if stream.read() != MCAP0_MAGIC:
        raise UserError(
            f"File {file} is cut off (the recording process was killed or the disk was full); "
            f"{_remedy(file)} recovers what precedes the cut."
        )


def _read_summary(file: Path, stream: BinaryIO) -> tuple[Summary, Statistics]:
    """Index of a complete file; UserError if it is of another profile, damaged or missing."""
    try:
        check_summary_crc(stream)
        stream.seek(0)
        header = next(StreamReader(stream).records)
        stream.seek(0)
        summary = SeekingReader(stream).get_summary()
    except Exception as error:  # mcap reports damage by any exception of its parser
        raise damaged(file, error) from error
    check_profile(file, header.profile if isinstance(header, Header) else "")
    statistics = summary.statistics if summary else None
    if summary is None or statistics is None or (statistics.message_count and not summary.chunk_indexes):
        raise UserError(f"File {file} has no index of its messages; {_remedy(file)} writes a copy that has one.")
    missing = {channel.schema_id for channel in summary.channels.values()} - {0, *summary.schemas}
    if missing or not set(statistics.channel_message_counts) <= set(summary.channels):
        raise damaged(file, McapError("the index names topics that it does not describe"))
    return summary, statistics


def _read_records(file: Path, stream: BinaryIO) -> dict[str, dict[str, str]]:
    """Metadata records of a complete file, by name."""
    try:
        return {record.name: record.metadata for record in SeekingReader(stream).iter_metadata()}
    except Exception as error:  # mcap reports damage by any exception of its parser
        raise damaged(file, error) from error


def _remedy(file: Path) -> str:
    return f"'sal-height salvage {file} --out DIR'"
