"""What a node tells of its work: its account as numbers on /progress, and beside its state on /diagnostics."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy._rclpy_pybind11 import RCLError
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from sal_height_msgs.msg import NodeAccount

from sal_height.nodes.account import DIAGNOSTICS, PROGRESS, Account


class State(NamedTuple):
    """How a node is, in the words of the diagnostics.

    Attributes:
        level: one of those of DiagnosticStatus.
        message: why, in a few words.
        hardware_id: the sensor that it works for; empty: none yet.
    """

    level: Any
    message: str
    hardware_id: str = ""


class Teller:
    """The publishers of a node's account. When the context ends meanwhile, nobody is told, and nothing fails."""

    def __init__(self, node: Node, on_match: Callable[[Any], None]) -> None:
        """Make the publishers; `on_match` is called when a subscription to one of them comes or goes."""
        self._node = node
        matched = PublisherEventCallbacks(matched=on_match)
        self._diagnostics = node.create_publisher(DiagnosticArray, DIAGNOSTICS, 10, event_callbacks=matched)
        self._progress = node.create_publisher(NodeAccount, PROGRESS, 10, event_callbacks=matched)

    @property
    def followers(self) -> int:
        """How many follow every piece of work."""
        return self._progress.get_subscription_count()

    def tell(self, told: Callable[[], tuple[Account, State]]) -> None:
        """Publish what `told` returns, which has all numbers, on both topics."""
        with suppress(RCLError):
            account, state = told()
            self._diagnostics.publish(self.diagnostics(account, state))
            self._progress.publish(account.to_message(self._node, whole=True))

    def tell_counts(self, counts: Callable[[], Account]) -> None:
        """Publish what `counts` returns, which are the numbers that a piece of work changes, if somebody follows."""
        with suppress(RCLError):
            if self.followers:
                self._progress.publish(counts().to_message(self._node, whole=False))

    def diagnostics(self, account: Account, state: State) -> DiagnosticArray:
        """Account and state as a message."""
        name = self._node.get_fully_qualified_name().lstrip("/")
        level, message, hardware_id = state
        values = account.to_values()
        status = DiagnosticStatus(level=level, name=name, message=message, hardware_id=hardware_id, values=values)
        array = DiagnosticArray(status=[status])
        array.header.stamp = self._node.get_clock().now().to_msg()
        return array
