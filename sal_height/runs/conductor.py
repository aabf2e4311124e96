"""Run the graph step by step: the next step starts when the messages of those before, but a few, are accounted for.

A step is a dwell, or in a replay by another clock than lockstep all that is played up to the next change in flight.
"""

from __future__ import annotations

import signal
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any, Self

from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import Trigger
from tqdm import tqdm

from sal_height.errors import UserError
from sal_height.messages import AIR
from sal_height.messages.types import DiagnosticArray, NodeAccount
from sal_height.nodes.account import DIAGNOSTICS, OTHER, PROGRESS, Account
from sal_height.nodes.domain import DomainChoice, ros_domain
from sal_height.nodes.graph import Graph
from sal_height.nodes.message_types import class_of, subscribe
from sal_height.nodes.played import IMAGES, SENSOR
from sal_height.nodes.player import CALIBRATION_TOPIC
from sal_height.nodes.playlist import FRAMES, ODOMETRY, SENSOR_INFO
from sal_height.nodes.stage import FRAMES_QOS
from sal_height.runs.catalogue import NODES, NodeParameters, stage_inputs
from sal_height.runs.ensemble import Ensemble, Member
from sal_height.runs.lead import IN_STEP, Lead

UNCOUNTED = ("diagnostics",)
"""Recorded topics of which the publishers count neither messages nor subscribers."""

COMPANY_TIMEOUT_S = 1.0
"""How long to look for other sensors before anything is started: discovery takes a few tenths of a second
on an idle machine."""

LOOK_PERIOD_S = 0.02
"""Time after which it is looked at nodes and signals even if nothing has come."""

RECORDER = "recorder"


@dataclass(frozen=True)
class Plan:
    """What a run of the graph is made of.

    Attributes:
        source: name of the node that publishes dwells, "simulator" or "player".
        stages: names of the processing nodes, sar_compression first.
        recorded: topics to record, without leading slash.
        bag: folder of the new bag.
        parameters: values of the nodes' parameters.
        dwells: number of dwells to expect, for the progress bar.
        custom_data: texts by name to store in the bag.
        played: topics of the source.
        remapped: other names of topics of all nodes, by their own; all without leading slash.
        simulated_time: whether all nodes take the time from /clock, which the source publishes.
        lead: how far the source may be ahead of nodes in processes of their own; those in one process gain nothing.
    """

    source: str
    stages: list[str]
    recorded: list[str]
    bag: Path
    parameters: NodeParameters
    dwells: int
    custom_data: Mapping[str, str] = field(default_factory=dict)
    played: Sequence[str] = SENSOR
    remapped: Mapping[str, str] = field(default_factory=dict)
    simulated_time: bool = False
    lead: Lead = IN_STEP

    def on_wire(self, topics: Iterable[str]) -> list[str]:
        """The names under which topics of the nodes are published."""
        return [self.remapped.get(topic, topic) for topic in topics]


@dataclass(frozen=True)
class Execution:
    """How a run is carried out; the heights do not depend on it.

    Attributes:
        processes: whether each node gets a process of its own.
        domain: the ROS domain of the nodes.
        record: topics to record besides those that the run needs, with or without leading slash.
        timeout_s: how long to wait while no node works and no message moves, s, before the run is given up. A dwell may
            take longer, as long as a node works on it.
    """

    processes: bool = False
    domain: DomainChoice = "free"
    record: Sequence[str] = ()
    timeout_s: float = 120.0


DEFAULT = Execution()


@dataclass(frozen=True)
class Outcome:
    """What a run did.

    Attributes:
        stages: account of the source and of every stage, by node name; of the recorder, if it has missed messages.
        dwells: number of dwells that were played.
        interrupted: whether the user stopped the run.
        failure: why the run ended early, unless the user stopped it.
        elapsed_s: from the first step until the last dwell was settled, or until the run ended, s.
    """

    stages: dict[str, Account]
    dwells: int
    interrupted: bool
    failure: UserError | None = None
    elapsed_s: float = 0.0

    @property
    def losses(self) -> list[str]:
        """A sentence for each node that dropped messages."""
        return [
            f"Node {name} dropped {count} messages ({reason})."
            for name, account in self.stages.items()
            for reason, count in account.dropped.items()
        ]


class Interruption:
    """While it is entered, SIGINT, SIGTERM and SIGHUP wait until `check`, so that they never cut a message in two.

    SIGHUP stays ignored where the caller wants it so (nohup).
    """

    def __init__(self) -> None:
        self._asked = False

    def check(self) -> None:
        """Raise KeyboardInterrupt if a signal has come."""
        if self._asked:
            raise KeyboardInterrupt

    def __enter__(self) -> Self:
        numbers = [signal.SIGINT, signal.SIGTERM]
        if signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
            numbers.append(signal.SIGHUP)
        self._before = {number: signal.signal(number, self._ask) for number in numbers}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _ask(self, _number: int, _frame: FrameType | None) -> None:
        self._asked = True


