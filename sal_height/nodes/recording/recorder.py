"""Node recorder: writes the messages of topics to a bag, byte for byte."""

from __future__ import annotations

import json
import threading
import time
import traceback
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from rclpy._rclpy_pybind11 import RCLError
from rclpy.clock import Clock, JumpThreshold, ROSClock, TimeJump
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.subscription import Subscription

from sal_height.bag.described import PARAMETER_EVENT_TYPE, PARAMETER_EVENTS
from sal_height.bag.files import ACCOUNT
from sal_height.bag.topics import FRAME_TYPE, HEIGHT_TYPE, IMAGE_TYPE, ODOMETRY_TYPE
from sal_height.bag.writer import BagWriter
from sal_height.errors import UserError
from sal_height.io import free_folder
from sal_height.messages.types import DiagnosticArray, DiagnosticStatus
from sal_height.nodes.accounts.account import (
    DIAGNOSTICS,
    NOT_WRITTEN,
    ON_THE_WAY,
    PROGRESS,
    QUEUE_FULL,
    RECORDER,
    Account,
    TopicCounts,
)
from sal_height.nodes.accounts.publisher import AccountPublisher
from sal_height.nodes.accounts.tally import process_numbers
from sal_height.nodes.managed import Role, Topics
from sal_height.nodes.parameters import LiveParameters
from sal_height.nodes.program import run_node
from sal_height.nodes.recording.parameter_reader import ASK_PERIOD_S, ParameterReader
from sal_height.nodes.recording.recorder_parameters import RecorderParameters, Selection
from sal_height.nodes.recording.subscribing import Arrived, TimedLooks, arrived, matching_profile, replaces_messages
from sal_height.nodes.transport.callbacks import Repeated, guarded, guarded_with_times
from sal_height.nodes.transport.log import RareWarnings
from sal_height.nodes.transport.message_types import message_class
from sal_height.nodes.transport.qos import from_profile

ACCOUNTS = {DIAGNOSTICS, PROGRESS}  # accounts of these would be recorded in turn, without end
FAILED = "internal error"  # kind of the errors that no message should cause
DIAGNOSTICS_PERIOD_S = 0.5
GIVE_BACK_PERIOD_S = 0.1

GATHER_S = 0.02
"""Time in which messages gather, so that the thread that writes wakes once for all of them, s."""

CLOCK_CHANGES = JumpThreshold(min_forward=None, min_backward=None, on_clock_change=True)
"""The node's clock follows /clock from now on, or no longer."""

OF_OBJECTS = 1000
"""Memory that the objects around a message need, bytes."""

OF_DWELLS = {FRAME_TYPE, IMAGE_TYPE, HEIGHT_TYPE, ODOMETRY_TYPE}
"""Types of which every message matters, however it is published."""

NEVER_CAME = (
    "Messages were lost between publisher and recorder, as the counts of others show (ignored.lost on the way): "
    "publish "
    "them reliably, or give their publisher more shared memory (`sal-height transport`)."
)


class _Item(NamedTuple):
    """A message that waits to be written, with the times of its reception and publication, ns."""

    topic: str
    cdr: bytes
    times: tuple[int, int]


