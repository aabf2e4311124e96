"""Check a bag against the contract of rosbag2 and the needs of the chain: `sal-height bag check`."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any

from mcap.data_stream import ReadDataStream
from mcap.records import Chunk, ChunkIndex, Message
from mcap.stream_reader import breakup_chunk
from mcap.writer import MCAP0_MAGIC

from sal_height.bag.check_sensor import RECORD_ALL, Finding, SensorCheck, error, of_refusal, recovery, some, warning
from sal_height.bag.described import FRAMES, PARAMETER_EVENTS, sensors_in
from sal_height.bag.files import (
    ACCOUNT,
    HEAD,
    PARAMETERS,
    REPEATED_SEQUENCE,
    FileIndex,
    bag_files,
    check_start,
    parameters_file,
    read_index,
    read_log_times,
)
from sal_height.bag.qos import read_yaml
from sal_height.bag.reader import BagMessage, BagReader, Topic
from sal_height.bag.topics import HEIGHT_TYPE, IMAGE_TYPE, RELIEF_TYPE
from sal_height.errors import UserError
from sal_height.messages.definition import known_definition
from sal_height.topics import SENSOR_INFO

WITH_PROVENANCE = {IMAGE_TYPE, HEIGHT_TYPE, RELIEF_TYPE}
"""Types of messages that state the parameters with which they were made."""

NO_METADATA = (
    "Write it with 'ros2 bag reindex -s mcap {path}', or a new bag with 'sal-height bag recover {path} --out DIR'."
)


def check_metadata(path: Path, indexes: list[FileIndex]) -> Iterator[Finding]:
    """Check metadata.yaml of a bag folder against its files; nothing for a file alone."""
    if not path.is_dir():
        return
    fix = NO_METADATA.format(path=path)
    if not (path / "metadata.yaml").is_file():
        yield warning(f"Bag {path} has no metadata.yaml, without which rosbag2 does not open it.", fix)
        return
    unlisted = sorted({file.name for file in path.glob("*.mcap")} - {index.path.name for index in indexes})
    if unlisted:
        yield warning(
            f"File metadata.yaml of bag {path} does not list {some(unlisted)}, which are in the same folder.", fix
        )
    information = read_yaml((path / "metadata.yaml").read_text(encoding="utf-8"))["rosbag2_bagfile_information"]
    try:
        stated, found = _stated(information), _found(indexes)
    except (KeyError, TypeError, AttributeError) as wrong:
        yield error(f"File metadata.yaml of bag {path} is not laid out as rosbag2 does it ({wrong!r}).", fix)
        return
    different = [
        f"{what} is {stated[what]} and not {found.get(what, 0)}"
        for what in stated
        if stated[what] != found.get(what, 0) and not _are_near(what, stated[what], found.get(what, 0))
    ]
    different += [f"{what} is not listed" for what in found.keys() - stated.keys() if what.startswith("count of ")]
    if different:
        yield warning(f"File metadata.yaml of bag {path} contradicts the files: {some(different)}.", fix)


def check_types(reader: BagReader) -> Iterator[Finding]:
    """Check the types of all topics against the installed ones, by their schemas and by their hashes."""
    old = sorted(topic.name for topic in reader.topics.values() if topic.is_old)
    if old:
        yield warning(
            f"Bag {reader.path} was recorded with an older version of sal_height_msgs (topics {', '.join(old)}).",
            f"It is read as it is; 'sal-height bag upgrade {reader.path} --out DIR' writes a bag of today's version.",
        )
    for topic in reader.topics.values():
        if not topic.is_old:
            yield from _check_type(topic)


def left_out(reader: BagReader) -> dict[str, dict[str, int]]:
    """Messages that are not in a bag, as its recorder says: their number by reason, by topic."""
    accounts = [account for index in reader.indexes for account in index.records.get(ACCOUNT, {}).items()]
    return {topic: lost for topic, text in accounts if (lost := _left_out(text))}


def check_accounts(reader: BagReader) -> Iterator[Finding]:
    """Check for messages that the recorder reports as left out, and for recorded parameters."""
    for topic, lost in left_out(reader).items():
        reasons = ", ".join(f"{count} {reason}" for reason, count in lost.items())
        yield warning(
            f"Messages of topic {topic} are not in the bag, as its recorder says: {reasons}.",
            "Record to a faster disk, or with more memory (max_memory_mb of node recorder).",
        )
    in_products = any(topic.type_name in WITH_PROVENANCE and topic.count for topic in reader.topics.values())
    events = reader.topics.get(PARAMETER_EVENTS)
    stated = PARAMETERS in reader.custom_data or parameters_file(reader.path).is_file()
    if not (in_products or stated or (events and events.count)):
        yield warning(
            f"Bag {reader.path} does not contain the parameters of nodes: neither custom data, nor {PARAMETER_EVENTS}, "
            "nor the provenance of products.",
            "A replay takes the defaults, and --param sets others; 'sal-height record' records them, too.",
        )


def _check_type(topic: Topic) -> Iterator[Finding]:
    name, package, recorded = topic.recorded_type, topic.recorded_type.partition("/")[0], topic.definition
    if _contradicts_hash(topic):
        yield error(
            f"The schema of topic {topic.name} is not that of the type hash recorded with it.",
            f"Record it with the package {package} that the publisher was built with.",
        )
        return
    try:
        known = known_definition(topic.type_name)
    except UserError:
        yield warning(
            f"Type {name} of topic {topic.name} is not installed, so that its messages cannot be played.",
            f"Install or source package {package}.",
        )
        return
    if not recorded.same_layout(known):
        yield error(
            f"Topic {topic.name} was recorded with another definition of {name} "
            f"({recorded.type_hash or 'no hash'}) than the one known here ({known.type_hash}).",
            f"Install the version of package {package} that it was recorded with.",
        )


def _contradicts_hash(topic: Topic) -> bool:
    """True if the text of a type has another hash than the recorded one; False where that is unknown."""
    recorded = topic.definition
    if not recorded.type_hash or recorded.encoding != "ros2msg":
        return False
    try:
        return _hash_of(topic.recorded_type, recorded.text) != recorded.type_hash
    except Exception:  # noqa: BLE001 (rosbags reports an invalid definition by any exception of its parser)
        return True


def _hash_of(type_name: str, text: str) -> str:
    """The type hash of a definition by its text."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: PLC0415 (a third of a second)

    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(text, type_name))
    return store.hash_rihs01(type_name)


