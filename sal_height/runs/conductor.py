"""Running the graph in lockstep: the next dwell starts when every message of the last one is accounted for."""

from __future__ import annotations

import math
import signal
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any, Self

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from std_srvs.srv import Trigger
from tqdm import tqdm

from sal_height.errors import UserError
from sal_height.nodes.graph import Graph
from sal_height.nodes.player import INPUTS
from sal_height.runs.ensemble import CALIBRATOR, ESTIMATORS, HEIGHTS, Ensemble, NodeParameters, height_sources

UNWATCHED = ("diagnostics",)
"""Recorded topics that no stage counts the subscribers of."""

COMPANY_TIMEOUT_S = 0.5
"""How long to look for other sensors before anything is started."""

START_TIMEOUT_S = 30.0
DWELL_TIMEOUT_S = 120.0
"""Longest waits for the graph, and for the account of one dwell (one that misses something is dropped earlier)."""

STAGE_KEYS = ("in", "out", "waiting")
RECORDER_KEYS = ("unwritten",)
"""What the status of a stage and of the recorder have at least; one without is not ours."""

Wait = Callable[[Callable[[], bool], float, str], None]
"""Waits until a condition holds, at most that many seconds, for what the words say; UserError if in vain."""


@dataclass(frozen=True)
class Outcome:
    """What a run did.

    Attributes:
        stages: account of every stage by node name (see Tally.summary).
        dwells: dwells that were played.
        interrupted: True if the user stopped the run.
        failure: why the run ended early, if not for the user.
    """

    stages: dict[str, dict[str, float]]
    dwells: int
    interrupted: bool
    failure: UserError | None = None


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
    """Watches the accounts of all stages on /diagnostics, and asks the source for dwells."""

    def __init__(
        self, source: str, stages: list[str], recorded: list[str], takes: Mapping[str, str], **node_arguments: Any
    ) -> None:
        """Conduct from node `source` through `stages` (sar_compression first) to a recorder of topics `recorded`.

        `takes` tells whose heights (a node of HEIGHTS) other stages take (`ensemble.height_sources`).
        """
        super().__init__("conductor", **node_arguments)
        self.accounts: dict[str, dict[str, float]] = {}
        self._source = source
        self._stages = stages
        self._takes = takes
        self._watched = {source, *stages, "recorder"}
        self._recorded = recorded
        self._steps = 0
        self._step = self.create_client(Trigger, f"{source}/step")
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 100)

    def connected(self) -> bool:
        """Whether every topic has its subscribers, as its publisher counts them: nothing will be lost."""
        consumers = Counter({"slc": sum(name in {*ESTIMATORS, CALIBRATOR} for name in self._stages)})
        consumers.update({"phase_history": 1, "platform/odometry": 1})
        consumers.update(f"{HEIGHTS[node]}/height" for node in self._takes.values())
        counts = {
            key.removeprefix("subscribers./"): count
            for account in self.accounts.values()
            for key, count in account.items()
            if key.startswith("subscribers.")
        }
        topics = {*consumers, *(topic for topic in self._recorded if topic not in UNWATCHED)}
        ready = all(counts.get(t, -1) >= consumers.get(t, 0) + (t in self._recorded) for t in topics)
        sole = all(self.count_publishers(topic) == 1 for topic in INPUTS)
        return ready and sole and self._step.service_is_ready() and self._watched <= self.accounts.keys()

    def check(self) -> None:
        """Make sure that the bag takes what comes, and that it comes from our source alone.

        Raises:
            UserError: messages could not be written, or somebody else publishes.
        """
        if lost := self.accounts.get("recorder", {}).get("unwritten"):
            raise UserError(f"{lost:.0f} messages could not be written to the bag; make room on its disk.")
        self.refuse_company(own=1)

    def refuse_company(self, own: int) -> None:
        """Make sure that nobody else publishes what a sensor does: two on one topic cannot be told apart.

        Args:
            own: how many publishers of each topic are ours.

        Raises:
            UserError: somebody does.
        """
        for topic in INPUTS:
            if self.count_publishers(topic) > own:
                whose = f"Somebody already publishes on /{topic} in this ROS domain"
                raise UserError(f"{whose}; stop them or set another ROS_DOMAIN_ID.")

    def step(self, wait: Wait) -> bool:
        """Ask for the next dwell; False when there is none.

        Raises:
            UserError: the source does not answer.
        """
        answer = self._step.call_async(Trigger.Request())
        wait(answer.done, START_TIMEOUT_S, f"an answer of node {self._source}")
        self._steps += answer.result().success
        return bool(answer.result().success)

    def settled(self) -> bool:
        """Whether all that was asked for has been published, accounted for in every stage, and recorded."""
        source, first = self.accounts[self._source], self.accounts[self._stages[0]]
        expected = dict.fromkeys(self._stages, first["out"]) | {
            self._source: self._steps,
            self._stages[0]: source["out"],
        }
        for name, node in self._takes.items():
            expected[name] = self.accounts[node]["out"]
        if any(
            self.accounts[name]["in"] != count or self.accounts[name]["waiting"] for name, count in expected.items()
        ):
            return False
        outputs = {"phase_history": source["out"]} | {
            f"{HEIGHTS[name]}/height": self.accounts[name]["out"] for name in self._stages if name in HEIGHTS
        }
        recorder = self.accounts["recorder"]
        return all(recorder.get(f"recorded./{t}", 0) == n for t, n in outputs.items() if t in self._recorded)

    def drops(self) -> str:
        """What the stages have dropped so far, in a few words."""
        return ", ".join(
            f"{name} {key.removeprefix('dropped.')}: {count:.0f}"
            for name, account in self.accounts.items()
            for key, count in account.items()
            if key.startswith("dropped.")
        )

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            numbers = {item.key: _number(item.value) for item in status.values}
            account = {key: number for key, number in numbers.items() if number is not None}
            expected = RECORDER_KEYS if status.name == "recorder" else STAGE_KEYS
            if status.name in self._watched and account.keys() >= set(expected):
                self.accounts[status.name] = account


