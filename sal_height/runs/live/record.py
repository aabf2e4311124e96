"""`sal-height record`: write published messages to a bag, and show the account of each topic."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rclpy.parameter import Parameter
from rich.box import SIMPLE_HEAD
from rich.table import Table

from sal_height.bag.check import left_out
from sal_height.bag.described import PARAMETER_EVENTS
from sal_height.bag.reader import BagReader
from sal_height.graph.watch import looks
from sal_height.io import check_new_folder, free_folder
from sal_height.nodes.accounts.account import TopicCounts
from sal_height.nodes.recording.recorder import Recorder
from sal_height.nodes.transport.domain import DomainChoice, ros_domain
from sal_height.nodes.transport.graph import Graph
from sal_height.tables import counted
from sal_height.workers.processes import Interruption

DEFAULT_FOLDER = Path("out/recorded")


@dataclass
class RecordingProgress:
    """Progress of a recording.

    Attributes:
        folder: folder of the bag.
        elapsed_s: time since the start, s.
        topic_counts: accounts of the messages of each topic.
    """

    folder: Path
    elapsed_s: float = 0.0
    topic_counts: Mapping[str, TopicCounts] = field(default_factory=dict)

    @property
    def written(self) -> int:
        """Messages in the bag."""
        return sum(counts.written for counts in self.topic_counts.values())

    @property
    def received(self) -> int:
        """Number of messages in the bag on the requested topics."""
        return self.written - self.topic_counts.get(PARAMETER_EVENTS, TopicCounts()).written

    @property
    def left_out(self) -> int:
        """Messages that are not in the bag."""
        return sum(counts.left_out.total() for counts in self.topic_counts.values())


def record(
    out: Path | None,
    parameters: Mapping[str, Any],
    domain: DomainChoice,
    seconds: float,
    show: Callable[[RecordingProgress], None],
) -> RecordingProgress:
    """Record until the time is over or the user interrupts.

    Args:
        out: folder of the bag, new or empty; None: the next free one of DEFAULT_FOLDER, DEFAULT_FOLDER_2, ….
        parameters: parameters of node recorder, without its directory.
        domain: ROS domain of the nodes that publish.
        seconds: duration, s; infinity: until it is interrupted.
        show: function called once a second, and at the end, with the counts of recorded messages.

    Raises:
        UserError: the folder or a parameter cannot be used.
    """
    done = RecordingProgress(out or free_folder(DEFAULT_FOLDER))
    check_new_folder(done.folder)
    with ros_domain(domain), Interruption() as interruption, Graph() as graph:
        overrides = [Parameter(name, value=value) for name, value in parameters.items() if value]
        recorder = graph.add(Recorder(done.folder, context=graph.context, parameter_overrides=overrides))
        with suppress(KeyboardInterrupt):
            for elapsed_s, is_due in looks(graph, interruption, seconds):
                done.elapsed_s, done.topic_counts = elapsed_s, recorder.topic_counts
                if is_due:
                    show(done)
        recorder.close_bag()
        done.topic_counts = recorder.topic_counts
    show(done)
    return done


def messages_left_out(bag: Path) -> int:
    """Number of messages that are not in a complete bag, as its recorder says.

    Raises:
        UserError: the bag is incomplete, since its recorder was killed or its disk was full.
    """
    return sum(sum(lost.values()) for lost in left_out(BagReader(bag)).values())


def recorded_table(done: RecordingProgress) -> Table:
    """A line for each topic."""
    title = f"{done.folder}: {counted(done.written, 'message')} in {done.elapsed_s:.0f} s"
    table = Table(title=title, box=SIMPLE_HEAD)
    table.add_column("topic", no_wrap=True)
    table.add_column("written", justify="right")
    table.add_column("left out")
    for topic, counts in sorted(done.topic_counts.items()):
        reasons = ", ".join(f"{count} {reason}" for reason, count in counts.left_out.items())
        table.add_row(topic, str(counts.written), reasons)
    return table