def _left_out(text: str) -> dict[str, int]:
    """Messages left out by reason, by the account of a topic; empty if it cannot be read."""
    try:
        return {str(reason): int(count) for reason, count in json.loads(text)["left_out"].items() if count}
    except (ValueError, KeyError, TypeError, AttributeError):
        return {}


def _stated(information: Mapping[str, Any]) -> dict[str, Any]:
    """Counts and times in metadata.yaml, by name; absent ones are left out."""
    stated = {
        "count of messages": information.get("message_count"),
        "duration in ns": (information.get("duration") or {}).get("nanoseconds"),
        "start in ns": (information.get("starting_time") or {}).get("nanoseconds_since_epoch"),
    }
    for entry in information.get("topics_with_message_count") or []:
        stated[f"count of {entry['topic_metadata']['name']}"] = entry["message_count"]
        stated[f"type of {entry['topic_metadata']['name']}"] = entry["topic_metadata"]["type"]
    for entry in information.get("files") or []:
        stated[f"count in {Path(entry['path']).name}"] = entry.get("message_count")
    if not stated["count of messages"]:  # a bag without messages has no times
        stated["duration in ns"] = stated["start in ns"] = None
    return {name: value for name, value in stated.items() if value is not None}


def _found(indexes: list[FileIndex]) -> dict[str, Any]:
    """The same counts and times of the files; messages in several files count in each."""
    statistics = [index.statistics for index in indexes if index.statistics.message_count]
    begin_ns = min((one.message_start_time for one in statistics), default=0)
    found: dict[str, Any] = {
        "count of messages": sum(one.message_count for one in statistics),
        "duration in ns": max((one.message_end_time for one in statistics), default=0) - begin_ns,
        "start in ns": begin_ns,
    }
    for index in indexes:
        found[f"count in {index.path.name}"] = index.statistics.message_count
        for channel in index.summary.channels.values():
            name = f"count of {channel.topic}"
            found[name] = found.get(name, 0) + index.statistics.channel_message_counts.get(channel.id, 0)
            found[f"type of {channel.topic}"] = index.summary.schemas[channel.schema_id].name
    return found


def _are_near(what: str, stated: Any, found: Any) -> bool:
    """True if two times are equal but for the last nanosecond, which writers count differently."""
    return what.endswith(" in ns") and abs(int(stated) - int(found)) <= 1


def check_bag(path: Path, advance: Callable[[int, int], None]) -> list[Finding]:
    """Find the faults of the bag at `path`; all its data are read.

    Args:
        path: path of the bag, a folder or a file.
        advance: function called while data are read, with the bytes just read and the bytes of all data.

    Raises:
        UserError: it is not a bag: it does not exist, or none of its files is an MCAP file.
    """
    try:
        files = bag_files(path)
    except UserError as refusal:
        if not (path / "metadata.yaml").is_file() or not any(path.glob("*.mcap")):
            raise
        return [of_refusal(refusal, recovery(path))]
    if not any(map(_is_mcap, files)):
        check_start(files[0], _start(files[0]))
    findings, indexes = [], []
    for file in files:
        try:
            indexes.append(read_index(file))
        except UserError as refusal:
            findings.append(of_refusal(refusal, recovery(path)))
    if findings:  # further findings would only follow from the missing messages of these files
        return findings
    try:
        reader = BagReader(path)
    except UserError as refusal:
        return [of_refusal(refusal, "Record the bag again: it has no messages that ROS 2 programs understand.")]
    return [
        *check_metadata(path, indexes),
        *_check_message_indexes(path, indexes),
        *check_types(reader),
        *check_accounts(reader),
        *_check_messages(reader, advance),
    ]


