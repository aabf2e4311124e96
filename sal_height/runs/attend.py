"""Start the nodes of a deployment beside a sensor that others operate, and watch them."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass

from sal_height.nodes.domain import ros_domain
from sal_height.runs.account_book import AccountBook
from sal_height.runs.conductor import Execution, Interruption
from sal_height.runs.ensemble import Ensemble, Member
from sal_height.runs.supervisor import Supervisor
from sal_height.runs.watch import LOOK_PERIOD_S, SHOW_PERIOD_S, Watcher


@dataclass
class Attended:
    """What has been seen of a deployment.

    Attributes:
        book: the accounts of all nodes of the graph, those of others too.
        elapsed_s: time since its nodes were started.
        starts: how often each node was started again.
    """

    book: AccountBook
    elapsed_s: float
    starts: dict[str, int]


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
        seconds: how long, s; infinity: until it is interrupted.
        supervised: whether nodes that have ended are started again, once all of them have come up.
        show: called once a second with what has been seen.

    Raises:
        UserError: a node refuses its parameters, or ends and is not to be started again.
    """
    seen = Attended(AccountBook(), 0.0, {})
    names = {f"{member.namespace}/{member.name}".removeprefix("/") for member in members}
    with (
        ros_domain(execution.domain),
        Interruption() as interruption,
        Ensemble(members, execution.processes) as ensemble,
        suppress(KeyboardInterrupt),
    ):
        graph = ensemble.graph
        graph.add(Watcher(seen.book, context=graph.context))
        began = time.monotonic()
        supervisor = Supervisor(ensemble, began)
        due_s = SHOW_PERIOD_S
        while seen.elapsed_s < seconds:
            graph.spin_for(min(LOOK_PERIOD_S, seconds - seen.elapsed_s))
            interruption.check()
            if supervised and _are_up(names, seen.book):
                supervisor.look(time.monotonic())
            else:
                ensemble.check()
            seen.elapsed_s, seen.starts = time.monotonic() - began, dict(supervisor.starts)
            if seen.elapsed_s >= min(due_s, seconds):
                due_s += SHOW_PERIOD_S
                show(seen)
    return seen


def _are_up(names: set[str], book: AccountBook) -> bool:
    """Whether all nodes have come up once."""
    return names <= book.entries.keys()
