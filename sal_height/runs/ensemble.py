"""The nodes of a run, in this process or each in its own."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from collections.abc import Mapping
from types import TracebackType
from typing import Any, Self

from rclpy.parameter import Parameter

from sal_height.errors import UserError
from sal_height.nodes.graph import Graph
from sal_height.nodes.ml_height import MlHeight
from sal_height.nodes.monopulse import Monopulse
from sal_height.nodes.player import Player
from sal_height.nodes.recorder import Recorder
from sal_height.nodes.sar_compression import SarCompression
from sal_height.nodes.simulator import Simulator

NODES: dict[str, Any] = {
    "simulator": Simulator,
    "player": Player,
    "sar_compression": SarCompression,
    "monopulse": Monopulse,
    "ml_height": MlHeight,
    "recorder": Recorder,
}
"""Every node by its name; a new estimator is entered here and in ESTIMATORS."""

ESTIMATORS = {"monopulse": "monopulse", "ml_height": "ml"}
"""Height nodes and the prefix of their topics."""

NodeParameters = Mapping[str, Mapping[str, Any]]
"""Parameter values by node name and parameter name."""

SETTABLE = ["sar_compression", *ESTIMATORS]
"""Nodes whose parameters users may set."""


def check_parameters(parameters: NodeParameters) -> None:
    """Make sure that every node and parameter named exists; the nodes themselves check the values.

    Raises:
        UserError: one does not.
    """
    for name, values in parameters.items():
        if name not in SETTABLE:
            raise UserError(f"There is no node {name!r} with parameters to set; allowed are {', '.join(SETTABLE)}.")
        known = [field.name for field in dataclasses.fields(NODES[name].parameters)]
        if unknown := [key for key in values if key not in known]:
            raise UserError(f"Node {name} has no parameter {unknown[0]!r}; allowed are {', '.join(known)}.")


class Ensemble:
    """The nodes of a run, either in this process or each in its own; ends them in the order of the data flow."""

    def __init__(self, graph: Graph, names: list[str], parameters: NodeParameters, processes: bool) -> None:
        """Start the nodes `names` with their parameters.

        Raises:
            UserError: a node refuses its parameters.
        """
        self._graph = graph
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        for name in names:
            values = parameters.get(name, {})
            if processes:
                self._processes[name] = subprocess.Popen(_command(name, values), start_new_session=True)  # noqa: S603 (our own nodes)
            else:
                overrides = [Parameter(key, value=value) for key, value in values.items()]
                graph.add(NODES[name](context=graph.context, parameter_overrides=overrides))

    def check(self) -> None:
        """Make sure that all processes still run.

        Raises:
            UserError: one has ended.
        """
        for name, process in self._processes.items():
            if process.poll() is not None:
                raise UserError(f"Node {name} ended with status {process.returncode}; its message is above.")

    def close(self) -> None:
        """End all nodes; those in processes get SIGTERM and have time to finish what they hold."""
        self._graph.close()
        for process in self._processes.values():
            if process.poll() is None:
                process.terminate()
            try:
                process.wait(30.0)
            except subprocess.TimeoutExpired:
                process.kill()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _command(name: str, values: Mapping[str, Any]) -> list[str]:
    """Command line of a node in a process of its own; parameter values in YAML, of which JSON is a part."""
    arguments = [word for key, value in values.items() for word in ("-p", f"{key}:={json.dumps(value)}")]
    return [sys.executable, "-m", f"sal_height.nodes.{name}", "--ros-args", *arguments]
