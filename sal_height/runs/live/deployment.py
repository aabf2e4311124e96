"""Nodes that are started for a sensor, with their parameters and names, as stated in a YAML file.

Nothing here brings NumPy with it: how many threads that may use depends on the file.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator

from sal_height.configuration import StrictKeys, read_yaml, validated


def _nothing_is_empty(value: Any) -> Any:
    return {} if value is None else value


Values = Annotated[dict[str, Any], BeforeValidator(_nothing_is_empty)]
Names = Annotated[dict[str, str], BeforeValidator(_nothing_is_empty)]


@dataclass(frozen=True)
class NodeEntry(StrictKeys):
    """A node of a deployment.

    Attributes:
        node: key in NODES; empty: the name.
        parameters: values by name.
        remap: other names of its topics, by their own.
        namespace: namespace of this node, instead of that of all.
    """

    node: str = ""
    parameters: Values = field(default_factory=dict)
    remap: Names = field(default_factory=dict)
    namespace: str | None = None


@dataclass(frozen=True)
class Deployment(StrictKeys):
    """The nodes that are started together.

    Attributes:
        nodes: nodes by name.
        namespace: namespace of all nodes that have none of their own; empty: no namespace.
        one_process: True if all are in one process instead of one each.
    """

    nodes: dict[str, Annotated[NodeEntry, BeforeValidator(_nothing_is_empty)]]
    namespace: str = ""
    one_process: bool = False


def load_deployment(path: Path) -> Deployment:
    """The deployment in a YAML file; `deployed_nodes.members_of` checks whether its nodes are allowed.

    Raises:
        UserError: it cannot be read, is no YAML, or has a key that is missing, unknown or of another type.
    """
    unreadable = f"Configuration {path} cannot be read; it must be a YAML file that lists nodes (see docs/live.md)."
    return validated(Deployment, read_yaml(path, f"Configuration {path}", unreadable), f"Configuration {path}")
