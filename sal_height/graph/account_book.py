"""The accounts of all nodes of a graph, kept over all their lives, as they arrive on /diagnostics."""

from __future__ import annotations

from dataclasses import dataclass, field

from sal_height.messages.types import DiagnosticArray, DiagnosticStatus
from sal_height.nodes.accounts.account import Account
from sal_height.nodes.accounts.tally import Pace

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
    """

    account: Account = field(default_factory=Account)
    level: str = ""
    message: str = ""
    received_at: float = 0.0
    lives: int = 0
    _before: Account = field(default_factory=Account)
    _pid: int = 0
    _cpu: Pace = field(default_factory=Pace)

    @property
    def cpu_per_second(self) -> float:
        """Processor seconds that its process uses per second, over the last seconds; 0 before two samples."""
        return sum(self._cpu.rates())

    def is_gone(self, now: float) -> bool:
        """True if it has published nothing for 3 s."""
        return now - self.received_at > 3.0

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
