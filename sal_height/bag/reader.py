"""Read MCAP bags, our own and those of rosbag2: topics, messages in order of time, and decoded messages."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from mcap.reader import SeekingReader

from sal_height.bag.definitions import Definition, known_definition
from sal_height.bag.files import (
    REPEATED_SEQUENCE,
    bag_files,
    check_encoding,
    custom_data_of,
    recorded_definition,
    recorded_qos,
    repeated_in,
)
from sal_height.bag.frame_heads import TimedPart, read_frame_parts
from sal_height.bag.index import FileIndex, damaged, read_index
from sal_height.bag.other_storage import OtherStorage, is_stored_otherwise
from sal_height.bag.played import part_of
from sal_height.bag.topics import BagMessage, Topic
from sal_height.bag.versions import current_name, needs_upgrade, upgraded
from sal_height.errors import UserError
from sal_height.messages import BrokenMessage
from sal_height.messages.codec import SHIPPED, recorded_types
from sal_height.messages.definition import shipped_definition

__all__ = ["BagMessage", "BagReader", "Topic"]


class LogTimes(NamedTuple):
    """Times of reception, ns: from the first to the last, both included."""

    first_ns: int = 0
    last_ns: int = 2**63 - 1


ALWAYS = LogTimes()


class BagReader:
    """A bag: a folder, or one file. Nothing stays open between calls.

    topics: topics by name. custom_data: texts by name that the recording program stored in the bag. begin_ns: reception
    of the first message, ns; 0 without messages. indexes: indexes of its files, oldest first; empty if it is not MCAP.
    repeated: number of messages of each file that are in the one before, too, by topic.
    """

    def __init__(self, path: Path) -> None:
        """Read the index of the bag at `path`; UserError with the remedy if it is not a complete bag."""
        self.path = path
        self._other = OtherStorage(path) if is_stored_otherwise(path) else None
        self.indexes = [] if self._other else [read_index(file) for file in bag_files(path)]
        self.repeated = [{}, *(repeated_in(index.records) for index in self.indexes[1:])]
        self.topics: dict[str, Topic] = {}
        self.custom_data: dict[str, str] = {}
        for index, repeated in zip(self.indexes, self.repeated, strict=False):
            self.custom_data |= _custom_data_of(index)
            for topic in _topics_of(index):
                self._add(topic, repeated.get(topic.name, 0))
        statistics = [index.statistics for index in self.indexes if index.statistics.message_count]
        self.begin_ns = min((one.message_start_time for one in statistics), default=0)
        if self._other:
            self.custom_data, self.begin_ns = self._other.custom_data, self._other.begin_ns
            for topic in self._other.topics:
                self._add(topic, 0)
        self._readers: dict[str, Callable[[bytes], Any]] = {}

    @property
    def message_count(self) -> int:
        """Number of messages in all topics."""
        return sum(topic.count for topic in self.topics.values())

    def messages(self, topics: Collection[str] | None = None, times: LogTimes = ALWAYS) -> Iterator[BagMessage]:
        """Messages in order of log time, those of `topics` or all; keeps a few chunks of the bag in memory.

        Messages of an older version of sal_height_msgs are converted to those of today. Chunks outside of `times` are
        not read.

        UserError if a checksum or a record is found to be wrong.
        """
        return map(self.as_today, self.recorded_messages(topics, times))

    def recorded_messages(
        self, topics: Collection[str] | None = None, times: LogTimes = ALWAYS
    ) -> Iterator[BagMessage]:
        """Messages as from `messages`, but those of an older version as they were recorded.

        UserError if a checksum or a record is found to be wrong.
        """
        if self._other:
            return (one for one in self._other.messages(topics) if times.first_ns <= one.log_time_ns <= times.last_ns)
        files = zip(self.indexes, self.repeated, strict=True)
        streams = (_read_messages(index.path, topics, repeated, times) for index, repeated in files)
        return heapq.merge(*streams, key=lambda message: message.log_time_ns)

    def frame_parts(self, topic: str) -> list[TimedPart]:
        """Reception and dwells of the frames on a topic, in order; broken frames are left out.

        Only the heads of frames are read where the index of the bag locates them, also of those that cannot be read
        whole since the bag is damaged; else frames are read up to the damage, which a full reading reports.
        """
        name = self._recorded_name(topic)
        if not (self._other or self.topics[topic].is_old or any(name in one for one in self.repeated)):
            found = [read_frame_parts(index, name) for index in self.indexes]
            if None not in found:
                return list(heapq.merge(*filter(None, found), key=lambda one: one.log_time_ns))
        parts = []
        with suppress(UserError):
            for recorded in self.messages([topic]):
                with suppress(UserError, RuntimeError):
                    if part := part_of(recorded):
                        parts.append(TimedPart(recorded.log_time_ns, part))
        return parts

    def _recorded_name(self, topic: str) -> str:
        """The name under which a topic was recorded."""
        return topic

    def decode(self, type_name: str, cdr: bytes) -> Any:
        """Read bytes as a plain message of a type; a type that is not shipped is read by the definition in the bag.

        UserError if the bag has another definition of the type than this version, or `cdr` is damaged.
        """
        self.check_type(type_name)
        try:
            return self._readers[type_name](cdr)
        except BrokenMessage as error:
            raise UserError(f"A message of type {type_name} in bag {self.path} cannot be decoded: {error}.") from error

    def as_today(self, message: BagMessage) -> BagMessage:
        """A recorded message in today's version; UserError if it cannot be decoded."""
        topic = self.topics[message.topic]
        if not topic.is_old:
            return message
        try:
            cdr = upgraded(message.type_name, topic.definition, message.cdr)
        except Exception as error:  # rosbags reports damage by any exception of its deserializer
            raise UserError(
                f"A message on topic {topic.name} of bag {self.path}, recorded with an older definition of "
                f"{message.type_name}, cannot be decoded: {str(error).rstrip('.')}."
            ) from error
        return message._replace(type_name=topic.type_name, cdr=cdr)

    def _add(self, topic: Topic, repeated: int) -> None:
        """Add a topic of a file, with the number of its messages that are in the file before, too."""
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

    def check_type(self, type_name: str) -> None:
        """UserError if messages of a type cannot be decoded, since the bag has another definition; checked once."""
        if type_name not in self._readers:
            self._readers[type_name] = self._reader_of(type_name)

    def _reader_of(self, type_name: str) -> Callable[[bytes], Any]:
        """The decoder of the messages of a type."""
        definitions = [one.definition for one in self.topics.values() if one.type_name == type_name and not one.is_old]
        if known := shipped_definition(type_name):
            for other in (one for one in definitions if not one.same_layout(known)):
                raise self._other_definition(type_name, other, known)
            return SHIPPED.reader(type_name)
        first = definitions[0] if definitions else known_definition(type_name)
        for other in (one for one in definitions if not one.same_layout(first)):
            raise self._other_definition(type_name, other, first)
        try:
            return recorded_types(type_name, first).reader(type_name)
        except Exception as error:  # an invalid definition may fail anywhere
            raise UserError(
                f"The definition of type {type_name} in bag {self.path} cannot be read: {str(error).rstrip('.')}."
            ) from error

    def _other_definition(self, type_name: str, recorded: Definition, known: Definition) -> UserError:
        topic = next(one.name for one in self.topics.values() if one.definition is recorded)
        return UserError(
            f"Topic {topic} of bag {self.path} was recorded with another definition of {type_name} "
            f"({recorded.type_hash or 'no hash'}) than the one known here ({known.type_hash or 'no hash'}); read it "
            f"with the version of package {type_name.partition('/')[0]} that it was recorded with."
        )


