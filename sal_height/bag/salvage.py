"""Make a proper bag of what is left of one: cut off by a killed process or a full disk, damaged, or without index."""

from __future__ import annotations

import logging
import os
import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, Header, Message, Schema
from mcap.stream_reader import get_chunk_data_stream
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC

from sal_height.bag.files import (
    bag_files,
    check_encoding,
    check_profile,
    check_start,
    recorded_definition,
    recorded_qos,
)
from sal_height.bag.writer import BagWriter
from sal_height.errors import UserError

_LOG = logging.getLogger(__name__)


def salvage(path: Path, out_directory: Path) -> int:
    """Copy every whole message of the bag at `path` into a new bag in `out_directory`; returns their number.

    Reads up to the cut, if there is one, and leaves out chunks whose checksum is wrong (each with a warning).
    UserError if `path` is no MCAP bag of ROS 2 or `out_directory` is not empty.
    """
    files = bag_files(path)
    for file in files:
        _check_header(file)
    count = 0
    with BagWriter(out_directory) as bag:
        for file in files:
            try:
                count += _copy(file, bag)
            except OSError as error:
                raise UserError(f"file '{file}' cannot be salvaged to '{out_directory}': {error}") from error
    return count


def _check_header(file: Path) -> None:
    try:
        with file.open("rb") as stream:
            check_start(file, stream.read(len(MCAP0_MAGIC)))
            opcode, body, whole = next(_records(stream), (Opcode.HEADER, b"", False))
    except OSError as error:
        raise UserError(f"file '{file}' cannot be read: {error.strerror}") from error
    if whole:
        check_profile(file, Header.read(_fields(body)).profile if opcode == Opcode.HEADER else "")


def _copy(file: Path, bag: BagWriter) -> int:
    """Copy the topics and whole messages of `file` into `bag`; returns the number of messages."""
    with file.open("rb") as stream:
        # A complete file repeats its schemas and channels at the end, where damage to a chunk does not reach them.
        summary = _summary(stream)
        schemas, channels = summary.schemas, summary.channels
        count = 0
        stream.seek(len(MCAP0_MAGIC))
        for opcode, body in _unpacked_records(file, stream):
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(_fields(body))
                schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                channel = Channel.read(_fields(body))
                channels[channel.id] = channel
            elif opcode == Opcode.MESSAGE:
                message = Message.read(_fields(body), len(body))
                known = channels.get(message.channel_id)
                if known is None or known.schema_id not in schemas:
                    continue  # the description of the topic was in a damaged chunk
                _add_topic(file, bag, known, schemas[known.schema_id])
                bag.write(known.topic, message.data, message.log_time, message.publish_time)
                count += 1
    return count


def _add_topic(file: Path, bag: BagWriter, channel: Channel, schema: Schema) -> None:
    check_encoding(file, channel)
    bag.add_topic(channel.topic, schema.name, recorded_qos(channel), recorded_definition(channel, schema))


def _summary(stream: BinaryIO) -> Summary:
    try:
        return SeekingReader(stream).get_summary() or Summary()
    except Exception:  # noqa: BLE001 - a cut file has none, and mcap stumbles over whatever stands there
        return Summary()


def _unpacked_records(file: Path, stream: BinaryIO) -> Iterator[tuple[int, bytes]]:
    """Whole records as (opcode, body), those inside chunks in place of the chunks."""
    for opcode, body, whole in _records(stream):
        if opcode == Opcode.CHUNK:
            inner = _records(BytesIO(_chunk_data(file, body, whole)))
            yield from ((inner_opcode, inner_body) for inner_opcode, inner_body, inner_whole in inner if inner_whole)
        elif whole:
            yield opcode, body


def _records(stream: BinaryIO | BytesIO) -> Iterator[tuple[int, bytes, bool]]:
    """Records from here on as (opcode, body, whether the body is whole), up to the end or the cut."""
    here = stream.tell()
    end = stream.seek(0, os.SEEK_END)
    stream.seek(here)
    while len(head := stream.read(9)) == 9:
        opcode, length = struct.unpack("<BQ", head)
        body = stream.read(min(length, end - stream.tell()))
        yield opcode, body, len(body) == length


def _chunk_data(file: Path, body: bytes, whole: bool) -> bytes:
    """Uncompressed contents of a chunk record; of one cut off what there is, of a damaged one nothing."""
    try:
        chunk = Chunk.read(_fields(body))
        if not whole:
            return chunk.data if chunk.compression == "" else b""
        data, size = get_chunk_data_stream(chunk, validate_crc=True)
        return data.read(size)
    except Exception as error:  # noqa: BLE001 - mcap reports damage by whatever its parser stumbles over
        if whole:
            _LOG.warning("left out a damaged chunk of '%s': %s", file, error)
        return b""


def _fields(body: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(body))
