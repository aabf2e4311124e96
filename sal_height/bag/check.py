"""Check a bag against the contract of rosbag2 and the needs of the chain: `sal-height bag check`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from io import BytesIO
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.records import Chunk, ChunkIndex, Message
from mcap.stream_reader import breakup_chunk

from sal_height.bag.check_files import check_accounts, check_metadata, check_types
from sal_height.bag.check_sensor import RECORD_ALL, SensorCheck
from sal_height.bag.chunk_search import HEAD
from sal_height.bag.files import REPEATED_SEQUENCE, bag_files, check_start
from sal_height.bag.findings import Finding, error, of_refusal, recovery, warning
from sal_height.bag.index import FileIndex, read_index, read_log_times
from sal_height.bag.reader import BagMessage, BagReader
from sal_height.bag.sensor_topics import FRAMES, sensors_in
from sal_height.errors import UserError
from sal_height.topics import SENSOR_INFO

MAGIC_BYTES = 8


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
            return stream.read(MAGIC_BYTES)
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
