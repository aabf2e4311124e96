"""Publishers of the account of a node, on /progress and /diagnostics."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

from rclpy._rclpy_pybind11 import RCLError
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node

from sal_height.messages.types import DiagnosticArray, NodeAccount
from sal_height.nodes.accounts.account import DIAGNOSTICS, PROGRESS, Account
from sal_height.nodes.transport.message_types import class_of, publish


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

    def publish(self, current: Callable[[], Account]) -> None:
        """Publish what `current` returns on both topics, on /progress if somebody follows."""
        with suppress(RCLError):
            account = current()
            publish(self._diagnostics, self.diagnostics(account))
            if self.followers:
                publish(self._progress, account.to_progress(self._name, self._now_ns()))

    def publish_progress(self, current: Callable[[], Account]) -> None:
        """Publish what `current` returns on /progress, if somebody follows."""
        with suppress(RCLError):
            if self.followers:
                publish(self._progress, current().to_progress(self._name, self._now_ns()))

    def diagnostics(self, account: Account) -> DiagnosticArray:
        """The account as a message on /diagnostics, at the time of the node's clock."""
        return account.to_diagnostics(self._name, self._now_ns())

    def _now_ns(self) -> int:
        return int(self._node.get_clock().now().nanoseconds)
