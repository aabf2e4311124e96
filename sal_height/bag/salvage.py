"""Make a valid bag of one that is cut off by a killed process or a full disk, damaged, or without index.

Nothing is invented: of a chunk whose checksum is wrong no message is copied. Files of other programs may have no
checksums; damage to the messages themselves cannot be recognized there.
"""

from __future__ import annotations

import bisect
import mmap
import os
import re
import struct
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, Header, Message, Metadata, Schema
from mcap.stream_reader import get_chunk_data_stream
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC

from sal_height.bag.files import (
    CHUNK_FIELDS,
    CUSTOM_DATA,
    HEAD,
    INDEX_ENTRY,
    INDEX_HEAD,
    REPEATED_SEQUENCE,
    bag_files,
    check_encoding,
    check_profile,
    check_start,
    check_summary_crc,
    custom_data_of,
    recorded_definition,
    recorded_qos,
    repeated_in,
)
from sal_height.bag.writer import BagWriter
from sal_height.errors import UserError
from sal_height.tables import aligned

UNKNOWN = "(unknown)"
"""Text in place of the topic of messages whose channel is no longer described."""

OPCODES = frozenset(Opcode)

COMPRESSION = HEAD.size + 28
"""Position of the name of the compression in a chunk: after times, size and checksum."""

LENGTH = struct.Struct("<Q")

CHUNK = re.compile(rb"(?=%c.{%d}(?:\0{4}|\x03\0{3}lz4|\x04\0{3}zstd))" % (Opcode.CHUNK, COMPRESSION - 1), re.DOTALL)
"""Start of a chunk, at every position."""


@dataclass(frozen=True)
class Gap:
    """A part of a file that could not be read.

    Attributes:
        file: file of the bag.
        offset: position of its first byte.
        size: size, bytes.
        reason: reason in words.
        lost: number of lost messages by topic, as far as the index of the chunk states it; else empty.
    """

    file: Path
    offset: int
    size: int
    reason: str
    lost: Mapping[str, int] = field(default_factory=dict, compare=False)

    def __str__(self) -> str:
        text = f"{self.size} bytes at byte {self.offset} of {self.file} could not be read: {self.reason}"
        counts = ", ".join(f"{count} messages on {topic}" for topic, count in sorted(self.lost.items()))
        return f"{text}; they contained {counts}." if counts else f"{text}."


@dataclass(frozen=True)
class Recovery:
    """Result of a recovery.

    Attributes:
        recovered: number of messages in the new bag by topic, topics without messages included.
        lost: number of messages that are known to be lost, by topic.
        gaps: parts of the files that could not be read.
    """

    recovered: Counter[str]
    lost: Counter[str]
    gaps: Sequence[Gap]

    @property
    def count(self) -> int:
        """Messages in the new bag."""
        return self.recovered.total()

    @property
    def is_whole(self) -> bool:
        """True if nothing is lost, as far as is known."""
        return not (self.gaps or self.lost)


def recovery_table(recovery: Recovery) -> str:
    """Messages recovered and lost, by topic, as lines of text."""
    topics = sorted({*recovery.recovered, *recovery.lost})
    rows = [[topic, str(recovery.recovered[topic]), str(recovery.lost[topic])] for topic in topics]
    return aligned([["topic", "recovered", "known lost"], *rows])


@dataclass(frozen=True)
class RecordSpan:
    """A record of a file, or a part of it that is no record.

    Attributes:
        offset: position of its first byte in the file.
        size: number of its bytes that are in the file, opcode and length included.
        opcode: opcode of the record; None: no record can be recognized.
        whole: True if all of it is in the file.
    """

    offset: int
    size: int
    opcode: int | None
    whole: bool = True

    def read(self, stream: BinaryIO) -> bytes:
        """The body of the record, as far as it is in the file."""
        stream.seek(self.offset + HEAD.size)
        return stream.read(self.size - HEAD.size)


def sound_summary(stream: BinaryIO) -> Summary | None:
    """The index at the end of a complete file, where damage to a chunk does not reach; None if it is not sound."""
    try:
        check_summary_crc(stream)
        stream.seek(0)
        return SeekingReader(stream).get_summary()
    except Exception:  # noqa: BLE001 - a cut file has none, and mcap may raise anything
        return None