class Recorder(Role, Node):
    """Subscribes to topics as soon as they have a publisher and writes their serialized messages to a bag.

    A thread of its own writes. Once messages of max_memory_mb wait for it, those that come are left out and counted.
    The bag is complete once the node is destroyed or its context shut down.
    """

    parameters = RecorderParameters
    inputs: ClassVar[Topics] = {"<topics>": "whatever is published"}
    completes_file = True

    def __init__(self, directory: Path | None = None, **node_arguments: Any) -> None:
        """Record into the new folder `directory` (None: the parameter of that name).

        node_arguments: passed to rclpy's Node (context, parameter_overrides, namespace, ...).
        UserError if a parameter or the folder cannot be used.
        """
        super().__init__("recorder", **node_arguments)
        try:
            self._parameters_now = LiveParameters(self, RecorderParameters)
            parameters = self._parameters_now.current
            names = [self._resolved(name) for name in parameters.topics]
            self._selection = Selection(names, parameters.patterns, parameters.types, parameters.excluded)
            self._reader = (
                ParameterReader(self, self._tell_parameters, self._fail) if parameters.node_parameters else None
            )
            custom_data = dict(_name_and_text(text) for text in parameters.custom_data)
            self._bag = BagWriter(directory or _folder(parameters.directory), custom_data, parameters.packing)
        except UserError:
            super().destroy_node()
            raise
        if not directory and self._bag.directory != Path(parameters.directory):
            self.get_logger().info(f"{parameters.directory} contains a bag already; this one is {self._bag.directory}.")
        self._subscribed: dict[str, Subscription] = {}
        self._publisher_counts: dict[str, Callable[[], int]] = {}
        """Functions that count the publishers of a topic."""
        self._refused: set[str] = set()
        self._topic_counts: dict[str, TopicCounts] = {}
        self._failures = 0
        self._last_loss = ""
        self._warnings = RareWarnings(self)
        self._reported = False
        self._closed = False
        self._receiving = threading.RLock()  # of a thread that receives: the bag is not completed meanwhile
        self._lock = threading.RLock()  # of the bag, which several threads write to
        self._turn = threading.RLock()  # of a thread that writes what waits: the recorder's, or one that needs it
        self._waiting: deque[_Item] = deque()
        self._guarded_write = guarded(self._write, self._fail)
        self._put_bytes, self._taken_bytes = 0, 0  # by the thread that receives, and in turns; their difference waits
        self._arrival, self._ending = threading.Event(), threading.Event()
        self._process_numbers: dict[str, Any] = {}
        """Last values of the fields of the account on processor time and memory."""
        self._account_publisher = AccountPublisher(self, guarded(lambda _: self._publish_account(), self._fail))
        self._clock_changes = self.get_clock().create_jump_callback(CLOCK_CHANGES, post_callback=self._look_at_clock)
        self._look_at_clock()
        self._worker = threading.Thread(target=self._work, name="recorder", daemon=True)
        self._worker.start()
        self.context.on_shutdown(self.close_bag)
        self._looks = TimedLooks(self, guarded(self._take, self._fail))
        self._every(0.1, self._discover)
        if self._reader:
            self._every(ASK_PERIOD_S, partial(self._look_for_parameters, self._reader))
        self._accounting = Repeated(DIAGNOSTICS_PERIOD_S, guarded(self._publish_account, self._fail), "account")
        self._giving_back = Repeated(GIVE_BACK_PERIOD_S, guarded(self._bag.give_back, self._fail), "give back")
        self._discover()

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """The subscriptions for which an executor waits: those of topics only if the node has another clock."""
        looked_at = [] if self._has_other_clock else list(self._subscribed.values())
        return (one for one in super().subscriptions if one not in looked_at)

    @property
    def recorded(self) -> dict[str, int]:
        """Number of messages in the bag, by topic; 0 for a topic that has just been subscribed to."""
        return {topic: counts.written for topic, counts in self.topic_counts.items()}

    def missed(self, topic: str) -> int:
        """Messages of a topic that its publisher has sent and that have not arrived."""
        return self._topic_counts[topic].missed if topic in self._topic_counts else 0

    def account(self) -> Account:
        """Its account as it is now, with its state."""
        self._process_numbers = process_numbers()
        account, missing = self._counts(), self._left_out.total()
        if missing:
            return replace(account, level=DiagnosticStatus.ERROR, state=f"{missing} messages are not in the bag")
        return replace(account, state="recording")

    @property
    def topic_counts(self) -> dict[str, TopicCounts]:
        """Counts of the messages of each topic."""
        return dict(self._topic_counts)

    @property
    def unwritten(self) -> int:
        """Number of messages that were received and could not be written."""
        return self._left_out[NOT_WRITTEN]

    @property
    def dropped(self) -> int:
        """Number of messages that were left out because too much waited to be written."""
        return self._left_out[QUEUE_FULL]

    @property
    def failures(self) -> int:
        """Number of errors that no message should cause."""
        return self._failures

    @property
    def failure(self) -> str:
        """Reason for which messages are not in the bag (the program ends with status 1 then); empty if all are."""
        return self._last_loss or (NEVER_CAME if self._left_out[ON_THE_WAY] else "")

    @property
    def _left_out(self) -> Counter[str]:
        """Messages of all topics that are not in the bag, by reason."""
        return sum((counts.left_out.copy() for counts in self.topic_counts.values()), Counter[str]())

    def close_bag(self) -> None:
        """Write what has arrived so far and complete the bag; later messages are ignored. May be called twice."""
        self._ending.set()
        with self._receiving:  # a thread that receives has handed over all that it has
            self._arrival.set()
        self._worker.join()
        self._giving_back.end()
        with self._turn, self._lock:  # in the order in which those who write take them
            if self._closed:
                return
            self._clock_changes.unregister()
            self._write_waiting()
            for topic, cdr, info in arrived(self._subscribed):
                self._receive(topic, info)
                self._write(topic, cdr, self._times(info))
            self._closed = True
            account = {topic: json.dumps(counts.as_json()) for topic, counts in self._topic_counts.items()}
            try:
                self._bag.close({ACCOUNT: account})
            except OSError as error:
                self._report(error)

    def destroy_node(self) -> None:
        """Complete the bag and destroy the node."""
        self._accounting.end()
        self.close_bag()
        super().destroy_node()

    def _resolved(self, name: str) -> str:
        """A topic with its namespace.

        Raises:
            UserError: no topic can have that name.
        """
        try:
            return str(self.resolve_topic_name(name))
        except RCLError as error:
            raise UserError(
                f"Parameter topics has {name!r}, which is no name of a topic, such as '/ml/height'."
            ) from error

    def _every(self, period_s: float, callback: Callable[[], None]) -> None:
        """Call `callback` again and again by a clock that never stands still; an error in it does not end the node."""
        self.create_timer(period_s, guarded(callback, self._fail), clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _discover(self) -> None:
        """Subscribe to the wanted topics that have a publisher by now, until all those that may appear have."""
        known = self._refused.union(self._subscribed)
        if not self._selection.is_open and known >= self._selection.names:
            return
        for name, types in self.get_topic_names_and_types():
            if name not in known and self._selection.wants(name, types):
                self._try_to_subscribe(name, types)

    def _try_to_subscribe(self, name: str, types: list[str]) -> None:
        """Subscribe to a topic, or log why it cannot be recorded."""
        try:
            self._subscribe(name, types)
        except UserError as error:
            self._refused.add(name)
            self.get_logger().warning(f"Topic {name} is not recorded. {error}")

    def _subscribe(self, name: str, types: list[str]) -> None:
        offered = [publisher.qos_profile for publisher in self.get_publishers_info_by_topic(name)]
        if not offered:
            return
        if len(types) != 1:
            raise UserError(f"It has the types {', '.join(types)}; a topic must have one.")
        message_type = message_class(types[0])
        with self._lock:
            if self._closed:
                return
            try:
                self._bag.add_topic(name, types[0], [from_profile(profile) for profile in offered])
            except OSError as error:
                self._report(error)
            profile = matching_profile(offered)
            self._topic_counts[name] = TopicCounts(latched=replaces_messages(offered) and types[0] not in OF_DWELLS)
            self._subscribed[name] = subscription = self.create_subscription(
                message_type, name, guarded_with_times(self._taker_of(name), self._fail), profile, raw=True
            )
            self._publisher_counts[name] = subscription.get_publisher_count

    def _look_for_parameters(self, reader: ParameterReader) -> None:
        """Ask nodes for their parameters, once the bag has the topic of their answers."""
        if PARAMETER_EVENTS not in self._refused.union(self._subscribed):
            self._try_to_subscribe(PARAMETER_EVENTS, [PARAMETER_EVENT_TYPE])
        if PARAMETER_EVENTS in self._subscribed:
            reader.look()

    def _tell_parameters(self, cdr: bytes) -> None:
        """Record the parameters of a node that was asked for them."""
        self._topic_counts[PARAMETER_EVENTS].receive(None, lambda: 0)
        self._put(PARAMETER_EVENTS, cdr, (self._now_ns, self._now_ns))

    def _take(self) -> bool:
        """Receive what has arrived on all topics; True if there is any."""
        before = self._put_bytes
        if not self._has_other_clock:
            self._receive_all(arrived(self._subscribed))
        return self._put_bytes > before

    def _taker_of(self, topic: str) -> Callable[[bytes, dict[str, Any]], None]:
        """A callback that receives the messages of a topic."""
        return lambda cdr, info: self._receive_all([Arrived(topic, cdr, info)])

    def _receive_all(self, messages: Iterable[Arrived]) -> None:
        """Hand messages to the thread that writes."""
        with self._receiving:
            if self._ending.is_set():
                return
            for topic, cdr, info in messages:
                self._receive(topic, info)
                self._put(topic, cdr, self._times(info))

    def _put(self, topic: str, cdr: bytes, times: tuple[int, int]) -> None:
        """Hand a message to the thread that writes, unless too much waits for it."""
        size, waiting = len(cdr) + OF_OBJECTS, self._put_bytes - self._taken_bytes
        most_mb = self._parameters_now.current.max_memory_mb
        if waiting and waiting + size > most_mb * 1_000_000:
            self._leave_out(topic, most_mb)
            return
        self._put_bytes += size
        self._waiting.append(_Item(topic, cdr, times))
        if not self._arrival.is_set():
            self._arrival.set()

    def _receive(self, topic: str, info: dict[str, Any]) -> None:
        """Count a message that has arrived."""
        self._topic_counts[topic].receive(info.get("publication_sequence_number"), self._publisher_counts[topic])

    def _leave_out(self, topic: str, most_mb: int) -> None:
        """Count a message for which there is no memory."""
        self._topic_counts[topic].left_out[QUEUE_FULL] += 1
        self._last_loss = (
            f"The disk falls behind: {most_mb} MB (max_memory_mb) of messages wait for it, and new messages are left "
            "out of the bag; record fewer topics, or on a faster disk."
        )
        self._warnings.log(self._last_loss)

    def _work(self) -> None:
        """Write messages until the bag is closed, and pass them to the operating system at regular times."""
        flush, publish = guarded(self._flush, self._fail), guarded(self._account_publisher.publish_progress, self._fail)
        flush_due: float | None = None
        while not self._ending.is_set():
            self._arrival.wait(None if flush_due is None else max(0.0, flush_due - time.monotonic()))
            self._ending.wait(GATHER_S)
            self._arrival.clear()
            topics, now = self._write_waiting(), time.monotonic()
            if topics - ACCOUNTS:
                publish(self._counts)
            if topics and flush_due is None:
                flush_due = now + self._parameters_now.current.flush_period_s
            if flush_due is not None and now >= flush_due:
                flush_due = None
                flush()

    def write_received(self) -> None:
        """Write the messages that have arrived; somebody waits for them."""
        self._take()
        self._write_waiting()

    def _write_waiting(self) -> set[str]:
        """Write the messages that wait, and return their topics.

        Messages that arrive before a clock other than the machine's has started wait for it: a bag must have times.
        """
        write, topics = self._guarded_write, set[str]()
        with self._turn:
            while self._waiting and (self._waiting[0].times[0] or self._now_ns or self._ending.is_set()):
                topic, cdr, times = self._waiting.popleft()
                self._taken_bytes += len(cdr) + OF_OBJECTS
                write(topic, cdr, times if times[0] else (self._now_ns, self._now_ns))
                topics.add(topic)
        return topics

    def _look_at_clock(self, _: TimeJump | None = None) -> None:
        """Note whether the node's clock is another one than that of the times of the middleware."""
        clock = self.get_clock()
        self._has_other_clock = isinstance(clock, ROSClock) and clock.ros_time_is_active
        if self.executor:
            self.executor.wake()  # for it waits for other subscriptions now

    @property
    def _now_ns(self) -> int:
        """The time of the node's clock, ns; 0: it has not started, or is before 1970."""
        return max(0, self.get_clock().now().nanoseconds)

    def _times(self, info: dict[str, Any]) -> tuple[int, int]:
        """Reception and publication of a message, ns; a bag cannot have times before 1970."""
        if self._has_other_clock:
            return (now_ns := self._now_ns), now_ns
        received_ns, published_ns = info["received_timestamp"], info["source_timestamp"]
        if received_ns <= 0:
            received_ns = self._now_ns
        return received_ns, published_ns if published_ns > 0 else received_ns

    def _write(self, topic: str, cdr: bytes, times: tuple[int, int]) -> None:
        try:
            with self._lock:
                self._bag.write(topic, cdr, *times)
                if self._reader and topic == PARAMETER_EVENTS and (known := self._reader.take(cdr)):
                    self._bag.keep(topic, *known, times[1])
        except Exception as error:
            self._topic_counts[topic].left_out[NOT_WRITTEN] += 1
            if not isinstance(error, OSError):
                raise
            self._report(error)
        else:
            self._topic_counts[topic].written += 1

    def _publish_account(self) -> None:
        self._account_publisher.publish(self.account)

    def _counts(self) -> Account:
        """Number of messages of each topic in the bag, and of those that were lost."""
        left_out = self._left_out
        ignored = {ON_THE_WAY: left_out[ON_THE_WAY], FAILED: self._failures}
        return Account(
            dropped={QUEUE_FULL: left_out[QUEUE_FULL]} if left_out[QUEUE_FULL] else {},
            ignored={name: count for name, count in ignored.items() if count},
            missed={
                topic.lstrip("/"): counts.missed
                for topic, counts in self.topic_counts.items()
                if counts.missed and not counts.latched
            },
            recorded={topic.lstrip("/"): count for topic, count in self.recorded.items()},
            unwritten=left_out[NOT_WRITTEN],
            last_drop=self.failure,
            kind=RECORDER,
            **self._process_numbers,
        )

    def diagnostics(self) -> DiagnosticArray:
        """The account and state, as the conventions have them."""
        return self._account_publisher.diagnostics(self.account())

    def _flush(self) -> None:
        try:
            with self._lock:
                self._bag.flush()
        except OSError as error:
            self._report(error)

    def _fail(self, error: Exception) -> None:
        """Count and log an error that no message should cause."""
        self._failures += 1
        trace = "".join(traceback.format_exception(error))
        self.get_logger().error(f"Unexpected failure, please report it: {trace}", throttle_duration_sec=1.0)

    def _report(self, error: OSError) -> None:
        """Report once that the bag can no longer be written."""
        self._last_loss = (
            f"Bag {self._bag.directory} cannot be written any further, and messages are lost from now on: {error}; "
            f"'sal-height salvage {self._bag.directory} --out DIR' recovers what was written before."
        )
        if not self._reported:
            self._reported = True
            self.get_logger().error(self._last_loss)


def _folder(path: str) -> Path:
    """The folder for the bag: a recorder that is started again, by whatever means, leaves the bag before as it is.

    Raises:
        UserError: none is named.
    """
    if not path:
        raise UserError("Parameter directory is empty; it must name a new folder for the bag.")
    named = Path(path)
    return free_folder(named) if any(named.glob("*.mcap")) else named


def _name_and_text(text: str) -> tuple[str, str]:
    name, separator, rest = text.partition("=")
    if not separator:
        raise UserError(f"Parameter custom_data has {text!r}; each of its texts must be NAME=TEXT.")
    return name, rest


def main() -> int:
    """Console script: record until SIGINT or SIGTERM."""
    return run_node(Recorder)


if __name__ == "__main__":
    raise SystemExit(main())
