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
        """Publish what `current` returns on both topics."""
        with suppress(RCLError):
            diagnostics, progress = self.messages(current())
            publish(self._diagnostics, diagnostics)
            publish(self._progress, progress)

    def publish_progress(self, current: Callable[[], Account]) -> None:
        """Publish what `current` returns on /progress, if somebody follows."""
        with suppress(RCLError):
            if self.followers:
                publish(self._progress, self.messages(current())[1])

    def messages(self, account: Account) -> tuple[DiagnosticArray, NodeAccount]:
        """The account as messages on /diagnostics and on /progress, at the time of the node's clock."""
        return account.to_messages(self._name, int(self._node.get_clock().now().nanoseconds))