def spans(stream: BinaryIO, summary: Summary | None) -> Iterator[RecordSpan]:
    """The records of a file, up to its index, its end or its cut.

    Records are found by the lengths of those before them. Where a length or an opcode is damaged, the next chunk is
    found by the index, or, if there is no sound one, by its own lengths. A file without chunks is lost from there on.
    """
    indexed = {chunk.chunk_start_offset: chunk.chunk_length for chunk in summary.chunk_indexes} if summary else {}
    chunks = indexed or find_chunks(stream)
    starts = sorted(chunks)
    end = stream.seek(0, os.SEEK_END)
    place = len(MCAP0_MAGIC)
    while place < end:
        if place in chunks and place + chunks[place] <= end:
            yield RecordSpan(place, chunks[place], Opcode.CHUNK)
            place += chunks[place]
            continue
        after = bisect.bisect_right(starts, place)
        limit = starts[after] if after < len(starts) else end
        span = _span(stream, place, limit, is_open=limit == end, has_chunks=bool(indexed))
        yield span
        if span.opcode == Opcode.DATA_END and span.whole:
            return
        place += span.size


def counts_of_index(span: RecordSpan, stream: BinaryIO) -> tuple[int, int] | None:
    """Channel and number of messages of a message index; None if its lengths contradict each other."""
    body = span.read(stream)
    if len(body) < INDEX_HEAD.size:
        return None
    channel_id, size = INDEX_HEAD.unpack_from(body)
    return (channel_id, size // INDEX_ENTRY.itemsize) if size == len(body) - INDEX_HEAD.size else None


def _span(stream: BinaryIO, place: int, limit: int, *, is_open: bool, has_chunks: bool) -> RecordSpan:
    """The record at `place`, or all up to `limit`, if it is no record.

    Args:
        stream: stream of the file.
        place: position in the file, bytes.
        limit: start of the next chunk, or end of the file.
        is_open: True if the limit is the end of the file, at which a record may be cut.
        has_chunks: True if an index names all chunks, so that none is here.
    """
    stream.seek(place)
    head = stream.read(HEAD.size)
    lost = RecordSpan(place, limit - place, None)
    if len(head) < HEAD.size:
        return lost
    opcode, length = HEAD.unpack(head)
    if not is_known(opcode) or (has_chunks and opcode in (Opcode.CHUNK, Opcode.MESSAGE)):
        return lost
    following = place + HEAD.size + length
    if following <= limit:
        return RecordSpan(place, HEAD.size + length, opcode)
    return RecordSpan(place, limit - place, opcode, whole=False) if is_open and not has_chunks else lost


def is_known(opcode: int) -> bool:
    """True if there are records with this opcode."""
    return opcode in OPCODES or opcode >= 0x80  # of private records, which may be anywhere


def find_chunks(stream: BinaryIO) -> dict[int, int]:
    """Offsets of the chunks of a file, and their bytes.

    Records follow from each other by their lengths. Where one does not lead to another, or is a chunk whose lengths
    contradict each other, the next chunk whose lengths agree is searched.
    """
    with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        return _find_chunks(data)


def _find_chunks(data: mmap.mmap) -> dict[int, int]:
    chunks, place = {}, len(MCAP0_MAGIC)
    while place < len(data):
        following = _following(data, place)
        leads_on = following == len(data) or _following(data, following) > 0
        is_chunk = data[place] == Opcode.CHUNK
        if (is_chunk and _is_sound_chunk(data, place)) or (is_chunk and following and leads_on):
            chunks[place] = following - place
        elif not (following and leads_on):
            following = min(following or len(data), _next_chunk(data, place + 1))
        place = following
    return chunks


def _following(data: mmap.mmap, place: int) -> int:
    """End of a record that may start at a position; 0: no record that ends in the file."""
    if not 0 < place <= len(data) - HEAD.size:
        return 0
    opcode, length = HEAD.unpack_from(data, place)
    end = place + HEAD.size + length
    return end if is_known(opcode) and end <= len(data) else 0


def _is_sound_chunk(data: mmap.mmap, place: int) -> bool:
    """True if a whole chunk starts at a position: its length and those of its parts agree."""
    end = _following(data, place)
    if not end or end - place < COMPRESSION + 4 + LENGTH.size:
        return False
    (name,) = struct.unpack_from("<I", data, place + COMPRESSION)
    records = place + COMPRESSION + 4 + name + LENGTH.size
    return records <= end and records + LENGTH.unpack_from(data, records - LENGTH.size)[0] == end


def _next_chunk(data: mmap.mmap, place: int) -> int:
    """Start of the next sound chunk; the end of the file if there are no more."""
    found = (match.start() for match in CHUNK.finditer(data, place))
    return next((start for start in found if _is_sound_chunk(data, start)), len(data))


def recover(path: Path, out_directory: Path) -> Recovery:
    """Copy every whole message of the bag at `path` into a new bag in `out_directory`.

    Reads up to the cut, if there is one, and leaves out chunks and records that are damaged. Topics without messages
    and the custom data (the parameters of a run) are copied too.

    Raises:
        UserError: `path` is no MCAP bag of ROS 2, or `out_directory` is not empty.
    """
    files = bag_files(path)
    for file in files:
        _check_header(file)
    recovered, lost, gaps = Counter[str](), Counter[str](), list[Gap]()
    with BagWriter(out_directory, _custom_data(files)) as bag:
        for file in files:
            try:
                with file.open("rb") as stream:
                    found = _FileCopy(file, stream, bag).run()
            except OSError as error:
                raise UserError(f"File {file} cannot be salvaged to {out_directory}: {error}.") from error
            recovered.update(found.recovered)  # unlike a sum, it keeps topics without messages
            lost += found.lost
            gaps += found.gaps
    return Recovery(recovered, lost, gaps)


def _check_header(file: Path) -> None:
    try:
        with file.open("rb") as stream:
            check_start(file, stream.read(len(MCAP0_MAGIC)))
            first = next(spans(stream, None), RecordSpan(0, 0, Opcode.HEADER, whole=False))
            body = first.read(stream) if first.whole and first.opcode == Opcode.HEADER else b""
    except OSError as error:
        raise UserError(f"File {file} cannot be read: {error.strerror}.") from error
    if first.whole and first.size >= HEAD.size:
        check_profile(file, _profile(body))


def _profile(body: bytes) -> str:
    """The profile in a header; empty if it is damaged."""
    try:
        return Header.read(_fields(body)).profile
    except Exception:  # noqa: BLE001 - mcap reports damage by any exception of its parser
        return ""


def _custom_data(files: list[Path]) -> dict[str, str]:
    """The custom data of the files: later files override earlier ones; in a file, one with a checksum is preferred."""
    found: dict[str, str] = {}
    for file in files:
        texts: dict[str, dict[str, str]] = {}
        with file.open("rb") as stream:
            for span in spans(stream, sound_summary(stream)):
                record = _metadata(span.read(stream)) if span.opcode == Opcode.METADATA and span.whole else None
                if record and (custom_data := custom_data_of(record.name, record.metadata)):
                    texts[record.name] = custom_data
        found |= texts.get(CUSTOM_DATA) or next(iter(texts.values()), {})
    return found


def _metadata(body: bytes) -> Metadata | None:
    """A metadata record; None if it is damaged."""
    try:
        return Metadata.read(_fields(body))
    except Exception:  # noqa: BLE001 - mcap reports damage by any exception of its parser
        return None


class _FileCopy:
    """Copies the whole messages of a file into a bag, and counts the rest."""

    def __init__(self, file: Path, stream: BinaryIO, bag: BagWriter) -> None:
        self._file, self._stream, self._bag = file, stream, bag
        self._summary: Summary | None = sound_summary(stream)
        self._schemas = dict(self._summary.schemas) if self._summary else {}
        self._channels = dict(self._summary.channels) if self._summary else {}
        self._repeated: dict[str, int] = {}
        self._recovered: Counter[str] = Counter()
        self._read: Counter[int] = Counter()
        """Number of readable messages by channel, including those that are in the file before."""
        self._gaps: dict[Gap, Counter[int]] = {}
        """Number of lost messages by channel, by gap."""
        self._unindexed: Counter[int] | None = None
        """Number of lost messages of the damaged chunk that message indexes follow."""
        self._has_checksums = self._in_chunks = False

    def run(self) -> Recovery:
        """Copy all whole messages."""
        self._in_chunks = any(span.opcode == Opcode.CHUNK for span in spans(self._stream, self._summary))
        for span in spans(self._stream, self._summary):
            if span.opcode != Opcode.MESSAGE_INDEX:
                self._unindexed = None
            if span.opcode == Opcode.CHUNK:
                self._copy_chunk(span)
            elif span.opcode is None or not span.whole:
                reason = "there is no record" if span.whole else "the file ends within a record"
                self._lose(span.offset, span.size, reason)
            else:
                self._copy_alone(span, span.opcode)
        for channel in self._channels.values():  # those without messages, too
            if self._add_topic(channel):
                self._recovered[channel.topic] += 0
        return self._account()

    def _copy_alone(self, span: RecordSpan, opcode: int) -> None:
        """Copy a record outside of chunks; messages are there only in files without chunks."""
        if opcode == Opcode.MESSAGE_INDEX:
            self._count_lost(span)
        elif opcode == Opcode.METADATA:
            if record := _metadata(span.read(self._stream)):
                self._repeated.update(repeated_in({record.name: record.metadata}))
        elif opcode == Opcode.MESSAGE and self._in_chunks:
            self._lose(span.offset, span.size, "a message outside of chunks, which is not allowed")
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
            self._copy_record(opcode, span.read(self._stream), span)

    def _account(self) -> Recovery:
        gaps = []
        for gap, counts in self._gaps.items():
            lost = Counter[str]()
            for channel_id, count in counts.items():
                lost[self._topic(channel_id)] += count
            gaps.append(replace(gap, lost=lost))
        lost = sum((Counter(gap.lost) for gap in gaps), Counter[str]())
        if self._summary and self._summary.statistics:
            lost = Counter()
            for channel_id, count in self._summary.statistics.channel_message_counts.items():
                lost[self._topic(channel_id)] += count - self._read[channel_id]
        return Recovery(self._recovered, +lost, gaps)

    def _topic(self, channel_id: int) -> str:
        return self._channels[channel_id].topic if channel_id in self._channels else UNKNOWN

    def _lose(self, offset: int, size: int, reason: str) -> Counter[int]:
        """Note that a part of the file could not be read; returns the messages lost with it, to be counted."""
        return self._gaps.setdefault(Gap(self._file, offset, size, reason), Counter())

    def _copy_chunk(self, span: RecordSpan) -> None:
        """Copy the records in a chunk; of one that is cut off those before the cut, unless it is compressed."""
        body = span.read(self._stream)
        try:
            chunk = Chunk.read(_fields(body))
            data = self._checked_data(chunk) if span.whole else chunk.data if chunk.compression == "" else b""
        except Exception as error:  # noqa: BLE001 - mcap reports damage by any exception of its parser
            if span.whole:
                reason = f"a damaged chunk ({error or type(error).__name__})"
                self._unindexed = self._lose(span.offset, span.size, reason)
            else:
                self._lose(span.offset, span.size, "the file ends within a chunk")
            return
        done = 0
        for opcode, record, size in _inner_records(data):
            self._copy_record(opcode, record, span)
            done += size
        if not span.whole:
            start = min(span.size, HEAD.size + CHUNK_FIELDS + done) if chunk.compression == "" else 0
            self._lose(span.offset + start, span.size - start, "the file ends within a chunk")

    def _checked_data(self, chunk: Chunk) -> bytes:
        """Uncompressed contents of a chunk.

        Raises:
            ValueError: it has no checksum, unlike the chunks before it, or another exception of mcap.
        """
        if self._has_checksums and not chunk.uncompressed_crc:
            raise ValueError("its checksum is gone")
        self._has_checksums = self._has_checksums or bool(chunk.uncompressed_crc)
        data, size = get_chunk_data_stream(chunk, validate_crc=True)
        return data.read(size)

    def _count_lost(self, span: RecordSpan) -> None:
        """Count the messages of a damaged chunk that a message index after it names."""
        found = counts_of_index(span, self._stream) if self._unindexed is not None else None
        if found and self._unindexed is not None:
            self._unindexed[found[0]] += found[1]

    def _copy_record(self, opcode: int, body: bytes, span: RecordSpan) -> None:
        """Read the description of a type or topic, or copy a message; known descriptions stay."""
        try:
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(_fields(body))
                self._schemas.setdefault(schema.id, schema)
            elif opcode == Opcode.CHANNEL:
                channel = Channel.read(_fields(body))
                self._channels.setdefault(channel.id, channel)
            elif opcode == Opcode.MESSAGE:
                message = Message.read(_fields(body), len(body))
            else:
                return
        except Exception as error:  # noqa: BLE001 - mcap reports damage by any exception of its parser
            self._lose(span.offset, span.size, f"a damaged record ({error or type(error).__name__})")
            return
        if opcode == Opcode.MESSAGE:
            self._copy_message(message, span)

    def _copy_message(self, message: Message, span: RecordSpan) -> None:
        channel = self._channels.get(message.channel_id)
        if channel is None or not self._add_topic(channel):
            reason = "messages of a topic that nothing describes any more"
            self._lose(span.offset, span.size, reason)[message.channel_id] += 1
            return
        self._read[channel.id] += 1
        topic = channel.topic
        if message.sequence == REPEATED_SEQUENCE and topic in self._repeated and self._bag.has_any(topic):
            return  # it was in the file before, too
        self._bag.write(topic, message.data, message.log_time, message.publish_time)
        self._recovered[topic] += 1

    def _add_topic(self, channel: Channel) -> bool:
        """Add a topic to the new bag; returns True if its type is known."""
        schema = self._schemas.get(channel.schema_id)
        if schema is None:
            return False
        check_encoding(self._file, channel)
        self._bag.add_topic(channel.topic, schema.name, recorded_qos(channel), recorded_definition(channel, schema))
        return True


def _inner_records(data: bytes) -> Iterator[tuple[int, bytes, int]]:
    """Whole records in a chunk: opcode, body, and bytes with opcode and length."""
    place = 0
    while place + HEAD.size <= len(data):
        opcode, length = HEAD.unpack_from(data, place)
        following = place + HEAD.size + length
        if following > len(data):
            return
        yield opcode, data[place + HEAD.size : following], following - place
        place = following


def _fields(body: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(body))
