"""Watch the nodes of a graph that others run."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node

from sal_height.graph.account_book import AccountBook
from sal_height.graph.processes import Interruption
from sal_height.messages.types import DiagnosticArray
from sal_height.nodes.accounts.account import DIAGNOSTICS
from sal_height.nodes.transport.domain import LOOK_S, LOST, DomainChoice, Ports, ros_domain
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.message_types import subscribe


class Watcher(Node):
    """Reads the accounts of all nodes on /diagnostics.

    Attributes:
        book: accounts of the nodes.
        is_deaf: True if nothing more can arrive, since the process has lost a port of shared memory; reported once.
    """

    def __init__(self, book: AccountBook, **node_arguments: Any) -> None:
        """Enter messages into `book`; `node_arguments` go to rclpy's Node."""
        super().__init__("sal_height_watcher", **node_arguments)
        self.book = book
        self.is_deaf = False
        self._ports = Ports()
        subscribe(self, DiagnosticArray, DIAGNOSTICS, self._take, 100)
        self.create_timer(LOOK_S, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _take(self, message: DiagnosticArray) -> None:
        self.book.take(message, time.monotonic())

    def _look(self) -> None:
        if not self.is_deaf and (lost := self._ports.lost()):
            self.is_deaf = True
            how = "The nodes go on, unseen; end this program with Ctrl-C, and start it again."
            self.get_logger().error(f"{LOST.format(lost[0])} {how}")


def looks(graph: Graph, interruption: Interruption, seconds: float) -> Iterator[tuple[float, bool]]:
    """Spin a graph for a time; again and again, yields the time since the start, s, and whether it is time to show.

    Raises:
        KeyboardInterrupt: the user has interrupted.
    """
    show_period_s = 1.0  # period at which the accounts are shown, s
    began, elapsed_s, due_s = time.monotonic(), 0.0, show_period_s
    look_period_s = 0.05  # period at which interruptions by the user are checked, s
    while elapsed_s < seconds:
        graph.spin_for(min(look_period_s, seconds - elapsed_s))
        interruption.check()
        elapsed_s = time.monotonic() - began
        is_due = elapsed_s >= min(due_s, seconds)
        due_s += show_period_s if is_due else 0.0
        yield elapsed_s, is_due


def watch(domain: DomainChoice, seconds: float, show: Callable[[AccountBook], None]) -> AccountBook:
    """Read the accounts of the nodes of a domain until the time is over or the user interrupts.

    Args:
        domain: ROS domain of the nodes.
        seconds: duration, s; infinity: until it is interrupted.
        show: function that is called once a second with the accounts.
    """
    book = AccountBook()
    with (
        ros_domain(domain),
        Interruption() as interruption,
        Graph() as graph,
        suppress(KeyboardInterrupt),
    ):
        graph.add(Watcher(book, context=graph.context))
        for _, is_due in looks(graph, interruption, seconds):
            if is_due:
                show(book)
    return book
