"""Write a rosbag2 bag: one MCAP file and its metadata.yaml, readable by rosbag2, Foxglove and rosbags."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any, Self

import yaml
from mcap.writer import CompressionType, Writer
from rclpy.qos import QoSProfile

from sal_height.bag import qos as qos_text
from sal_height.bag.definitions import Definition, installed_definition
from sal_height.bag.files import CHECKSUM, CUSTOM_DATA, checksum
from sal_height.errors import UserError

METADATA_VERSION = 9
ROS_DISTRO = "jazzy"
CHUNK_SIZE = 1 << 20  # bytes; a larger message becomes a chunk of its own

# What rosbag2 gives as the start of a bag without messages.
_NO_TIME = 2**63 - 1


@dataclass
class _Topic:
    type_name: str
    definition: Definition
    offered_qos: Sequence[QoSProfile]
    channel_id: int
    count: int = 0


class BagWriter:
    """A bag folder that is being written; a context manager, or call `close`.

    Everything up to the last `flush` outlives a killed process and is recovered by `sal_height.bag.salvage`.
    """

    def __init__(self, directory: Path, custom_data: Mapping[str, str] = MappingProxyType({})) -> None:
        """Create the folder `directory` and in it ``<name of the folder>_0.mcap``.

        custom_data: texts by name that travel with the bag, as those of ``ros2 bag record --custom-data``. They are
        written first, so that they outlive a killed process.
        UserError if the folder cannot be made or already holds something.
        """
        self.directory = directory
        self.file = directory / f"{directory.resolve().name}_0.mcap"
        try:
            directory.mkdir(parents=True, exist_ok=True)
            if any(directory.iterdir()):
                raise UserError(f"Bag folder {directory} is not empty; name a new or an empty folder.")
            self._stream = self.file.open("xb")
        except OSError as error:
            raise UserError(f"Bag folder {directory} cannot be written: {error.strerror}.") from error
        self._custom_data = dict(custom_data)
        self._topics: dict[str, _Topic] = {}
        self._schema_ids: dict[tuple[str, Definition], int] = {}
        self._first_ns = _NO_TIME
        self._last_ns = 0
        self._broken = False
        # Speckle does not compress (0.93 at a third of the speed), so samples are stored as they are.
        self._writer = Writer(self._stream, chunk_size=CHUNK_SIZE, compression=CompressionType.NONE)
        with self._breaking():
            self._writer.start(profile="ros2", library="sal_height")
            if custom_data:
                self._writer.add_metadata(CUSTOM_DATA, {**custom_data, CHECKSUM: checksum(custom_data)})

    def add_topic(
        self, name: str, type_name: str, qos: Sequence[QoSProfile] = (), definition: Definition | None = None
    ) -> None:
        """Prepare `name` for `write`; to add it again with the same type does nothing.

        qos: profile of every publisher, for players that want to offer the same.
        definition: text and hash of the type; None takes the installed one.
        UserError if the type is not installed or the topic already has another type.
        """
        if name in self._topics:
            if self._topics[name].type_name != type_name:
                raise UserError(
                    f"Topic {name} of bag {self.directory} carries {self._topics[name].type_name!r} and cannot carry "
                    f"{type_name!r} as well; a topic of a bag has one type."
                )
            return
        definition = definition or installed_definition(type_name)
        with self._breaking():
            channel_id = self._writer.register_channel(
                name,
                "cdr",
                self._schema_id(type_name, definition),
                {"offered_qos_profiles": qos_text.to_yaml(qos), "topic_type_hash": definition.type_hash},
            )
        self._topics[name] = _Topic(type_name, definition, list(qos), channel_id)

    def write(self, topic: str, cdr: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Append one serialized message of a topic added before. Times in nanoseconds, not negative.

        OSError if the file cannot take it (disk full): the bag is cut there, and every later `write` fails too.
        """
        with self._breaking():
            entry = self._topics[topic]
            self._writer.add_message(entry.channel_id, log_time_ns, cdr, publish_time_ns)
        entry.count += 1
        self._first_ns = min(self._first_ns, log_time_ns)
        self._last_ns = max(self._last_ns, log_time_ns)

    def flush(self) -> None:
        """Hand everything written so far to the operating system, so that it outlives this process."""
        with self._breaking():
            self._writer.flush()

    def close(self) -> None:
        """Write index and metadata and close the file; may be called twice.

        After a failed `write` there is nothing more to write: the file stays cut, for `salvage`.
        """
        if self._stream.closed:
            return
        try:
            if not self._broken:
                with self._breaking():
                    self._finish()
        finally:
            # A broken stream still holds bytes that it tries, and fails, to write again.
            with contextlib.suppress(OSError):
                self._stream.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _schema_id(self, type_name: str, definition: Definition) -> int:
        """Id of the schema record of a type, written once however many topics carry it."""
        key = (type_name, definition)
        if key not in self._schema_ids:
            text = definition.text.encode()
            self._schema_ids[key] = self._writer.register_schema(type_name, definition.encoding, text)
        return self._schema_ids[key]

    @contextlib.contextmanager
    def _breaking(self) -> Iterator[None]:
        """After an OSError the file ends in half a record: nothing may be appended to it."""
        if self._broken:
            raise OSError(f"an earlier write error has cut bag {self.directory}")
        try:
            yield
        except OSError:
            self._broken = True
            raise

    def _finish(self) -> None:
        metadata = self._metadata()
        self._writer.flush()
        self._writer.add_metadata("rosbag2", {"serialized_metadata": yaml.safe_dump(metadata, sort_keys=False)})
        self._writer.finish()
        self._stream.flush()
        unfinished = self.directory / "metadata.yaml.tmp"
        unfinished.write_text(yaml.safe_dump({"rosbag2_bagfile_information": metadata}, sort_keys=False))
        unfinished.replace(self.directory / "metadata.yaml")

    def _metadata(self) -> dict[str, Any]:
        """Contents of metadata.yaml, and of the record of the same meaning inside the file."""
        count = sum(topic.count for topic in self._topics.values())
        starting_time = {"nanoseconds_since_epoch": self._first_ns}
        duration = {"nanoseconds": self._last_ns - self._first_ns if count else 0}
        return {
            "version": METADATA_VERSION,
            "storage_identifier": "mcap",
            "duration": duration,
            "starting_time": starting_time,
            "message_count": count,
            "topics_with_message_count": [
                {
                    "topic_metadata": {
                        "name": name,
                        "type": topic.type_name,
                        "serialization_format": "cdr",
                        "offered_qos_profiles": qos_text.to_dicts(topic.offered_qos),
                        "type_description_hash": topic.definition.type_hash,
                    },
                    "message_count": topic.count,
                }
                for name, topic in self._topics.items()
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [self.file.name],
            "files": [
                # PyYAML would write a shared dictionary as an alias, which not every reader resolves.
                {
                    "path": self.file.name,
                    "starting_time": dict(starting_time),
                    "duration": dict(duration),
                    "message_count": count,
                }
            ],
            "custom_data": self._custom_data or None,
            "ros_distro": ROS_DISTRO,
        }
