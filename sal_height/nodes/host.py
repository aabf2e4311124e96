"""The node host: any stage of the engine as a ROS node.

Topics, types, quality of service, parameters, services and accounts follow from what the stage declares. Callbacks only
let the stage accept what arrives; the jobs that it makes are processed on the node's worker thread.
"""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from contextlib import suppress
from typing import Any, ClassVar

from rclpy._rclpy_pybind11 import RCLError
from rclpy.duration import Duration
from rclpy.qos import QoSProfile

from sal_height.engine.air import AirSample
from sal_height.engine.calibrations import CALIBRATIONS_ARRIVED
from sal_height.engine.compression import Compression
from sal_height.engine.frames import StaticTransform
from sal_height.engine.height_items import Heights
from sal_height.engine.image_items import count_messages
from sal_height.engine.navigation import Attitude, Fix, Pose, Twist
from sal_height.engine.registry import STAGES
from sal_height.engine.results import Answer, DwellKey, Event, FileProduct, Loss, Notice, Product, Remark, Result
from sal_height.engine.stage import Decision, Job, Port, Stage
from sal_height.errors import Rejected, UserError
from sal_height.geometry import Mounting, PlatformState
from sal_height.messages.codec import SHIPPED, BrokenMessage
from sal_height.messages.kinds import kind_of
from sal_height.nodes.managed import Topics
from sal_height.nodes.parameters import parameter_of
from sal_height.nodes.polled import PERIOD_S, SHORTEST_QUEUE, PolledOdometry
from sal_height.nodes.pooled import PooledJobs
from sal_height.nodes.transport.endpoints import Inlet, Outlet
from sal_height.nodes.transport.log import log_warning
from sal_height.nodes.transport.qos import FRAMES_QOS, INSTRUMENT_QOS, LATCHED_QOS, ODOMETRY_QOS, TF_STATIC_QOS
from sal_height.nodes.transport.services import ENDING, Said
from sal_height.nodes.viewing import VIEWERS, OdometryViewer, view_topics
from sal_height.nodes.worker import ENDED, WorkerNode
from sal_height.settings import settings_of
from sal_height.stage_files import check_written, read_inputs, write_product
from sal_height.topics import ODOMETRY
from sal_height.workers.pool import Pool
from sal_height.workers.processes import cpu_of_thread

OVERFLOWED = Rejected(
    "overload",
    "Messages arrive faster than they are received: those that waited were left out, to go on with whole dwells.",
)

OF_KIND: Mapping[type, QoSProfile] = {
    PlatformState: ODOMETRY_QOS,
    AirSample: ODOMETRY_QOS,
    StaticTransform: TF_STATIC_QOS,
    **dict.fromkeys((Pose, Fix, Attitude, Twist), INSTRUMENT_QOS),
}
"""Quality of service by the class of the items, where it is not that of frames."""


def quality_of(port: Port) -> QoSProfile:
    """The quality of service of a port."""
    return OF_KIND.get(port.kind, LATCHED_QOS if port.latched else FRAMES_QOS)


