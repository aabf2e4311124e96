"""Node recorder: writes the messages of topics to a bag, byte for byte."""

from __future__ import annotations

import sys
import threading
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ClassVar

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.clock import Clock, ROSClock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from sal_height.bag.definitions import message_class
from sal_height.bag.writer import BagWriter
from sal_height.errors import UserError
from sal_height.nodes.account import DROPPED, IGNORED, RECORDED, UNWRITTEN, Account
from sal_height.nodes.guard import guarded
from sal_height.nodes.jobs import Job, JobQueue
from sal_height.nodes.parameters import LiveParameters
from sal_height.nodes.program import run_node
from sal_height.nodes.role import Role, Topics
from sal_height.settings import Settings, setting

DIAGNOSTICS = "/diagnostics"
QUEUE_FULL, FAILED = f"{DROPPED}queue full", f"{IGNORED}internal error"
NEVER_BY_DEFAULT = ("/rosout", "/parameter_events")
QUEUE_DEPTH = 1000  # messages per topic that may wait in the middleware until the node takes them
JOB_BYTES = 1000  # memory of a message that waits, besides its own bytes
DISCOVERY_PERIOD_S = 0.1
DIAGNOSTICS_PERIOD_S = 0.5
NEWS_DELAY_S = 0.02  # from the first message written to the account that counts it, for whoever waits for it
FLUSH_PERIOD_S = 1.0  # at most this much is lost when the process is killed


class Parameters(Settings):
    """Parameters of the node."""

    directory: str = setting("", "new or empty folder for the bag", read_only=True)
    topics: tuple[str, ...] = setting(
        (), f"topics to record; none: every topic except {' and '.join(NEVER_BY_DEFAULT)}", read_only=True
    )
    custom_data: tuple[str, ...] = setting(
        (), "texts to store in the bag, each as NAME=TEXT, as with ros2 bag record --custom-data", read_only=True
    )
    max_memory_mb: int = setting(
        2048, "memory for messages that wait to be written to the disk", unit="MB", minimum=1, maximum=1_000_000
    )


