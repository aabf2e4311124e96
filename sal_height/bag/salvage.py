"""Make a proper bag of what is left of one: cut off by a killed process or a full disk, damaged, or without index."""

from __future__ import annotations

import logging
import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, Header, Message, Metadata, Schema
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC

from sal_height.bag.files import (
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

_LOG = logging.getLogger(__name__)


@dataclass
class _Contents:
    """What is known of a file so far: descriptions of its topics, custom data, and what is in the one before, too."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    custom_data: dict[str, str] = field(default_factory=dict)
    repeated: dict[str, int] = field(default_factory=dict)


def salvage(path: Path, out_directory: Path) -> int:
    """Copy every whole message of the bag at `path` into a new bag in `out_directory`; returns their number.

    Reads up to the cut, if there is one, and leaves out chunks and records that are damaged (each with a warning).
    Topics without messages and the custom data (the parameters of a run) are copied too.
    UserError if `path` is no MCAP bag of ROS 2 or `out_directory` is not empty.
    """
    files = bag_files(path)
    for file in files:
        _check_header(file)
    count = 0
    with BagWriter(out_directory, _custom_data(files)) as bag:
        for file in files:
            try:
                count += _copy(file, bag)
            except OSError as error:
                raise UserError(f"File {file} cannot be salvaged to {out_directory}: {error}.") from error
    return count


def _check_header(file: Path) -> None:
    try:
        with file.open("rb") as stream:
            check_start(file, stream.read(len(MCAP0_MAGIC)))
            opcode, body, whole = next(_records(stream), (Opcode.HEADER, b"", False))
    except OSError as error:
        raise UserError(f"File {file} cannot be read: {error.strerror}.") from error
    if whole:
        check_profile(file, _profile(body) if opcode == Opcode.HEADER else "")


def _profile(body: bytes) -> str:
    """The profile in a header; empty if it is damaged."""
    try:
        return Header.read(_fields(body)).profile
    except Exception:  # noqa: BLE001 - mcap reports damage by whatever its parser stumbles over
        return ""


def _custom_data(files: list[Path]) -> dict[str, str]:
    """The custom data at the start of the files; what later ones say counts."""
    found: dict[str, str] = {}
    for file in files:
        with file.open("rb") as stream:
            stream.seek(len(MCAP0_MAGIC))
            contents = _Contents()
            for opcode, body, whole in _records(stream):
                if opcode == Opcode.CHUNK:
                    break
                if whole and opcode == Opcode.METADATA:
                    _describe(file, opcode, body, contents)
            found |= contents.custom_data
    return found


def _copy(file: Path, bag: BagWriter) -> int:
    """Copy the topics and whole messages of `file` into `bag`; returns the number of messages."""
    count = 0
    with file.open("rb") as stream:
        contents = _index(stream)
        stream.seek(len(MCAP0_MAGIC))
        for opcode, body in _unpacked_records(file, stream):
            if opcode == Opcode.MESSAGE:
                count += _copy_message(file, body, contents, bag)
            else:
                _describe(file, opcode, body, contents)
    for channel in contents.channels.values():  # those without messages, too
        _add_topic(file, bag, channel, contents)
    return count


def _index(stream: BinaryIO) -> _Contents:
    """What a complete file repeats at its end, where damage to a chunk does not reach; nothing if it is damaged."""
    try:
        check_summary_crc(stream)
        stream.seek(0)
        summary = SeekingReader(stream).get_summary()
    except Exception:  # noqa: BLE001 - a cut file has none, and mcap stumbles over whatever stands there
        return _Contents()
    return _Contents(summary.schemas, summary.channels) if summary else _Contents()


def _describe(file: Path, opcode: int, body: bytes, contents: _Contents) -> None:
    """Take in a record that describes a type or topic, or that holds the custom data."""
    try:
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(_fields(body))
            contents.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(_fields(body))
            contents.channels[channel.id] = channel
        elif opcode == Opcode.METADATA:
            record = Metadata.read(_fields(body))
            contents.custom_data.update(custom_data_of(record.name, record.metadata) or {})
            contents.repeated.update(repeated_in({record.name: record.metadata}))
    except Exception as error:  # noqa: BLE001 - mcap reports damage by whatever its parser stumbles over
        _LOG.warning("A damaged record of %s was left out: %s.", file, error)


def _copy_message(file: Path, body: bytes, contents: _Contents, bag: BagWriter) -> bool:
    """Copy a message whose topic is known; returns whether it was."""
    try:
        message = Message.read(_fields(body), len(body))
    except Exception as error:  # noqa: BLE001 - mcap reports damage by whatever its parser stumbles over
        _LOG.warning("A damaged message of %s was left out: %s.", file, error)
        return False
    channel = contents.channels.get(message.channel_id)
    if channel is None or not _add_topic(file, bag, channel, contents):
        return False  # the description of the topic was in a damaged chunk
    if message.sequence == REPEATED_SEQUENCE and channel.topic in contents.repeated and bag.has_any(channel.topic):
        return False  # it was in the file before, too
    bag.write(channel.topic, message.data, message.log_time, message.publish_time)
    return True


def _add_topic(file: Path, bag: BagWriter, channel: Channel, contents: _Contents) -> bool:
    """Add a topic to the new bag; returns whether its type is known."""
    schema = contents.schemas.get(channel.schema_id)
    if schema is None:
        return False
    check_encoding(file, channel)
    bag.add_topic(channel.topic, schema.name, recorded_qos(channel), recorded_definition(channel, schema))
    return True


def _unpacked_records(file: Path, stream: BinaryIO) -> Iterator[tuple[int, bytes]]:
    """Whole records before the index as (opcode, body), those inside chunks in place of the chunks."""
    for opcode, body, whole in _records(stream):
        if opcode == Opcode.DATA_END:  # `_index` has read the rest, if it is sound
            return
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
            _LOG.warning("A damaged chunk of %s was left out: %s.", file, error)
        return b""


def _fields(body: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(body))
