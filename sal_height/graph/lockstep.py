"""Run the graph step by step in one process: the next step starts when all messages of the one before are processed.

Nodes exchange ROS messages, and the recorder is a subscriber. Only the control is by objects: a step is over when the
counts of the node objects say so, parameters are set on the objects, and what no longer arrives is announced to them.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any, NamedTuple

from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.time import Time

from sal_height.engine.results import DwellKey
from sal_height.errors import UserError
from sal_height.graph.catalogue import stage_inputs
from sal_height.graph.ensemble import Ensemble, members_of
from sal_height.graph.plan import DEFAULT, RECORDER, UNCOUNTED, Execution, Outcome, Plan
from sal_height.nodes.accounts.account import Account
from sal_height.nodes.host import StageNode
from sal_height.nodes.playing.player import Player
from sal_height.nodes.recording.recorder import Recorder
from sal_height.nodes.transport.domain import ros_domain
from sal_height.nodes.transport.endpoints import Inlet, Outlet
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.worker import WorkerNode
from sal_height.progress import Bar
from sal_height.workers.processes import Interruption


class Ends(NamedTuple):
    """The two ends of a topic, with what had been published and received before the first step.

    Attributes:
        outlets: publishers, each with the number of messages before.
        inlets: subscriptions, each with the number of messages before.
    """

    outlets: list[tuple[Outlet, int]]
    inlets: list[tuple[Inlet, int]]

    @property
    def published(self) -> int:
        """Number of messages published since the start of the first step."""
        return sum(outlet.published - before for outlet, before in self.outlets)

    @property
    def is_received(self) -> bool:
        """True if every subscription has received them, but for those that the middleware has lost."""
        published = self.published
        return all(inlet.received + inlet.missed - before >= published for inlet, before in self.inlets)


class Lockstep:
    """The nodes of a plan in one process, and what is known of their messages."""

    def __init__(self, plan: Plan, ensemble: Ensemble) -> None:
        """Join the nodes of an ensemble that has been entered.

        Raises:
            UserError: no node publishes a topic that is to be recorded.
        """
        self._plan, self._graph = plan, ensemble.graph
        self._source: WorkerNode = ensemble.nodes[plan.source]
        self._stages: dict[str, StageNode] = {name: ensemble.nodes[name] for name in plan.stages}
        self._recorder: Recorder = ensemble.nodes[RECORDER]
        self._workers: list[WorkerNode] = [self._source, *self._stages.values()]
        self._recorded = [f"/{topic}" for topic in plan.on_wire(plan.recorded) if topic not in UNCOUNTED]
        self._ends: dict[str, Ends] = {}
        self._set_clocks()
        offered = {outlet.topic for node in self._workers for outlet in node.outlets}
        if unknown := sorted(set(self._recorded) - offered):
            names = ", ".join(sorted(topic.lstrip("/") for topic in offered))
            raise UserError(f"No node of this run publishes topic {unknown[0].lstrip('/')}; it has {names}.")

    def is_ready(self) -> bool:
        """True if all nodes are connected, and have done what they do before the first dwell."""
        if not (self._source.is_ready and all(stage.is_ready for stage in self._stages.values())):
            return False
        subscribed = self._recorder.recorded
        if any(topic not in subscribed for topic in self._recorded):
            return False
        ours: dict[str, int] = defaultdict(int)
        for topic in (*(inlet.topic for node in self._workers for inlet in node.inlets), *self._recorded):
            ours[topic] += 1
        outlets = [outlet for node in self._workers for outlet in node.outlets]
        topic_counts = self._recorder.topic_counts
        latched = [(outlet, topic_counts[outlet.topic]) for outlet in outlets if outlet.topic in topic_counts]
        if any(outlet.published and counts.latched and not counts.written for outlet, counts in latched):
            return False  # the next message may replace the one that is on its way
        return all(outlet.subscribers >= ours[outlet.topic] for outlet in outlets)

    def begin(self) -> None:
        """Record what was published and received so far, and schedule the changes before dwells."""
        ends: dict[str, Ends] = defaultdict(lambda: Ends([], []))
        for node in self._workers:
            for outlet in node.outlets:
                ends[outlet.topic].outlets.append((outlet, outlet.published))
            for inlet in node.inlets:
                ends[inlet.topic].inlets.append((inlet, inlet.received))
        self._ends = {topic: one for topic, one in ends.items() if one.outlets}
        self._written_before = dict(self._recorder.recorded)
        self._schedule_changes()
        self.announce()

    def _schedule_changes(self) -> None:
        """Notify the stages and the player of the changes before dwells, and of dwells that are left out."""
        for stage in self._stages.values():
            for sensor, mounting in self._plan.mountings.items():
                stage.state_mounting(sensor, mounting)
        applied_from: dict[str, list[DwellKey]] = defaultdict(list)
        for change in self._plan.changes:
            for calibration in change.calibrations:
                applied_from[calibration].append(change.dwell)
            for name, values in change.parameters.items():
                if name in self._stages:
                    self._stages[name].set_before(change.dwell, values)
        for name, stage in self._stages.items():
            stage.state_calibrations(applied_from)
            for dwell, item in self._plan.as_flown.scheduled(name):
                stage.stage.schedule(dwell, "", item)
        if isinstance(self._source, Player):
            self._source.schedule({one.dwell: one.calibrations for one in self._plan.changes}, self._plan.frames)

    def step(self) -> bool:
        """Have the source publish the next step, at its time; False at the end."""
        is_begun = self._source.step()[0]
        self._set_clocks()  # no node has received a message of the step, for none is spun
        return is_begun

    def _set_clocks(self) -> None:
        """Set the clocks of all nodes to the time of the step, if the source goes by steps."""
        if self._plan.simulated_time and self._source.step_ns:
            now = Time(nanoseconds=self._source.step_ns, clock_type=ClockType.ROS_TIME)
            nodes: list[Any] = [self._recorder, *self._workers]
            for node in nodes:
                node.get_clock().set_ros_time_override(now)

    def is_settled(self) -> bool:
        """True if all that was published has been received, processed and recorded."""
        if any(node.jobs for node in self._workers):
            return False
        for stage in self._stages.values():
            stage.receive_polled()
        if not all(ends.is_received for ends in self._ends.values()):
            return False
        self._recorder.write_received()
        return all(self._is_recorded(topic) for topic in self._recorded)

    def announce(self) -> None:
        """Announce to the stages what no longer arrives."""
        if self._plan.announces:
            for topic, stamp_ns in self._source.announced().items():
                for stage in self._stages.values():
                    stage.nothing_before(topic, stamp_ns)

    def finish(self, wait: Callable[[Callable[[], bool], str], None]) -> None:
        """Notify one stage after the other that nothing more arrives, in the order of the data."""
        for name, stage in self._stages.items():
            stage.finish_stage()
            wait(self.is_settled, f"the last dwells to be processed by {name}")

    def check(self) -> None:
        """Make sure that the source works, that the bag records what arrives, and that nobody else publishes frames.

        Raises:
            UserError: it is not so.
        """
        source = self._source.account()
        if source.dropped:
            raise UserError(source.last_drop)
        recorder = self._recorder.account()
        if recorder.unwritten:
            raise UserError(f"{recorder.unwritten} messages could not be written to the bag; make room on its disk.")
        if recorder.dropped:
            raise UserError(recorder.last_drop)
        refuse_company(self._source, self._plan.on_wire(self._plan.played), own=1)

    @property
    def progress(self) -> tuple[int, ...]:
        """Numbers that change as long as a node makes progress."""
        counts = [ends.published for ends in self._ends.values()]
        received = [inlet.received for node in self._workers for inlet in node.inlets]
        recorded = [self._recorder.recorded.get(topic, 0) for topic in self._recorded]  # not accounts, which go on
        return (*counts, *received, *recorded, *(node.jobs for node in self._workers))

    @property
    def is_working(self) -> bool:
        """True if a node works on something."""
        return any(node.jobs for node in self._workers)

    @property
    def played(self) -> int:
        """Dwells that the source has published."""
        return self._source.account().dwells

    def drops(self) -> str:
        """Messages that the nodes have dropped so far, in a few words."""
        return ", ".join(
            f"{name} {reason}: {count}"
            for name, node in self._stages.items()
            for reason, count in node.account().dropped.items()
        )

    def final_accounts(self) -> dict[str, Account]:
        """The accounts of the source and of every stage; messages that never arrived count as received and dropped.

        So do those that the recorder has missed; its account is included only then.
        """
        accounts = {self._plan.source: self._source.account()}
        for name, stage in self._stages.items():
            account = stage.account()
            accounts[name] = account.with_losses(sum(account.missed.values()))
        recorder = self._recorder.account()
        missed = sum(count for topic, count in recorder.missed.items() if f"/{topic}" in self._recorded)
        return accounts | ({RECORDER: recorder.with_losses(missed)} if missed else {})

    def _is_recorded(self, topic: str) -> bool:
        ends = self._ends.get(topic)
        if ends is None:
            return True
        written = self._recorder.recorded.get(topic, 0) - self._written_before.get(topic, 0)
        missed = self._recorder.missed(topic)
        return written + missed >= ends.published


def perform(plan: Plan, execution: Execution = DEFAULT) -> Outcome:
    """Run the graph on all dwells of a source, step by step, and record it.

    What goes wrong once all nodes are started is in the outcome, together with the accounts up to then.

    Raises:
        UserError: a node or the bag refuses its parameters, a stage reads heights that no other makes, no node
            publishes a topic that is to be recorded, or somebody else publishes frames.
    """
    also = [topic.removeprefix("/") for topic in execution.record]
    plan = replace(plan, recorded=list(dict.fromkeys([*plan.recorded, *also])))
    interrupted, elapsed_s = False, 0.0
    failure: UserError | None = None
    stage_inputs(plan.stages, plan.parameters, plan.played)  # refuses a plan before anything is started
    with ros_domain(execution.domain):
        if execution.domain != "free":
            _look_for_company(plan)
        with Interruption() as interruption, Ensemble(members_of(plan), "one") as ensemble:
            run = Lockstep(plan, ensemble)
            wait = _waiter(ensemble.graph, run, interruption, execution.timeout_s)
            began = time.monotonic()
            with Bar(total=plan.dwells, unit="dwell", desc=plan.bag.parent.name) as progress:
                try:
                    wait(run.is_ready, "all nodes to be ready")
                    run.begin()
                    progress.reset()  # its rate is that of the dwells
                    began = time.monotonic()
                    while run.step():
                        wait(run.is_settled, f"what was played from dwell {progress.n} on to be processed")
                        run.announce()
                        wait(run.is_settled, f"what was played up to dwell {run.played} to be processed")
                        progress.set_postfix_str(run.drops(), refresh=False)
                        progress.update(run.played - progress.n)
                    run.finish(wait)
                    progress.update(run.played - progress.n)
                except KeyboardInterrupt:
                    interrupted = True
                except UserError as error:
                    failure = error
                elapsed_s = time.monotonic() - began
            accounts, played = run.final_accounts(), run.played
    return Outcome(accounts, played, interrupted, failure, elapsed_s)


def refuse_company(node: Any, topics: Iterable[str], own: int) -> None:
    """Make sure that nobody else publishes what a sensor does: two on one topic cannot be distinguished.

    Args:
        node: node that looks for publishers.
        topics: topics of the sensor.
        own: number of our own publishers of each topic.

    Raises:
        UserError: somebody does.
    """
    for topic in topics:
        if node.count_publishers(topic) > own:
            raise UserError(
                f"Somebody else publishes on /{topic} in this ROS domain; stop them, or choose another domain."
            )


def _waiter(
    graph: Graph, run: Lockstep, interruption: Interruption, timeout_s: float
) -> Callable[[Callable[[], bool], str], None]:
    """Make a function that spins the graph until a condition is true, which it is given with words for it.

    The function raises UserError if the run cannot go on, and KeyboardInterrupt if the user has interrupted.
    """

    def wait(condition: Callable[[], bool], what: str) -> None:
        due = last_progress = time.monotonic()
        progress = run.progress

        def is_over() -> bool:
            nonlocal due, progress, last_progress
            look_period_s = 0.1  # period at which signals, the bag and other publishers are checked, s
            if (now := time.monotonic()) >= due:
                due = now + look_period_s
                interruption.check()
                run.check()
                if run.is_working or run.progress != progress:
                    progress, last_progress = run.progress, now
                if now - last_progress > timeout_s:
                    raise UserError(
                        f"No node has made progress for {timeout_s:g} s while waiting for {what}; the log above may "
                        "say why."
                    )
            return condition()

        if not graph.spin_until(is_over):
            raise UserError(f"ROS was shut down while waiting for {what}.")

    return wait


def _look_for_company(plan: Plan) -> None:
    """Look for other sensors as long as discovery needs.

    Raises:
        UserError: there is one.
    """
    # Time for which other sensors are looked for before the start, s: discovery needs a few tenths of a second on an
    # idle machine.
    company_timeout_s = 1.0
    with Graph() as graph:
        looker = graph.add(Node("sal_height_looker", context=graph.context))

        def found() -> bool:
            refuse_company(looker, plan.on_wire(plan.played), own=0)
            return False

        graph.spin_until(found, company_timeout_s)
