"""A graph goes on after one of its nodes was killed, at a rate at which its shared memory fills meanwhile.

`python -m benchmarks.killed_stage watch RESULT` runs the graph, in a process that begins as `sal-height live` does, and
writes what was seen to the file RESULT. With `kill PROCESS`, it is the program that kills a node.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from rclpy.node import Node

from benchmarks.live_runs import highest_rate, watch
from benchmarks.row import Row, load, sized
from sal_height.graph.plan import Execution
from sal_height.nodes.transport.graph import Graph
from sal_height.runs.live.live import Live, live
from sal_height.runs.live.sensor_bag import Feed, record_sensor
from sal_height.simulation import load_preset
from sal_height.workers.processes import ONE_THREAD

if TYPE_CHECKING:
    from sal_height.runs.live.live import Watched

PRESET, RATE = sized(("sal_spotlight", None), ("small", 0.02))
"""Simulated preset, and seconds of the sensor in a second; None for `SHARE` of the highest that is sustained."""

SHARE, FIRST_GUESS, SEARCH_S = 0.8, 0.3, 20.0
"""Of the highest rate that is sustained, the one played at; the rate that is tried first, and for how long one is."""

LEAST_RATE = 0.02
"""Taken for the highest where none that was tried is sustained."""

KILLED = "sar_compression"
KILLS = sized(3, 1)
FIRST_S, EVERY_S = sized((10.0, 14.0), (1.0, 5.0))

PASSES_S = sized(2.0, 0.5)
"""Time for which another program is in the domain before it kills the compression and ends without leaving: the new
process takes its ports."""

BACK_S, SEEN_S = sized((7.0, 5.0), (2.0, 2.0))
"""From a kill until heights are counted, and how long they are. The last start comes 2 s after the end."""


class _Kills:
    """Kills the compression again and again, and counts heights."""

    def __init__(self) -> None:
        self.killed_s: list[float] = []
        self.heights: list[tuple[float, int]] = []
        self._killer: subprocess.Popen[bytes] | None = None

    def show(self, watched: Watched) -> None:
        """Count heights, and kill if it is time."""
        now, number = watched.elapsed_s, len(self.killed_s)
        self.heights.append((now, len(watched.latencies_s["ml/height"])))
        due_s = FIRST_S + EVERY_S * number
        if self._killer is None and number < KILLS and now >= due_s:
            words = [sys.executable, "-m", __name__, "kill", str(watched.book.entries[KILLED].account.pid)]
            self._killer = subprocess.Popen(words)  # noqa: S603 (our own module)
        elif self._killer and self._killer.poll() is not None:
            self._killer = None
            self.killed_s.append(now)

    def counted(self) -> Iterator[float]:
        """Heights in a second, some time after each kill; 0 if the run ended before that was seen."""
        for killed_s in self.killed_s:
            inside = [seen for seen in self.heights if BACK_S <= seen[0] - killed_s <= BACK_S + SEEN_S]
            (first_s, first), (last_s, last) = (inside[0], inside[-1]) if inside else ((0.0, 0), (0.0, 0))
            yield (last - first) / (last_s - first_s) if last_s > first_s else 0.0
        yield from [0.0] * (KILLS - len(self.killed_s))


def killed_stage() -> Iterator[Row]:
    """The kill after which fewest heights come counts."""
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder, "seen.json")
        command = [sys.executable, "-m", __name__, "watch", str(result)]
        subprocess.run(command, check=True, env=ONE_THREAD | os.environ)  # noqa: S603 (our own module)
        seen = json.loads(result.read_text(encoding="utf-8"))
    rate, offered_hz, heights_hz = seen["rate"], seen["offered_hz"], seen["heights_hz"]
    yield Row(
        "heights after the compression was killed and started again",
        100 * min(heights_hz) / offered_hz,
        "% of dwells",
        ">= 95",
        f"{PRESET} at {rate:.2g} of its pace, {offered_hz:.1f} dwells/s; the fewest, from {BACK_S:g} to "
        f"{BACK_S + SEEN_S:g} s after each of {KILLS} kills: "
        + ", ".join(f"{hz:.1f}" for hz in heights_hz)
        + f"; {load()}",
    )


def _watch(result: Path) -> None:
    """Run a graph whose compression is killed again and again."""
    folder = result.parent
    bag = record_sensor(load_preset(PRESET), 1, folder / "sensor")
    rate = RATE or SHARE * (highest_rate(lambda tried: watch(bag, tried, SEARCH_S), FIRST_GUESS)[0] or LEAST_RATE)
    kills = _Kills()
    how = Live(rate, FIRST_S + EVERY_S * KILLS + BACK_S, supervised=True)
    watched = live(Feed.of_bag(bag), folder / "live", {}, how, Execution("host"), kills.show)
    seen = {"rate": rate, "offered_hz": watched.offered_hz, "heights_hz": list(kills.counted())}
    result.write_text(json.dumps(seen), encoding="utf-8")


def _pass_and_kill(process: int) -> None:
    """Be a node of the domain for a short time, kill a process, and end without leaving the domain."""
    graph = Graph()
    graph.add(Node("passer", context=graph.context))
    graph.spin_for(PASSES_S)
    os.kill(process, signal.SIGKILL)
    os._exit(0)


if __name__ == "__main__":
    if sys.argv[1] == "watch":
        _watch(Path(sys.argv[2]))
    else:
        _pass_and_kill(int(sys.argv[2]))
