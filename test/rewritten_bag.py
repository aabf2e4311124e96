"""A copy of a bag in which messages are changed or left out."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from sal_height.bag.reader import BagMessage, BagReader
from sal_height.bag.writer import BagWriter


def rewritten(bag: Path, folder: Path, change: Callable[[BagMessage, int], BagMessage | None]) -> Path:
    """A bag whose messages of a topic, which are numbered, are changed or left out."""
    reader, numbers = BagReader(bag), dict.fromkeys(BagReader(bag).topics, -1)
    with BagWriter(folder, reader.custom_data) as out:
        for topic in reader.topics.values():
            out.add_topic(topic.name, topic.type_name, topic.offered_qos)
        for message in reader.messages():
            numbers[message.topic] += 1
            if changed := change(message, numbers[message.topic]):
                out.write(changed.topic, changed.cdr, changed.log_time_ns, changed.publish_time_ns)
    return folder