class Recorder(Role, Node):
    """Subscribes to topics as soon as they have a publisher and writes their serialized messages to a bag.

    A thread of its own writes. Once messages of max_memory_mb wait for it, those that come are left out and counted.
    The bag is complete once the node is destroyed or its context shut down.
    """

    parameters = Parameters
    inputs: ClassVar[Topics] = {"<topics>": "whatever is published"}
    completes_file = True
    takes_message_info = True

    def __init__(self, directory: Path | None = None, **node_arguments: Any) -> None:
        """Record into the new folder `directory` (None: the parameter of that name).

        node_arguments: passed to rclpy's Node (context, parameter_overrides, namespace, ...).
        UserError if a parameter or the folder cannot be used.
        """
        super().__init__("recorder", **node_arguments)
        try:
            self._parameters_now = LiveParameters(self, Parameters)
            parameters = self._parameters_now.current
            self._topics = [self.resolve_topic_name(name) for name in parameters.topics]
            custom_data = dict(_name_and_text(text) for text in parameters.custom_data)
            self._bag = BagWriter(directory or _folder(parameters.directory), custom_data)
        except UserError:
            super().destroy_node()
            raise
        self._subscribed: dict[str, Subscription] = {}
        self._refused: set[str] = set()
        self._recorded: dict[str, int] = {}
        self._unwritten = 0
        self._lost: Counter[str] = Counter()
        self._last_loss = ""
        self._reported = False
        self._closed = False
        self._lock = threading.Lock()  # of the bag, which several threads write to
        self._queue = JobQueue()
        self._worker = threading.Thread(target=self._work, name="recorder", daemon=True)
        self._worker.start()
        self.context.on_shutdown(self.close_bag)
        self._diagnostics = self.create_publisher(DiagnosticArray, DIAGNOSTICS, 10)
        self._every(DISCOVERY_PERIOD_S, self._discover)
        self._every(FLUSH_PERIOD_S, lambda: self._put(self._flush))
        self._every(DIAGNOSTICS_PERIOD_S, self._publish_diagnostics)
        self._news = self._every(NEWS_DELAY_S, self._publish_diagnostics)
        self._discover()

    @property
    def recorded(self) -> dict[str, int]:
        """Number of messages in the bag, by topic; 0 for a topic that has just been subscribed to."""
        return dict(self._recorded)

    @property
    def unwritten(self) -> int:
        """Number of messages that were received and could not be written."""
        return self._unwritten

    @property
    def dropped(self) -> int:
        """Number of messages that were left out because too much waited to be written."""
        return self._lost[QUEUE_FULL]

    @property
    def failures(self) -> int:
        """Number of errors that no message should cause."""
        return self._lost[FAILED]

    def close_bag(self) -> None:
        """Write what has arrived so far and complete the bag; later messages are ignored. May be called twice."""
        self._queue.close()
        self._worker.join()
        with self._lock:
            if self._closed:
                return
            for topic, subscription in self._subscribed.items():
                for cdr, info in _taken(subscription):
                    self._write(topic, cdr, self._times(info))
            self._closed = True
            try:
                self._bag.close()
            except OSError as error:
                self._report(error)

    def destroy_node(self) -> None:
        """Complete the bag and destroy the node."""
        self.close_bag()
        super().destroy_node()

    def _every(self, period_s: float, callback: Callable[[], None]) -> Timer:
        """Call `callback` again and again by a clock that never stands still; an error in it does not end the node."""
        return self.create_timer(period_s, guarded(callback, self._fail), clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _discover(self) -> None:
        """Subscribe to the wanted topics that have a publisher by now."""
        for name, types in self.get_topic_names_and_types():
            wanted = name in self._topics if self._topics else name not in NEVER_BY_DEFAULT
            if wanted and name not in self._subscribed and name not in self._refused:
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
                self._bag.add_topic(name, types[0], offered)
            except OSError as error:
                self._report(error)
            self._recorded[name] = 0
            self._subscribed[name] = self.create_subscription(
                message_type, name, guarded(self._taker_of(name), self._fail), _matching(offered), raw=True
            )

    def _taker_of(self, topic: str) -> Callable[..., None]:
        """A callback that hands the messages of a topic to the thread that writes."""

        def take(cdr: bytes, info: dict[str, Any]) -> None:
            self._receive(topic, cdr, info)
            # What has come as well needs no wait set of its own.
            for more, its_info in _taken(self._subscribed[topic]):
                self._receive(topic, more, its_info)
            # An account of the accounts recorded would be recorded in turn, without end.
            if topic != DIAGNOSTICS and self._news.is_canceled():
                self._news.reset()

        return take

    def _receive(self, topic: str, cdr: bytes, info: dict[str, Any]) -> None:
        times = self._times(info)
        self._put(lambda: self._write(topic, cdr, times), 1, len(cdr) + JOB_BYTES)

    def _put(self, run: Callable[[], None], messages: int = 0, size: int = 0) -> None:
        """Have something done by the thread that writes, unless too much waits for it."""
        limit_mb = self._parameters_now.current.max_memory_mb
        lost = self._queue.put(Job(run, messages, size), sys.maxsize, limit_mb * 1_000_000, "newest")
        if self._queue.closed or not any(job.messages for job in lost):
            return
        self._lost[QUEUE_FULL] += 1
        self._last_loss = (
            f"The disk falls behind: {limit_mb} MB (max_memory_mb) of messages wait for it, and what comes is left out "
            "of the bag; record fewer topics, or on a faster disk."
        )
        self.get_logger().warning(self._last_loss, throttle_duration_sec=1.0)

    def _work(self) -> None:
        while job := self._queue.get():
            with self._lock:
                guarded(job.run, self._fail)()

    def _times(self, info: dict[str, Any]) -> tuple[int, int]:
        """When a message was received and when it was published, ns; a bag cannot hold times before 1970."""
        clock = self.get_clock()
        now_ns = max(0, clock.now().nanoseconds)
        if isinstance(clock, ROSClock) and clock.ros_time_is_active:  # the middleware's times are not of this clock
            return now_ns, now_ns
        received_ns = max(0, info["received_timestamp"]) or now_ns
        return received_ns, max(0, info["source_timestamp"]) or received_ns

    def _write(self, topic: str, cdr: bytes, times: tuple[int, int]) -> None:
        try:
            self._bag.write(topic, cdr, *times)
        except Exception as error:
            self._unwritten += 1
            if not isinstance(error, OSError):
                raise
            self._report(error)
        else:
            self._recorded[topic] += 1

    def _publish_diagnostics(self) -> None:
        """Publish how many messages of each topic are in the bag (recorded.<topic>) and how many were lost."""
        if not self._queue.unfinished:
            self._news.cancel()
        recorded = {f"{RECORDED}{topic}": count for topic, count in self._recorded.items()}
        missing = self._unwritten + self.dropped
        status = DiagnosticStatus(
            level=DiagnosticStatus.ERROR if missing else DiagnosticStatus.OK,
            name=self.get_fully_qualified_name().lstrip("/"),
            message=f"{missing} messages are not in the bag" if missing else "recording",
            values=Account({UNWRITTEN: self._unwritten} | self._lost | recorded, self._last_loss).to_values(),
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)

    def _flush(self) -> None:
        try:
            self._bag.flush()
        except OSError as error:
            self._report(error)

    def _fail(self, error: Exception) -> None:
        """Count and log an error that no message should cause."""
        self._lost[FAILED] += 1
        trace = "".join(traceback.format_exception(error))
        self.get_logger().error(f"Unexpected failure, please report it: {trace}", throttle_duration_sec=1.0)

    def _report(self, error: OSError) -> None:
        """Say once that the bag can no longer be written."""
        self._last_loss = (
            f"Bag {self._bag.directory} cannot be written any further, and messages are lost from now on: {error}; "
            f"'sal-height salvage {self._bag.directory} --out DIR' recovers what was written before."
        )
        if not self._reported:
            self._reported = True
            self.get_logger().error(self._last_loss)


def _taken(subscription: Subscription) -> Iterator[tuple[bytes, dict[str, Any]]]:
    """The messages that have come and that the executor has not handed out, with the times of their transport."""
    for _ in range(QUEUE_DEPTH):
        with subscription.handle:
            taken = subscription.handle.take_message(subscription.msg_type, True)
        if taken is None:
            return
        yield taken


def _folder(path: str) -> Path:
    if not path:
        raise UserError("Parameter directory is empty; it must name a new folder for the bag.")
    return Path(path)


def _name_and_text(text: str) -> tuple[str, str]:
    name, separator, rest = text.partition("=")
    if not separator:
        raise UserError(f"Parameter custom_data has {text!r}; each of its texts must be NAME=TEXT.")
    return name, rest


def _matching(offered: list[QoSProfile]) -> QoSProfile:
    """The strictest profile that receives from all publishers, with a deep queue."""
    reliable = all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in offered)
    latched = all(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in offered)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=QUEUE_DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def main() -> int:
    """Console script: record until SIGINT or SIGTERM."""
    return run_node(Recorder)


if __name__ == "__main__":
    raise SystemExit(main())
