"""Start the nodes of a deployment for a sensor that others operate, and watch them."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass

from sal_height.graph.account_book import AccountBook
from sal_height.graph.ensemble import Ensemble, Member
from sal_height.graph.interruption import Interruption
from sal_height.graph.plan import Execution
from sal_height.graph.supervisor import Supervisor
from sal_height.graph.watch import Watcher, looks
from sal_height.nodes.transport.domain import ros_domain


@dataclass
class Attended:
    """Progress of a deployment.

    Attributes:
        book: the accounts of all nodes of the graph, those of others too.
        elapsed_s: time since its nodes were started.
    """

    book: AccountBook
    elapsed_s: float

    @property
    def has_worked(self) -> bool:
        """True if any node has processed or recorded anything."""
        accounts = [entry.account for entry in self.book.entries.values()]
        return any(account.processed or any(account.recorded.values()) for account in accounts)


def attend(
    members: Sequence[Member],
    execution: Execution,
    seconds: float,
    supervised: bool,
    show: Callable[[Attended], None],
) -> Attended:
    """Run the nodes of a deployment until the time is over or the user interrupts.

    Args:
        members: the nodes.
        execution: domain; whether each node has a process of its own.
        seconds: duration, s; infinity: until it is interrupted.
        supervised: True if nodes that have ended are started again.
        show: function called once a second with the accounts received so far.

    Raises:
        UserError: a node refuses its parameters, or ends and is not to be started again.
    """
    seen = Attended(AccountBook(), 0.0)
    with (
        ros_domain(execution.domain),
        Interruption() as interruption,
        Ensemble(members, execution.processes) as ensemble,
        suppress(KeyboardInterrupt),
    ):
        graph = ensemble.graph
        graph.add(Watcher(seen.book, context=graph.context))
        supervisor = Supervisor(ensemble, time.monotonic())
        for seen.elapsed_s, is_due in looks(graph, interruption, seconds):
            if supervised and not _refused(ensemble, seen.book):
                supervisor.look(time.monotonic())
            else:
                ensemble.check()
            if is_due:
                show(seen)
    return seen


def _refused(ensemble: Ensemble, book: AccountBook) -> bool:
    """True if a node has ended by itself before it published an account, as one does that refuses its parameters."""
    members = ensemble.members
    named = {name: f"{members[name].namespace}/{name}".removeprefix("/") for name in members}
    return any(status >= 0 and named[name] not in book.entries for name, status in ensemble.ended().items())
