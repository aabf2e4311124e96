"""Start and end of the nodes of a run."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from itertools import chain
from types import TracebackType
from typing import Any, Self

from rclpy.parameter import Parameter

from sal_height.errors import UserError
from sal_height.graph.node_classes import NODES
from sal_height.graph.plan import RECORDER, Plan
from sal_height.graph.processes import ONE_THREAD, Forked, can_fork, end_with_parent, name_process
from sal_height.nodes.program import run_node
from sal_height.nodes.transport.graph import Graph


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
    """The nodes of a run, all in this process or each in its own, with a graph of this process; a context manager.

    At the end the first one is ended first.

    Attributes:
        members: nodes by name.
        graph: context and executor of this process; once it is entered.
    """

    def __init__(self, members: Iterable[Member], processes: bool) -> None:
        """Choose the nodes; they are started on entering."""
        self.members = {member.name: member for member in members}
        self.graph: Graph
        self.nodes: dict[str, Any] = {}
        """The nodes of this process, by name."""
        self._separate = processes
        self._processes: dict[str, subprocess.Popen[bytes] | Forked] = {}

    def ended(self) -> dict[str, int]:
        """Exit statuses of the processes that have ended, by the name of their node."""
        statuses = {name: process.poll() for name, process in self._processes.items()}
        return {name: status for name, status in statuses.items() if status is not None}

    def check(self) -> None:
        """Make sure that all processes still run.

        Raises:
            UserError: one has ended.
        """
        for name, status in self.ended().items():
            raise UserError(f"Node {name} ended with status {status}; its message is above.")

    def start_again(self, name: str) -> None:
        """Start a node whose process has ended in a new one.

        Raises:
            UserError: it cannot be started.
        """
        self._processes[name] = _process_of(self.members[name], forks=False)

    def __enter__(self) -> Self:
        """Start the nodes; if one cannot be, none is left.

        Those in processes start before the graph, whose threads would prevent `Forked`.

        Raises:
            UserError: a node refuses its parameters, or its process cannot be started.
        """
        with ExitStack() as on_failure:
            on_failure.callback(self._end_processes)
            if self._separate:
                forks = can_fork()
                for name, member in self.members.items():
                    self._processes[name] = _process_of(member, forks)
            self.graph = on_failure.enter_context(Graph())
            if not self._separate:
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
        for process in self._processes.values():
            if process.poll() is None:
                process.terminate()
            try:
                process.wait(30.0)
            except subprocess.TimeoutExpired:
                process.kill()


def _process_of(member: Member, forks: bool) -> subprocess.Popen[bytes] | Forked:
    """Start a node in a process of its own.

    Args:
        member: node to start.
        forks: True if the process goes on with what this one has imported and computed; else it starts without.

    Raises:
        UserError: it cannot be started.
    """
    kind, parent, arguments = member.kind or member.name, os.getpid(), member.arguments
    try:
        if forks:
            return Forked(lambda: _run(kind, parent, arguments), member.name)
        command = [sys.executable, "-m", __name__, member.name, kind, str(parent), *arguments]
        return subprocess.Popen(command, process_group=0, env=ONE_THREAD | os.environ)  # noqa: S603 (our nodes)
    except OSError as error:
        raise UserError(f"Node {member.name} cannot be started in a process of its own: {error.strerror}.") from error


def _run(kind: str, parent: int, arguments: list[str]) -> int:
    """Run a node until the process `parent`, which started this one, ends, even if it is killed.

    Those that complete a file are then asked to end; the others have nothing to finish. What a node waits
    for is not reported in its log, for all others of the run are starting.
    """
    if not end_with_parent(parent, signal.SIGTERM if NODES[kind].completes_file else signal.SIGKILL):
        return 1
    sys.argv[1:] = arguments
    return run_node(NODES[kind], begin=lambda _: None)


def main() -> int:
    """Run a node of the kind argv[2] as argv[1], until process argv[3], which started this one, ends."""
    name_process(sys.argv[1])
    return _run(sys.argv[2], int(sys.argv[3]), sys.argv[4:])


if __name__ == "__main__":
    raise SystemExit(main())
