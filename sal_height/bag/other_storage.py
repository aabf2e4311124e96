"""Bags of rosbag2 that are not plain MCAP: SQLite3, and compression of whole files or of messages; read by rosbags."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from sal_height.bag import qos
from sal_height.bag.definitions import Definition, known_definition
from sal_height.bag.files import stored_as
from sal_height.bag.metadata_text import read_yaml, yaml_text
from sal_height.bag.qos import Qos
from sal_height.bag.topics import BagMessage, Topic
from sal_height.bag.versions import current_name, needs_upgrade
from sal_height.errors import UserError


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
