"""The nodes of a run: how they are started and ended."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from itertools import chain
from types import TracebackType
from typing import Any, Self

from rclpy.parameter import Parameter

from sal_height.errors import UserError
from sal_height.nodes.graph import Graph
from sal_height.nodes.program import run_node
from sal_height.runs.catalogue import NODES
from sal_height.runs.processes import (
    ONE_THREAD,
    Child,
    Forked,
    adopted_from,
    can_fork,
    end_with_parent,
    has_one_thread,
    name_process,
)

STARTER = "sal_height.runs.starter"
"""Program that starts nodes in copies of itself."""

ADOPTED_S = 1e-3
"""Time between two looks whether a node has been adopted."""


@dataclass(frozen=True)
class Member:
    """A node of an ensemble.

    Attributes:
        name: of the node, unlike that of every other one.
        kind: which one of NODES it is; empty: the one of its name.
        parameters: values by name; all others have their defaults.
        remappings: other names of its topics and services, by their own.
        namespace: before its relative names; empty: none.
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


class Ensemble:
    """The nodes of a run, all in this process or each in its own, and a graph beside them; a context manager.

    At the end the first one is ended first.

    Attributes:
        members: the nodes by name.
        graph: context and executor of this process; once it is entered.
    """

    def __init__(self, members: Iterable[Member], processes: bool) -> None:
        """Choose the nodes; they are started on entering."""
        self.members = {member.name: member for member in members}
        self.graph: Graph
        self._separate = processes
        self._processes: dict[str, subprocess.Popen[bytes] | Child] = {}

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
        self._processes[name] = _begun_anew(self.members[name])

    def __enter__(self) -> Self:
        """Start the nodes; if one cannot be, none is left.

        Those in processes come before the graph, whose threads would be in the way of `Forked`.

        Raises:
            UserError: a node refuses its parameters, or its process cannot be started.
        """
        with ExitStack() as on_failure:
            on_failure.callback(self._end_processes)
            if self._separate:
                self._start_processes()
            self.graph = on_failure.enter_context(Graph())
            if not self._separate:
                for member in self.members.values():
                    overrides = [Parameter(key, value=value) for key, value in member.parameters.items()]
                    self.graph.add(
                        member.node(context=self.graph.context, parameter_overrides=overrides, cli_args=member.names)
                    )
            self._at_end = on_failure.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._at_end.close()

    def _start_processes(self) -> None:
        """Start each node in a copy of this process or, if it cannot be copied, of a new one that imports for all."""
        members = self.members.values()
        if can_fork():
            for member in members:
                self._processes[member.name] = copy_for(member, os.getpid())
        elif has_one_thread(ONE_THREAD | os.environ):
            said = json.dumps([asdict(member) for member in members])
            try:
                processes = adopted_from([sys.executable, "-m", STARTER, str(os.getpid()), said])
            except OSError as error:
                raise UserError(f"Nodes cannot be started in processes of their own: {error.strerror}.") from error
            self._processes.update(zip(self.members, processes, strict=True))
        else:
            for member in members:
                self._processes[member.name] = _begun_anew(member)

    def _end_processes(self) -> None:
        """Send SIGTERM, and give time to finish what is held."""
        for process in self._processes.values():
            if process.poll() is None:
                process.terminate()
            try:
                process.wait(30.0)
            except subprocess.TimeoutExpired:
                process.kill()


def copy_for(member: Member, parent: int) -> Forked:
    """Start a node in a copy of this process.

    Args:
        member: the node.
        parent: number of the process with which it ends: this one, or one that adopts it as soon as this one ends.

    Raises:
        UserError: it cannot be started.
    """
    starter = os.getpid()

    def run() -> int:
        while os.getppid() == starter != parent:
            time.sleep(ADOPTED_S)
        return _run(member.kind or member.name, parent, member.arguments)

    try:
        return Forked(run, member.name)
    except OSError as error:
        raise _not_started(member, error) from error


def _begun_anew(member: Member) -> subprocess.Popen[bytes]:
    """Start a node in a new process.

    Raises:
        UserError: it cannot be started.
    """
    own = [member.name, member.kind or member.name, str(os.getpid()), *member.arguments]
    try:
        command = [sys.executable, "-m", __name__, *own]
        return subprocess.Popen(command, process_group=0, env=ONE_THREAD | os.environ)  # noqa: S603 (our nodes)
    except OSError as error:
        raise _not_started(member, error) from error


def _not_started(member: Member, error: OSError) -> UserError:
    return UserError(f"Node {member.name} cannot be started in a process of its own: {error.strerror}.")


def _run(kind: str, parent: int, arguments: list[str]) -> int:
    """Run a node until the process `parent`, which started this one, ends, even if it is killed.

    Those that complete a file are then asked to end; the others hold nothing that anybody waits for. What a node waits
    for is not said in its log, for all others of the run are coming up.
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
