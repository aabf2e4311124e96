"""Read MCAP bags, our own and those of rosbag2: topics, messages in order of time, and decoded messages."""

from __future__ import annotations

import heapq
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from mcap.exceptions import McapError
from mcap.reader import SeekingReader
from mcap.records import Header, Statistics
from mcap.stream_reader import StreamReader
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message

from sal_height.bag.definitions import Definition, installed_definition, message_class
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
from sal_height.bag.versions import current_name, needs_upgrade, upgraded
from sal_height.errors import UserError


@dataclass(frozen=True)
class Topic:
    """A topic of a bag.

    count: number of messages. offered_qos: profile of every publisher at the time of recording, as far as known.
    definition: text and hash of the type as recorded, which may be older than the installed one.
    is_old: whether the type is of an older version of sal_height_msgs, which `type_name` and messages() make current.
    """

    name: str
    type_name: str
    count: int
    offered_qos: tuple[QoSProfile, ...]
    definition: Definition
    is_old: bool = False


class BagMessage(NamedTuple):
    """A serialized message and the time it was received, in nanoseconds."""

    topic: str
    type_name: str
    cdr: bytes
    log_time_ns: int


class BagReader:
    """A bag: a folder, or one .mcap file. Nothing stays open between calls.

    topics: by name. custom_data: texts by name that the recording program stored in the bag.
    """

    def __init__(self, path: Path) -> None:
        """Read the index of the bag at `path`; UserError with the remedy if it is not a complete bag."""
        self.path = path
        self._files = bag_files(path)
        self.topics: dict[str, Topic] = {}
        self.custom_data: dict[str, str] = {}
        self._repeated: list[dict[str, int]] = []
        """How many messages of each file are in the one before, too, by topic."""
        for file in self._files:
            topics, custom_data, repeated = _read_index(file)
            self._repeated.append(repeated if self._repeated else {})
            self.custom_data |= custom_data
            for topic in topics:
                self._add(topic, self._repeated[-1].get(topic.name, 0))
        self._checked_types: set[str] = set()

    @property
    def message_count(self) -> int:
        """Number of messages in all topics."""
        return sum(topic.count for topic in self.topics.values())

    def messages(self, topics: Collection[str] | None = None) -> Iterator[BagMessage]:
        """Messages in order of log time, those of `topics` or all; holds a few chunks of the bag in memory.

        Messages of an older version of sal_height_msgs are made into those of today on the way.

        UserError if a checksum or a record is found to be wrong on the way.
        """
        files = zip(self._files, self._repeated, strict=True)
        streams = (_read_messages(file, topics, repeated) for file, repeated in files)
        return map(self._upgraded, heapq.merge(*streams, key=lambda message: message.log_time_ns))

    def decode(self, type_name: str, cdr: bytes) -> Any:
        """Message object of the installed class.

        UserError if the type is not installed, the bag has another definition of it, or `cdr` is damaged.
        """
        if type_name not in self._checked_types:
            self._check_definition(type_name)
            self._checked_types.add(type_name)
        # rclpy's own error class is private, and a subclass of RuntimeError.
        try:
            return deserialize_message(cdr, message_class(type_name))
        except RuntimeError as error:
            raise UserError(f"A message of type {type_name} in bag {self.path} cannot be decoded: {error}.") from error

    def _upgraded(self, message: BagMessage) -> BagMessage:
        topic = self.topics[message.topic]
        if not topic.is_old:
            return message
        try:
            cdr = upgraded(message.type_name, topic.definition, message.cdr)
        except Exception as error:  # rosbags reports damage by whatever its deserializer stumbles over
            raise UserError(
                f"A message on topic {topic.name} of bag {self.path}, recorded with an older definition of "
                f"{message.type_name}, cannot be decoded: {error}."
            ) from error
        return message._replace(type_name=topic.type_name, cdr=cdr)

    def _add(self, topic: Topic, repeated: int) -> None:
        """Add a topic of a file, of which so many messages are in the file before, too."""
        known = self.topics.setdefault(topic.name, topic)
        if known is topic:
            return
        if known.type_name != topic.type_name:
            raise UserError(
                f"Topic {topic.name} of bag {self.path} has two types, {known.type_name!r} and {topic.type_name!r}; "
                "a topic must have one."
            )
        count = known.count + topic.count - repeated
        self.topics[topic.name] = replace(known, count=count)

    def _check_definition(self, type_name: str) -> None:
        installed = installed_definition(type_name)
        for topic in self.topics.values():
            if topic.type_name == type_name and not (topic.is_old or topic.definition.same_layout(installed)):
                raise UserError(
                    f"Topic {topic.name} of bag {self.path} was recorded with another definition of {type_name} "
                    f"({topic.definition.type_hash or 'no hash'}) than the installed one ({installed.type_hash}); "
                    f"install the version of package {type_name.partition('/')[0]} it was recorded with."
                )