class Conductor(Node):
    """Reads the accounts of all nodes, and asks the source for dwells."""

    def __init__(self, plan: Plan, *, in_steps: bool = False, **node_arguments: Any) -> None:
        """Conduct the nodes of a plan.

        Args:
            plan: the plan.
            in_steps: whether nodes are to tell their accounts after every piece of work, and not only at times.
            node_arguments: passed to rclpy's Node.

        Raises:
            UserError: a stage takes heights that no other stage makes.
        """
        super().__init__("conductor", **node_arguments)
        self.accounts: dict[str, Account] = {}
        self.last_progress = time.monotonic()
        self._source = plan.source
        inputs = stage_inputs(plan.stages, plan.parameters, plan.played)
        self._inputs = {plan.source: "", **dict(zip(inputs, plan.on_wire(inputs.values()), strict=True))}
        self._recorded, self._played = plan.on_wire(plan.recorded), plan.on_wire(plan.played)
        self._sensor_info, self._calibration = plan.on_wire([SENSOR_INFO, CALIBRATION_TOPIC])
        taken = [topic for name in plan.stages for topic in (ODOMETRY, *AIR) if topic in NODES[name].inputs]
        self._samples = plan.on_wire(taken)
        self._calibrated = [name for name in plan.stages if CALIBRATION_TOPIC in NODES[name].inputs]
        self._frames, self._images = plan.on_wire([FRAMES, IMAGES])
        self._steps = 0
        self._has_news = False
        self._step = self.create_client(Trigger, f"{plan.source}/{NODES[plan.source].begin_service}")
        if in_steps:
            subscribe(self, NodeAccount, PROGRESS, self._on_progress, 100)
        else:
            subscribe(self, DiagnosticArray, DIAGNOSTICS, self._on_diagnostics, 100)

    def connected(self) -> bool:
        """Whether every topic has its subscribers, as its publisher counts them: nothing will be lost.

        Raises:
            UserError: a topic to record is published by no node.
        """
        if not {*self._inputs, RECORDER} <= self.accounts.keys():
            return False
        offered = {topic: n for account in self.accounts.values() for topic, n in account.subscribers.items()}
        recorded = set(self._recorded) - set(UNCOUNTED)
        if unknown := sorted(recorded - offered.keys()):
            raise UserError(f"No node of this run publishes topic {unknown[0]}; it has {', '.join(sorted(offered))}.")
        needed = Counter(topic for topic in self._inputs.values() if topic)
        needed.update([*(topic for topic in self._samples if topic in self._played), *recorded])
        alone = all(self.count_publishers(topic) == 1 for topic in self._played)
        return alone and all(offered[topic] >= n for topic, n in needed.items()) and self._step.service_is_ready()

    def ready(self) -> bool:
        """Whether all nodes are connected, and have done what they do before the first dwell."""
        return self.connected() and all(
            account.ready for name, account in self.accounts.items() if name in self._inputs
        )

    def listen_raw(self, message_type: type, topic: str, receive: Callable[[bytes], None]) -> None:
        """Have the serialized messages of a topic taken by `receive`."""
        self.create_subscription(class_of(message_type), topic, receive, FRAMES_QOS, raw=True)

    def check(self) -> None:
        """Make sure that the source works, that the bag takes what comes, and that nobody else publishes frames.

        Raises:
            UserError: it is not so.
        """
        if (source := self.accounts.get(self._source)) and source.dropped:
            raise UserError(source.last_drop)
        recorder = self.accounts.get(RECORDER, Account())
        if recorder.unwritten:
            raise UserError(f"{recorder.unwritten} messages could not be written to the bag; make room on its disk.")
        if recorder.dropped:
            raise UserError(recorder.last_drop)
        self.refuse_company(own=1)

    def refuse_company(self, own: int) -> None:
        """Make sure that nobody else publishes what a sensor does: two on one topic cannot be told apart.

        Args:
            own: how many publishers of each topic are ours.

        Raises:
            UserError: somebody does.
        """
        for topic in self._played:
            if self.count_publishers(topic) > own:
                raise UserError(
                    f"Somebody else publishes on /{topic} in this ROS domain; stop them, or choose another domain."
                )

    def ask(self) -> Future:
        """Ask the source to begin, or for the next dwell; its answer is in the future."""
        answer = self._step.call_async(Trigger.Request())
        answer.add_done_callback(lambda _: self._note_news())
        return answer

    def take_news(self) -> bool:
        """Whether an answer or an account has come since the last call: all else would be as it was then."""
        news, self._has_news = self._has_news, False
        return news

    def _note_news(self) -> None:
        self._has_news = True

    def step(self, wait: Callable[[Callable[[], bool], str], None]) -> bool:
        """Ask for the next step; False when there is none.

        Raises:
            UserError: the source does not answer.
        """
        answer = self.ask()
        wait(answer.done, f"an answer of node {self._source}")
        self._steps += answer.result().success
        return bool(answer.result().success)

    def caught_up(self, lead: Lead) -> bool:
        """Whether the next dwell may be asked for, as every node is done with all dwells but the last few.

        That can be told while every dwell has all its frames. All is to be settled otherwise: a dwell that waits for
        frames must not be overtaken.
        """
        source, frames = self.accounts[self._source], self._frames
        as_asked = source.received == self._steps and not source.waiting
        if not (lead.dwells and as_asked and self._published()[frames] == self._steps * lead.channels):
            return self.settled()
        done = self._steps - lead.dwells
        least = {"": 0, frames: done * lead.channels, self._images: done * lead.channels}
        finished = {name: self.accounts[name].received - self.accounts[name].waiting for name in self._inputs}
        return self.settled() or (
            all(finished[name] >= least.get(topic, done) for name, topic in self._inputs.items())
            and self.accounts[RECORDER].recorded.get(frames, 0) >= least[frames]
        )

    def settled(self) -> bool:
        """Whether all that was asked for has been published, accounted for in every stage, and recorded."""
        published, recorded = self._published(), self.accounts[RECORDER].recorded
        if any(self._open(name, topic, published) for name, topic in self._inputs.items()):
            return False
        if not self._has_calibrations(recorded):
            return False
        if self._sensor_info in self._recorded and not recorded.get(self._sensor_info):
            return False
        topics = [topic for topic in self._recorded if topic in published]
        return all(topic in recorded and not self._unrecorded(topic, published) for topic in topics)

    @property
    def told(self) -> bool:
        """Whether no stage holds back what it will tell once no more dwells come."""
        return not any(self.accounts[name].unpublished for name in self._inputs)

    def _open(self, name: str, topic: str, published: Mapping[str, int]) -> int:
        """Messages of a topic, or steps of the source, that a node has not accounted for."""
        account, expected = self.accounts[name], published[topic] if topic else self._steps
        return account.waiting + abs(expected - account.received - account.missed.get(topic, 0))

    def _unrecorded(self, topic: str, published: Mapping[str, int]) -> int:
        """Messages of a topic that are not in the bag; negative: its publisher has not told of all."""
        recorder = self.accounts[RECORDER]
        return published[topic] - recorder.recorded.get(topic, 0) - recorder.missed.get(topic, 0)

    @property
    def played(self) -> int:
        """Dwells that the source has published."""
        return self.accounts.get(self._source, Account()).dwells

    def final_accounts(self) -> dict[str, Account]:
        """The accounts of the source and of every stage; what never came is received and dropped in them.

        So is what the recorder has missed, whose account is there only then.
        """
        accounts = {
            name: (account := self.accounts.get(name, Account())).with_losses(account.missed.get(topic, 0))
            for name, topic in self._inputs.items()
        }
        recorder, published = self.accounts.get(RECORDER, Account()), self._published()
        missed = sum(recorder.missed.get(topic, 0) for topic in self._recorded if topic in published)
        return accounts | ({RECORDER: recorder.with_losses(missed)} if missed else {})

    def _published(self) -> Counter[str]:
        """Messages published by all nodes on each topic that keeps all of them."""
        published: Counter[str] = Counter()
        for account in self.accounts.values():
            published.update(account.published_on)
        return published

    def _has_calibrations(self, recorded: Mapping[str, int]) -> bool:
        """Whether the calibrations that the source has published are in the stages that take them, and in the bag."""
        published = self.accounts[self._source].calibrations
        taken = [self.accounts[name].calibrations for name in self._calibrated if published]
        if self._calibration in self._recorded:
            taken.append(recorded.get(self._calibration, 0))
        return all(count >= published for count in taken)

    def drops(self) -> str:
        """What the nodes have dropped so far, in a few words."""
        return ", ".join(
            f"{name} {reason}: {count}"
            for name, account in self.accounts.items()
            for reason, count in account.dropped.items()
        )

    def _on_progress(self, message: NodeAccount) -> None:
        self._enter(message.node, Account.of_message(message))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            account = Account.of_status(status)
            if account.kind != OTHER:
                self._enter(status.name, account)

    def _enter(self, node: str, account: Account) -> None:
        """Take note of an account, if it is one of a node of the plan."""
        self._note_news()
        if node in {*self._inputs, RECORDER}:
            if account.jobs or _counts(account) != _counts(self.accounts.get(node)):
                self.last_progress = time.monotonic()
            self.accounts[node] = account


