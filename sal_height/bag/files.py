"""The files of a bag, and the checks that reader and salvage share."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO

import yaml
from mcap.exceptions import McapError
from mcap.records import Channel, Schema
from mcap.writer import MCAP0_MAGIC

from sal_height.bag import qos
from sal_height.bag.qos import Qos, read_yaml
from sal_height.errors import UserError
from sal_height.messages.definition import Definition

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
