"""Common parts of the processing nodes: a worker thread, accounting of every message, diagnostics."""

from __future__ import annotations

import copy
import math
import os
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar

from rclpy._rclpy_pybind11 import RCLError
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from sal_height.engine.results import DwellKey, Loss
from sal_height.engine.stage import StageSettings
from sal_height.errors import Rejected, UserError
from sal_height.messages.accounts import loss_to_message
from sal_height.messages.codec import SHIPPED, BrokenMessage
from sal_height.messages.types import DiagnosticArray, DiagnosticStatus, DwellLoss
from sal_height.nodes.accounts.account import Account
from sal_height.nodes.accounts.publisher import AccountPublisher
from sal_height.nodes.accounts.tally import Pace, Tally, process_numbers
from sal_height.nodes.jobs import JobQueue, QueuedJob
from sal_height.nodes.managed import INACTIVE, Managed, Role, Topics
from sal_height.nodes.parameters import LiveParameters
from sal_height.nodes.transport.callbacks import Repeated, guarded
from sal_height.nodes.transport.endpoints import QOS_OVERRIDES, RECENT_S, Inlet, Outlet
from sal_height.nodes.transport.log import RareWarnings, log_warning
from sal_height.nodes.transport.message_types import class_of
from sal_height.nodes.transport.qos import FRAMES_QOS, LATCHED_QOS, ODOMETRY_QOS
from sal_height.nodes.transport.services import ENDING, FAILED, Said, offer_trigger
from sal_height.topics import LOSSES

RESET = {"~/reset": "forget what was gathered of the dwells so far"}
"""The service that every stage offers."""

ENDED = Rejected("ended", "The node is ending; waiting and new messages are left out.")

DIAGNOSTICS_PERIOD_S = 0.5


