"""Start and end of the nodes of a run, and the questions that a run asks of its sensor."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from itertools import chain
from types import TracebackType
from typing import Any, Self

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.task import Future
from std_srvs.srv import Trigger

from sal_height.engine.air import AIR_PARAMETERS
from sal_height.errors import UserError
from sal_height.graph.catalogue import stage_inputs
from sal_height.graph.node_classes import NODES
from sal_height.graph.plan import RECORDER, UNCOUNTED, Plan, Processes
from sal_height.nodes.accounts.account import DIAGNOSTICS, OTHER, Account
from sal_height.nodes.processing import PROCESSING, rank
from sal_height.nodes.program import run_host, run_node
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.message_types import class_of
from sal_height.nodes.transport.qos import FRAMES_QOS
from sal_height.topics import ODOMETRY
from sal_height.workers.processes import ONE_THREAD, Forked, can_fork, end_with_parent, name_process


class Conductor(Node):
    """Reads the accounts of all nodes, and asks the source to start.

    Attributes:
        accounts: accounts of the nodes of the plan, by name.
    """

    def __init__(self, plan: Plan, **node_arguments: Any) -> None:
        """Conduct the nodes of a plan; `node_arguments` go to rclpy's Node.

        Raises:
            UserError: a stage reads heights that no other stage makes.
        """
        super().__init__("conductor", **node_arguments)
        self.accounts: dict[str, Account] = {}
        inputs = stage_inputs(plan.stages, plan.parameters, plan.played)
        self._inputs = {plan.source: "", **dict(zip(inputs, plan.on_wire(inputs.values()), strict=True))}
        self._recorded, self._played = plan.on_wire(plan.recorded), plan.on_wire(plan.played)
        taken = [topic for name in plan.stages for topic in (ODOMETRY, *AIR_PARAMETERS) if topic in NODES[name].inputs]
        self._samples = plan.on_wire(taken)
        self._begin = self.create_client(Trigger, f"{plan.source}/{NODES[plan.source].begin_service}")
        self._diagnostics = self.create_subscription(DiagnosticArray, DIAGNOSTICS, self._on_diagnostics, 100)

    def connected(self) -> bool:
        """True if every topic has its subscribers, as its publisher counts them: nothing will be lost.

        Raises:
            UserError: a topic to record is published by no node.
        """
        if not {*self._inputs, RECORDER} <= self.accounts.keys():
            return False
        offered = {topic: n for account in self.accounts.values() for topic, n in account.subscribers.items()}
        recorded = set(self._recorded) - set(UNCOUNTED)
        if unknown := sorted(recorded - offered.keys()):
            if not all(self.accounts[name].ready for name in self._inputs):
                return False  # an account may be older than the topics of its node
            raise UserError(f"No node of this run publishes topic {unknown[0]}; it has {', '.join(sorted(offered))}.")
        needed = Counter(topic for topic in self._inputs.values() if topic)
        needed.update([*(topic for topic in self._samples if topic in self._played), *recorded])
        alone = all(self.count_publishers(topic) == 1 for topic in self._played)
        return (
            alone and all(offered.get(topic, 0) >= n for topic, n in needed.items()) and self._begin.service_is_ready()
        )

    def ready(self) -> bool:
        """True if all nodes are connected, and have done what they do before the first dwell."""
        return self.connected() and all(self.accounts[name].ready for name in self._inputs)

    def stop_reading(self) -> None:
        """Read no more accounts: all nodes are ready."""
        self.destroy_subscription(self._diagnostics)

    def subscribe_raw(self, message_type: type, topic: str, receive: Callable[[bytes], None]) -> None:
        """Have the serialized messages of a topic received by `receive`."""
        self.create_subscription(class_of(message_type), topic, receive, FRAMES_QOS, raw=True)

    def ask(self) -> Future:
        """Ask the source to start; its answer is in the future."""
        return self._begin.call_async(Trigger.Request())

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            account = Account.of_status(status)
            if account.kind != OTHER and status.name in {*self._inputs, RECORDER}:
                self.accounts[status.name] = account


HOST = "live host"
"""Name of the process of all nodes of stages."""


@dataclass(frozen=True)
class Member:
    """A node of an ensemble.

    Attributes:
        name: name of the node, unlike that of every other one.
        kind: key in NODES; empty: the name.
        parameters: values by name; all others have their defaults.
        remappings: other names of its topics and services, by their own.
        namespace: prefix of its relative names; empty: no prefix.
    """

    name: str
    kind: str = ""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    remappings: Mapping[str, str] = field(default_factory=dict)
    namespace: str = ""

    @property
    def node(self) -> type[Any]:
        """Class of the node."""
        return NODES[self.kind or self.name]

    @property
    def names(self) -> list[str]:
        """Its name, namespace and remappings, as arguments of ROS."""
        own = {"__node": self.name, **({"__ns": self.namespace} if self.namespace else {})}
        rules = (("-r", f"{old}:={new}") for old, new in {**own, **self.remappings}.items())
        return ["--ros-args", *chain.from_iterable(rules)]

    @property
    def arguments(self) -> list[str]:
        """All that it is started with, as arguments of ROS; parameter values in YAML, of which JSON is a part."""
        values = (("-p", f"{key}:={json.dumps(value)}") for key, value in self.parameters.items())
        return [*self.names, *chain.from_iterable(values)]


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
        Member(RECORDER, parameters={**recording, **time_source}),  # subscribes to the names as they are published
        *(Member(name, "", {**values, **time_source}, plan.remapped) for name, values in others.items()),
    ]


class Ensemble:
    """The nodes of a run, in this process or in others, with a graph of this process; a context manager.

    At the end the first one is ended first.

    Attributes:
        members: nodes by name.
        processes: nodes of each process, by its name; none: all are in this one.
        graph: context and executor of this process; once it is entered.
    """

    def __init__(self, members: Iterable[Member], processes: Processes) -> None:
        """Choose the nodes; they are started on entering."""
        self.members = {member.name: member for member in members}
        self.processes = grouped(self.members.values(), processes)
        self.graph: Graph
        self.nodes: dict[str, Any] = {}
        """The nodes of this process, by name."""
        self._processes: dict[str, subprocess.Popen[bytes] | Forked] = {}

    def ended(self) -> dict[str, int]:
        """Exit statuses of the processes that have ended, by their names."""
        statuses = {name: process.poll() for name, process in self._processes.items()}
        return {name: status for name, status in statuses.items() if status is not None}

    def describe(self, process: str) -> str:
        """Description of a process in messages: its node, or the live host with its nodes."""
        names = ", ".join(member.name for member in self.processes[process])
        return f"The live host ({names})" if process == HOST else f"Node {names}"

    def check(self) -> None:
        """Make sure that all processes still run.

        Raises:
            UserError: one has ended.
        """
        for name, status in self.ended().items():
            raise UserError(f"{self.describe(name)} ended with status {status}; its message is above.")

    def start_again(self, process: str) -> None:
        """Start a process again that has ended.

        Raises:
            UserError: it cannot be started.
        """
        self._processes[process] = _started(process, self.processes[process], forks=False)

    def __enter__(self) -> Self:
        """Start the nodes; if one cannot be, none is left.

        Those in processes start before the graph, whose threads would prevent `Forked`.

        Raises:
            UserError: a node refuses its parameters, or its process cannot be started.
        """
        with ExitStack() as on_failure:
            on_failure.callback(self._end_processes)
            forks = can_fork()
            for name, members in self.processes.items():
                self._processes[name] = _started(name, members, forks)
            self.graph = on_failure.enter_context(Graph())
            if not self.processes:
                for member in self.members.values():
                    overrides = [Parameter(key, value=value) for key, value in member.parameters.items()]
                    self.nodes[member.name] = self.graph.add(
                        member.node(context=self.graph.context, parameter_overrides=overrides, cli_args=member.names)
                    )
            self._at_end = on_failure.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._at_end.close()

    def _end_processes(self) -> None:
        """Send SIGTERM, and allow time to finish what is in work."""
        for name, process in self._processes.items():
            if process.poll() is None:
                process.terminate()
            try:
                process.wait(30.0 * len(self.processes[name]))
            except subprocess.TimeoutExpired:
                process.kill()


def grouped(members: Iterable[Member], processes: Processes) -> dict[str, list[Member]]:
    """The nodes of each process by its name, in the order in which these end.

    Args:
        members: nodes, in the order in which they end.
        processes: processes that there are to be.
    """
    if processes == "one":
        return {}
    groups: dict[str, list[Member]] = {}
    for member in members:
        is_hosted = processes == "host" and (member.kind or member.name) in PROCESSING
        groups.setdefault(HOST if is_hosted else member.name, []).append(member)
    if HOST in groups:
        groups[HOST].sort(key=lambda member: rank(member.kind or member.name))
    return groups


def _started(process: str, members: Sequence[Member], forks: bool) -> subprocess.Popen[bytes] | Forked:
    """Start a process.

    Args:
        process: its name.
        members: its nodes.
        forks: True if the process goes on with what this one has imported and computed; else it starts without.

    Raises:
        UserError: it cannot be started.
    """
    parent = os.getpid()
    nodes = [(member.kind or member.name, member.arguments) for member in members]
    try:
        if forks:
            return Forked(lambda: _run(process, parent, nodes), process)
        command = [sys.executable, "-m", __name__, process, str(parent), json.dumps(nodes)]
        return subprocess.Popen(command, process_group=0, env=ONE_THREAD | os.environ)  # noqa: S603 (our nodes)
    except OSError as error:
        names = ", ".join(member.name for member in members)
        raise UserError(f"Node {names} cannot be started in a process of its own: {error.strerror}.") from error


def _run(process: str, parent: int, nodes: Sequence[tuple[str, list[str]]]) -> int:
    """Run nodes until the process `parent`, which started this one, ends, even if it is killed.

    Those that complete a file are then asked to end; the others have nothing to finish. What a node waits
    for is not reported in its log, for all others of the run are starting.
    """
    completes = any(NODES[kind].completes_file for kind, _ in nodes)
    if not end_with_parent(parent, signal.SIGTERM if completes else signal.SIGKILL):
        return 1
    if process == HOST:
        return run_host([(NODES[kind], own) for kind, own in nodes], sys.argv[:1], begin=lambda _: None)
    (kind, arguments), *_ = nodes
    sys.argv[1:] = arguments
    return run_node(NODES[kind], begin=lambda _: None)


def main() -> int:
    """Run nodes, as in argv[3], in a process of the name argv[1], until process argv[2], which started it, ends."""
    name_process(sys.argv[1])
    return _run(sys.argv[1], int(sys.argv[2]), json.loads(sys.argv[3]))


if __name__ == "__main__":
    raise SystemExit(main())
