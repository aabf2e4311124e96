"""Live graphs at one rate or another, and the highest that they sustain.

`python -m benchmarks.live_runs BAG RATE SECONDS NODES RESULT TOPIC...` runs one, in a process that begins as
`sal-height live` does. NODES is one of `Nodes`, RESULT the file of what was seen, and TOPICs are recorded besides
heights and diagnostics.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import Enum
from pathlib import Path
from typing import Literal

from benchmarks.processes import Sample, Usage, memory_bytes, thread_cpu_s
from benchmarks.row import sized
from sal_height.workers.processes import ONE_THREAD

PHASE_HISTORY = ("phase_history",)

TRIALS = sized(9, 1)
"""Rates that are tried at most in search of the highest."""

NEAR = 1.12
"""The search ends when the lowest rate that leaves dwells out is so many times the highest that does not."""

STEP = 1.4
"""From a rate without any drop to the next."""

BACKOFF = (0.5, 0.8)
"""From a rate with drops to the next: the share of dwells that were processed, but at least and at most so much."""

IN_PARTS = ("buffer full", "incomplete dwell")
"""Why messages are dropped if others of the same dwell do not come."""


class Nodes(Enum):
    """Processes that a graph consists of."""

    HOST = "host"
    """The live host has the stages, player and recorder have processes of their own."""
    SEPARATE = "separate"
    """Every node has a process of its own."""
    TOGETHER = "together"
    """All nodes are in one process."""
    IDLE = "idle"
    """Every node has a process of its own, and does nothing but receive and publish (`idle_nodes`)."""


PROCESSES: Mapping[Nodes, Literal["host", "each", "one"]] = {
    Nodes.HOST: "host",
    Nodes.SEPARATE: "each",
    Nodes.TOGETHER: "one",
    Nodes.IDLE: "each",
}
"""Processes of each kind of graph, as `sal-height live` knows them."""


@dataclass(frozen=True)
class Seen:
    """Observations of a live graph, and the resources that its processes have used.

    Attributes:
        offered_hz: dwells in a second that the sensor delivered.
        elapsed_s: duration, s.
        left_out: messages that any node has dropped.
        in_parts: those among them that were dropped because others of the same dwell did not come.
        latencies_s: times from the last pulse of a dwell to each of its height images, s, by topic.
        usage: use of processors and memory.
        beside_s: processor time of the threads of source and recorder in a graph of one process, while it was watched.
        recorded_bytes: size of the bag.
        memory_bytes: memory of all processes after a second, what they share counted once, bytes.
    """

    offered_hz: float
    elapsed_s: float
    left_out: int
    in_parts: int
    latencies_s: Mapping[str, Sequence[float]]
    usage: Usage
    beside_s: float
    recorded_bytes: int
    memory_bytes: int

    @property
    def achieved(self) -> float:
        """Share of the dwells offered that have become heights."""
        made = min((len(ages) for ages in self.latencies_s.values()), default=0)
        return made / (self.offered_hz * self.elapsed_s)


def watch(
    bag: Path, rate: float, seconds: float, nodes: Nodes = Nodes.HOST, record: Sequence[str] = PHASE_HISTORY
) -> Seen:
    """Run a graph.

    Args:
        bag: bag of what the sensor delivers.
        rate: seconds of the sensor in a second.
        seconds: duration, s.
        nodes: nodes that it consists of.
        record: topics recorded in addition to heights and diagnostics.
    """
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder, "seen.json")
        words = [str(bag), str(rate), str(seconds), nodes.value, str(result), *record]
        subprocess.run(  # noqa: S603 (our own module)
            [sys.executable, "-m", "benchmarks.live_runs", *words], check=True, env=ONE_THREAD | os.environ
        )
        seen = json.loads(result.read_text(encoding="utf-8"))
    usage = Usage([Sample(**sample) for sample in seen.pop("usage")["samples"]])
    return Seen(**seen, usage=usage)


def highest_rate(run: Callable[[float], Seen], guess: float) -> tuple[float, Seen]:
    """The highest rate at which no dwell is left out, and what was seen at it; 0, and what was last seen, if none is.

    Args:
        run: runs a graph at a rate.
        guess: rate that is tried first.
    """
    low, high, best = 0.0, float("inf"), None
    rate = guess
    for _ in range(TRIALS):
        seen = run(rate)
        if seen.left_out:
            high, below = rate, rate * min(max(seen.achieved, BACKOFF[0]), BACKOFF[1])
        else:
            low, best, below = rate, seen, rate
        if high <= low * NEAR:
            break
        rate = low * STEP if high == float("inf") else max(below, (low * high) ** 0.5)
    return low, best or seen


def _watch_here(bag: Path, rate: float, seconds: float, nodes: Nodes, record: tuple[str, ...]) -> Seen:
    """Run a graph from this process, which must not have made any node yet."""
    from sal_height.graph.node_classes import NODES  # noqa: PLC0415
    from sal_height.graph.plan import RECORDER, Execution  # noqa: PLC0415
    from sal_height.runs.live.live import (  # noqa: PLC0415 (what only starts such processes needs none of this)
        SOURCE,
        Live,
        Watched,
        live,
    )
    from sal_height.runs.live.sensor_bag import Feed  # noqa: PLC0415

    if nodes is Nodes.IDLE:
        from benchmarks.idle_nodes import IDLE  # noqa: PLC0415

        NODES.update(IDLE)
    usage = Usage()
    threads: list[dict[str, float]] = []
    memory: list[int] = []

    def show(_: Watched) -> None:
        if not memory:
            memory.append(memory_bytes())
        usage.take()
        threads.append(thread_cpu_s())

    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "live")
        execution = Execution(PROCESSES[nodes], record=record)
        watched = live(Feed.of_bag(bag), out, {}, Live(rate, seconds), execution, show)
        recorded = sum(file.stat().st_size for file in (out / "bag").iterdir())
    beside = (SOURCE, RECORDER, f"spin {RECORDER}")
    dropped = Counter[str]()
    for account in watched.accounts.values():
        dropped.update(account.dropped)
    return Seen(
        offered_hz=watched.offered_hz,
        elapsed_s=watched.elapsed_s,
        left_out=dropped.total(),
        in_parts=sum(dropped[reason] for reason in IN_PARTS),
        latencies_s={topic: ages.tolist() for topic, ages in watched.latencies_s.items()},
        usage=usage,
        beside_s=sum(threads[-1].get(name, 0.0) - threads[0].get(name, 0.0) for name in beside),
        recorded_bytes=recorded,
        memory_bytes=memory[0],
    )


def _main(bag: str, rate: str, seconds: str, nodes: str, result: str, *record: str) -> None:
    seen = _watch_here(Path(bag), float(rate), float(seconds), Nodes(nodes), record)
    Path(result).write_text(json.dumps(asdict(seen)), encoding="utf-8")


if __name__ == "__main__":
    _main(*sys.argv[1:])
