"""Write a rosbag2 bag: MCAP files and their metadata.yaml, readable by rosbag2, Foxglove and rosbags."""

from __future__ import annotations

import contextlib
import errno
import math
import os
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from io import FileIO
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any, NamedTuple, Self

from sal_height.bag import qos as qos_text
from sal_height.bag.files import CHECKSUM, CUSTOM_DATA, REPEATED, REPEATED_SEQUENCE, checksum
from sal_height.bag.mcap_file import McapFile
from sal_height.bag.qos import TRANSIENT_LOCAL, Qos, yaml_text
from sal_height.errors import UserError
from sal_height.messages.definition import Definition, known_definition

NO_TIME = 2**63 - 1
"""Start of a bag without messages, as rosbag2 states it."""


class _Kept(NamedTuple):
    """A message that is repeated at the head of the next file."""

    cdr: bytes
    publish_time_ns: int


@dataclass
class _Topic:
    """A topic of a bag that is being written.

    Attributes:
        name: name of the topic.
        type_name: type of its messages.
        definition: text and hash of the type.
        offered_qos: profile of every publisher.
        latched: last messages, as many as publishers keep.
        kept: messages that are repeated, by key.
    """

    name: str
    type_name: str
    definition: Definition
    offered_qos: Sequence[Qos]
    latched: deque[_Kept]
    kept: dict[str, _Kept] = field(default_factory=dict)

    @property
    def head(self) -> list[_Kept]:
        """Messages and metadata at the head of the next file."""
        return [*self.latched, *self.kept.values()]


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

    def add(self, topic: str, log_time_ns: int) -> None:
        """Count a message."""
        self.counts[topic] += 1
        self.first_ns = min(self.first_ns, log_time_ns)
        self.last_ns = max(self.last_ns, log_time_ns)


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
        self._stream = FileIO(path, "x")
        self._schema_ids: dict[tuple[str, Definition], int] = {}
        self._channel_ids: dict[str, int] = {}
        self._writer = McapFile(self._stream, compression, profile="ros2", library="sal_height")
        if custom_data:
            self._writer.add_metadata(CUSTOM_DATA, {**custom_data, CHECKSUM: checksum(custom_data)})
        if repeated:
            self._writer.add_metadata(REPEATED, {topic: str(count) for topic, count in repeated.items()})

    @property
    def size(self) -> int:
        """Bytes of the file so far, up to a chunk."""
        return self._writer.size

    @property
    def is_closed(self) -> bool:
        """True if nothing more can be written."""
        return self._stream.closed

    def add_topic(self, topic: _Topic) -> None:
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
        self.written.add(topic, log_time_ns)

    def flush(self) -> None:
        """Hand everything written so far to the operating system, so that it outlives this process.

        Raises:
            OSError: it cannot be written, or the file has been removed meanwhile.
        """
        self._writer.flush()
        if not os.fstat(self._stream.fileno()).st_nlink:
            raise FileNotFoundError(errno.ENOENT, "the file has been removed", str(self.path))

    def give_back(self) -> None:
        """Have the disk write what is new, and free the memory of the last bytes that it has written."""
        last = 1 << 27  # bytes; of a disk that falls behind by more, the rest stays in memory
        with contextlib.suppress(ValueError):  # it has been closed
            os.posix_fadvise(self._stream.fileno(), max(0, self.size - last), 0, os.POSIX_FADV_DONTNEED)

    def finish(self, records: Mapping[str, Mapping[str, str]]) -> None:
        """Write metadata records by name, and the index, and close the file."""
        self._writer.flush()
        for name, values in records.items():
            self._writer.add_metadata(name, values)
        self._writer.finish()
        self._stream.close()

    def cut(self) -> None:
        """Close the file as it is."""
        self._stream.close()


class _Breaking:
    """After an OSError in a block of this kind no other may begin: the file ends in half a record.

    Attributes:
        has_broken: True after an OSError.
    """

    def __init__(self, directory: Path) -> None:
        """Watch over the bag in a folder."""
        self._directory = directory
        self.has_broken = False

    def __enter__(self) -> None:
        if self.has_broken:
            raise OSError(f"an earlier write error has cut bag {self._directory}")

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if isinstance(error, OSError):
            self.has_broken = True


ROS_DISTRO = "jazzy"


