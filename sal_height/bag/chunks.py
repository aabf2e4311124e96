"""Chunks of MCAP files: their checksums, and their messages in order of log time.

The mcap package computes checksums by zlib, which takes ten times as long as ISA-L where processors multiply
polynomials.
"""

from __future__ import annotations

import heapq
from collections.abc import Collection, Iterator
from dataclasses import replace
from io import BytesIO
from typing import BinaryIO

from isal.isal_zlib import crc32
from mcap.data_stream import ReadDataStream
from mcap.records import Chunk, ChunkIndex, Message
from mcap.stream_reader import CRCValidationError, breakup_chunk, get_chunk_data_stream
from mcap.summary import Summary

from sal_height.bag.files import HEAD


def unpacked(chunk: Chunk) -> Chunk:
    """A chunk without compression, whose records are those of its checksum, if it has one.

    Raises:
        CRCValidationError: they are not, or another exception of mcap or of the compression.
    """
    stream, size = get_chunk_data_stream(chunk)
    records = stream.read(size)
    if chunk.uncompressed_crc and (found := crc32(records)) != chunk.uncompressed_crc:
        raise CRCValidationError(chunk.uncompressed_crc, found, chunk)
    return replace(chunk, compression="", data=records)


def messages_of(stream: BinaryIO, index: ChunkIndex) -> list[Message]:
    """The messages of a chunk in a file.

    Raises:
        CRCValidationError: the checksum is wrong, or another exception of mcap or of the compression.
    """
    stream.seek(index.chunk_start_offset + HEAD.size)
    body = BytesIO(stream.read(index.chunk_length - HEAD.size))
    return [
        record for record in breakup_chunk(unpacked(Chunk.read(ReadDataStream(body)))) if isinstance(record, Message)
    ]


def messages_in_order(
    stream: BinaryIO, summary: Summary, channels: Collection[int], first_ns: int, last_ns: int
) -> Iterator[Message]:
    """The messages of a file with chunks in order of log time, those of one time in the order of the file.

    Args:
        stream: file.
        summary: summary of the file, with the indexes of all chunks.
        channels: numbers of the channels whose messages are read.
        first_ns: earliest log time, ns.
        last_ns: latest log time, ns.

    Raises:
        CRCValidationError: the checksum of a chunk is wrong, or another exception of mcap or of the compression.
    """
    waiting: list[tuple[int, int, int, ChunkIndex | Message]] = [
        (index.message_start_time, index.chunk_start_offset, -1, index)
        for index in summary.chunk_indexes
        if index.message_start_time <= last_ns
        and index.message_end_time >= first_ns
        and not (index.message_index_offsets and index.message_index_offsets.keys().isdisjoint(channels))
    ]
    heapq.heapify(waiting)
    while waiting:
        _, offset, _, item = heapq.heappop(waiting)
        if isinstance(item, Message):
            yield item
            continue
        for number, message in enumerate(messages_of(stream, item)):
            if message.channel_id in channels and first_ns <= message.log_time <= last_ns:
                heapq.heappush(waiting, (message.log_time, offset, number, message))
