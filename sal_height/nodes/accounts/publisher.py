"""Publishers of the account of a node: its numbers on /progress, and these with its state on /diagnostics."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any, NamedTuple

from rclpy._rclpy_pybind11 import RCLError
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node

from sal_height.messages import to_stamp
from sal_height.messages.types import DiagnosticArray, DiagnosticStatus, Header, NodeAccount
from sal_height.nodes.accounts.account import DIAGNOSTICS, PROGRESS, Account
from sal_height.nodes.transport.message_types import class_of, publish


class State(NamedTuple):
    """State of a node in the terms of the diagnostics.

    Attributes:
        level: level of DiagnosticStatus.
        message: reason for the level, in a few words.
        hardware_id: name of the sensor that it works for; empty: none yet.
    """

    level: Any
    message: str
    hardware_id: str = ""


class AccountPublisher:
    """The publishers of the account of a node. Once the context has ended, nothing is published, and nothing fails."""

    def __init__(self, node: Node, on_match: Callable[[Any], None]) -> None:
        """Make the publishers; `on_match` is called when a subscription to one of them appears or disappears."""
        self._node, self._name = node, node.get_fully_qualified_name().lstrip("/")
        matched = PublisherEventCallbacks(matched=on_match)
        self._diagnostics, self._progress = (
            node.create_publisher(class_of(kind), topic, 10, event_callbacks=matched)
            for kind, topic in ((DiagnosticArray, DIAGNOSTICS), (NodeAccount, PROGRESS))
        )

    @property
    def followers(self) -> int:
        """Number of subscribers to /progress, which follow every piece of work."""
        return int(self._progress.get_subscription_count())

    def publish(self, current: Callable[[], tuple[Account, State]]) -> None:
        """Publish what `current` returns on both topics."""
        with suppress(RCLError):
            account, state = current()
            publish(self._diagnostics, self.diagnostics(account, state))
            publish(self._progress, account.to_message(self._name, self._now_ns))

    def publish_counts(self, counts: Callable[[], Account]) -> None:
        """Publish what `counts` returns on /progress, if somebody follows."""
        with suppress(RCLError):
            if self.followers:
                publish(self._progress, counts().to_message(self._name, self._now_ns))

    def diagnostics(self, account: Account, state: State) -> DiagnosticArray:
        """Account and state as a message."""
        level, message, hardware_id = state
        values = account.to_values()
        status = DiagnosticStatus(level=level, name=self._name, message=message, hardware_id=hardware_id, values=values)
        return DiagnosticArray(header=Header(stamp=to_stamp(self._now_ns)), status=[status])

    @property
    def _now_ns(self) -> int:
        """The time of the node's clock, ns."""
        return int(self._node.get_clock().now().nanoseconds)
