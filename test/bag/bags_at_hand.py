"""Small bags of sensors, made from the reference bag without a run."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path
from typing import Any

from sal_height.bag.reader import BagMessage, BagReader
from sal_height.bag.writer import ONE_FILE, BagWriter, Packing
from sal_height.messages import serialize

REFERENCE = Path(__file__).parents[2] / "bags" / "version_3"
"""Two dwells of eight detectors."""


@cache
def _source() -> BagReader:
    return BagReader(REFERENCE)


@cache
def _messages() -> tuple[BagMessage, ...]:
    return tuple(_source().messages())


def reference() -> list[BagMessage]:
    """The messages of the reference bag."""
    return list(_messages())


def write_like_reference(
    folder: Path, messages: Iterable[BagMessage], custom_data: dict[str, str] | None = None, packing: Packing = ONE_FILE
) -> Path:
    """A bag with topics as the reference bag has them, and these messages, each in a chunk of its own."""
    source = _source()
    messages = list(messages)
    profiles = {name: topic.offered_qos for name, topic in source.topics.items()}
    with BagWriter(folder, source.custom_data if custom_data is None else custom_data, packing) as bag:
        for message in messages:
            bag.add_topic(message.topic, message.type_name, profiles.get(message.topic, ()))
        for message in messages:
            bag.write(message.topic, message.cdr, message.log_time_ns, message.publish_time_ns)
            bag.flush()
    return folder


def changed(message: BagMessage, change: Callable[[Any], None]) -> BagMessage:
    """A message after a change to what it says."""
    decoded = _source().decode(message.type_name, message.cdr)
    change(decoded)
    return message._replace(cdr=serialize(decoded))
