"""Parameters of other nodes, as one node sets them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient

from sal_height.errors import UserError

ANSWER_S = 30.0
"""Longest time that a node may take to answer; it does so between two messages."""

LOOK_S = 0.05
"""Period at which it is looked whether the wait for an answer has become vain."""


class RemoteParameters:
    """Sets parameters of other nodes, from a thread beside the executor of the node that sets them."""

    def __init__(self, node: Node, names: Iterable[str]) -> None:
        """Be ready to set parameters of the nodes of these names, in the namespace of `node`."""
        self._clients = {name: AsyncParameterClient(node, name) for name in names}

    @property
    def are_ready(self) -> bool:
        """Whether all these nodes can be reached."""
        return all(client.services_are_ready() for client in self._clients.values())

    def set(self, name: str, values: Mapping[str, Any], is_over: Callable[[], bool]) -> None:
        """Set parameters of a node, all of them or none, and wait until it has them.

        Args:
            name: of the node.
            values: of the parameters, by name.
            is_over: whether the wait has become vain.

        Raises:
            UserError: the node does not answer, or refuses a value.
        """
        said = f"Node {name} was to get {', '.join(f'{key}={value!r}' for key, value in values.items())}, as in flight"
        answered = threading.Event()
        parameters = [_parameter(key, value) for key, value in values.items()]
        answer = self._clients[name].set_parameters_atomically(parameters, lambda _: answered.set())
        deadline = time.monotonic() + ANSWER_S
        while not answered.wait(LOOK_S):
            if is_over() or time.monotonic() > deadline:
                raise UserError(f"{said}, and does not answer.")
        result = answer.result().result
        if not result.successful:
            raise UserError(f"{said}, and refuses ({result.reason.rstrip('.') or 'it does not say why'}).")


def _parameter(name: str, value: Any) -> Parameter:
    """A parameter; rclpy cannot tell the type of an empty list, which is one of texts here."""
    return Parameter(name, Parameter.Type.STRING_ARRAY, []) if value == [] else Parameter(name, value=value)