def _counts(account: Account | None) -> object:
    """What changes in an account when the node gets on with its work."""
    if account is None:
        return None
    recorded = {topic: count for topic, count in account.recorded.items() if topic not in UNCOUNTED}
    return account.received, account.waiting, account.missed, account.published_on, account.subscribers, recorded


def perform(plan: Plan, execution: Execution) -> Outcome:
    """Run the graph on all dwells of a source, step by step, and record it.

    What goes wrong once all nodes are started is in the outcome, together with the accounts up to then.

    Raises:
        UserError: a node or the bag refuses its parameters, a stage takes heights that no other makes, no node
            publishes a topic that is to be recorded, or somebody else publishes frames.
    """
    also = [topic.removeprefix("/") for topic in execution.record]
    plan = replace(plan, recorded=list(dict.fromkeys([*plan.recorded, *also])))
    interrupted, elapsed_s = False, 0.0
    failure: UserError | None = None
    lead = plan.lead if execution.processes else IN_STEP
    stage_inputs(plan.stages, plan.parameters, plan.played)  # refuses a plan before anything is started
    with ros_domain(execution.domain):
        if execution.domain != "free":
            _refuse_company(plan)
        with Interruption() as interruption, Ensemble(members_of(plan), execution.processes) as ensemble:
            graph = ensemble.graph
            conductor = graph.add(Conductor(plan, in_steps=True, context=graph.context))
            wait = _waiter(ensemble, conductor, interruption, execution.timeout_s)
            with tqdm(total=plan.dwells, unit="dwell", desc=plan.bag.parent.name) as progress:

                def reached(lead: Lead) -> bool:
                    nonlocal elapsed_s
                    elapsed_s = time.monotonic() - begun
                    progress.update(conductor.played - progress.n)
                    return conductor.caught_up(lead)

                try:
                    wait(conductor.ready, "all nodes to be ready")
                    begun = time.monotonic()
                    while conductor.step(wait):
                        wait(lambda: reached(lead), f"what was played from dwell {progress.n} on to be processed")
                        progress.set_postfix_str(conductor.drops())
                    wait(lambda: reached(IN_STEP) and conductor.told, "the last dwells to be processed")
                except KeyboardInterrupt:
                    interrupted = True
                except UserError as error:
                    failure = error
    return Outcome(conductor.final_accounts(), conductor.played, interrupted, failure, elapsed_s)