class WorkerNode(Role, Managed):
    """A node whose callbacks only accept messages; a worker thread processes them in order."""

    answers: ClassVar[Topics] = RESET
    parameters: type[StageSettings] = StageSettings
    """The node's ROS parameters."""

    step_ns = 0
    """Time at which the messages of the last step are recorded, ns; 0: the node's clock says it."""

    niceness: ClassVar[int] = 0
    """Degree to which the node's work gives way to other threads, as in nice(1). Under overload, early stages that do
    leave out what later ones could not process, before any work on it; and messages are received during a dwell's work.
    """

    def __init__(self, name: str, **node_arguments: Any) -> None:
        """Make the node; `node_arguments` go to rclpy's Node (context, parameter_overrides, ...).

        Raises:
            UserError: a parameter has a value that is not allowed.
        """
        super().__init__(name, **node_arguments)
        try:
            self._parameters_now = LiveParameters(self, self.parameters)
        except UserError:
            super().destroy_node()
            raise
        self.tally = Tally()
        self.last_rejection = self.last_drop = self.hardware_id = ""
        self.steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._jobs = JobQueue()
        self._lost_at = -math.inf
        self._warnings = RareWarnings(self)
        self._doubted = set[str]()  # kinds that the log has
        self._pace = Pace()
        self._measured = 0
        self._slow_numbers: dict[str, Any] = {}
        """Last values of the fields of the account that take time to find."""
        self._offered: list[Outlet] = []
        self._inlets: list[Inlet] = []
        self._optional: list[Inlet] = []
        self._on_match = guarded(lambda _: self._publish_account(), self._fail)
        """Publishes the account when a subscription or publisher appears or disappears, which runs wait for."""
        self._matched = PublisherEventCallbacks(matched=self._on_match)
        self._account_publisher = AccountPublisher(self, self._on_match)
        self._losses = self.offer(DwellLoss, LOSSES)
        self._accounting = Repeated(DIAGNOSTICS_PERIOD_S, guarded(self._measure_pace, self._fail), f"{name} account")
        self._worker: threading.Thread | None = None
        self.begin_work()
        self.serve("~/reset", self._reset)
        if self.current_parameters().autostart:
            self.start()

    def begin_work(self) -> None:
        """Begin to process jobs, on a thread of the node's own."""
        self._worker = threading.Thread(target=self._work, name=self.get_name(), daemon=True)
        self._worker.start()

    def current_parameters(self) -> Any:
        """The parameters as they are now: a frozen object of the class `parameters`."""
        return self._parameters_now.current

    def offer(self, message_type: type[Any], topic: str, qos: QoSProfile = FRAMES_QOS) -> Outlet:
        """A publisher of plain messages of a class, whose messages and subscribers are counted in the diagnostics."""
        publisher = self.create_publisher(
            class_of(message_type),
            topic,
            copy.copy(qos),
            qos_overriding_options=QOS_OVERRIDES,
            event_callbacks=self._matched,
        )
        self._offered.append(Outlet(publisher))
        return self._offered[-1]

    def listen(
        self,
        message_type: type[Any],
        topic: str,
        callback: Callable[[Any], None],
        qos: QoSProfile = FRAMES_QOS,
        *,
        optional: bool = False,
        read: Callable[[bytes], Any] | None = None,
    ) -> Inlet:
        """Subscribe; if the only publishers offer less than `qos`, with what they offer.

        Args:
            message_type: class of plain messages of the type.
            topic: name of the topic.
            callback: callback for a message; an error in it is counted and logged.
            qos: quality of service.
            optional: True if the node can do its work without a message on this topic.
            read: decoder of serialized messages for the callback, which may raise BrokenMessage; None: that of the
                plain message.
        """
        read = read or SHIPPED.reader(message_type.__msgtype__)
        profile = copy.copy(qos)
        if qos is LATCHED_QOS:
            profile.depth = 8  # with fewer, a message overwrites another before the node takes it

        def receive(cdr: bytes) -> None:
            if inlet.has_only_strangers:
                self.ignore("another definition", UserError(inlet.warning.strip()))
                return
            try:
                message = read(cdr)
            except BrokenMessage as error:
                self.ignore("broken message", UserError(f"A message on {topic} cannot be decoded: {error}."))
            else:
                callback(message)

        def matched(_: Any) -> None:
            inlet.look_for_strangers()
            self._publish_account()

        inlet = Inlet(
            self,
            message_type,
            topic,
            receive,
            profile,
            guarded(matched, self._fail),
            self._fail,
            has_one_source=qos is ODOMETRY_QOS,
        )
        (self._optional if optional else self._inlets).append(inlet)
        return inlet

    def every(self, period_s: float, callback: Callable[[], Any], clock: Clock | None = None) -> Timer:
        """Call `callback` again and again, by a clock that never stands still unless another one is given."""
        return self.create_timer(period_s, guarded(callback, self._fail), clock=clock or self.steady_clock)

    def serve(self, name: str, callback: Callable[[], Said | Future[Said]]) -> None:
        """Offer a service of type Trigger.

        Args:
            name: name of the service.
            callback: function that returns whether it succeeded, and a message; or, for work that may take long, a
                future of both: the node goes on to receive messages, and the answer is sent once the work is done.
        """
        offer_trigger(self, name, lambda: guarded(callback, self._fail)() or FAILED)

    def submit(
        self,
        messages: int,
        work: Callable[[], int],
        size: int = 0,
        item: Any = None,
        complete_s: float | None = None,
    ) -> None:
        """Have `work` done on the worker thread.

        What it rejects or fails at is counted and logged, and does not end the node.

        Args:
            messages: number of messages that it consumes.
            work: function that returns the number of messages it published.
            size: size of the messages, bytes.
            item: data that is worked on; `waiting` gives it to work that looks ahead.
            complete_s: time at which its dwell was complete, s of the monotonic clock; None: now.
        """
        self._put(QueuedJob(work, messages, size, item, self.now_s() if complete_s is None else complete_s))

    def _put(self, queued: QueuedJob) -> None:
        """Have a job wait for its turn, and leave out those for which there is no room."""
        if queued.messages:
            self.tally.offer()
        parameters = self.current_parameters()
        capacity, policy = parameters.max_queued_dwells, parameters.queue_policy
        full = (
            f"Processing falls behind: {capacity} dwells (max_queued_dwells) or {parameters.max_memory_mb} MB "
            f"(max_memory_mb) wait already, and the {policy} dwell was dropped (queue_policy)."
        )
        for job in self._jobs.put(queued, capacity, parameters.max_memory_bytes, policy):
            self._leave_out(job, ENDED if self._jobs.closed else Rejected("queue full", full))

    def _leave_out(self, job: QueuedJob, reason: Rejected) -> None:
        """Count the messages of a job that will not be done, and answer the service that waits for it."""
        if job.messages:
            self.reject(job.messages, reason, _dwell_of(job.item))
        if job.answer:
            job.answer.set_result(ENDING)

    def now_s(self) -> float:
        """Time of the monotonic clock, s."""
        return time.monotonic()

    def settle(self, job: QueuedJob, work: Callable[[], int]) -> None:
        """Do the work of a job, and count what becomes of it; nothing is raised."""
        try:
            published = work()
        except Exception as error:  # noqa: BLE001 (no message may end the node)
            over = not (isinstance(error, UserError) or self.context.ok())  # nobody is left to publish to
            self.reject(job.messages, ENDED if over else self.unexpected(error), _dwell_of(job.item))
        else:
            self.tally.finish(job.messages, published, time.monotonic() - job.complete_s)
        if job.messages:
            self._account_publisher.publish_progress(self._counts)
        else:
            self._publish_account()  # the node may be ready now

    def promise(self, work: Callable[[], Said]) -> Future[Said]:
        """Have `work` done on the worker thread, after what waits; the future gets what it returns, or `ENDING`."""
        done: Future[Said] = Future()

        def run() -> int:
            try:
                done.set_result(work())
            except BaseException:
                done.set_result(FAILED)
                raise
            return 0

        self._put(QueuedJob(run, 0, complete_s=self.now_s(), answer=done))
        return done

    def waiting(self) -> list[Any]:
        """The items of the jobs that wait, in their order."""
        return self._jobs.items()

    def check_budget(self, job: QueuedJob, ahead_s: float = 0.0) -> None:
        """Leave a dwell out that has waited too long: later ones are worth more to those who watch.

        Args:
            job: job of the dwell.
            ahead_s: time that passes from now until it is published, s, where that counts.

        Raises:
            Rejected: it has.
        """
        budget_s, waited_s = self.current_parameters().latency_budget_s, time.monotonic() - job.complete_s
        if job.messages and 0 < budget_s < waited_s + ahead_s:
            ahead = f", and would take {ahead_s:.3g} s" if ahead_s else ""
            raise Rejected(
                "overload",
                f"Dwells arrive faster than they are processed: one that had waited {waited_s:.3g} s{ahead} was left "
                f"out, more than {budget_s:g} s (latency_budget_s).",
            )

    def takes(self, messages: int = 1) -> bool:
        """Count messages as received; True if they are to be processed: an inactive node drops them."""
        self.tally.receive(messages)
        if not self.is_active:
            self.reject(messages, Rejected("inactive", f"A message was left out: {INACTIVE}."))
        return self.is_active

    def _reset(self) -> tuple[bool, str]:
        self.forget()
        return True, "what was gathered is forgotten once the dwells that wait have been processed"

    @property
    def is_ready(self) -> bool:
        """True if it works, what it needs has publishers, and what takes time before the first dwell is done."""
        return self.is_active and all(inlet.is_connected for inlet in self._inlets)

    @property
    def jobs(self) -> int:
        """Jobs that wait or run: above 0, the node is working."""
        return self._jobs.unfinished

    def unexpected(self, error: Exception) -> Rejected:
        """Reason to drop messages after an error; one that no input should cause is logged in full."""
        if isinstance(error, Rejected):
            return error
        if isinstance(error, UserError):
            return Rejected("cannot be processed", str(error))
        trace = "".join(traceback.format_exception(error))
        self.get_logger().error(f"Unexpected failure, please report it: {trace}")
        return Rejected("internal error", repr(error))

    def _fail(self, error: Exception) -> None:
        """Count and log an error in a callback."""
        reason = self.unexpected(error)
        self.ignore(reason.reason, reason)

    def reject(self, messages: int, error: Rejected, dwell: DwellKey | None = None) -> None:
        """Count messages that are dropped, publish and log why.

        Args:
            messages: number of messages.
            error: reason for the loss.
            dwell: dwell of the messages; None: not known, or no dwell.
        """
        self.last_rejection = f"{error.reason}: {error}"
        self.last_drop = str(error)  # before it is counted, so that no account has a drop without a reason
        self._lost_at = time.monotonic()
        self.tally.drop(messages, error.reason)
        self._publish_loss(Loss(dwell, messages, error.reason, str(error)))
        self._warnings.log(f"Dropped {messages} ({error.reason}): {error}")

    def _publish_loss(self, loss: Loss) -> None:
        name, now_ns = _plain(self.get_fully_qualified_name()), self.get_clock().now().nanoseconds
        with suppress(RCLError):  # the context may have ended: nobody is left to publish to
            self._losses.publish(loss_to_message(name, loss, now_ns))

    def ignore(self, what: str, error: UserError) -> None:
        """Count a message of no dwell (sensor info, odometry, ...) that cannot be used, and log why."""
        self.count_ignored(what, error)
        self._warnings.log(f"Ignored {what}: {error}")

    def doubt(self, what: str, error: UserError) -> None:
        """Count a dwell that is used although something speaks against it, and log the first of each kind."""
        if what not in self._doubted:
            self._doubted.add(what)
            log_warning(self, f"{error} (Logged once; diagnostics count such dwells as {what!r}.)")
        self.count_ignored(what, error)

    def count_ignored(self, what: str, error: UserError) -> None:
        """Count a message that cannot be used, or something else that goes wrong, without a word in the log."""
        self._lost_at = time.monotonic()
        self.tally.ignore(what)
        self.last_rejection = f"{what}: {error}"

    def tell(self, event: str, times: int = 1) -> None:
        """Count something that costs no message, and publish the account at once: somebody may wait for it."""
        self.tally.note(event, times)
        self._publish_account()

    @property
    def outlets(self) -> Sequence[Outlet]:
        """Its publishers."""
        return self._offered

    @property
    def inlets(self) -> Sequence[Inlet]:
        """Its subscriptions."""
        return (*self._inlets, *self._optional)

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """The subscriptions for whose messages an executor waits."""
        polled = [inlet.subscription for inlet in self.inlets if inlet.is_polled]
        return (one for one in super().subscriptions if one not in polled)

    def usage(self) -> Mapping[str, Any]:
        """Processor time, number and memory of its process, as fields of an account."""
        return process_numbers()

    def account(self) -> Account:
        """Its account as it is now, with its state."""
        subscribers = {_plain(outlet.topic): outlet.subscribers for outlet in self._offered}
        ready = {"ready": self.is_ready, "subscribers": subscribers}
        rates = zip(("offered_hz", "achieved_hz"), self._pace.rates(), strict=False)
        self._slow_numbers = {**ready, **self.usage(), **{name: round(rate, 2) for name, rate in rates}}
        account = self._counts()
        level, state = self._state(sum(account.dropped.values()) + sum(account.ignored.values()))
        return replace(account, level=level, state=state, hardware_id=self.hardware_id)

    def _measure_pace(self) -> None:
        self._measured += 1
        if self._measured % 4 == 0:  # names of nodes arrive after their publishers; to ask for them takes a while
            for inlet in self.inlets:
                inlet.look_for_strangers()
        self._pace.sample(time.monotonic(), self.tally.offered, self.tally.finished)
        self._publish_account()

    def _publish_account(self) -> None:
        self._account_publisher.publish(self.account)

    def _counts(self) -> Account:
        """The account; what changes without a piece of work is as it was last."""
        missed = {_plain(inlet.topic): inlet.missed for inlet in self.inlets if inlet.missed and not inlet.latched}
        account = self.tally.account()  # before what is published, and after what was received
        published = {_plain(outlet.topic): outlet.published for outlet in self._offered if outlet.keeps_all}
        account = replace(account, jobs=self.jobs, missed=missed, published_on=published, last_drop=self.last_drop)
        return replace(account, **self._slow_numbers)

    def diagnostics(self) -> DiagnosticArray:
        """The stage's account and state, as the conventions have them."""
        return self._account_publisher.diagnostics(self.account())

    @property
    def source_warning(self) -> str:
        """Warnings, each after a space, about publishers that are not right; else nothing."""
        return "".join(inlet.warning for inlet in self.inlets)

    def silent_topics(self) -> list[str]:
        """The topics that the node needs and that had no message lately, with those of the same name elsewhere."""
        described = []
        for inlet in (inlet for inlet in self._inlets if inlet.is_silent(time.monotonic())):
            elsewhere = ", ".join(inlet.published_elsewhere())
            hint = f" (there is {elsewhere}: is the namespace right?)" if elsewhere else ""
            described.append(f"{inlet.topic}{hint}")
        return described

    def _state(self, lost: int) -> tuple[Any, str]:
        """Level and message of the diagnostics, as of the last seconds.

        WARN: messages were lost, two sources contradict each other, or one knows other messages; STALE: messages that
        the node needs do not arrive; OK: none of these, or the node is not active.
        """
        if warning := self.source_warning:
            return DiagnosticStatus.WARN, f"{warning.strip()} {lost} dropped or ignored in all"
        if time.monotonic() - self._lost_at < RECENT_S:
            return DiagnosticStatus.WARN, f"{lost} dropped or ignored in all, last {self.last_rejection}"
        if not self.is_active:
            return DiagnosticStatus.OK, "inactive"
        if not self.jobs and (silent := self.silent_topics()):
            return DiagnosticStatus.STALE, f"waiting for {', '.join(silent)}"
        return DiagnosticStatus.OK, "processing"

    def finish(self) -> None:
        """Finish all jobs that wait, and accept no more; may be called twice."""
        self._jobs.close()
        if self._worker:
            self._worker.join()
        # Longest time that workers may take for the jobs that they have, s.
        self._jobs.wait_until_done(30.0)

    def destroy_node(self) -> None:
        """Finish the job at hand, drop what still waits, publish the last account, and end the node."""
        self._accounting.end()
        for job in self._jobs.clear():
            self._leave_out(job, ENDED)
        self.finish()
        if waiting := self.tally.account().waiting:
            self.get_logger().error(f"{waiting} messages are not accounted for; please report it.")
        self._publish_account()
        super().destroy_node()

    def _work(self) -> None:
        thread = threading.get_native_id()
        os.setpriority(os.PRIO_PROCESS, thread, os.getpriority(os.PRIO_PROCESS, thread) + self.niceness)
        while job := self._jobs.get():
            self.settle(job, partial(self._run, job))

    def _run(self, job: QueuedJob) -> int:
        self.check_budget(job)
        return job.run()


def _dwell_of(item: Any) -> DwellKey | None:
    """The dwell of a job of a stage; None: another job."""
    return getattr(item, "dwell", None)


def _plain(topic: str) -> str:
    """A topic without its leading slash."""
    return topic.removeprefix("/")
