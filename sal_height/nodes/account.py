"""The account of a node: its message counts, as its messages on /progress and its status on /diagnostics carry them.

Nodes write their account with `to_message` and `to_values`, and whoever watches a graph reads it with `of_message` and
`of_status`. The names of the numbers are those of NodeAccount.
"""

from __future__ import annotations

import array
import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Self

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rclpy.node import Node
from sal_height_msgs.msg import NodeAccount
from std_msgs.msg import Header

DIAGNOSTICS = "/diagnostics"
"""Topic of the accounts as the conventions have them, at regular times."""
PROGRESS = "/progress"
"""Topic of the accounts at regular times and after every piece of work, made only while somebody listens."""

RECEIVED, PROCESSED, PUBLISHED = NodeAccount.RECEIVED, NodeAccount.PROCESSED, NodeAccount.PUBLISHED
WAITING, JOBS, READY = NodeAccount.WAITING, NodeAccount.JOBS, NodeAccount.READY
DWELLS, CALIBRATIONS = NodeAccount.DWELLS, NodeAccount.CALIBRATIONS
DROPPED, IGNORED, LAST_MINUTE = NodeAccount.DROPPED, NodeAccount.IGNORED, NodeAccount.LAST_MINUTE
PUBLISHED_ON, SUBSCRIBERS, MISSED = NodeAccount.PUBLISHED_ON, NodeAccount.SUBSCRIBERS, NodeAccount.MISSED
UNWRITTEN, RECORDED = NodeAccount.UNWRITTEN, NodeAccount.RECORDED
OFFERED, ACHIEVED = NodeAccount.OFFERED, NodeAccount.ACHIEVED
LATENCY_P50, LATENCY_P95 = NodeAccount.LATENCY_P50, NodeAccount.LATENCY_P95
CPU, MEMORY, PID = NodeAccount.CPU, NodeAccount.MEMORY, NodeAccount.PID
"""Names of numbers, or what they begin with; NodeAccount says of what."""

UNTOLD = "untold"
"""Name of the number of dwells that a node has processed, and tells of when later ones have come, or none for long."""
LAST_DROP = "last_drop"
"""Name of the sentence of an account on /diagnostics."""
LOST_WITH_PROCESS = "lost with its process"
"""Why messages that waited when the process of a node ended were dropped."""
ON_THE_WAY = "lost on the way"
"""Why messages that were published have not come: the middleware has lost them."""

STATES = {WAITING, JOBS, READY, OFFERED, ACHIEVED, MEMORY, PID, LATENCY_P50, LATENCY_P95, UNTOLD}
STATES_UNDER = (SUBSCRIBERS, MISSED, LAST_MINUTE)
"""Numbers that tell how a node is now, by name and by the beginning of their names; all others count from its start."""