def _read_index(file: Path) -> tuple[list[Topic], dict[str, str], dict[str, int]]:
    """Topics and custom data of a file, and how many messages of each topic are in the file before, too."""
    try:
        with file.open("rb") as stream:
            _check_complete(file, stream)
            summary, statistics = _read_summary(file, stream)
            records = _read_records(file, stream)
    except OSError as error:
        raise UserError(f"File {file} cannot be read: {error.strerror}.") from error
    counts = statistics.channel_message_counts
    topics = []
    for channel in summary.channels.values():
        check_encoding(file, channel)
        schema = summary.schemas[channel.schema_id]
        definition = recorded_definition(channel, schema)
        is_old = needs_upgrade(schema.name, definition)
        count, name = counts.get(channel.id, 0), current_name(schema.name)
        topics.append(Topic(channel.topic, name, count, recorded_qos(channel), definition, is_old))
    custom_data = [custom_data_of(name, values) for name, values in records.items()]
    return topics, next((texts for texts in custom_data if texts), {}), repeated_in(records)


def _check_complete(file: Path, stream: BinaryIO) -> None:
    magic_size = len(MCAP0_MAGIC)
    check_start(file, stream.read(magic_size))
    stream.seek(max(magic_size, file.stat().st_size - magic_size))
    if stream.read() != MCAP0_MAGIC:
        raise UserError(
            f"File {file} is cut off (the recording process was killed or the disk was full); "
            f"{_salvage(file)} recovers what precedes the cut."
        )


def _read_summary(file: Path, stream: BinaryIO) -> tuple[Summary, Statistics]:
    """Index of a complete file; UserError if it is of another profile, damaged or missing."""
    try:
        check_summary_crc(stream)
        stream.seek(0)
        header = next(StreamReader(stream).records)
        stream.seek(0)
        summary = SeekingReader(stream).get_summary()
    except Exception as error:  # mcap reports damage by whatever its parser stumbles over
        raise _damaged(file, error) from error
    check_profile(file, header.profile if isinstance(header, Header) else "")
    statistics = summary.statistics if summary else None
    if summary is None or statistics is None or (statistics.message_count and not summary.chunk_indexes):
        raise UserError(f"File {file} has no index of its messages; {_salvage(file)} writes a copy that has one.")
    missing = {channel.schema_id for channel in summary.channels.values()} - {0, *summary.schemas}
    if missing or not set(statistics.channel_message_counts) <= set(summary.channels):
        raise _damaged(file, McapError("the index names topics that it does not describe"))
    return summary, statistics


def _read_records(file: Path, stream: BinaryIO) -> dict[str, dict[str, str]]:
    """Metadata records of a complete file, by name."""
    try:
        return {record.name: record.metadata for record in SeekingReader(stream).iter_metadata()}
    except Exception as error:  # mcap reports damage by whatever its parser stumbles over
        raise _damaged(file, error) from error


def _read_messages(file: Path, topics: Collection[str] | None, repeated: Collection[str]) -> Iterator[BagMessage]:
    """Messages of a file in order of log time; those in the file before, too, are left out of topics in `repeated`."""
    try:
        with file.open("rb") as stream:
            for schema, channel, message in SeekingReader(stream, validate_crcs=True).iter_messages(topics):
                if channel.topic in repeated and message.sequence == REPEATED_SEQUENCE:
                    continue
                if schema is not None:  # always so: `check_encoding` refuses channels without
                    yield BagMessage(channel.topic, schema.name, message.data, message.log_time)
    except Exception as error:  # mcap reports damage by whatever its parser stumbles over
        raise _damaged(file, error) from error


def _damaged(file: Path, error: Exception) -> UserError:
    return UserError(f"File {file} is damaged ({error or type(error).__name__}); {_salvage(file)} recovers the rest.")


def _salvage(file: Path) -> str:
    return f"'sal-height salvage {file} --out DIR'"
