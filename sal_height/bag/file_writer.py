"""One MCAP file of a bag that is being written."""

from __future__ import annotations

import errno
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from mcap.writer import CompressionType, Writer

from sal_height.bag import qos as qos_text
from sal_height.bag.files import CHECKSUM, CUSTOM_DATA, REPEATED, REPEATED_SEQUENCE, checksum
from sal_height.bag.qos import Qos
from sal_height.messages.definition import Definition

CHUNK_SIZE = 1 << 20  # bytes; a larger message becomes a chunk of its own

COMPRESSIONS = {"none": CompressionType.NONE, "lz4": CompressionType.LZ4, "zstd": CompressionType.ZSTD}
"""Compressions of chunks, by the names that users give. Noise and speckle hardly get smaller."""

NO_TIME = 2**63 - 1
"""Start of a bag without messages, as rosbag2 states it."""


@dataclass(frozen=True)
class WrittenTopic:
    """A topic of a bag that is being written: its type, and the profiles of its publishers."""

    name: str
    type_name: str
    definition: Definition
    offered_qos: Sequence[Qos]


@dataclass
class Written:
    """Summary of a written file: all that is left of it once it is finished.

    Attributes:
        name: name of the file.
        counts: messages by topic.
        first_ns: earliest log time; NO_TIME without messages.
        last_ns: latest log time; 0 without messages.
    """

    name: str
    counts: Counter[str] = field(default_factory=Counter)
    first_ns: int = NO_TIME
    last_ns: int = 0


class FileWriter:
    """An MCAP file that is being written.

    Attributes:
        path: path of the file.
        written: summary of its content so far.
    """

    def __init__(
        self, path: Path, compression: str, custom_data: Mapping[str, str], repeated: Mapping[str, int]
    ) -> None:
        """Start the file `path`, which must not exist.

        Args:
            path: path of the file.
            compression: compression of its chunks, one of COMPRESSIONS.
            custom_data: texts by name; they are written first, so that they outlive a killed process.
            repeated: number of messages by topic that are written first and are in the file before, too.

        Raises:
            OSError: it cannot be written.
        """
        self.path, self.written = path, Written(path.name)
        self._stream = path.open("xb")
        self._schema_ids: dict[tuple[str, Definition], int] = {}
        self._channel_ids: dict[str, int] = {}
        self._writer = Writer(self._stream, chunk_size=CHUNK_SIZE, compression=COMPRESSIONS[compression])
        self._writer.start(profile="ros2", library="sal_height")
        if custom_data:
            self._writer.add_metadata(CUSTOM_DATA, {**custom_data, CHECKSUM: checksum(custom_data)})
        if repeated:
            self._writer.add_metadata(REPEATED, {topic: str(count) for topic, count in repeated.items()})

    @property
    def size(self) -> int:
        """Bytes of the file so far, up to a chunk."""
        return self._stream.tell()

    @property
    def is_closed(self) -> bool:
        """True if nothing more can be written."""
        return self._stream.closed

    def add_topic(self, topic: WrittenTopic) -> None:
        """Prepare a topic for `write`."""
        key = (topic.type_name, topic.definition)
        if key not in self._schema_ids:  # once for all topics with it
            text = topic.definition.text.encode()
            self._schema_ids[key] = self._writer.register_schema(topic.type_name, topic.definition.encoding, text)
        self._channel_ids[topic.name] = self._writer.register_channel(
            topic.name,
            "cdr",
            self._schema_ids[key],
            {
                "offered_qos_profiles": qos_text.to_yaml(topic.offered_qos),
                "topic_type_hash": topic.definition.type_hash,
            },
        )

    def write(self, topic: str, cdr: bytes, log_time_ns: int, publish_time_ns: int, *, repeated: bool = False) -> None:
        """Append a serialized message; `repeated`: True if it is in the file before, too."""
        sequence = REPEATED_SEQUENCE if repeated else 0
        self._writer.add_message(self._channel_ids[topic], log_time_ns, cdr, publish_time_ns, sequence)
        written = self.written
        written.counts[topic] += 1
        written.first_ns, written.last_ns = min(written.first_ns, log_time_ns), max(written.last_ns, log_time_ns)

    def flush(self) -> None:
        """Hand everything written so far to the operating system, so that it outlives this process.

        Raises:
            OSError: it cannot be written, or the file has been removed meanwhile.
        """
        self._writer.flush()
        if not os.fstat(self._stream.fileno()).st_nlink:
            raise FileNotFoundError(errno.ENOENT, "the file has been removed", str(self.path))

    def finish(self, records: Mapping[str, Mapping[str, str]]) -> None:
        """Write metadata records by name, and the index, and close the file."""
        self._writer.flush()
        for name, values in records.items():
            self._writer.add_metadata(name, dict(values))
        self._writer.finish()
        self._stream.close()

    def cut(self) -> None:
        """Close the file as it is: a broken stream still keeps bytes that it tries, and fails, to write again."""
        self._stream.close()
