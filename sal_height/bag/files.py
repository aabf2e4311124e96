"""The files of a bag and their indexes: what they contain, without reading the messages."""

from __future__ import annotations

import os
import struct
import zlib
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import yaml
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, ChunkIndex, Header, Schema, Statistics
from mcap.stream_reader import StreamReader
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from sal_height.bag import qos
from sal_height.bag.qos import Qos, read_yaml
from sal_height.errors import UserError
from sal_height.messages.definition import Definition
from sal_height.numeric import I64

# How a file ends: start of the summary, start of the summary offsets, checksum from the former up to here; magic.
_FOOTER_TAIL = struct.Struct("<QQI8s")

CUSTOM_DATA = "sal_height"
"""Name of the MCAP metadata record with the custom data from the start of a file of ours."""

PARAMETERS = "parameters"
"""Name of the nodes' parameters (JSON) in the custom data of a bag."""

REPEATED = "sal_height.repeated"
"""Name of the MCAP metadata record with the number of messages of a file that are in the one before, by topic."""

REPEATED_SEQUENCE = 1
"""Sequence number of such messages; all others have 0."""

ACCOUNT = "sal_height.account"
"""Name of the MCAP metadata record with the account of the messages of each topic, as JSON by topic."""

CHECKSUM = "crc32"
"""Name of the checksum in that record."""


def bag_files(path: Path) -> list[Path]:
    """The .mcap files of the bag at `path` (folder or file), oldest first; UserError without any."""
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise UserError(f"Bag {path} does not exist; name a bag folder or an .mcap file.")
    metadata = path / "metadata.yaml"
    if metadata.is_file():
        files = [path / name for name in _listed_files(metadata)]
    else:  # the recording process was killed; "bag_2.mcap" comes before "bag_10.mcap"
        files = sorted(path.glob("*.mcap"), key=lambda file: (len(file.name), file.name))
    if not files:
        raise UserError(f"Folder {path} is not a bag; it must contain an .mcap file.")
    return files


def parameters_file(path: Path) -> Path:
    """The file with the parameters of nodes next to the bag at `path` (folder or file), for bags of version 0."""
    return (path if path.is_dir() else path.parent) / "parameters.yaml"


def check_start(file: Path, start: bytes) -> None:
    """UserError unless `start` is the start of an MCAP file; a part is enough, for the file may be cut."""
    if not start:
        raise UserError(f"File {file} is empty; name a bag folder or an .mcap file.")
    if start != MCAP0_MAGIC[: len(start)]:
        raise UserError(f"File {file} is not an MCAP file; name a bag folder or an .mcap file.")


def check_summary_crc(stream: BinaryIO) -> None:
    """McapError if the index is not as it was written; the mcap package does not check it."""
    crc_end = stream.seek(-_FOOTER_TAIL.size, os.SEEK_END) + 2 * 8
    summary_start, _, crc, _ = _FOOTER_TAIL.unpack(stream.read())
    stream.seek(summary_start)
    if crc and zlib.crc32(stream.read(crc_end - summary_start)) != crc:
        raise McapError("the checksum of its index is wrong")


def check_profile(file: Path, profile: str) -> None:
    """UserError unless the `profile` in the header states that the file is one of ROS 2."""
    if profile != "ros2":
        raise UserError(f"File {file} has the profile {profile!r}; only MCAP files of profile 'ros2' can be read.")


def check_encoding(file: Path, channel: Channel) -> None:
    """UserError unless the channel has CDR messages of a type that is described."""
    if channel.message_encoding != "cdr" or channel.schema_id == 0:
        raise UserError(
            f"Topic {channel.topic} of file {file} has the encoding {channel.message_encoding!r} and schema "
            f"{channel.schema_id}; only the encoding 'cdr' with a schema (not 0) can be read."
        )


