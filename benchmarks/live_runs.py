"""Live graphs at one rate or another, and the highest that they sustain."""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

from benchmarks.processes import Usage, thread_cpu_s
from benchmarks.row import sized
from sal_height.runs import ensemble
from sal_height.runs.conductor import RECORDER, Execution
from sal_height.runs.live import SOURCE, Live, Watched, live

TRIALS = sized(5, 1)
"""Rates that are tried at most in search of the highest."""

NEAR = 1.12
"""The search ends when the lowest rate that leaves dwells out is so many times the highest that does not."""

STEP = 1.4
"""From a rate without any drop to the next."""

BACKOFF = (0.5, 0.9)
"""From a rate with drops to the next: the share of dwells that were processed, but at least and at most so much."""


@dataclass(frozen=True)
class Seen:
    """What was seen of a live graph, and what its processes have used."""

    watched: Watched
    usage: Usage
    recorded_bytes: int

    @property
    def left_out(self) -> int:
        """Messages that any node has dropped."""
        return sum(sum(account.dropped.values()) for account in self.watched.accounts.values())

    @property
    def achieved(self) -> float:
        """Share of the dwells offered that have become heights."""
        offered = self.watched.offered_hz * self.watched.elapsed_s
        return min((len(ages) for ages in self.watched.latencies_s.values()), default=0) / offered


def watch(bag: Path, rate: float, seconds: float, record: tuple[str, ...] = ("phase_history",)) -> Seen:
    """Run a graph with every node in a process of its own.

    Args:
        bag: what the sensor delivers.
        rate: seconds of the sensor in a second.
        seconds: how long, s.
        record: topics recorded besides heights and diagnostics.
    """
    usage = Usage()
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "live")
        watched = live(bag, out, {}, Live(rate, seconds), Execution(True, record=record), lambda _: usage.take())
        recorded = sum(file.stat().st_size for file in (out / "bag").iterdir())
    return Seen(watched, usage, recorded)


def watch_idle(bag: Path, rate: float, seconds: float) -> Seen:
    """Run the same graph with nodes that do nothing: what is left is transport (`idle_nodes`)."""
    with patch.object(ensemble, "__name__", "benchmarks.idle_nodes"):  # the module that child processes run
        return watch(bag, rate, seconds)


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


def cpu_in_one_process(bag: Path, rate: float, seconds: float) -> float:
    """Processor time (s) that a graph in this process takes for a dwell, without its source and its recorder.

    Args:
        bag: what the sensor delivers.
        rate: seconds of the sensor in a second, at which nothing is left out.
        seconds: how long, s.
    """
    usage, threads = Usage(), []

    def show(_: Watched) -> None:
        usage.take()
        threads.append(thread_cpu_s())

    with tempfile.TemporaryDirectory() as folder:
        execution = Execution(processes=False, record=("phase_history",))
        watched = live(bag, Path(folder, "live"), {}, Live(rate, seconds), execution, show)
    first, last = usage.samples[0], usage.samples[-1]
    used = sum(last.cpu_s.values()) - sum(first.cpu_s.values())
    beside = (SOURCE, RECORDER, f"spin {RECORDER}")
    used -= sum(threads[-1].get(name, 0.0) - threads[0].get(name, 0.0) for name in beside)
    return used / (watched.offered_hz * (last.at_s - first.at_s))


if __name__ == "__main__":
    sys.stdout.write(json.dumps(cpu_in_one_process(Path(sys.argv[1]), float(sys.argv[2]), float(sys.argv[3]))) + "\n")
