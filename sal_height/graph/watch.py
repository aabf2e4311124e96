"""The accounts of nodes that others run, kept over all lives of a node, as they arrive on /diagnostics."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node

from sal_height.messages.types import DiagnosticArray, DiagnosticStatus
from sal_height.nodes.accounts.account import DIAGNOSTICS, Account
from sal_height.nodes.accounts.tally import Pace
from sal_height.nodes.transport.domain import LOOK_S, LOST, DomainChoice, Ports, ros_domain
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.message_types import subscribe
from sal_height.workers.processes import Interruption

SILENT_S = 3.0
"""Time after its last account, s, from which a node is silent: it publishes two a second."""

MOST_NODES = 1000
"""Greatest number of nodes that are kept: a publisher of endless names uses no more memory."""

LEVELS = {
    DiagnosticStatus.OK: "ok",
    DiagnosticStatus.WARN: "warning",
    DiagnosticStatus.ERROR: "error",
    DiagnosticStatus.STALE: "stale",
}


@dataclass
class NodeAccount:
    """State of a node.

    Attributes:
        account: account over all processes that it has had.
        level: level of its diagnostics, "ok", "warning", "error" or "stale".
        message: message of its diagnostics.
        received_at: time of its last message, s of the monotonic clock.
        lives: number of processes that it has had.
        is_there: True if the ROS graph has a node of that name that publishes accounts.
    """

    account: Account = field(default_factory=Account)
    level: str = ""
    message: str = ""
    received_at: float = 0.0
    lives: int = 0
    is_there: bool = False
    _before: Account = field(default_factory=Account)
    _pid: int = 0
    _cpu: Pace = field(default_factory=Pace)

    @property
    def cpu_per_second(self) -> float:
        """Processor seconds that its process uses per second, over the last seconds; 0 before two samples."""
        return sum(self._cpu.rates())

    def is_gone(self, now: float) -> bool:
        """True if it is silent and has left the ROS graph, or is no node, as the parts of foreign drivers."""
        return not self.is_there and self._silent_for_s(now) > SILENT_S

    def note_presence(self, is_there: bool, now: float) -> None:
        """Enter whether the ROS graph has the node; one that is silent all the same is stale."""
        self.is_there = is_there
        if is_there and (silent_s := self._silent_for_s(now)) > SILENT_S:
            self.level = LEVELS[DiagnosticStatus.STALE]
            self.message = f"no account for {silent_s:.0f} s; the node is there, and too busy, or stands still"

    def _silent_for_s(self, now: float) -> float:
        return now - self.received_at

    def take(self, status: DiagnosticStatus, now: float) -> None:
        """Enter a status of the node."""
        account = Account.of_status(status)
        if self.lives == 0 or account.pid != self._pid:
            self._before, self._pid = self.account, account.pid
            self.lives += 1
            self._cpu = Pace()
        self.account = account.after(self._before)
        self.level, self.message, self.received_at = LEVELS.get(status.level, "?"), status.message, now
        self._cpu.sample(now, account.cpu_s)


class AccountBook:
    """States of all nodes.

    Attributes:
        entries: states by the name of the node with its namespace, without leading slash.
    """

    def __init__(self) -> None:
        self.entries: dict[str, NodeAccount] = {}

    def take(self, message: DiagnosticArray, now: float) -> None:
        """Enter a message that arrived at the time `now`, s of the monotonic clock."""
        for status in message.status:
            if status.name not in self.entries and len(self.entries) >= MOST_NODES:
                continue
            self.entries.setdefault(status.name, NodeAccount()).take(status, now)

    def note_nodes(self, names: Collection[str], now: float) -> None:
        """Enter which nodes the ROS graph has at the time `now`: names with their namespaces, without leading slash."""
        for name, entry in self.entries.items():
            entry.note_presence(name in names, now)


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
        publishers = self.get_publishers_info_by_topic(DIAGNOSTICS)
        names = {f"{one.node_namespace.rstrip('/')}/{one.node_name}".lstrip("/") for one in publishers}
        self.book.note_nodes(names, time.monotonic())
        if not self.is_deaf and (lost := self._ports.lost()):
            self.is_deaf = True
            how = "The nodes go on, unseen; end this program with Ctrl-C, and start it again."
            self.get_logger().error(f"{LOST.format(lost[0])} {how}")


def looks(graph: Graph, interruption: Interruption, seconds: float) -> Iterator[tuple[float, bool]]:
    """Spin a graph for a time; again and again, yields the time since the start, s, and whether it is time to show.

    Raises:
        KeyboardInterrupt: the user has interrupted.
    """
    period_s = 1.0
    began, elapsed_s, due_s = time.monotonic(), 0.0, period_s
    while elapsed_s < seconds:
        graph.spin_for(min(0.1, seconds - elapsed_s))
        interruption.check()
        elapsed_s = time.monotonic() - began
        is_due = elapsed_s >= min(due_s, seconds)
        due_s += period_s if is_due else 0.0
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
