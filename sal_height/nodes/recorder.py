"""Node recorder: writes the messages of topics to a bag, byte for byte."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.clock import Clock, ROSClock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from sal_height.bag.definitions import message_class
from sal_height.bag.writer import BagWriter
from sal_height.errors import UserError
from sal_height.nodes.account import RECORDED, UNWRITTEN, Account
from sal_height.nodes.parameters import LiveParameters
from sal_height.nodes.program import run_node
from sal_height.nodes.role import Role, Topics
from sal_height.settings import Settings, setting

DIAGNOSTICS = "/diagnostics"
NEVER_BY_DEFAULT = ("/rosout", "/parameter_events")
QUEUE_DEPTH = 1000  # messages per topic that may wait while the disk is busy
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


class Recorder(Role, Node):
    """Subscribes to topics as soon as they have a publisher and writes their serialized messages to a bag.

    The bag is complete once the node is destroyed or its context shut down.
    """

    parameters = Parameters
    inputs: ClassVar[Topics] = {"<topics>": "whatever is published"}
    completes_file = True

    def __init__(self, directory: Path | None = None, **node_arguments: Any) -> None:
        """Record into the new folder `directory` (None: the parameter of that name).

        node_arguments: passed to rclpy's Node (context, parameter_overrides, namespace, ...).
        UserError if a parameter or the folder cannot be used.
        """
        super().__init__("recorder", **node_arguments)
        try:
            parameters = LiveParameters(self, Parameters).current
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
        self._reported = False
        self._closed = False
        self._lock = threading.Lock()  # the context may be shut down in another thread than the executor's
        self.context.on_shutdown(self.close_bag)
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # simulated time may stand still
        self.create_timer(DISCOVERY_PERIOD_S, self._discover, clock=steady)
        self.create_timer(FLUSH_PERIOD_S, self._flush, clock=steady)
        self._diagnostics = self.create_publisher(DiagnosticArray, DIAGNOSTICS, 10)
        self.create_timer(DIAGNOSTICS_PERIOD_S, self._publish_diagnostics, clock=steady)
        self._news = self.create_timer(NEWS_DELAY_S, self._publish_diagnostics, clock=steady)
        self._discover()

    @property
    def recorded(self) -> dict[str, int]:
        """Number of messages in the bag, by topic; 0 for a topic that has just been subscribed to."""
        return dict(self._recorded)

    @property
    def unwritten(self) -> int:
        """Number of messages that were received and could not be written."""
        return self._unwritten

    def close_bag(self) -> None:
        """Write what has arrived so far and complete the bag; later messages are ignored. May be called twice."""
        with self._lock:
            if self._closed:
                return
            for topic, subscription in self._subscribed.items():
                self._drain(topic, subscription)
            self._closed = True
            try:
                self._bag.close()
            except OSError as error:
                self._report(error)

    def destroy_node(self) -> None:
        """Complete the bag and destroy the node."""
        self.close_bag()
        super().destroy_node()

    def _discover(self) -> None:
        """Subscribe to the wanted topics that have a publisher by now."""
        for name, types in self.get_topic_names_and_types():
            wanted = name in self._topics if self._topics else name not in NEVER_BY_DEFAULT
            if wanted and name not in self._subscribed and name not in self._refused:
                try:
                    self._subscribe(name, types)
                except UserError as error:
                    self._refused.add(name)
                    self.get_logger().warning(f"topic '{name}' is not recorded: {error}")

    def _subscribe(self, name: str, types: list[str]) -> None:
        offered = [publisher.qos_profile for publisher in self.get_publishers_info_by_topic(name)]
        if not offered:
            return
        if len(types) != 1:
            raise UserError(f"it has the types {', '.join(types)}; a topic must have one")
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
                message_type, name, self._writer_of(name), _matching(offered), raw=True
            )

    def _writer_of(self, topic: str) -> Callable[..., None]:
        def received(cdr: bytes, info: dict[str, Any]) -> None:
            with self._lock:
                if not self._closed:
                    self._write(topic, cdr, info)
            # An account of the accounts recorded would be recorded in turn, without end.
            if topic != DIAGNOSTICS and self._news.is_canceled():
                self._news.reset()

        return received

    def _write(self, topic: str, cdr: bytes, info: dict[str, Any]) -> None:
        clock = self.get_clock()
        now_ns = clock.now().nanoseconds
        if isinstance(clock, ROSClock) and clock.ros_time_is_active:  # the middleware's times are not of this clock
            received_ns, published_ns = now_ns, now_ns
        else:
            received_ns = info["received_timestamp"] or now_ns
            published_ns = info["source_timestamp"] or received_ns
        try:
            self._bag.write(topic, cdr, received_ns, published_ns)
            self._recorded[topic] += 1
        except OSError as error:
            self._unwritten += 1
            self._report(error)

    def _drain(self, topic: str, subscription: Subscription) -> None:
        """Write the messages that have arrived but not been handed out by the executor."""
        with subscription.handle:
            for _ in range(QUEUE_DEPTH):
                taken = subscription.handle.take_message(subscription.msg_type, True)
                if taken is None:
                    return
                self._write(topic, *taken)

    def _publish_diagnostics(self) -> None:
        """Publish how many messages of each topic are in the bag (recorded.<topic>) and how many were lost."""
        self._news.cancel()
        recorded = {f"{RECORDED}{topic}": count for topic, count in self._recorded.items()}
        status = DiagnosticStatus(
            level=DiagnosticStatus.ERROR if self._unwritten else DiagnosticStatus.OK,
            name=self.get_fully_qualified_name().lstrip("/"),
            message=f"{self._unwritten} messages could not be written" if self._unwritten else "recording",
            values=Account({UNWRITTEN: self._unwritten} | recorded).to_values(),
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)

    def _flush(self) -> None:
        with self._lock:
            if not self._closed:
                try:
                    self._bag.flush()
                except OSError as error:
                    self._report(error)

    def _report(self, error: OSError) -> None:
        if not self._reported:
            self._reported = True
            self.get_logger().error(
                f"bag '{self._bag.directory}' cannot be written any further, messages are lost from now on: {error}; "
                f"'sal-height salvage {self._bag.directory} --out DIR' recovers what was written before"
            )


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