@dataclass(frozen=True)
class Account:
    """Message counts of one node.

    At any time received = processed + dropped + waiting.

    Attributes:
        numbers: finite, by their names.
        last_drop: sentence that says why messages were last left out; empty if none were.
    """

    numbers: Mapping[str, float] = field(default_factory=dict)
    last_drop: str = ""

    @classmethod
    def of_status(cls, status: DiagnosticStatus) -> Self:
        """Read an account; values that are not finite numbers are left out."""
        numbers = {item.key: number for item in status.values if (number := _number(item.value)) is not None}
        failures = [item.value for item in status.values if item.key == LAST_DROP]
        return cls(numbers, "".join(failures))

    def to_values(self) -> list[KeyValue]:
        """The account as values of a status."""
        texts = {**{key: str(number) for key, number in self.numbers.items()}, LAST_DROP: self.last_drop}
        return [KeyValue(key=key, value=text) for key, text in texts.items() if text]

    @classmethod
    def of_message(cls, message: NodeAccount, earlier: Account | None = None) -> Self:
        """Read an account; what it lacks is as in an earlier one of the same node.

        Numbers that are not finite, or have no name, are left out.
        """
        found = zip(message.names, message.numbers, strict=False)
        numbers = {name: number for name, number in found if math.isfinite(number)}
        known = {} if message.whole or earlier is None else earlier.numbers
        return cls({**known, **numbers}, message.last_drop)

    def to_message(self, node: Node, *, whole: bool) -> NodeAccount:
        """The account of a node as a message; `whole`: it has all numbers."""
        return NodeAccount(
            header=Header(stamp=node.get_clock().now().to_msg()),
            node=node.get_fully_qualified_name().lstrip("/"),
            whole=whole,
            names=list(self.numbers),
            numbers=array.array("d", self.numbers.values()),
            last_drop=self.last_drop,
        )

    def after(self, earlier: Account) -> Account:
        """This account, with the counts of an earlier process of the same node added.

        What waited when that one ended was lost with it.
        """
        counts = Counter({name: number for name, number in earlier.numbers.items() if _is_count(name)})
        if earlier.waiting:
            counts[f"{DROPPED}{LOST_WITH_PROCESS}"] += earlier.waiting
        own = {name: number + counts.pop(name, 0) for name, number in self.numbers.items() if _is_count(name)}
        return Account({**self.numbers, **own, **counts}, self.last_drop or earlier.last_drop)

    @property
    def received(self) -> int:
        """Messages that came in."""
        return self.count(RECEIVED)

    @property
    def waiting(self) -> int:
        """Messages that are neither processed nor dropped yet."""
        return self.count(WAITING)

    @property
    def jobs(self) -> int:
        """Jobs that the worker has at hand or before it: above 0, the node is working."""
        return self.count(JOBS)

    @property
    def dropped(self) -> dict[str, int]:
        """Messages that were left out, by reason."""
        return self.under(DROPPED)

    @property
    def lately(self) -> dict[str, int]:
        """Messages that were left out or could not be used in the last minute, by reason."""
        return self.under(f"{LAST_MINUTE}{DROPPED}") | self.under(f"{LAST_MINUTE}{IGNORED}")

    @property
    def ignored(self) -> dict[str, int]:
        """Messages beside the frames, such as odometry, that could not be used, by kind."""
        return self.under(IGNORED)

    @property
    def published(self) -> dict[str, int]:
        """Messages published on each topic that keeps all of them (see `Stage.offer`)."""
        return self.under(PUBLISHED_ON)

    @property
    def missed(self) -> dict[str, int]:
        """Messages of each topic that its publisher has published and that have not come, as their numbers tell."""
        return self.under(MISSED)

    def with_losses(self, count: int) -> Self:
        """This account, with messages that never came as received and dropped."""
        if not count:
            return self
        name = f"{DROPPED}{ON_THE_WAY}"
        lost = {RECEIVED: self.received + count, name: self.count(name) + count}
        return replace(self, numbers={**self.numbers, **lost})

    @property
    def subscribers(self) -> dict[str, int]:
        """Subscribers of each topic that the node publishes."""
        return self.under(SUBSCRIBERS)

    @property
    def recorded(self) -> dict[str, int]:
        """Messages in the bag, by topic (recorder only)."""
        return self.under(RECORDED)

    @property
    def unwritten(self) -> int:
        """Messages that could not be written to the bag (recorder only)."""
        return self.count(UNWRITTEN)

    def count(self, name: str) -> int:
        """The count of that name; 0 if the account has none."""
        return int(self.numbers.get(name, 0))

    def under(self, prefix: str) -> dict[str, int]:
        """The counts whose names begin with `prefix`, by the rest of the name; topics are without leading slash."""
        return {
            name.removeprefix(prefix).removeprefix("/"): int(number)
            for name, number in self.numbers.items()
            if name.startswith(prefix)
        }


def _is_count(name: str) -> bool:
    """Whether a number counts something from the start of its node."""
    return name not in STATES and not name.startswith(STATES_UNDER)


def _number(text: str) -> float | None:
    """The finite number that a text stands for, if any."""
    try:
        number = float(text)
    except ValueError:
        return None
    return number if math.isfinite(number) else None
