"""The table of `live` and `top`: rate, latency, drops and state of every node; nodes attended with it."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from sal_height.graph.ensemble import Ensemble, Member
from sal_height.graph.plan import Execution
from sal_height.graph.supervisor import Supervisor
from sal_height.graph.watch import AccountBook, NodeAccount, Watcher, looks
from sal_height.nodes.transport.domain import ros_domain
from sal_height.runs.live.live import SOURCE, Watched
from sal_height.workers.processes import Interruption

GONE = "gone"

COLOURS = {"ok": "green", "warning": "yellow", "error": "red", GONE: "red"}


@contextmanager
def showing(draw: Callable[[Any], RenderableType]) -> Iterator[Callable[[Any], None]]:
    """A function that shows what `draw` returns for its argument.

    A terminal shows each as it arrives; else only the last is shown, at the end, since a log cannot change.
    """
    console = Console()
    if console.is_terminal:
        with Live(console=console, auto_refresh=False) as display:
            yield lambda seen: display.update(draw(seen), refresh=True)
        return
    last: list[RenderableType] = []
    yield lambda seen: last.__setitem__(slice(None), [draw(seen)])
    console.print(*last)


def node_table(book: AccountBook, now: float, title: str, without: Collection[str] = ()) -> Group:
    """A line for each node that publishes on /diagnostics; below, the losses and the warnings.

    Args:
        book: states of the nodes.
        now: time, s of the monotonic clock.
        title: title of the table.
        without: names of nodes that are left out.
    """
    names = sorted(book.entries.keys() - set(without))
    common = _common_namespace(names)
    title = f"{title}, in namespace {common.rstrip('/')}" if common else title
    table = Table(title=title, caption="dwells a second, latency in ms, processors, memory in MB", box=SIMPLE_HEAD)
    table.add_column("node", no_wrap=True)
    table.add_column("state", no_wrap=True)
    for name in ("in/s", "done/s", "p50", "p95", "CPU", "MB"):
        table.add_column(name, justify="right", no_wrap=True)
    said = []
    for full_name in names:
        name, entry = full_name.removeprefix(common), book.entries[full_name]
        state = GONE if entry.is_gone(now) else entry.level
        table.add_row(name, f"[{COLOURS.get(state, 'yellow')}]{state}[/]", *_numbers(entry))
        said += [Text(f"{name} {sentence}") for sentence in _sentences(entry, state)]
    return Group(table, *said)


def _common_namespace(names: Sequence[str]) -> str:
    """The namespace that all nodes have in common, with a slash at its end."""
    common = os.path.commonpath([f"/{name.rpartition('/')[0]}" for name in names] or ["/"])
    return f"{common.strip('/')}/".lstrip("/")


def _numbers(entry: NodeAccount) -> list[str]:
    """Rates, latencies, processors and memory of a node, as texts."""
    account = entry.account
    numbers = account.offered_hz, account.achieved_hz, account.latency_p50_ms, account.latency_p95_ms
    texts = ["" if math.isnan(number) else f"{number:.1f}" for number in numbers]
    return [*texts, f"{entry.cpu_per_second:.2f}", f"{account.memory_mb:.0f}" if account.memory_mb else ""]


def _sentences(entry: NodeAccount, state: str) -> Iterator[str]:
    """Messages on a node, without its name: starts, messages left out by reason, warnings."""
    if entry.lives > 1:
        yield f"was started {entry.lives} times."
    lost, lately = {**entry.account.dropped, **entry.account.ignored}, entry.account.lost_last_minute
    if lost:
        counts = ", ".join(f"{reason} {lately.get(reason, 0)} ({count})" for reason, count in lost.items())
        yield f"has left out in the last minute (in all): {counts}."
    if state == GONE:
        yield "publishes nothing any more."
    elif state != "ok":
        yield f"says: {entry.message}"


def live_table(watched: Watched, now: float) -> Group:
    """Progress of a live graph, and the time from its sensor's last pulses to its heights."""
    title = f"{watched.elapsed_s:.0f} s, the sensor delivers {watched.offered_hz:.3g} dwells/s"
    ages = Table(title="from the last pulse to the heights, ms")
    for name in ("topic", "images", "p50", "p95", "p99.9"):
        ages.add_column(name, justify="left" if name == "topic" else "right")
    for topic, values in watched.latencies_s.items():
        if values:
            percentiles = 1e3 * np.percentile(values, [50, 95, 99.9])
            ages.add_row(topic, f"{len(values)}", *(f"{value:.1f}" for value in percentiles))
    return Group(node_table(watched.book, now, title, without={SOURCE}), ages)


@dataclass
class Attended:
    """Accounts of all nodes of the graph, those of others too, and time since its nodes were started, s."""

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
    """True if a process has ended by itself before its nodes published an account, as if one refuses its parameters."""

    def published(name: str) -> bool:
        return any(
            f"{member.namespace}/{member.name}".removeprefix("/") in book.entries for member in ensemble.processes[name]
        )

    return any(status >= 0 and not published(name) for name, status in ensemble.ended().items())