class StageNode(WorkerNode):
    """A node that hosts a stage; subclasses by `node_of` name the stage and are otherwise empty."""

    stage_class: ClassVar[type[Stage]]

    def __init__(self, pool: Pool | None = None, **node_arguments: Any) -> None:
        """Make the node.

        Args:
            pool: workers for jobs that copies of the stage can process; None: a thread of the node processes them.
            node_arguments: arguments of rclpy's Node.

        Raises:
            UserError: a parameter has a value that is not allowed, or a file cannot be used.
        """
        self._odometry: PolledOdometry | None = None
        self._pool, self._work_s = pool, 0.0
        super().__init__(self.stage_class.usual_name, **node_arguments)
        self._settings_known = settings = self.current_parameters()
        try:
            check_written(self.stage_class, settings)
            self.stage = self.stage_class(settings, read_inputs(self.stage_class, settings), self.get_name())
            self._offer_and_listen(settings)
        except UserError:
            super().destroy_node()
            raise
        self._deciding = threading.RLock()  # the context may be shut down in another thread than the executor's
        self._results: dict[int, tuple[Job, Sequence[Result]]] = {}
        self._ended = self._is_finished = False
        self.failure = ""
        """Message on a file that could not be written; empty if there was no failure."""
        self.stage.describe_sources = lambda: self.source_warning
        self.stage.publishers_of = lambda port: self._inlets_of[port].publishers
        for name in self.stage_class.commands:
            self.serve(f"~/{name}", lambda name=name: self._command(name))  # type: ignore[misc]
        self._decide(lambda: self.stage.start(self.get_clock().now().nanoseconds))
        self.every(0.1, lambda: self._decide(lambda: self.stage.advance(time.monotonic(), busy=self.jobs > 0)))
        if self.stage_class.concludes:
            self.context.on_shutdown(self.conclude)

    def begin_work(self) -> None:
        """Begin to process jobs, by the workers or on a thread of the node's own."""
        if self._pool and self.stage_class.is_parallel and self.stage_class in STAGES.values():
            jobs = PooledJobs(self, self.stage_class.usual_name, self._jobs, self._conclude_job)
            self._pool.serve(jobs, later=self.takes_images)
        else:
            super().begin_work()

    def usage(self) -> Mapping[str, Any]:
        """Fields of an account; in a process with workers the processor time is that of the node's jobs.

        What the other threads of that process need, which receive and publish, is in that of the node which receives
        phase histories.
        """
        numbers = super().usage()
        if self._pool is None:
            return numbers
        if self._worker:
            self._work_s = max(self._work_s, cpu_of_thread(self._worker))  # which is 0 once the thread has ended
        cpu_s = self._work_s
        if not (self._worker or self.takes_images):
            cpu_s += self._pool.cpu_s + cpu_of_thread(threading.main_thread())
        return {**numbers, "cpu_s": round(cpu_s, 3)}

    def _offer_and_listen(self, settings: Any) -> None:
        """Make publishers and subscriptions of the ports.

        Raises:
            UserError: the messages of a port do not exist in this environment.
        """
        self._outlets, self._viewers, self._latched = {}, {}, set[str]()
        self.joinable_outlets: list[tuple[Port, Outlet]] = []
        """Publishers whose items subscribers of the same process can receive as they are."""
        self.joinable_inlets: list[tuple[Port, Inlet, Callable[[Any, float], None]]] = []
        """Subscriptions that can receive items as they are, each with what accepts these."""
        for port in self.stage_class.outputs(settings):
            kind = kind_of(port)
            self._outlets[port.name] = (
                self.offer(SHIPPED.message_class(kind.type_name), port.name, quality_of(port)),
                kind,
            )
            if port.latched:
                self._latched.add(port.name)
            else:
                self.joinable_outlets.append((port, self._outlets[port.name][0]))
            if viewer := VIEWERS.get(port.kind):
                self._viewers[port.name] = viewer(self, port)
            elif getattr(settings, "publish_tf", False) and port.name == ODOMETRY:
                self._viewers[port.name] = OdometryViewer(self)
        self._inlets_of = {port.name: self._listen_to(port, settings) for port in self.stage_class.inputs(settings)}
        if isinstance(self.stage, Compression) and self._inlets_of[ODOMETRY].depth >= SHORTEST_QUEUE:
            timer = self.every(PERIOD_S, self.receive_polled)
            self._odometry = PolledOdometry(self, self._inlets_of[ODOMETRY], timer, self.stage, settings.frames)

    def _listen_to(self, port: Port, settings: Any) -> Any:
        """Subscribe to a port; what cannot be read is counted under the name of its kind."""
        kind = kind_of(port)

        def accept(item: Any, complete_s: float | None = None) -> None:
            if not port.counted or self.takes(count_messages(item)):
                self._decide(lambda: self.stage.accept(port.name, item, time.monotonic()), complete_s)

        def read(cdr: bytes) -> Sequence[Any]:
            try:
                return kind.read(cdr, settings)
            except UserError as error:
                self._count_unread(port, error)
                return ()

        def receive(items: Sequence[Any]) -> None:
            if port.per_channel and inlet.overflowed:
                self._catch_up(inlet, read)
            for item in items:
                accept(item)

        inlet = self.listen(
            SHIPPED.message_class(kind.type_name),
            port.name,
            receive,
            quality_of(port),
            optional=port.optional,
            read=read,
        )
        if not port.latched:
            self.joinable_inlets.append((port, inlet, accept))
        return inlet

    def _catch_up(self, inlet: Inlet, read: Callable[[bytes], Sequence[Any]]) -> None:
        """Leave out the messages that wait, as others of their dwells are lost, and receive those of other topics.

        Else each message that is received pushes another one out, and no dwell ever becomes whole.
        """
        left_out: Counter[DwellKey] = Counter()
        for cdr in inlet.take_waiting():
            try:
                left_out.update(item.key for item in read(cdr))
            except BrokenMessage as error:
                self.ignore("broken message", UserError(f"A message on {inlet.topic} cannot be decoded: {error}."))
        inlet.overflowed = False
        for dwell, count in left_out.items():
            if self.takes(count):
                self.reject(count, OVERFLOWED, dwell)
        for other in self.inlets:
            if other is not inlet and not other.is_polled:
                other.receive_waiting()

    def _count_unread(self, port: Port, error: UserError) -> None:
        """Count a message on a port that cannot be read."""
        if port.counted and self.takes():
            self.reject(1, self.unexpected(error))
        elif not port.counted:
            self.ignore(kind_of(port).trouble or getattr(error, "reason", port.name), error)

    @property
    def is_ready(self) -> bool:
        """True if it works, what it needs has publishers, and what takes time before the first dwell is done."""
        if not hasattr(self, "stage"):  # it was refused, and the node ends
            return False
        needed = all(self._inlets_of[port].is_connected for port in self.stage.needed_ports)
        return needed and self.stage.is_ready and super().is_ready

    @property
    def unpublished(self) -> int:
        """Dwells that have been processed and whose products follow once later ones have arrived."""
        return self.stage.unpublished

    def receive_polled(self) -> None:
        """Receive what has arrived and no executor waits for."""
        self._decide(tuple)

    def nothing_before(self, topic: str, stamp_ns: int) -> None:
        """Notify the stage that nothing with an earlier stamp will arrive on a topic (run and replay)."""
        if topic in self._inlets_of:
            self._decide(lambda: self.stage.nothing_before(topic, stamp_ns))

    def finish_stage(self) -> None:
        """Notify the stage that nothing more arrives (run and replay)."""
        self._decide(self.stage.finish)
        self._is_finished = True

    def set_before(self, dwell: DwellKey, values: Mapping[str, Any]) -> None:
        """Set parameters that apply from a dwell on.

        Raises:
            UserError: a value is not allowed.
        """
        with self._deciding:
            result = self.set_parameters_atomically([parameter_of(name, value) for name, value in values.items()])
            if not result.successful:
                said = ", ".join(f"{name}={value!r}" for name, value in values.items())
                reason = result.reason.rstrip(".")
                raise UserError(f"Node {self.get_name()} was to get {said}, as in flight, and refuses ({reason}).")
            self._settings_known = self.current_parameters()
            self.stage.change(self._settings_known, before=dwell)

    def state_mounting(self, sensor: str, mounting: Mounting) -> None:
        """Use a mounting for a sensor (config_hash) instead of that of its description, as a flight did."""
        if isinstance(self.stage, Compression):
            self.stage.state_mounting(sensor, mounting)

    def state_calibrations(self, applied_from: Mapping[str, Sequence[DwellKey]]) -> None:
        """Apply calibrations (by identity) from these dwells on, as a flight did, and not once they arrive."""
        if isinstance(self.stage, Compression):
            self.stage.state_calibrations(applied_from)

    def forget(self) -> None:
        """Forget what has been gathered of the dwells so far, once those that wait have been processed."""
        self._decide(self.stage.reset)

    def conclude(self) -> None:
        """Process what waits, and do what is due at the end. May be called twice."""
        with self._deciding:
            if self._ended:
                return
            self._ended = True
        self.finish()
        for job in self._own_jobs([] if self._is_finished else self.stage.finish()):
            self._report(self._processed([job])[0][1])
        # Longest wait at the end of the node for subscribers to receive the last latched messages, s.
        last_words_s = 2.0
        with suppress(RCLError):
            for topic in self._latched:
                self._outlets[topic][0].publisher.wait_for_all_acked(Duration(seconds=last_words_s))

    def destroy_node(self) -> None:
        """Process or drop what waits, then end the node."""
        for inlet in self.inlets:
            inlet.leave()
        if hasattr(self, "_deciding"):
            if self.stage_class.concludes:
                self.conclude()
            else:
                self._decide(self.stage.abandon)
        super().destroy_node()

    def _own_jobs(self, decisions: Sequence[Decision]) -> list[Job]:
        """The jobs among decisions; the rest is published and counted."""
        jobs = [one for one in decisions if isinstance(one, Job)]
        _, losses = self._report([one for one in decisions if not isinstance(one, Job)])
        for loss in losses:
            self.reject(loss.messages, Rejected(loss.reason, loss.sentence), loss.dwell)
        return jobs

    def _decide(self, ask: Callable[[], Sequence[Decision]], complete_s: float | None = None) -> None:
        """Ask the stage, and do what it decides.

        Args:
            ask: function that returns what the stage decides.
            complete_s: time at which the dwell that it decides on was complete, s of the monotonic clock; None: now.
        """
        with self._deciding:
            decisions = self._asked(ask)
            if not decisions:  # as after most messages
                return
            for job in self._own_jobs(decisions):
                self._enqueue(job, self.now_s() if complete_s is None else complete_s)

    def _asked(self, ask: Callable[[], Sequence[Decision]]) -> Sequence[Decision]:
        """The decisions of the stage, with the parameters as they are now."""
        now = self.current_parameters()
        if now is not self._settings_known:
            self._settings_known = now
            self.stage.change(now)
        decisions = self._odometry.decisions(ask) if self._odometry else ask()
        self.hardware_id = self.stage.sensor_name
        return decisions

    def _enqueue(self, job: Job, complete_s: float) -> None:
        if self._ended and job.messages:
            self.reject(job.messages, ENDED, job.dwell)
            return
        self.submit(job.messages, lambda: self._process_job(job, complete_s), job.size, job, complete_s)
        if self._pool and not self._worker:
            self._pool.wake()

    def _process_job(self, job: Job, complete_s: float = 0.0) -> int:
        """Process a job (on the node's own thread), and publish its results; the number of messages published."""
        return self._publish_results(self._results_of(job), complete_s)

    def _conclude_job(self, job: Job, results: Sequence[Result], complete_s: float, cpu_s: float) -> int:
        """Notify the stage of the results of a job that a worker has processed, and publish them."""
        self._work_s += cpu_s
        self._decide(lambda: self.stage.note_done(job, results))
        return self._publish_results(results, complete_s)

    def _publish_results(self, results: Sequence[Result], complete_s: float) -> int:
        """Publish the products of a job; the number of messages published.

        Raises:
            Rejected: the stage has left it out.
        """
        published, losses = self._report(results, complete_s)
        if losses:
            raise Rejected(losses[0].reason, losses[0].sentence)
        return published

    def _results_of(self, job: Job) -> Sequence[Result]:
        """The results of a job, which may have been processed ahead; if not, those that wait are processed with it."""
        if id(job) not in self._results:
            waiting = self.waiting()[: self.stage.at_once - 1] if self.stage.at_once > 1 else []
            found = self._processed([job, *(one for one in waiting if isinstance(one, Job))])
            self._results = {id(one): (one, results) for one, results in found}
        return self._results.pop(id(job))[1]

    def _processed(self, jobs: Sequence[Job]) -> list[tuple[Job, Sequence[Result]]]:
        """Process jobs, and notify the stage of their results; returns each job with its results."""
        found = list(zip(jobs, self.stage.process(jobs), strict=True))
        for job, results in found:
            self._decide(lambda job=job, results=results: self.stage.note_done(job, results))  # type: ignore[misc]
        return found

    def _report(self, results: Sequence[Result], complete_s: float = 0.0) -> tuple[int, list[Loss]]:
        """Publish products, count and log the rest; the number of messages published, and the losses of jobs."""
        published, losses = 0, list[Loss]()
        for one in results:
            if isinstance(one, Product):
                published += self._publish(one, complete_s)
            elif isinstance(one, Loss):
                losses.append(one)
                self._log_trace(one.trace)
            elif isinstance(one, Notice):
                self._log_trace(one.trace)
                (self.ignore if one.dwell is None else self.doubt)(one.kind, UserError(one.sentence))
            elif isinstance(one, Event):
                (self.tell if one.name == CALIBRATIONS_ARRIVED else self.tally.note)(one.name, one.times)
                if one.loss:
                    self._publish_loss(one.loss)
            elif isinstance(one, FileProduct):
                self._write(one)
            elif isinstance(one, Remark):
                log_warning(self, one.sentence)
        return published, losses

    def _publish(self, product: Product, complete_s: float) -> int:
        """Publish a product, and what viewers show of it while somebody subscribes; the number of its messages."""
        if not (self.is_active or product.port in self._latched):
            return 0
        outlet, kind = self._outlets[product.port]
        outlet.hand_over(product.item, complete_s)
        with suppress(RCLError):  # the context may have ended: nobody is left to publish to
            if viewer := self._viewers.get(product.port):
                viewer.publish(product.item)
            if outlet.joined and not outlet.remote_subscribers:
                return count_messages(product.item)
            serialized = kind.write(product.item, self.current_parameters())
            for cdr in serialized:
                outlet.publish(cdr)
            return len(serialized)
        return 0

    def _write(self, product: FileProduct) -> None:
        try:
            write_product(product)
        except UserError as error:
            self.failure = str(error)
            self.count_ignored("file", error)
            self.get_logger().error(self.failure)
        else:
            if product.remark:
                self.get_logger().warning(product.remark)

    def _log_trace(self, trace: str) -> None:
        if trace:
            self.get_logger().error(f"Unexpected failure, please report it: {trace}")

    def _command(self, name: str) -> Said | Future[Said]:
        """Have the stage do something that was asked for by hand, after the jobs that wait."""
        with self._deciding:
            if self._ended:
                return ENDING
            jobs = self._own_jobs(self._asked(lambda: self.stage.command(name)))
            return self.promise(lambda: self._answer_of(jobs))

    def _answer_of(self, jobs: Sequence[Job]) -> Said:
        """Process the jobs of a command; its answer."""
        self.failure = ""
        answers: list[Answer] = []
        for _, results in self._processed(jobs):
            self._report(results)
            answers.extend(one for one in results if isinstance(one, Answer))
        answer = answers[0] if answers else Answer(success=False, sentence="no answer")
        return answer.success and not self.failure, self.failure or answer.sentence