def _waiter(
    ensemble: Ensemble, conductor: Conductor, interruption: Interruption, timeout_s: float
) -> Callable[[Callable[[], bool], str], None]:
    """Make a function that spins the graph until a condition holds, which it is told with words for it.

    The function raises UserError if the run cannot go on, and KeyboardInterrupt if the user has interrupted.
    """

    def wait(condition: Callable[[], bool], what: str) -> None:
        began, due = time.monotonic(), 0.0

        def reached() -> bool:
            nonlocal due
            now = time.monotonic()
            if not conductor.take_news() and now < due:
                return False
            due = now + LOOK_PERIOD_S
            interruption.check()
            ensemble.check()
            conductor.check()
            if condition():
                return True
            if now - max(began, conductor.last_progress) > timeout_s:
                raise UserError(
                    f"No node has made progress for {timeout_s:g} s while waiting for {what}; the log above may say "
                    "why."
                )
            return False

        if not ensemble.graph.spin_until(reached):
            raise UserError(f"ROS was shut down while waiting for {what}.")

    return wait


def members_of(plan: Plan) -> list[Member]:
    """The nodes of a plan, in the order in which they end: the recorder first and the source last.

    The recorder leaves parameters out unless the plan says otherwise: they are in its custom data.
    """
    topics = [f"/{topic}" for topic in plan.on_wire(plan.recorded)]
    time_source = {"use_sim_time": True} if plan.simulated_time else {}
    custom_data = [f"{name}={text}" for name, text in plan.custom_data.items()]
    recording: dict[str, Any] = {"directory": str(plan.bag), "topics": topics, "node_parameters": False}
    if custom_data:
        recording["custom_data"] = custom_data
    recording |= plan.parameters.get(RECORDER, {})
    others = {name: plan.parameters.get(name, {}) for name in [*reversed(plan.stages), plan.source]}
    return [
        Member(RECORDER, parameters={**recording, **time_source}),  # which is told the names as they are published
        *(Member(name, "", {**values, **time_source}, plan.remapped) for name, values in others.items()),
    ]


def _refuse_company(plan: Plan) -> None:
    """Look for other sensors as long as it takes to discover them.

    Raises:
        UserError: there is one.
    """
    with Graph() as graph:
        conductor = graph.add(Conductor(plan, context=graph.context))

        def found() -> bool:
            conductor.refuse_company(own=0)
            return False

        graph.spin_until(found, COMPANY_TIMEOUT_S)
