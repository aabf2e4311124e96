"""Copies of a bag with other messages, or with other names of its topics."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from sal_height.bag.reader import BagMessage, BagReader
from sal_height.bag.writer import BagWriter


def copied(
    bag: Path,
    folder: Path,
    messages: Iterable[BagMessage] | None = None,
    *,
    names: Callable[[str], Sequence[str]] = lambda topic: [topic],
    more: Mapping[str, str] = MappingProxyType({}),
    custom_data: Mapping[str, str] | None = None,
) -> Path:
    """A bag with the topics and custom data of another one, each message in a chunk of its own.

    Args:
        bag: the other one.
        folder: folder of the copy.
        messages: messages of the copy; None: those of the other one.
        names: names in the copy of a topic of the other one.
        more: types of topics that the other one lacks.
        custom_data: custom data of the copy; None: those of the other one.
    """
    reader = BagReader(bag)
    with BagWriter(folder, reader.custom_data if custom_data is None else custom_data) as out:
        for topic in reader.topics.values():
            for name in names(topic.name):
                out.add_topic(name, topic.type_name, topic.offered_qos)
        for name, type_name in more.items():
            out.add_topic(name, type_name)
        for message in reader.messages() if messages is None else messages:
            for name in names(message.topic):
                out.write(name, message.cdr, message.log_time_ns, message.publish_time_ns)
            out.flush()
    return folder


def rewritten(bag: Path, folder: Path, change: Callable[[BagMessage, int], BagMessage | None]) -> Path:
    """A bag whose messages of a topic, which are numbered, are changed or left out."""
    numbers = dict.fromkeys(BagReader(bag).topics, -1)

    def changed() -> Iterator[BagMessage]:
        for message in BagReader(bag).messages():
            numbers[message.topic] += 1
            if (other := change(message, numbers[message.topic])) is not None:
                yield other

    return copied(bag, folder, changed())
