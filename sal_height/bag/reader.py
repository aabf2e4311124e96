"""Read MCAP bags, our own and those of rosbag2: topics, messages in order of time, and decoded messages."""

from __future__ import annotations

import heapq
import struct
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader

from sal_height import messages
from sal_height.bag import qos
from sal_height.bag.files import (
    CHUNK_FIELDS,
    HEAD,
    REPEATED_SEQUENCE,
    FileIndex,
    bag_files,
    check_encoding,
    custom_data_of,
    damaged,
    read_index,
    read_message_indexes,
    recorded_definition,
    recorded_qos,
    repeated_in,
    stored_as,
)
from sal_height.bag.played import DwellPart, part_of, part_of_frame
from sal_height.bag.qos import Qos, read_yaml, yaml_text
from sal_height.bag.topics import BagMessage, Topic
from sal_height.bag.versions import current_name, needs_upgrade, upgraded
from sal_height.engine.frame_items import Frame
from sal_height.errors import UserError
from sal_height.messages import BrokenMessage
from sal_height.messages.codec import SHIPPED, recorded_types
from sal_height.messages.definition import Definition, known_definition, shipped_definition

_MESSAGE = struct.Struct("<BQHIQQ")
"""Opcode and length of a message, its channel, number, and times of reception and publication, ns."""

HEAD_BYTES = 8192
"""Bytes of a frame that are read first; more follow if it has more pulses."""

ZEROS_BYTES = 64
"""First bytes of a frame; if all are zero, the file is damaged there."""

PULSE_BYTES = 16
"""Bytes of the time and reference range of a pulse."""

__all__ = ["BagMessage", "BagReader", "Topic"]


def is_stored_otherwise(path: Path) -> bool:
    """True if a bag, a folder or a file, is stored in another way than as plain MCAP files.

    Raises:
        UserError: its metadata.yaml cannot be read.
    """
    metadata = path / "metadata.yaml"
    if not metadata.is_file():
        return path.is_file() and path.suffix == ".db3"
    storage, compression, _ = stored_as(metadata)
    return storage != "mcap" or compression != "none"


class OtherStorage:
    """A bag that rosbags reads. Nothing stays open between calls.

    Attributes:
        topics: topics of the bag; one for each publisher, if these are counted separately.
        custom_data: custom texts by name.
        begin_ns: reception of the first message, ns; 0 without messages.
    """

    def __init__(self, path: Path) -> None:
        """Read the topics of the bag at `path`.

        Raises:
            UserError: it is damaged, or stored in a way that rosbags does not know.
        """
        self._path = path
        try:
            with self._reader() as reader:
                profiles = _profiles(path)
                self.topics = [_topic(connection, profiles) for connection in reader.connections]
                self.custom_data = {str(k): str(v) for k, v in (reader.storage.metadata.custom or {}).items()}
                self.begin_ns = reader.start_time if reader.message_count else 0
        except UserError:
            raise
        except Exception as error:  # rosbags reports damage by any exception
            raise self._refusal(error) from error

    def messages(self, topics: Collection[str] | None) -> Iterator[BagMessage]:
        """Messages in the order of their reception, those of `topics` or all; their publish times are not known.

        Raises:
            UserError: the bag is damaged.
        """
        try:
            with self._reader() as reader:
                wanted = [one for one in reader.connections if topics is None or one.topic in topics]
                for connection, time_ns, cdr in reader.messages(wanted) if wanted else ():
                    yield BagMessage(connection.topic, connection.msgtype, bytes(cdr), time_ns, time_ns)
        except Exception as error:  # rosbags reports damage by any exception
            raise self._refusal(error) from error

    def _reader(self) -> Any:
        from rosbags.rosbag2 import Reader  # noqa: PLC0415 (bags of MCAP are read without)

        return Reader(self._path)

    def _refusal(self, error: Exception) -> UserError:
        said = " ".join(str(error).split()).rstrip(".") or type(error).__name__
        return UserError(f"Bag {self._path} cannot be read ({said}); rosbag2 may be able to ('ros2 bag convert').")


def _topic(connection: Any, profiles: dict[str, tuple[Qos, ...]]) -> Topic:
    """A topic for `BagReader`; of a bag without definitions the installed ones are used."""
    recorded = Definition(connection.msgdef.data, connection.digest or "")
    name = current_name(connection.msgtype)
    if not recorded.text:
        try:
            installed = known_definition(name)
        except UserError:
            installed = recorded
        recorded = Definition(installed.text, recorded.type_hash or installed.type_hash)
    return Topic(
        name=connection.topic,
        type_name=name,
        count=connection.msgcount,
        offered_qos=profiles.get(connection.topic, ()),
        definition=recorded,
        is_old=needs_upgrade(connection.msgtype, recorded),
        recorded_type=connection.msgtype,
    )


def _profiles(path: Path) -> dict[str, tuple[Qos, ...]]:
    """Profiles of publishers by topic, from metadata.yaml, in its layout or as a text of an older version."""
    metadata = path / "metadata.yaml"
    if not metadata.is_file():
        return {}
    information = read_yaml(metadata.read_text(encoding="utf-8"))["rosbag2_bagfile_information"]
    found = {}
    for entry in information["topics_with_message_count"]:
        profiles = entry["topic_metadata"].get("offered_qos_profiles") or ""
        text = profiles if isinstance(profiles, str) else yaml_text(profiles)
        found[entry["topic_metadata"]["name"]] = tuple(qos.from_yaml(text))
    return found


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


def _read_frame(stream: BinaryIO, at: int, size: int) -> Frame:
    """The frame of `size` bytes that starts at `at`, with zeros in place of its samples.

    Raises:
        RuntimeError: the frame is broken.
        McapError: there are zeros instead.
    """

    def read(count: int) -> Frame:
        stream.seek(at)
        head = stream.read(min(count, size))
        if not any(head[:ZEROS_BYTES]):
            raise McapError(f"there are zeros at byte {at}")
        return messages.received_frame(head.ljust(size, b"\0"))

    frame = read(HEAD_BYTES)
    text_bytes = 2048  # largest number of bytes of the texts and numbers of a frame, without its pulses and samples
    if not len(frame.pulse_time) or len(frame.frame_id) + len(frame.key.sensor) > text_bytes // 2:
        return read(size)  # a text may be longer than the bytes read before
    needed = text_bytes + PULSE_BYTES * len(frame.pulse_time)
    return frame if needed <= HEAD_BYTES else read(needed)


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