@dataclass(frozen=True)
class Packing:
    """Division of a bag into files, and compression of its messages.

    Attributes:
        compression: compression of chunks: none, lz4 or zstd.
        split_bytes: size of a file at which the next one is started, bytes.
        split_ns: time from the first message of a file at which the next one is started, ns.
    """

    compression: str = "none"
    split_bytes: float = math.inf
    split_ns: float = math.inf

    @property
    def cuts(self) -> bool:
        """True if there may be more than one file."""
        return min(self.split_bytes, self.split_ns) < math.inf


ONE_FILE = Packing()


class BagWriter:
    """A bag folder that is being written; a context manager, or call `close`.

    Everything up to the last `flush` outlives a killed process and is recovered by `sal_height.bag.salvage`. Each file
    can be read alone: the last messages of latched topics are at its head.
    """

    def __init__(
        self,
        directory: Path,
        custom_data: Mapping[str, str] = MappingProxyType({}),
        packing: Packing = ONE_FILE,
    ) -> None:
        """Create the folder `directory` and in it ``<name of the folder>_0.mcap``.

        Args:
            directory: new or empty folder.
            custom_data: texts by name that are kept in the bag, as those of ``ros2 bag record --custom-data``. They are
                at the start of every file, so that they outlive a killed process.
            packing: division of the bag into files, and compression of its messages.

        Raises:
            UserError: the folder cannot be made or is not empty.
        """
        self.directory = directory
        self._custom_data, self._packing, self._cuts = dict(custom_data), packing, packing.cuts
        self._topics: dict[str, _Topic] = {}
        self._finished: list[Written] = []
        self._breaking = _Breaking(directory)
        try:
            directory.mkdir(parents=True, exist_ok=True)
            if any(directory.iterdir()):
                raise UserError(f"Bag folder {directory} is not empty; name a new or an empty folder.")
            self._file = self._begin_file({})
        except OSError as error:
            raise UserError(f"Bag folder {directory} cannot be written: {error.strerror}.") from error

    @property
    def file(self) -> Path:
        """The file that is being written."""
        return self._file.path

    def has_any(self, topic: str) -> bool:
        """True if the bag has a message of a topic."""
        return any(file.counts[topic] for file in (*self._finished, self._file.written))

    def add_topic(
        self, name: str, type_name: str, qos: Sequence[Qos] = (), definition: Definition | None = None
    ) -> None:
        """Prepare `name` for `write`; to add it again with the same type does nothing.

        Args:
            name: name of the topic.
            type_name: type of its messages.
            qos: profile of every publisher, for players that want to offer the same.
            definition: text and hash of the type; None: that of the package or the environment.

        Raises:
            UserError: the type is not known, or the topic already has another type.
            OSError: the file cannot be written.
        """
        if name in self._topics:
            known = self._topics[name].type_name
            if known != type_name:
                raise UserError(
                    f"Topic {name} of bag {self.directory} carries {known!r} and cannot carry {type_name!r} as well; a "
                    "topic of a bag has one type."
                )
            return
        latched = deque[_Kept](maxlen=kept_by_publishers(qos))
        topic = _Topic(name, type_name, definition or known_definition(type_name), list(qos), latched)
        with self._breaking:
            self._file.add_topic(topic)
        self._topics[name] = topic

    def write(self, topic: str, cdr: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Append one serialized message of a topic added before. Times in nanoseconds, not negative.

        Raises:
            OSError: the file cannot be written (disk full): the bag is cut there, and every later `write` fails too.
        """
        entry = self._topics[topic]
        with self._breaking:
            if self._cuts and self._is_full(log_time_ns):
                self._split(log_time_ns)
            self._file.write(topic, cdr, log_time_ns, publish_time_ns)
        if entry.latched.maxlen:
            entry.latched.append(_Kept(cdr, publish_time_ns))

    def keep(self, topic: str, key: str, cdr: bytes, publish_time_ns: int) -> None:
        """Repeat a message at the head of every later file, in place of the one kept under the same key."""
        self._topics[topic].kept[key] = _Kept(cdr, publish_time_ns)

    def flush(self) -> None:
        """Hand everything written so far to the operating system, so that it outlives this process."""
        with self._breaking:
            self._file.flush()

    def give_back(self) -> None:
        """Free the memory of what the disk has. To be called several times a second, by any thread.

        Once a bag fills the memory of the machine, Linux searches it for a page for every page that is written.
        """
        self._file.give_back()

    def close(self, records: Mapping[str, Mapping[str, str]] = MappingProxyType({})) -> None:
        """Write metadata and index and close the file; may be called twice.

        After a failed `write` there is nothing more to write: the file stays cut, for `salvage`.

        Args:
            records: MCAP metadata records by name, for the last file.
        """
        if self._file.is_closed:
            return
        try:
            if not self._breaking.has_broken:
                with self._breaking:
                    self._finish_file(records)
                    self._write_metadata()
        finally:
            with contextlib.suppress(OSError):
                self._file.cut()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _is_full(self, log_time_ns: int) -> bool:
        """True if a message belongs to the next file; a file has at least one."""
        written = self._file.written
        return bool(written.counts) and (
            log_time_ns - written.first_ns >= self._packing.split_ns or self._file.size >= self._packing.split_bytes
        )

    def _split(self, log_time_ns: int) -> None:
        """Start the next file, at the time of its first message."""
        self._finish_file({})
        heads = {name: topic.head for name, topic in self._topics.items() if topic.head}
        self._file = self._begin_file({name: len(kept) for name, kept in heads.items()})
        for topic in self._topics.values():
            self._file.add_topic(topic)
        for name, kept in heads.items():
            for message in kept:
                self._file.write(name, message.cdr, log_time_ns, message.publish_time_ns, repeated=True)

    def _begin_file(self, repeated: Mapping[str, int]) -> FileWriter:
        path = self.directory / f"{self.directory.resolve().name}_{len(self._finished)}.mcap"
        return FileWriter(path, self._packing.compression, self._custom_data, repeated)

    def _finish_file(self, records: Mapping[str, Mapping[str, str]]) -> None:
        metadata = yaml_text(self._metadata([self._file.written]), sort_keys=False)
        self._file.finish({**records, "rosbag2": {"serialized_metadata": metadata}})
        self._finished.append(self._file.written)

    def _write_metadata(self) -> None:
        information = {"rosbag2_bagfile_information": self._metadata(self._finished)}
        unfinished = self.directory / "metadata.yaml.tmp"
        unfinished.write_text(yaml_text(information, sort_keys=False), encoding="utf-8")
        unfinished.replace(self.directory / "metadata.yaml")

    def _metadata(self, files: Sequence[Written]) -> dict[str, Any]:
        """Contents of metadata.yaml, and of the record of the same meaning inside each file."""
        counts = sum((file.counts for file in files), Counter[str]())
        return {
            "version": 9,  # of rosbag2 in Jazzy
            "storage_identifier": "mcap",
            **_span(files),
            "topics_with_message_count": [
                {
                    "topic_metadata": {
                        "name": name,
                        "type": topic.type_name,
                        "serialization_format": "cdr",
                        "offered_qos_profiles": qos_text.to_dicts(topic.offered_qos),
                        "type_description_hash": topic.definition.type_hash,
                    },
                    "message_count": counts[name],
                }
                for name, topic in self._topics.items()
            ],
            "compression_format": "",  # of whole files or messages; that of chunks is in the MCAP file itself
            "compression_mode": "",
            "relative_file_paths": [file.name for file in files],
            "files": [{"path": file.name, **_span([file])} for file in files],
            "custom_data": self._custom_data or None,
            "ros_distro": ROS_DISTRO,
        }


def _span(files: Sequence[Written]) -> dict[str, Any]:
    """Start, duration and number of messages of files."""
    first_ns, last_ns = min(file.first_ns for file in files), max(file.last_ns for file in files)
    return {
        "duration": {"nanoseconds": 0 if first_ns == NO_TIME else last_ns - first_ns},
        "starting_time": {"nanoseconds_since_epoch": first_ns},
        "message_count": sum(file.counts.total() for file in files),
    }


def kept_by_publishers(profiles: Sequence[Qos]) -> int:
    """Messages that publishers keep for late subscribers, 100 at most; 0 if any of them keeps none."""
    if any(profile.durability != TRANSIENT_LOCAL for profile in profiles):
        return 0
    return min(100, sum(max(1, profile.depth) for profile in profiles))