def _topics_of(index: FileIndex) -> list[Topic]:
    """Topics of a file."""
    counts = index.statistics.channel_message_counts
    topics = []
    for channel in index.summary.channels.values():
        check_encoding(index.path, channel)
        schema = index.summary.schemas[channel.schema_id]
        definition = recorded_definition(channel, schema)
        topics.append(
            Topic(
                name=channel.topic,
                type_name=current_name(schema.name),
                count=counts.get(channel.id, 0),
                offered_qos=recorded_qos(channel),
                definition=definition,
                is_old=needs_upgrade(schema.name, definition),
                recorded_type=schema.name,
            )
        )
    return topics


def _custom_data_of(index: FileIndex) -> dict[str, str]:
    """Custom data of a file; empty without any."""
    custom_data = (custom_data_of(name, dict(values)) for name, values in index.records.items())
    return next((texts for texts in custom_data if texts), {})


def _read_messages(
    file: Path, topics: Collection[str] | None, repeated: Collection[str], times: LogTimes
) -> Iterator[BagMessage]:
    """Messages of a file in order of log time; those in the file before, too, are left out of topics in `repeated`."""
    try:
        with file.open("rb") as stream:
            reader = SeekingReader(stream, validate_crcs=True)
            for schema, channel, message in reader.iter_messages(
                topics, starting_at=times.first_ns, ending_at=times.last_ns
            ):
                if channel.topic in repeated and message.sequence == REPEATED_SEQUENCE:
                    continue
                if schema is not None:  # always so: `check_encoding` refuses channels without
                    yield BagMessage(channel.topic, schema.name, message.data, message.log_time, message.publish_time)
    except Exception as error:  # mcap reports damage by any exception of its parser
        raise damaged(file, error) from error
