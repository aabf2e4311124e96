"""Parts of a run of the graph, its execution, and its outcome."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from sal_height.bag.reader import LogTimes
from sal_height.engine.compression import SENSOR
from sal_height.engine.results import DwellKey
from sal_height.engine.stage import Reset
from sal_height.errors import Rejected, UserError
from sal_height.geometry import Mounting
from sal_height.graph.catalogue import NodeParameters
from sal_height.nodes.accounts.account import Account
from sal_height.tables import counted

if TYPE_CHECKING:
    from sal_height.nodes.transport.domain import DomainChoice  # which needs locks of POSIX

RECORDER = "recorder"

UNCOUNTED = ("diagnostics",)
"""Recorded topics of which the publishers count neither messages nor subscribers."""


@dataclass(frozen=True)
class DwellChanges:
    """Changes before a dwell.

    Attributes:
        dwell: key of the dwell.
        parameters: values that nodes get, by node and name.
        calibrations: identities of the calibrations that are published, in this order.
    """

    dwell: DwellKey
    parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    calibrations: tuple[str, ...] = ()


@dataclass(frozen=True)
class AsFlown:
    """Dwells that nodes did not process in flight, which a replay leaves out at the same nodes.

    Attributes:
        left_out: reasons for which dwells are left out, by node.
        restarted: dwells before which nodes were reset or started again, by node.
        unmade: dwells that nodes did not process in flight for whatever reason, by node.
        unrecorded: dwells whose heights were made and are not in the bag, by prefix of the topic.
        lost_before: dwells that did not get as far as a node, by node.
    """

    left_out: Mapping[str, Mapping[DwellKey, Rejected]] = field(default_factory=dict)
    restarted: Mapping[str, Sequence[DwellKey]] = field(default_factory=dict)
    unmade: Mapping[str, frozenset[DwellKey]] = field(default_factory=dict)
    unrecorded: Mapping[str, frozenset[DwellKey]] = field(default_factory=dict)
    lost_before: Mapping[str, frozenset[DwellKey]] = field(default_factory=dict)

    def scheduled(self, node: str) -> Iterator[tuple[DwellKey, Reset | Rejected]]:
        """Dwells and items for `Stage.schedule`, with which a node processes the same dwells as in flight."""
        for dwell in self.restarted.get(node, ()):
            yield dwell, Reset()
        yield from self.left_out.get(node, {}).items()

    def report(self) -> list[dict[str, Any]]:
        """Entries of a report: node, reason and the numbers of the dwells that are left out for it."""
        numbers: dict[tuple[str, str], list[int]] = {}
        for node, dwells in self.left_out.items():
            for dwell, reason in dwells.items():
                numbers.setdefault((node, reason.reason), []).append(dwell.number)
        return [{"node": node, "reason": reason, "dwells": dwells} for (node, reason), dwells in numbers.items()]


ALL_PROCESSED = AsFlown()


@dataclass(frozen=True)
class Plan:
    """Nodes, settings and changes of a run of the graph.

    Attributes:
        source: name of the node that publishes dwells, "simulator" or "player".
        stages: names of the processing nodes, sar_compression first.
        recorded: topics to record, without leading slash.
        bag: folder of the new bag.
        parameters: values of the nodes' parameters.
        dwells: number of dwells to expect, for the progress bar.
        custom_data: texts by name to store in the bag.
        played: topics of the source.
        remapped: other names of topics of all nodes, by their own; all without leading slash.
        simulated_time: True if all nodes have the time of the source: by steps, or from /clock, which it publishes.
        changes: changes before dwells.
        mountings: mountings of sensors (config_hash) on the platform, where the flight had others than described.
        announces: True if the source knows what no longer arrives, so that nothing waits for a time-out.
        frames: times when the frames of each dwell of a bag were recorded.
        as_flown: dwells that nodes left out in flight.
    """

    source: str
    stages: list[str]
    recorded: list[str]
    bag: Path
    parameters: NodeParameters
    dwells: int
    custom_data: Mapping[str, str] = field(default_factory=dict)
    played: Sequence[str] = SENSOR
    remapped: Mapping[str, str] = field(default_factory=dict)
    simulated_time: bool = False
    changes: Sequence[DwellChanges] = ()
    mountings: Mapping[str, Mounting] = field(default_factory=dict)
    announces: bool = True
    frames: Mapping[DwellKey, LogTimes] = field(default_factory=dict)
    as_flown: AsFlown = ALL_PROCESSED

    def on_wire(self, topics: Iterable[str]) -> list[str]:
        """The names under which topics of the nodes are published."""
        return [self.remapped.get(topic, topic) for topic in topics]


Processes = Literal["host", "each", "one"]
"""Processes of a live graph: the stages in one process with workers, and each other node in its own; one for each node;
or one for all."""


@dataclass(frozen=True)
class Execution:
    """Execution of a run; the heights do not depend on it.

    Attributes:
        processes: processes of a live graph; other graphs run in one process.
        domain: ROS domain of the nodes.
        record: topics to record in addition to those that the run needs, with or without leading slash.
        timeout_s: time without a working node or a moving message after which the run is given up, s. A dwell may
            last longer, as long as a node works on it.
    """

    processes: Processes = "one"
    domain: DomainChoice = "free"
    record: Sequence[str] = ()
    timeout_s: float = 120.0


DEFAULT = Execution()


@dataclass(frozen=True)
class Outcome:
    """Outcome of a run.

    Attributes:
        stages: accounts of the source and of every stage, by node name; of the recorder, if it has missed messages.
        dwells: number of dwells that were played.
        interrupted: True if the user stopped the run.
        failure: error that ended the run early, unless the user stopped it.
        elapsed_s: time from the first step until the last dwell was settled, or until the run ended, s.
        as_flown: messages that were dropped of dwells that the node did not process in flight either, by node and
            reason.
    """

    stages: dict[str, Account]
    dwells: int
    interrupted: bool
    failure: UserError | None = None
    elapsed_s: float = 0.0
    as_flown: Mapping[tuple[str, str], int] = field(default_factory=dict)

    @property
    def losses(self) -> list[str]:
        """Warnings, one for each node and reason for which it dropped messages, but for those `as_flown`."""
        return [
            f"Node {name} dropped {counted(count - self.as_flown.get((name, reason), 0), 'message')} ({reason})."
            for name, account in self.stages.items()
            for reason, count in account.dropped.items()
            if count > self.as_flown.get((name, reason), 0)
        ]

    @property
    def losses_as_flown(self) -> list[str]:
        """Sentences, one for each node and reason for which it left out messages as it had in flight."""
        return [
            f"Node {name} left out {counted(count, 'message')} as in flight ({reason})."
            for (name, reason), count in self.as_flown.items()
        ]
