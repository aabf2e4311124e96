"""What the processing nodes share: a worker thread, accounting of every message, diagnostics."""

from __future__ import annotations

import queue
import threading
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy._rclpy_pybind11 import RCLError
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions, QoSPolicyKind

from sal_height.errors import Rejected, UserError
from sal_height.nodes.account import DROPPED, IGNORED, JOBS, PUBLISHED_ON, SUBSCRIBERS, Account
from sal_height.nodes.parameters import LiveParameters
from sal_height.nodes.role import Role
from sal_height.nodes.tally import Tally
from sal_height.settings import Settings

FRAMES_QOS = QoSProfile(depth=256, reliability=ReliabilityPolicy.RELIABLE)
"""Phase histories and images: nothing may be lost in the burst of frames that a dwell is."""

ODOMETRY_QOS = QoSProfile(depth=10_000, reliability=ReliabilityPolicy.RELIABLE)
"""Platform state: small, but a dwell may come with thousands."""

LATCHED_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Sensor info: the last one reaches those who come late."""

QOS_OVERRIDES = QoSOverridingOptions(
    [QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY, QoSPolicyKind.DURABILITY]
)
"""Policies that users can change by the qos_overrides parameters."""

DIAGNOSTICS_PERIOD_S = 0.5

QUEUED_JOBS = 8
"""Jobs that may wait for the worker before further ones are dropped."""


class Outlet:
    """A publisher that counts its messages."""

    def __init__(self, publisher: Publisher) -> None:
        self.publisher = publisher
        self.topic: str = publisher.topic_name
        self.published = 0

    @property
    def subscribers(self) -> int:
        """How many subscriptions it is matched with."""
        return int(self.publisher.get_subscription_count())

    @property
    def keeps_all(self) -> bool:
        """Whether it is meant to deliver every message; of a latched topic only the last one matters."""
        return bool(self.publisher.qos_profile.durability != DurabilityPolicy.TRANSIENT_LOCAL)

    def publish(self, message: Any) -> None:
        """Publish a message, or the bytes of a serialized one."""
        self.publisher.publish(message)
        self.published += 1


class Stage(Role, Node):
    """A node whose callbacks only take messages in; the work is done in order on a thread of its own."""

    parameters: type[Settings] = Settings
    """The node's ROS parameters."""

    def __init__(self, name: str, **node_arguments: Any) -> None:
        """Make the node; `node_arguments` go to rclpy's Node (context, parameter_overrides, ...).

        Raises:
            UserError: a parameter has a value that is not allowed.
        """
        super().__init__(name, **node_arguments)
        self._parameters_now = LiveParameters(self, self.parameters)
        self.tally = Tally()
        self.last_rejection = ""
        self.last_drop = ""
        self._jobs: queue.Queue[Callable[[], None] | None] = queue.Queue(QUEUED_JOBS)
        self._offered: list[Outlet] = []
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(DIAGNOSTICS_PERIOD_S, self.publish_diagnostics, clock=self.steady_clock)
        self._worker = threading.Thread(target=self._work, name=name, daemon=True)
        self._worker.start()

    def current_parameters(self) -> Any:
        """The parameters as they are now: a frozen object of the class `parameters`."""
        return self._parameters_now.current

    def offer(self, message_type: type, topic: str, qos: QoSProfile = FRAMES_QOS) -> Outlet:
        """A publisher whose messages and subscribers are counted in the diagnostics."""
        publisher = self.create_publisher(message_type, topic, qos, qos_overriding_options=QOS_OVERRIDES)
        self._offered.append(Outlet(publisher))
        return self._offered[-1]

    def listen(
        self, message_type: type, topic: str, callback: Callable[[Any], None], qos: QoSProfile = FRAMES_QOS
    ) -> None:
        """Subscribe; users can adapt the QoS to a publisher of theirs by the qos_overrides parameters."""

        def guarded(message: Any) -> None:
            try:
                callback(message)
            except Exception as error:  # noqa: BLE001 (no message may end the node)
                self.get_logger().error(f"Unexpected failure, please report it: {traceback.format_exc()}")
                self.ignore("internal error", UserError(repr(error)))

        self.create_subscription(message_type, topic, guarded, qos, qos_overriding_options=QOS_OVERRIDES)

    def submit(self, messages: int, work: Callable[[], int]) -> None:
        """Have `work` done on the worker; it consumes `messages` messages and returns the number it published.

        What it rejects or fails at is counted, said in the log, and does not end the node.
        """
        arrived = time.monotonic()

        def job() -> None:
            try:
                published = work()
            except Rejected as error:
                self.reject(messages, error)
            except UserError as error:
                self.reject(messages, Rejected("cannot be processed", str(error)))
            except Exception as error:  # noqa: BLE001 (no message may end the node)
                if not self.context.ok():
                    return  # shutting down: nobody is left to publish to
                self.get_logger().error(f"Unexpected failure, please report it: {traceback.format_exc()}")
                self.reject(messages, Rejected("internal error", repr(error)))
            else:
                self.tally.finish(messages, published, time.monotonic() - arrived)
            self.publish_diagnostics()

        try:
            self._jobs.put_nowait(job)
        except queue.Full:
            self.reject(messages, Rejected("queue full", f"More than {QUEUED_JOBS} dwells wait; slow the sensor down."))

    def reject(self, messages: int, error: Rejected) -> None:
        """Count messages left out, and say why."""
        self.last_rejection = f"{error.reason}: {error}"
        self.last_drop = str(error)  # before it is counted, so that no account has a drop without a reason
        self.tally.drop(messages, error.reason)
        self.get_logger().warning(f"Dropped {messages} ({error.reason}): {error}", throttle_duration_sec=1.0)

    def ignore(self, what: str, error: UserError) -> None:
        """Count a message beside the stream of frames that cannot be used, and say why."""
        self.tally.ignore(what)
        self.last_rejection = f"{what}: {error}"
        self.get_logger().warning(f"Ignored {what}: {error}", throttle_duration_sec=1.0)

    def publish_diagnostics(self) -> None:
        """Publish the stage's account on /diagnostics."""
        summary = self.tally.summary()  # first: what is processed then has been published
        lost = sum(int(count) for name, count in summary.items() if name.startswith((DROPPED, IGNORED)))
        account = Account(
            summary
            | {JOBS: self._jobs.unfinished_tasks}
            | {f"{PUBLISHED_ON}{outlet.topic}": outlet.published for outlet in self._offered if outlet.keeps_all}
            | {f"{SUBSCRIBERS}{outlet.topic}": outlet.subscribers for outlet in self._offered},
            self.last_drop,
        )
        status = DiagnosticStatus(
            level=DiagnosticStatus.WARN if lost else DiagnosticStatus.OK,
            name=self.get_fully_qualified_name().lstrip("/"),
            message=f"{lost} dropped or ignored, last {self.last_rejection}" if lost else "all messages processed",
            values=account.to_values(),
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        with suppress(RCLError):  # the context may end meanwhile
            self._diagnostics.publish(message)

    def finish(self) -> None:
        """Finish all jobs that wait, and take no more; may be called twice."""
        if self._worker.is_alive():
            self._jobs.put(None)
            self._worker.join()

    def destroy_node(self) -> None:
        """Finish the job at hand, then end the node; jobs that still wait are given up."""
        if self._worker.is_alive():
            with suppress(queue.Empty):
                while True:
                    self._jobs.get_nowait()
        self.finish()
        super().destroy_node()

    def _work(self) -> None:
        while job := self._jobs.get():
            job()
            self._jobs.task_done()
