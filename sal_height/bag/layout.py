"""The records of a file one after the other, found without its index, or past damage with it."""

from __future__ import annotations

import bisect
import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC

from sal_height.bag.chunk_search import HEAD, find_chunks, is_known
from sal_height.bag.files import check_summary_crc

INDEX_HEAD = struct.Struct("<HI")
"""Channel of a message index, and bytes of its entries, of INDEX_ENTRY bytes each."""

INDEX_ENTRY = 16


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
    return (channel_id, size // INDEX_ENTRY) if size == len(body) - INDEX_HEAD.size else None


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