def node_of(stage: type[Stage], *, settable: bool = True) -> type[StageNode]:
    """The class of a stage's node, with what runs know of it (`nodes.managed`).

    Args:
        stage: class of the stage.
        settable: True if users may set its parameters in a run or replay.
    """
    settings = stage.settings()
    inputs, outputs = stage.inputs(settings), stage.described_outputs()
    heights = next((port.name.removesuffix("/height") for port in outputs if port.kind is Heights), "")
    takes_heights = any(port.kind is Heights for port in inputs)
    frame_topics = OdometryViewer.topics if "publish_tf" in settings_of(stage.settings) else {}
    attributes = {
        "stage_class": stage,
        "parameters": stage.settings,
        "niceness": stage.niceness,
        "inputs": _described(stage.described_inputs()),
        "outputs": {**_described(outputs), **view_topics(outputs), **frame_topics},
        "answers": {**WorkerNode.answers, **{f"~/{name}": about for name, about in stage.commands.items()}},
        "product": heights,
        "takes_images": any(port.name == "slc" for port in inputs),
        "takes_heights": takes_heights,
        "settable": settable,
        "completes_file": bool(stage.concludes and stage.commands),
        "__doc__": stage.__doc__,
        "__module__": __name__,
    }
    return type(stage.__name__, (StageNode,), attributes)


def _described(ports: Sequence[Port]) -> Topics:
    return {port.name: port.about for port in ports}
