"""The nodes of a run: how they are started and ended."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from contextlib import ExitStack
from types import TracebackType
from typing import Any, Self

from rclpy.parameter import Parameter

from sal_height.errors import UserError
from sal_height.nodes.graph import Graph
from sal_height.nodes.program import run_node
from sal_height.runs.catalogue import NODES, NodeParameters
from sal_height.runs.processes import ONE_THREAD, Forked, can_fork, end_with_parent


class Ensemble:
    """The nodes of a run, all in this process or each in its own, and a graph beside them; a context manager.

    At the end the recorder is ended first and the source last.

    Attributes:
        graph: context and executor of this process; once it is entered.
    """

    def __init__(self, names: list[str], parameters: NodeParameters, processes: bool) -> None:
        """Choose the nodes `names` and their parameters; they are started on entering."""
        self.graph: Graph
        self._parameters = {name: parameters.get(name, {}) for name in names}
        self._separate = processes
        self._processes: dict[str, subprocess.Popen[bytes] | Forked] = {}

    def check(self) -> None:
        """Make sure that all processes still run.

        Raises:
            UserError: one has ended.
        """
        for name, process in self._processes.items():
            if process.poll() is not None:
                raise UserError(f"Node {name} ended with status {process.returncode}; its message is above.")

    def __enter__(self) -> Self:
        """Start the nodes; if one cannot be, none is left.

        Those in processes come before the graph, whose threads would be in the way of `Forked`.

        Raises:
            UserError: a node refuses its parameters, or its process cannot be started.
        """
        with ExitStack() as on_failure:
            on_failure.callback(self._end_processes)
            if self._separate:
                forks = can_fork()
                for name, values in self._parameters.items():
                    self._processes[name] = _process_of(name, values, forks)
            self.graph = on_failure.enter_context(Graph())
            if not self._separate:
                for name, values in self._parameters.items():
                    overrides = [Parameter(key, value=value) for key, value in values.items()]
                    self.graph.add(NODES[name](context=self.graph.context, parameter_overrides=overrides))
            self._at_end = on_failure.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._at_end.close()

    def _end_processes(self) -> None:
        """Send SIGTERM, and give time to finish what is held."""
        for process in self._processes.values():
            if process.poll() is None:
                process.terminate()
            try:
                process.wait(30.0)
            except subprocess.TimeoutExpired:
                process.kill()


def _process_of(name: str, values: Mapping[str, Any], forks: bool) -> subprocess.Popen[bytes] | Forked:
    """Start a node in a process of its own; parameter values in YAML, of which JSON is a part.

    Args:
        name: of the node.
        values: of its parameters.
        forks: whether the process goes on with what this one has imported and computed, or begins anew.

    Raises:
        UserError: it cannot be started.
    """
    words = [word for key, value in values.items() for word in ("-p", f"{key}:={json.dumps(value)}")]
    arguments, parent = ["--ros-args", *words], os.getpid()
    try:
        if forks:
            return Forked(lambda: _run(name, parent, arguments), name)
        command = [sys.executable, "-m", __name__, name, str(parent), *arguments]
        return subprocess.Popen(command, process_group=0, env=ONE_THREAD | os.environ)  # noqa: S603 (our nodes)
    except OSError as error:
        raise UserError(f"Node {name} cannot be started in a process of its own: {error.strerror}.") from error


def _run(name: str, parent: int, arguments: list[str]) -> int:
    """Run a node until the process `parent`, which started this one, ends, even if it is killed.

    Those that complete a file are then asked to end; the others hold nothing that anybody waits for. What a node waits
    for is not said in its log, for all others of the run are coming up.
    """
    if not end_with_parent(parent, signal.SIGTERM if NODES[name].completes_file else signal.SIGKILL):
        return 1
    sys.argv[1:] = arguments
    return run_node(NODES[name], begin=lambda _: None)


def main() -> int:
    """Run the node argv[1] until process argv[2], which started this one, ends."""
    return _run(sys.argv[1], int(sys.argv[2]), sys.argv[3:])


if __name__ == "__main__":
    raise SystemExit(main())
