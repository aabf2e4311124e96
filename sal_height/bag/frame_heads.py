"""The dwells of the frames in a bag, read from the heads of the frames: their samples are nearly all of its bytes."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import suppress
from typing import BinaryIO, NamedTuple

from mcap.exceptions import McapError
from mcap.opcode import Opcode

from sal_height import messages
from sal_height.bag.chunk_search import CHUNK_FIELDS, HEAD
from sal_height.bag.index import FileIndex, read_message_indexes
from sal_height.bag.played import DwellPart, part_of_frame
from sal_height.messages.received import ReceivedFrame

_MESSAGE = struct.Struct("<BQHIQQ")
"""Opcode and length of a message, its channel, number, and times of reception and publication, ns."""

HEAD_BYTES = 8192
"""Bytes of a frame that are read first; more follow if it has more pulses."""

TEXT_BYTES = 2048
"""Largest number of bytes of the texts and numbers of a frame, without its pulses and samples."""

ZEROS_BYTES = 64
"""First bytes of a frame; if all are zero, the file is damaged there."""

PULSE_BYTES = 16
"""Bytes of the time and reference range of a pulse."""


class TimedPart(NamedTuple):
    """Reception of a frame, ns, and its dwell."""

    log_time_ns: int
    part: DwellPart


def read_frame_parts(index: FileIndex, topic: str) -> list[TimedPart] | None:
    """The dwells of the frames on a topic of a file, in the order of their reception; broken frames are left out.

    Checksums are those of whole chunks and are not checked.

    Returns:
        The dwells; None: the frames must be read whole, for they are compressed, or not where the index states.
    """
    try:
        with index.path.open("rb", buffering=0) as stream:
            return list(_parts(index, topic, stream))
    except (OSError, McapError, struct.error, ValueError, OverflowError):
        return None


def _parts(index: FileIndex, topic: str, stream: BinaryIO) -> Iterator[TimedPart]:
    """The dwells of the frames.

    Raises:
        OSError, McapError, struct.error, ValueError, OverflowError: frames are not where the index of the
            file states.
    """
    channels = {number for number, channel in index.summary.channels.items() if channel.topic == topic}
    places = sorted(_places(index, channels, stream))
    if len(places) != sum(index.statistics.channel_message_counts.get(number, 0) for number in channels):
        raise McapError("the index does not have all messages")
    for log_time_ns, at, end in places:
        stream.seek(at)
        opcode, length, channel, _, received_ns, _ = _MESSAGE.unpack(stream.read(_MESSAGE.size))
        size = length - (_MESSAGE.size - HEAD.size)
        is_message = opcode == Opcode.MESSAGE and channel in channels and received_ns == log_time_ns
        if not is_message or not 0 <= size <= end - at - _MESSAGE.size:
            raise McapError(f"there is no message at byte {at}")
        with suppress(RuntimeError):  # an invalid message
            yield TimedPart(log_time_ns, part_of_frame(_read_frame(stream, at + _MESSAGE.size, size)))


def _places(index: FileIndex, channels: set[int], stream: BinaryIO) -> Iterator[tuple[int, int, int]]:
    """Log time (ns) of each message of the channels, its first byte in the file, and the end of its chunk."""
    for chunk in index.summary.chunk_indexes:
        if not channels & chunk.message_index_offsets.keys():
            continue
        if chunk.compression:
            raise McapError("messages are compressed")
        start = chunk.chunk_start_offset
        begin, end = start + HEAD.size + CHUNK_FIELDS, start + chunk.chunk_length
        for channel, entries in read_message_indexes(stream, chunk):
            if channel in channels:
                for log_time_ns, offset in entries.tolist():
                    yield log_time_ns, begin + offset, end


def _read_frame(stream: BinaryIO, at: int, size: int) -> ReceivedFrame:
    """The frame of `size` bytes that starts at `at`, with zeros in place of its samples.

    Raises:
        RuntimeError: the frame is broken.
        McapError: there are zeros instead.
    """

    def read(count: int) -> ReceivedFrame:
        stream.seek(at)
        head = stream.read(min(count, size))
        if not any(head[:ZEROS_BYTES]):
            raise McapError(f"there are zeros at byte {at}")
        return messages.received_frame(head.ljust(size, b"\0"))

    frame = read(HEAD_BYTES)
    if not len(frame.pulse_time) or len(frame.frame_id) + len(frame.config_hash) > TEXT_BYTES // 2:
        return read(size)  # a text may be longer than the bytes read before
    needed = TEXT_BYTES + PULSE_BYTES * len(frame.pulse_time)
    return frame if needed <= HEAD_BYTES else read(needed)