def perform(
    source: str,
    stages: list[str],
    recorded: list[str],
    bag: Path,
    parameters: NodeParameters,
    dwells: int,
    processes: bool = False,
) -> Outcome:
    """Run the graph on all dwells of a source, in lockstep, and record it.

    What goes wrong once all nodes are started is in the outcome, together with the accounts up to then.

    Args:
        source: node name, "simulator" or "player".
        stages: node names from sar_compression on.
        recorded: topics to record, without leading slash.
        bag: folder of the new bag.
        parameters: of the nodes.
        dwells: how many to expect, for the progress bar.
        processes: each node in its own process.

    Raises:
        UserError: a node or the bag refuses its parameters, a stage takes heights that no other makes, or somebody else
            publishes frames.
    """
    takes = height_sources(stages, parameters)
    names = ["recorder", *reversed(stages), source]
    values = {**parameters, "recorder": {"directory": str(bag), "topics": [f"/{topic}" for topic in recorded]}}
    played, interrupted = 0, False
    failure: UserError | None = None
    with Graph() as graph:
        conductor = graph.add(Conductor(source, stages, recorded, takes, context=graph.context))
        _refuse_company(graph, conductor)
        with Interruption() as interruption, Ensemble(graph, names, values, processes) as ensemble:

            def wait(condition: Callable[[], bool], timeout_s: float, what: str) -> None:
                def reached() -> bool:
                    interruption.check()
                    ensemble.check()
                    conductor.check()
                    return condition()

                if not graph.spin_until(reached, timeout_s):
                    raise UserError(f"Waited {timeout_s:.0f} s for {what}, in vain; the log above says why.")

            with tqdm(total=dwells, unit="dwell", desc=bag.parent.name) as progress:
                try:
                    wait(conductor.connected, START_TIMEOUT_S, "the graph to come up")
                    while conductor.step(wait):
                        wait(conductor.settled, DWELL_TIMEOUT_S, f"the account of dwell {played}")
                        played += 1
                        progress.update()
                        progress.set_postfix_str(conductor.drops())
                except KeyboardInterrupt:
                    interrupted = True
                except UserError as error:
                    failure = error
    return Outcome({name: conductor.accounts.get(name, {}) for name in [source, *stages]}, played, interrupted, failure)


def _refuse_company(graph: Graph, conductor: Conductor) -> None:
    """Look for other sensors as long as it takes to discover them.

    Raises:
        UserError: there is one.
    """

    def found() -> bool:
        conductor.refuse_company(own=0)
        return False

    graph.spin_until(found, COMPANY_TIMEOUT_S)


def _number(text: str) -> float | None:
    """The finite number that a text stands for, if any."""
    try:
        number = float(text)
    except ValueError:
        return None
    return number if math.isfinite(number) else None
