"""The records of an MCAP file, in the order of the mcap package's Writer, and without a copy of a message's bytes.

The Writer copies every message three times into buffers that it asks the system for anew: most of its time.
"""

from __future__ import annotations

import os
import struct
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from io import FileIO

import lz4.frame
import zstandard
from isal.isal_zlib import crc32
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

CHUNK_SIZE = 1 << 20  # bytes; a larger message becomes a chunk of its own

LARGEST_WRITE = 1 << 19
"""Bytes that are handed to the operating system at once: Linux puts more into pages of 2 MB, which it lacks and clears;
4 MB at once cost up to five times the processor time."""

MOST_PARTS = 1000
"""Parts that are handed to the operating system at once; POSIX systems accept 1024."""

COMPRESSIONS: dict[str, Callable[[bytes], bytes] | None] = {
    "none": None,
    "lz4": lz4.frame.compress,
    "zstd": zstandard.compress,
}
"""Compressions of chunks, by the names that users give. Noise and speckle hardly get smaller."""

MESSAGE_HEAD = struct.Struct("<BQHIQQ")
"""Kind and length of the record of a message, its channel, sequence, log time and publish time."""

CHUNK_HEAD = struct.Struct("<BQQQQII")
"""Kind and length of the record of a chunk, its first and last time, its size, checksum, and length of the name of its
compression; that name and the size of the compressed records follow."""

NO_CHECKSUM = bytes(4)
"""End of a footer without a checksum."""

INDEX_HEAD = struct.Struct("<BQHI")
"""Kind and length of the record of a message index, its channel, and size of the entries that follow."""

OF_RECORD = 9
"""Size of kind and length of a record, bytes."""


def _packed(records: Iterable[McapRecord]) -> bytes:
    """Records, as they are in the file."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())


def _index_record(channel: int, entries: Sequence[int]) -> bytes:
    """The record of a message index; the entries are log time, ns, and place of one message after the other."""
    size = 8 * len(entries)
    head = INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, INDEX_HEAD.size - OF_RECORD + size, channel, size)
    return head + struct.pack(f"<{len(entries)}Q", *entries)


def _pieces(parts: Iterable[bytes]) -> Iterator[bytes | memoryview]:
    """The parts, and pieces of those that are too large to be written at once."""
    for part in parts:
        if len(part) <= LARGEST_WRITE:
            yield part
        else:
            for start in range(0, len(part), LARGEST_WRITE):
                yield memoryview(part)[start : start + LARGEST_WRITE]


def _groups_to_write(parts: Iterable[bytes]) -> Iterator[list[bytes | memoryview]]:
    """Pieces of the parts, as many together as are written at once."""
    group, size = list[bytes | memoryview](), 0
    for piece in _pieces(parts):
        size += len(piece)
        if size > LARGEST_WRITE or len(group) == MOST_PARTS:
            yield group
            group, size = [], len(piece)
        group.append(piece)
    yield group


def _write_together(stream: FileIO, group: list[bytes | memoryview]) -> None:
    """Write pieces, also if the operating system accepts only some of their bytes at first.

    Raises:
        OSError: they cannot be written.
    """
    written = os.writev(stream.fileno(), group)
    if written < sum(map(len, group)):
        rest = memoryview(b"".join(group))[written:]
        while rest:
            rest = rest[os.write(stream.fileno(), rest) :]


@dataclass
class _Chunk:
    """Records that are gathered for a chunk.

    Attributes:
        parts: the records; a message is two of them, so that its bytes are not copied.
        size: size of the records, bytes.
        entries: log time, ns, and place of one message after the other, by channel.
    """

    parts: list[bytes] = field(default_factory=list)
    size: int = 0
    entries: dict[int, list[int]] = field(default_factory=dict)

    def add(self, record: bytes) -> None:
        """Append a record that is no message."""
        self.parts.append(record)
        self.size += len(record)

    def add_message(self, channel: int, sequence: int, log_time_ns: int, publish_time_ns: int, cdr: bytes) -> None:
        """Append a message."""
        length = MESSAGE_HEAD.size - OF_RECORD + len(cdr)
        head = MESSAGE_HEAD.pack(Opcode.MESSAGE, length, channel, sequence, log_time_ns, publish_time_ns)
        self.entries.setdefault(channel, []).extend((log_time_ns, self.size))
        self.parts.extend((head, cdr))
        self.size += OF_RECORD + length

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last log time, ns."""
        times = [entries[::2] for entries in self.entries.values()]
        return min(map(min, times)), max(map(max, times))

    @property
    def checksum(self) -> int:
        """CRC-32 of the records."""
        found = 0
        for part in self.parts:
            found = crc32(part, found)
        return found