def recorded_definition(channel: Channel, schema: Schema) -> Definition:
    """Definition of a channel's type in the file; UserError if it is not a text."""
    try:
        text = schema.data.decode()
    except UnicodeDecodeError as error:
        raise UserError(f"The schema of topic {channel.topic} is no text ({error}).") from error
    return Definition(text, channel.metadata.get("topic_type_hash", ""), schema.encoding)


def recorded_qos(channel: Channel) -> tuple[Qos, ...]:
    """Profiles that the channel's publishers offered; empty where they were not recorded."""
    return tuple(qos.from_yaml(channel.metadata.get("offered_qos_profiles", "")))


def checksum(texts: Mapping[str, str]) -> str:
    """Checksum of custom data, for MCAP has none for metadata records."""
    return f"{zlib.crc32(repr(sorted(texts.items())).encode()):08x}"


def custom_data_of(record: str, values: dict[str, str]) -> dict[str, str] | None:
    """Custom data in the MCAP metadata record of that name; None if they are absent or damaged."""
    if record == CUSTOM_DATA:
        texts = {name: text for name, text in values.items() if name != CHECKSUM}
        return texts if values.get(CHECKSUM) == checksum(texts) else None
    if record != "rosbag2":
        return None
    try:
        found = _content(values["serialized_metadata"])["custom_data"] or {}
        return {str(name): str(value) for name, value in found.items()}
    except (yaml.YAMLError, KeyError, TypeError, AttributeError):  # rosbag2 before version 6 has none
        return None


def repeated_in(records: Mapping[str, Mapping[str, str]]) -> dict[str, int]:
    """Number of messages of a file that are in the one before, too, by topic, by its metadata records."""
    return {topic: int(count) for topic, count in records.get(REPEATED, {}).items() if count.isdecimal()}


def stored_as(metadata: Path) -> tuple[str, str, list[str]]:
    """Storage, compression mode and names of files, by the file metadata.yaml of a bag.

    Raises:
        UserError: it cannot be read.
    """
    try:
        information = _content(metadata.read_text(encoding="utf-8"))["rosbag2_bagfile_information"]
        storage = str(information["storage_identifier"])
        compression = str(information.get("compression_mode") or "none").lower()
        return storage, compression, [Path(name).name for name in information["relative_file_paths"]]
    except (OSError, yaml.YAMLError, UnicodeDecodeError, KeyError, TypeError, AttributeError) as error:
        raise UserError(f"File {metadata} cannot be read as the metadata of a bag: {error!r}.") from error


@lru_cache(maxsize=16)
def _content(text: str) -> Any:
    """Plain data of a YAML text, which must not be changed; cached, since opening a bag needs it several times."""
    return read_yaml(text)


def _listed_files(metadata: Path) -> list[str]:
    storage, compression, names = stored_as(metadata)
    if storage != "mcap" or compression != "none":
        raise UserError(
            f"Bag {metadata.parent} has storage {storage!r} and compression mode {compression!r}, but storage 'mcap' "
            f"and mode 'none' (compression inside the MCAP file) are needed here; 'sal-height bag upgrade "
            f"{metadata.parent} --out DIR' makes such a bag of it."
        )
    return names


HEAD = struct.Struct("<BQ")
"""Opcode and length of a record."""

CHUNK_FIELDS = 40
"""Bytes before the data of a chunk that is not compressed, after opcode and length."""

INDEX_HEAD = struct.Struct("<HI")
"""Channel of a message index, and bytes of its entries."""

INDEX_ENTRY = np.dtype([("log_time", "<u8"), ("offset", "<u8")])


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
        channel_id, size = INDEX_HEAD.unpack_from(block, body)
        if opcode != Opcode.MESSAGE_INDEX or size != length - INDEX_HEAD.size:
            raise McapError(
                f"there is no message index at byte {chunk.chunk_start_offset + chunk.chunk_length + place}"
            )
        yield channel_id, np.frombuffer(block, INDEX_ENTRY, size // INDEX_ENTRY.itemsize, body + INDEX_HEAD.size)
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
