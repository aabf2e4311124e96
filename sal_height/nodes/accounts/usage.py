"""Text that the executable of a node prints for --help, and refusals of arguments that it does not know."""

from __future__ import annotations

import inspect
import sys
import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rclpy.node import Node
from rclpy.utilities import remove_ros_args

from sal_height.errors import UserError
from sal_height.nodes.accounts.account import DIAGNOSTICS, PROGRESS
from sal_height.nodes.managed import Managed
from sal_height.nodes.worker import WorkerNode
from sal_height.settings import settings_of, unknown_name
from sal_height.topics import LOSSES

ACCOUNTS = {
    DIAGNOSTICS: "message counts and state of the node",
    PROGRESS: "the counts as numbers, also after every piece of work, made while somebody subscribes",
}

LEFT_OUT = {LOSSES: "what the node leaves out, one message for each loss, and each of its resets"}

LIFE_CYCLE = {"~/change_state": "life cycle, as by ros2 lifecycle; the node publishes it on ~/transition_event"}

QOS = """The parameters qos_overrides./TOPIC.subscription.POLICY and qos_overrides./TOPIC.publisher.POLICY set the
quality of service of a topic; POLICY is history, depth, reliability or durability."""


def usage(node: type[Any], program: str) -> str:
    """Description of a node, its topics, and its parameters with units and allowed values.

    Args:
        node: class of the node, with attributes `inputs`, `outputs`, `answers` and `parameters`.
        program: name of its executable.
    """
    parameters = settings_of(node.parameters).values()
    losses = LEFT_OUT if issubclass(node, WorkerNode) else {}
    example = next(iter(parameters)).name
    sections = [
        f"usage: {program} [--ros-args -p {example}:=VALUE --params-file FILE -r TOPIC:=OTHER …]",
        inspect.getdoc(node) or "",
        _listed("Topics that the node subscribes to:", node.inputs),
        _listed("Topics that it publishes:", {**node.outputs, **losses, **ACCOUNTS}),
        _listed("Services that it offers:", {**node.answers, **(LIFE_CYCLE if issubclass(node, Managed) else {})}),
        "Parameters (-p NAME:=VALUE):",
        *(
            _entry(
                f"{entry.name} = {_shown(entry.default)}",
                f"{entry.text}; {entry.allowed}{'; set at the start only' if entry.read_only else ''}",
            )
            for entry in parameters
        ),
        QOS,
    ]
    return "\n\n".join(section for section in sections if section) + "\n"


def check_arguments(arguments: list[str]) -> None:
    """Refuse arguments that are not those of ROS, which would otherwise have no effect.

    Raises:
        UserError: there is one.
    """
    if others := remove_ros_args(arguments)[1:]:
        raise UserError(
            f"Argument {others[0]!r} is not known; parameters are set by --ros-args -p NAME:=VALUE (see --help)."
        )


def check_overrides(node: Node) -> None:
    """Refuse parameters that were given a value and do not exist, which would otherwise have no effect.

    Raises:
        UserError: there is one.
    """
    given = node._parameter_overrides  # noqa: SLF001 (rclpy has no other access to them)
    unknown = [name for name in given if not node.has_parameter(name)]
    if unknown:
        names = sorted(node.list_parameters([], 0).names)
        own = [name for name in names if not name.startswith("qos_overrides.")]
        known = names if unknown[0].startswith("qos_overrides.") else own
        raise UserError(unknown_name(unknown[0], known, f"Node {node.get_name()}"))


def announce(node: Node) -> None:
    """Report in the log what the node waits for."""
    topics: list[str] = getattr(node, "silent_topics", list)()
    if topics:
        node.get_logger().info(f"Waiting for messages on {', '.join(topics)}.")


def program_name() -> str:
    """Name of the program that runs."""
    return Path(sys.argv[0]).name


def _listed(title: str, topics: Mapping[str, str]) -> str:
    return "\n".join([title, *(f"  {topic}: {text}" for topic, text in topics.items())]) if topics else ""


def _entry(title: str, text: str) -> str:
    return f"  {title}\n" + textwrap.fill(text, 100, initial_indent="      ", subsequent_indent="      ")


def _shown(value: Any) -> str:
    return repr(value) if isinstance(value, str) else str(value).lower() if isinstance(value, bool) else f"{value}"