class McapFile:
    """An MCAP file that is being written, with chunks and all indexes.

    Attributes:
        size: bytes of the file so far, without the chunk that is being gathered.
    """

    def __init__(self, stream: FileIO, compression: str, profile: str, library: str) -> None:
        """Start the file.

        Args:
            stream: file that is open for writing without a buffer, at its start.
            compression: compression of chunks, one of COMPRESSIONS.
            profile: name of the conventions that its channels follow.
            library: name of the program that writes it.

        Raises:
            OSError: it cannot be written.
        """
        self._stream, self.size = stream, 0
        self._compression, self._compress = compression.removeprefix("none"), COMPRESSIONS[compression]
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._counts = Counter[int]()
        self._chunk = _Chunk()
        self._chunks: list[ChunkIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._append(MCAP0_MAGIC, _packed([Header(profile, library)]))

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Add a type of messages, and return its number."""
        self._schemas.append(Schema(id=len(self._schemas) + 1, name=name, encoding=encoding, data=data))
        self._gather(_packed(self._schemas[-1:]))
        return len(self._schemas)

    def register_channel(self, topic: str, message_encoding: str, schema_id: int, metadata: dict[str, str]) -> int:
        """Add a topic, and return its number."""
        number = len(self._channels) + 1
        self._channels.append(Channel(number, topic, message_encoding, metadata, schema_id))
        self._gather(_packed(self._channels[-1:]))
        return number

    def add_message(self, channel: int, log_time_ns: int, cdr: bytes, publish_time_ns: int, sequence: int = 0) -> None:
        """Append a message of a channel; its bytes must not change any more."""
        self._chunk.add_message(channel, sequence, log_time_ns, publish_time_ns, cdr)
        self._counts[channel] += 1
        self._end_full_chunk()

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record at once."""
        record = _packed([Metadata(name=name, metadata=dict(values))])
        self._metadata.append(MetadataIndex(offset=self.size, length=len(record), name=name))
        self._append(record)

    def flush(self) -> None:
        """End the chunk that is being gathered, if it has a message: all is handed to the operating system."""
        self._end_chunk()

    def finish(self) -> None:
        """Write the indexes and the end of the file; the stream stays open."""
        self._end_chunk()
        self._append(_packed([DataEnd(0)]))
        start, summary, offsets = self.size, b"", list[SummaryOffset]()
        for kind, records in self._groups():
            group = _packed(records)
            offsets.append(SummaryOffset(kind, start + len(summary), len(group)))
            summary += group
        footer = _packed([Footer(start, start + len(summary), 0)]).removesuffix(NO_CHECKSUM)
        summary += _packed(offsets)
        checksum = crc32(footer, crc32(summary))
        self._append(summary, footer, struct.pack("<I", checksum), MCAP0_MAGIC)

    def _groups(self) -> Sequence[tuple[Opcode, Sequence[McapRecord]]]:
        """Records of the summary."""
        spans = [(index.message_start_time, index.message_end_time) for index in self._chunks] or [(0, 0)]
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunks),
            message_count=self._counts.total(),
            message_start_time=min(first for first, _ in spans),
            message_end_time=max(last for _, last in spans),
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        return (
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.ATTACHMENT_INDEX, []),
            (Opcode.METADATA_INDEX, self._metadata),
        )

    def _gather(self, record: bytes) -> None:
        """Append a record that is no message to the chunk."""
        self._chunk.add(record)
        self._end_full_chunk()

    def _end_full_chunk(self) -> None:
        if self._chunk.size > CHUNK_SIZE:
            self._end_chunk()

    def _end_chunk(self) -> None:
        """Write the chunk that is being gathered, with its index, if it has a message."""
        chunk = self._chunk
        if not chunk.entries:
            return
        first_ns, last_ns = chunk.span_ns
        parts = [self._compress(b"".join(chunk.parts))] if self._compress else chunk.parts
        packed_size = sum(map(len, parts)) if self._compress else chunk.size
        name = self._compression.encode()
        length = CHUNK_HEAD.size - OF_RECORD + len(name) + 8 + packed_size
        head = CHUNK_HEAD.pack(Opcode.CHUNK, length, first_ns, last_ns, chunk.size, chunk.checksum, len(name))
        start, after = self.size, self.size + OF_RECORD + length
        indexes, offsets, index_size = [], {}, 0
        for channel, entries in chunk.entries.items():
            offsets[channel] = after + index_size
            indexes.append(_index_record(channel, entries))
            index_size += len(indexes[-1])
        self._append(head, name, struct.pack("<Q", packed_size), *parts, *indexes)
        self._chunks.append(
            ChunkIndex(
                message_start_time=first_ns,
                message_end_time=last_ns,
                chunk_start_offset=start,
                chunk_length=after - start,
                message_index_offsets=offsets,
                message_index_length=index_size,
                compression=self._compression,
                compressed_size=packed_size,
                uncompressed_size=chunk.size,
            )
        )
        self._chunk = _Chunk()

    def _append(self, *parts: bytes) -> None:
        """Write parts."""
        for group in _groups_to_write(parts):
            _write_together(self._stream, group)
        self.size += sum(map(len, parts))
