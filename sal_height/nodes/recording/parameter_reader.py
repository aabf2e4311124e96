"""The parameters of all nodes of a graph, as events: those at the start, and all changes."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.client import Client
from rclpy.node import Node
from rclpy.serialization import serialize_message
from rclpy.task import Future

from sal_height.bag.described import PARAMETER_EVENTS, after
from sal_height.messages import BrokenMessage, deserialize, serialize, to_stamp
from sal_height.messages.types import Parameter, ParameterEvent, ParameterValue
from sal_height.nodes.transport.callbacks import guarded
from sal_height.nodes.transport.endpoints import NAMELESS

ASK_PERIOD_S = 0.5
"""Period at which new nodes are looked for, s."""

ANSWER_S = 2.0
"""Time, s, after which a silent node is asked again: an answer is lost if it does not know its client yet."""

MOST_NODES = 1000
"""Greatest number of nodes whose parameters are asked for and kept."""

MOST_BYTES = 1_000_000
"""Greatest size of the serialized parameters of a node that are kept, bytes."""


class ParameterReader:
    """Asks every node once for all its parameters; one that is started again is asked again."""

    def __init__(self, node: Node, tell: Callable[[bytes], None], fail: Callable[[Exception], None]) -> None:
        """Ask on behalf of `node`.

        Args:
            node: node that asks.
            tell: callback for an answer, which is a serialized event of new parameters.
            fail: callback for an error in an answer.
        """
        self._node, self._tell, self._fail = node, tell, fail
        self._questions: dict[bytes, _Question] = {}
        """Questions by the identity of the publisher of parameter events that each node has."""
        self._known: dict[str, ParameterEvent] = {}

    def look(self) -> None:
        """Ask the nodes that have appeared since the last time and those that could not answer then."""
        own = self._node.get_fully_qualified_name()
        nodes = {
            bytes(info.endpoint_gid): f"{info.node_namespace.rstrip('/')}/{info.node_name}"
            for info in self._node.get_publishers_info_by_topic(PARAMETER_EVENTS)
            if not info.node_name.startswith(NAMELESS)  # its name arrives later than its publisher
        }
        for identity in self._questions.keys() - nodes.keys():
            self._questions.pop(identity).end()
        for identity, name in nodes.items():
            if name != own and identity not in self._questions and len(self._questions) < MOST_NODES:
                self._questions[identity] = _Question(self._node, name, self._tell, self._fail)
        for question in self._questions.values():
            question.ask()

    def take(self, cdr: bytes) -> tuple[str, bytes] | None:
        """Read a serialized event; returns its node, and a serialized event of all that is known of it now."""
        try:
            event = deserialize(cdr, ParameterEvent)
        except BrokenMessage:
            return None
        known = after(self._known.get(event.node), event)
        whole = serialize(known)
        if len(whole) > MOST_BYTES or (event.node not in self._known and len(self._known) == MOST_NODES):
            return None
        self._known[event.node] = known
        return event.node, whole


class _Question:
    """A node is asked for the names of its parameters, and then for their values."""

    def __init__(self, node: Node, name: str, tell: Callable[[bytes], None], fail: Callable[[Exception], None]) -> None:
        self._node, self._name, self._tell, self._fail = node, name, tell, fail
        self._names = node.create_client(ListParameters, f"{name}/list_parameters")
        self._values = node.create_client(GetParameters, f"{name}/get_parameters")
        self._clients: list[Client] = [self._names, self._values]
        self._is_answered = False
        self._asked_at = -math.inf

    def ask(self) -> None:
        """Ask when the node can answer, and again if it does not; end once it has."""
        now = time.monotonic()
        if self._is_answered:
            self.end()
        elif now - self._asked_at > ANSWER_S and all(client.service_is_ready() for client in self._clients):
            self._asked_at = now
            self._names.call_async(ListParameters.Request()).add_done_callback(guarded(self._take_names, self._fail))

    def end(self) -> None:
        """Ask no more."""
        for client in self._clients:
            self._node.destroy_client(client)
        self._clients = []

    def _take_names(self, answer: Future) -> None:
        names = list(answer.result().result.names)
        values = self._values.call_async(GetParameters.Request(names=names))
        values.add_done_callback(guarded(lambda answer: self._take_values(names, answer), self._fail))

    def _take_values(self, names: list[str], answer: Future) -> None:
        if self._is_answered:  # it was asked twice
            return
        stamp = to_stamp(self._node.get_clock().now().nanoseconds)
        values = [deserialize(serialize_message(value), ParameterValue) for value in answer.result().values]
        found = zip(names, values, strict=False)  # a node may answer what it likes
        event = ParameterEvent(node=self._name, stamp=stamp)
        event.new_parameters = [Parameter(name=name, value=value) for name, value in found]
        self._is_answered = True
        self._tell(serialize(event))
