"""The messages of a bag."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from sal_height.bag.reader import BagReader
from sal_height.errors import UserError
from sal_height.view.drawings import ReceivedMessage
from sal_height.view.painter import COMPLEX_IMAGE, DIAGNOSTICS, HEIGHT_IMAGE, Subject, estimator_of, is_shown


class Recorded:
    """Messages of a bag that can be shown.

    Attributes:
        topics: names of their topics.
        damage: warning about each part of the bag that could not be read.
    """

    def __init__(self, reader: BagReader, namespace: str) -> None:
        """Look into a bag for topics of sensors in a namespace; empty: any.

        Raises:
            UserError: it has none.
        """
        self._reader = reader
        self.topics = [t.name for t in reader.topics.values() if t.count and is_shown(t.name, t.type_name, namespace)]
        self.damage: list[str] = []
        if all(reader.topics[name].type_name == DIAGNOSTICS for name in self.topics) and (namespace or not self.topics):
            where = f" in namespace {namespace}" if namespace else ""
            raise UserError(
                f"Bag {reader.path} has no heights, images or odometry{where}; its topics are "
                f"{', '.join(sorted(reader.topics)) or 'none'}."
            )

    @property
    def subject(self) -> Subject:
        """Description of the drawings of the topics, without positions."""
        types = {name: self._reader.topics[name].type_name for name in sorted(self.topics)}
        return Subject(
            tuple(estimator_of(name) for name, type_name in types.items() if type_name == HEIGHT_IMAGE),
            tuple(name.strip("/") for name, type_name in types.items() if type_name == COMPLEX_IMAGE),
        )

    def some_heights(self) -> Iterator[ReceivedMessage]:
        """Up to 64 height images of every topic, evenly spread over the bag."""
        heights = {name: self._reader.topics[name].count for name in self.topics if self._is_height(name)}
        seen = dict.fromkeys(heights, 0)
        for received in self._messages(list(heights)):
            number, count = seen[received.topic], heights[received.topic]
            seen[received.topic] += 1
            if number * 64 // count != (number - 1) * 64 // count:
                yield received
        self.damage.clear()  # it will be met again

    def __iter__(self) -> Iterator[ReceivedMessage]:
        """All messages, in the order in which they were recorded."""
        return self._messages(self.topics)

    def _is_height(self, name: str) -> bool:
        return self._reader.topics[name].type_name == HEIGHT_IMAGE

    def _messages(self, topics: list[str]) -> Iterator[ReceivedMessage]:
        recorded = self._reader.messages(topics) if topics else iter(())
        while True:
            try:
                message = next(recorded)
            except StopIteration:
                return
            except UserError as error:
                self.damage.append(str(error))
                continue
            read = partial(self._reader.decode, message.type_name, message.cdr)
            yield ReceivedMessage(message.topic, message.type_name, message.log_time_ns, read)
