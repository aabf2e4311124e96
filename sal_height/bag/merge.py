"""Bags that belong together as one: files of a split, or recordings of several recorders."""

from __future__ import annotations

import heapq
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from sal_height.bag.copies import kept_count, kept_custom_data, kept_packing
from sal_height.bag.reader import BagMessage, BagReader, Topic
from sal_height.bag.writer import BagWriter
from sal_height.errors import UserError


@dataclass(frozen=True)
class Merged:
    """Content of a merged bag.

    Attributes:
        counts: messages in the new bag by topic.
        duplicates: messages by topic that are left out, as an earlier bag has them too.
        latched: latched messages by topic that are left out, as they repeat what late subscribers receive already.
        custom_data: names of custom data of which the bags have several texts; that of the earliest bag is kept.
    """

    counts: Mapping[str, int]
    duplicates: Mapping[str, int]
    latched: Mapping[str, int]
    custom_data: Sequence[str]


def merge(paths: Sequence[Path], out_directory: Path) -> Merged:
    """Write the messages of several bags to a new one, in one file and in the order of their reception.

    Messages are byte for byte those of the bags, with their times. A message is a duplicate if another bag has one of
    the same topic, bytes and time of publication (of reception, if that of publication is not known); it is kept once,
    as it was received first. A latched message is left out if it equals one of the last ones of its topic, which late
    subscribers receive. About 100 bytes of memory are used for each message.

    Args:
        paths: paths of the bags, folders or files.
        out_directory: folder of the new bag.

    Raises:
        UserError: a bag is damaged or not complete, the folder is not empty, or bags differ in the type of a topic or
            in the definition of a type.
    """
    readers = sorted(map(BagReader, paths), key=lambda reader: reader.begin_ns)
    topics = _topics(readers)
    custom_data, several = _custom_data(readers)
    once = _Once(topics)
    counts = Counter[str]()
    try:
        with BagWriter(out_directory, custom_data, kept_packing(readers[0])) as bag:
            for topic in topics.values():
                bag.add_topic(topic.name, topic.recorded_type, topic.offered_qos, topic.definition)
            for message in once.messages(readers):
                bag.write(message.topic, message.cdr, message.log_time_ns, message.publish_time_ns)
                counts[message.topic] += 1
    except OSError as error:
        raise UserError(f"Bag {out_directory} cannot be written: {error}.") from error
    return Merged(counts, once.duplicates, once.latched, several)


def _topics(readers: Sequence[BagReader]) -> dict[str, Topic]:
    """Topics of all bags by name, with the profiles of the publishers of each.

    Raises:
        UserError: bags differ in the type of a topic or in the definition of a type.
    """
    topics: dict[str, Topic] = {}
    defined: dict[str, tuple[Topic, BagReader]] = {}
    for reader in readers:
        for topic in reader.topics.values():
            first, other = defined.setdefault(topic.recorded_type, (topic, reader))
            if not topic.definition.same_layout(first.definition):
                raise UserError(
                    f"Bags {other.path} and {reader.path} have different definitions of type {topic.recorded_type}; "
                    "'sal-height bag upgrade' writes a bag with those of today."
                )
            known = topics.setdefault(topic.name, topic)
            if known.recorded_type != topic.recorded_type:
                raise UserError(
                    f"Topic {topic.name} has type {topic.recorded_type} in bag {reader.path} and "
                    f"{known.recorded_type} in another; a topic must have one type."
                )
            new = [profile for profile in topic.offered_qos if profile not in known.offered_qos]
            topics[topic.name] = replace(known, offered_qos=(*known.offered_qos, *new))
    return topics


def _custom_data(readers: Sequence[BagReader]) -> tuple[dict[str, str], list[str]]:
    """Custom data of all bags, those of the earliest first, and the names of those of which there are several texts."""
    found = [kept_custom_data(reader) for reader in readers]
    merged: dict[str, str] = {}
    for texts in found:
        merged = {**texts, **merged}
    return merged, [name for name, text in merged.items() if any(texts.get(name, text) != text for texts in found)]


class _Once:
    """Messages of several bags, without repetitions, which are counted."""

    def __init__(self, topics: Mapping[str, Topic]) -> None:
        self.duplicates, self.latched = Counter[str](), Counter[str]()
        self._from: dict[int, int] = {}
        """Number of the bag that had a message first, by hash of its topic, time and bytes."""
        self._kept = {
            name: deque[bytes](maxlen=count) for name, topic in topics.items() if (count := kept_count(topic))
        }

    def messages(self, readers: Sequence[BagReader]) -> Iterator[BagMessage]:
        """The messages that are kept, in the order of their reception."""
        numbered = [_numbered(number, reader) for number, reader in enumerate(readers)]
        for number, message in heapq.merge(*numbered, key=lambda one: one[1].log_time_ns):
            time_ns = message.publish_time_ns or message.log_time_ns
            first = self._from.setdefault(hash((message.topic, time_ns, message.cdr)), number)
            kept = self._kept.get(message.topic)
            if first != number:
                self.duplicates[message.topic] += 1
            elif kept is not None and message.cdr in kept:
                self.latched[message.topic] += 1
            else:
                if kept is not None:
                    kept.append(message.cdr)
                yield message


def _numbered(number: int, reader: BagReader) -> Iterator[tuple[int, BagMessage]]:
    return ((number, message) for message in reader.recorded_messages())