def _start(file: Path) -> bytes:
    try:
        with file.open("rb") as stream:
            return stream.read(len(MCAP0_MAGIC))
    except OSError as refusal:
        raise UserError(f"File {file} cannot be read: {refusal.strerror}.") from refusal


def _is_mcap(file: Path) -> bool:
    try:
        check_start(file, _start(file))
    except UserError:
        return False
    return True


def _check_message_indexes(path: Path, indexes: Sequence[FileIndex]) -> Iterator[Finding]:
    """Check that each chunk is followed by the indexes of its messages, by which readers seek."""
    for index in indexes:
        try:
            read_log_times(index)
        except UserError as refusal:
            yield of_refusal(refusal, recovery(path))


def _check_messages(reader: BagReader, advance: Callable[[int, int], None]) -> Iterator[Finding]:
    """Read all messages once: the checksums of their chunks, their times, and their content."""
    checks = [SensorCheck(reader, sensor) for sensor in sensors_in(reader.topics)]
    if not checks:
        yield error(f"Bag {reader.path} has no messages on {FRAMES} and {SENSOR_INFO} of any sensor.", RECORD_ALL)
    by_topic = {name: check for check in checks for name in check.topics.names}
    clocks = _Clocks()
    total = sum(chunk.chunk_length for index in reader.indexes for chunk in index.summary.chunk_indexes)
    for index, repeated in zip(reader.indexes, reader.repeated, strict=True):
        for chunk in index.summary.chunk_indexes:
            found = _messages_of(index, chunk)
            if isinstance(found, str):
                yield error(found, recovery(reader.path))
                continue
            for sequence, message in found:
                if sequence == REPEATED_SEQUENCE and message.topic in repeated:
                    continue
                clocks.add(message)
                if check := by_topic.get(message.topic):
                    _look_at(message, reader, check)
            advance(chunk.chunk_length, total)
    yield from clocks.findings()
    for check in checks:
        yield from check.findings()


class _Clocks:
    """Messages whose publish time is later than their reception."""

    def __init__(self) -> None:
        self._ahead: Counter[str] = Counter()
        self._furthest_ns = 0

    def add(self, message: BagMessage) -> None:
        """Look at a message."""
        ahead_ns = message.publish_time_ns - message.log_time_ns
        if ahead_ns > 1_000_000_000:  # the clocks of two machines may differ by this
            self._ahead[message.topic] += 1
            self._furthest_ns = max(self._furthest_ns, ahead_ns)

    def findings(self) -> Iterator[Finding]:
        """The faults, once all messages have been read."""
        if self._ahead:
            counts = ", ".join(f"{count} on {topic}" for topic, count in sorted(self._ahead.items()))
            furthest = f"up to {self._furthest_ns * 1e-9:.3f} s after they were received"
            yield warning(
                f"Messages say that they were published {furthest}: {counts}.",
                "Set the clocks of the machines by PTP or NTP.",
            )


def _look_at(message: BagMessage, reader: BagReader, check: SensorCheck) -> None:
    """Show a message to the check of its sensor; one of an older version that cannot be read as it is."""
    with suppress(UserError):
        message = reader.as_today(message)
    check.add(message)


def _messages_of(index: FileIndex, chunk: ChunkIndex) -> list[tuple[int, BagMessage]] | str:
    """Messages of a chunk, each after its sequence number; if it is damaged, a text that reports it."""
    summary = index.summary
    try:
        with index.path.open("rb") as stream:
            stream.seek(chunk.chunk_start_offset + HEAD.size)
            body = BytesIO(stream.read(chunk.chunk_length - HEAD.size))
        records = breakup_chunk(Chunk.read(ReadDataStream(body)), validate_crc=True)
        found = []
        for record in (record for record in records if isinstance(record, Message)):
            channel = summary.channels[record.channel_id]
            type_name = summary.schemas[channel.schema_id].name
            message = BagMessage(channel.topic, type_name, record.data, record.log_time, record.publish_time)
            found.append((record.sequence, message))
    except Exception as damage:  # noqa: BLE001 (mcap reports damage by whatever its parser stumbles over)
        where = f"The chunk of {chunk.chunk_length} bytes at byte {chunk.chunk_start_offset} of file {index.path}"
        return f"{where} is damaged ({damage or type(damage).__name__})."
    return found
