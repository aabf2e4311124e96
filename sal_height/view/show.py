"""`sal-height view`: shows a bag or the live graph, and counts what it leaves out."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING

from sal_height.bag.reader import BagReader
from sal_height.errors import Rejected, UserError
from sal_height.messages import MAP_FRAME, field_from_message
from sal_height.view.drawings import Note, ReceivedMessage, Sheet, Spans
from sal_height.view.painter import COMPLEX_IMAGE, DIAGNOSTICS, HEIGHT_IMAGE, Painter, Subject, estimator_of, is_shown
from sal_height.view.screen import Screen
from sal_height.workers.processes import Interruption

if TYPE_CHECKING:
    from sal_height.view.listener import Listener  # which needs ROS

SKIPPED = "messages/view"
"""Path of the log of what was left out here."""

UNREADABLE, UNEXPECTED = "unreadable", "unexpected"

TELL_PERIOD_S, LOOK_PERIOD_S = 1.0, 0.1


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
        topics = [self._reader.topics[name] for name in self.topics]
        heights = {topic.name: topic.count for topic in topics if topic.type_name == HEIGHT_IMAGE}
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


@dataclass
class Shown:
    """Account of the messages.

    Attributes:
        drawn: number of messages that were drawn, by topic.
        skipped: number of messages that were not, by topic and reason.
        sentences: first warning of each topic and reason.
    """

    drawn: Counter[str] = field(default_factory=Counter)
    skipped: Counter[tuple[str, str]] = field(default_factory=Counter)
    sentences: dict[tuple[str, str], str] = field(default_factory=dict)

    def complaints(self) -> list[str]:
        """A message for each topic and reason for which messages were not drawn."""
        return [
            f"{count} {'message' if count == 1 else 'messages'} on {topic} not shown ({reason})"
            + (f": {self.sentences[topic, reason]}" if (topic, reason) in self.sentences else ".")
            for (topic, reason), count in sorted(self.skipped.items())
        ]


class Artist:
    """Draws messages on a screen; none of them ends it."""

    def __init__(self, painter: Painter, screen: Screen, expected: Subject) -> None:
        """Arrange the views for the expected drawings, and again for others once they arrive."""
        self.shown = Shown()
        self._painter, self._screen = painter, screen
        self._expected = {*expected.estimators, *expected.powers}
        screen.arrange(expected)

    def draw(self, received: ReceivedMessage) -> None:
        """Draw a message, or count it."""
        try:
            message = received.read()
        except UserError as error:
            self._skip(received, UNREADABLE, str(error))
            return
        except Exception as error:  # noqa: BLE001 (decoders fail in many ways)
            self._skip(received, UNREADABLE, f"A message of type {received.type_name} cannot be read: {_said(error)}.")
            return
        try:
            sheets = self._painter.paint(received, message)
        except Rejected as error:
            self._skip(received, error.reason, str(error))
        except Exception as error:  # noqa: BLE001 (no message may end the view)
            self._skip(received, UNEXPECTED, f"Unexpected failure, please report it: {_said(error)}.")
        else:
            self.shown.drawn[received.topic] += 1
            self._show(sheets)

    def draw_rest(self) -> None:
        """Draw what waits for messages that have not arrived."""
        self._show(self._painter.finish())

    def arrange(self) -> None:
        """Arrange the views for all that has been drawn."""
        self._screen.arrange(self._painter.subject)

    def _show(self, sheets: Iterable[Sheet]) -> None:
        for sheet in sheets:
            self._screen.show(sheet)
        subject = self._painter.subject
        drawn = {*subject.estimators, *subject.powers}
        if not drawn <= self._expected:
            self._expected |= drawn
            self._screen.arrange(subject)

    def _skip(self, received: ReceivedMessage, reason: str, sentence: str) -> None:
        """Count a message that cannot be drawn, and say so the first time."""
        self.shown.skipped[received.topic, reason] += 1
        if (received.topic, reason) not in self.shown.sentences:
            self.shown.sentences[received.topic, reason] = sentence
            self.report(received.received_ns, f"{received.topic}: {sentence}")

    def report(self, received_ns: int, sentence: str) -> None:
        """Say something in the viewer."""
        self._screen.show(Sheet(None, received_ns, (Note(SKIPPED, sentence),)))


def _said(error: Exception) -> str:
    """The text of an error, on one line without the full stop."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}".rstrip(".: ")


def show_bag(recorded: Recorded, screen: Screen, map_frame: str = MAP_FRAME) -> Shown:
    """Show all messages of a bag; `map_frame` is the name of the frame that all positions are in."""
    spans = Spans(10_000)  # surfaces: all that are read beforehand
    for received in recorded.some_heights():
        with suppress(Exception):  # it is met again when it is to be drawn
            spans.add(field_from_message(received.read(), map_frame))
    spans.are_settled = True
    artist = Artist(Painter(map_frame, spans), screen, recorded.subject)
    for received in recorded:
        artist.draw(received)
    artist.draw_rest()
    artist.arrange()
    for sentence in recorded.damage:
        artist.shown.skipped["the bag", "damaged"] += 1
        artist.shown.sentences["the bag", "damaged"] = sentence
    return artist.shown


def show_live(listener: Listener, screen: Screen, is_over: Callable[[], bool], map_frame: str = MAP_FRAME) -> Shown:
    """Show what a live graph publishes, all positions in `map_frame`, until it is over or the user interrupts."""
    artist = Artist(Painter(map_frame), screen, Subject())
    reported: dict[tuple[str, str], int] = {}
    due = time.monotonic() + TELL_PERIOD_S
    with Interruption() as interruption, suppress(KeyboardInterrupt):
        while not is_over():
            interruption.check()
            received = listener.received()
            if received:
                artist.draw(received)
            if time.monotonic() >= due:
                due += TELL_PERIOD_S
                _report_losses(artist, reported, listener.left_out)
    artist.draw_rest()
    artist.shown.skipped.update(listener.left_out)
    return artist.shown


def wait_for_interrupt(screen: Screen) -> None:
    """Wait until the user interrupts, or the screen is closed."""
    with Interruption() as interruption, suppress(KeyboardInterrupt):
        while screen.is_open():
            interruption.check()
            time.sleep(LOOK_PERIOD_S)


def _report_losses(artist: Artist, reported: dict[tuple[str, str], int], left_out: dict[tuple[str, str], int]) -> None:
    """Say in the viewer how many messages more have not been handed out."""
    for (topic, reason), count in left_out.items():
        more = count - reported.get((topic, reason), 0)
        if more:
            artist.report(time.time_ns(), f"{topic}: {more} more messages {reason}; they are not shown.")
    reported.update(left_out)
