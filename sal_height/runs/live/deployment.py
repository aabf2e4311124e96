"""Nodes that are started for a sensor, with parameters and names from a YAML file, and the check of both."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator

from sal_height.configuration import StrictKeys, read_yaml, validated
from sal_height.errors import UserError, did_you_mean
from sal_height.graph.catalogue import check_values
from sal_height.graph.ensemble import Member
from sal_height.graph.node_classes import NODES
from sal_height.nodes.accounts.account import DIAGNOSTICS, PROGRESS

NAME = r"[A-Za-z_]\w*"

OF_ROS: Mapping[str, type] = {"use_sim_time": bool, "start_type_description_service": bool}
"""Parameters that every node of ROS has, and the type of their values."""


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
        one_process: True if all are in one process.
        separate: True if each has a process of its own; else the stages have one together, with workers.
    """

    nodes: dict[str, Annotated[NodeEntry, BeforeValidator(_nothing_is_empty)]]
    namespace: str = ""
    one_process: bool = False
    separate: bool = False


def load_deployment(path: Path) -> Deployment:
    """The deployment in a YAML file; `members_of` checks whether its nodes are allowed.

    Raises:
        UserError: it cannot be read, is no YAML, or has a key that is missing, unknown or of another type.
    """
    unreadable = f"Configuration {path} cannot be read; it must be a YAML file that lists nodes (see docs/live.md)."
    return validated(Deployment, read_yaml(path, f"Configuration {path}", unreadable), f"Configuration {path}")


def members_of(deployment: Deployment) -> list[Member]:
    """The nodes of a deployment as an ensemble starts them: those that complete files end first.

    Raises:
        UserError: the deployment is empty, or a node, parameter, topic or name is not allowed.
    """
    if not deployment.nodes:
        raise UserError(f"There are no nodes; list at least one of {', '.join(NODES)}.")
    members = [_member(name, entry, deployment.namespace) for name, entry in deployment.nodes.items()]
    return sorted(members, key=lambda member: not member.node.completes_file)


def _member(name: str, entry: NodeEntry, common: str) -> Member:
    """A node; `common` is the namespace of nodes that have none of their own.

    Raises:
        UserError: a name, parameter or topic is not allowed.
    """
    kind = entry.node or name
    if kind not in NODES:
        raise UserError(f"There is no node {kind!r}{did_you_mean(kind, NODES)}; allowed are {', '.join(NODES)}.")
    if not re.fullmatch(NAME, name):
        raise UserError(f"Node name {name!r} is not allowed; it must be of letters, digits and underscores.")
    namespace = common if entry.namespace is None else entry.namespace
    if namespace and not re.fullmatch(rf"/?{NAME}(/{NAME})*", namespace):
        raise UserError(f"Node {name}: namespace is {namespace!r}; it must be of the form /aircraft/lidar.")
    for topic in entry.remap:
        _check_topic(name, topic, NODES[kind])
    absolute = f"/{namespace.removeprefix('/')}" if namespace else ""
    return Member(name, kind, _checked(name, kind, entry.parameters), entry.remap, absolute)


def _checked(name: str, kind: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """Parameter values of the declared types.

    Raises:
        UserError: a parameter does not exist, or its value is not allowed.
    """
    of_ros = {key: value for key, value in values.items() if key in OF_ROS or key.startswith("qos_overrides.")}
    for key, value in of_ros.items():
        if not isinstance(value, OF_ROS.get(key, (str, int))):
            allowed = "true or false" if key in OF_ROS else "a text or a whole number"
            raise UserError(f"Node {name}: parameter {key} is {value!r}; it must be {allowed}.")
    own = {key: value for key, value in values.items() if key not in of_ros}
    return {**check_values(name, NODES[kind].parameters, own), **of_ros}


def _check_topic(name: str, topic: str, node: type[Any]) -> None:
    """Refuse to rename a topic that a node does not have, which would have no effect.

    Raises:
        UserError: it has no such topic.
    """
    topics = [*node.inputs, *node.outputs, DIAGNOSTICS, PROGRESS]
    known = [re.sub(r"<\w+>", ".+", re.escape(entry)) for entry in topics]
    if not any(re.fullmatch(f"(/.*)?{pattern}", topic) for pattern in known):
        raise UserError(
            f"Node {name} has no topic {topic!r}{did_you_mean(topic, topics)}; allowed are {', '.join(topics)}."
        )
