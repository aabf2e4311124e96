"""The core alone on all processors: the functions of the pipeline on the dwells of a bag, without any message.

`python -m benchmarks.core_limit BAG SECONDS` runs one process of it: it says "ready", begins when it reads a line, and
prints its dwells and the processor time that they took (s).
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from benchmarks.row import sized
from sal_height import messages
from sal_height.bag.reader import BagReader
from sal_height.elevation import ESTIMATORS
from sal_height.geometry import Trajectory
from sal_height.graph.catalogue import TRACKER, consumers, parameters_of, suited
from sal_height.graph.reporting import merged
from sal_height.nodes.playing.playlist import Playlist
from sal_height.numeric import WORKERS
from sal_height.pipeline import Compressor, heights
from sal_height.relief import PriorEstimate, ReliefMap, track
from sal_height.relief.map import fitting_cell_size
from sal_height.runs.chain.entry import contents
from sal_height.runs.chain.recorded_parameters import recorded_parameters
from sal_height.sensor import PhaseHistory
from sal_height.workers.processes import ONE_THREAD

MAPPER, MOST_CELLS = "relief_mapper", 4_000_000
"""Node that averages the heights of all dwells, and the greatest number of cells of its map."""

ALL = sized(WORKERS, 1)
"""Processes that keep all processors busy."""


@dataclass(frozen=True)
class CoreRate:
    """Rate and processor time of the core.

    Attributes:
        dwells_hz: dwells in a second.
        cpu_s: processor time of a dwell, s.
        stages_s: the same by name of the node that does this part of the work, s.
    """

    dwells_hz: float
    cpu_s: float
    stages_s: dict[str, float]


def core_rate(bag: Path, seconds: float, processes: int = ALL) -> CoreRate:
    """Rate and processor time of several processes at the same time, each with one thread.

    Args:
        bag: bag of what the sensor delivers.
        seconds: duration, s.
        processes: number of processes.
    """
    command = [sys.executable, "-m", "benchmarks.core_limit", str(bag), str(seconds)]
    started = [
        subprocess.Popen(  # noqa: S603 (our own module)
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env={**os.environ, **ONE_THREAD}
        )
        for _ in range(processes)
    ]
    for process in started:
        if process.stdout is None or process.stdout.readline() != "ready\n":
            raise RuntimeError(f"The core on its own failed: {' '.join(command)}")
    for process in started:
        if process.stdin:
            process.stdin.write("begin\n")
            process.stdin.flush()
    results = [json.loads(process.communicate()[0]) for process in started]
    dwells = sum(result["dwells"] for result in results)
    names = results[0]["stages_s"]
    stages_s = {name: sum(result["stages_s"][name] for result in results) / dwells for name in names}
    rate = sum(result["dwells"] / result["wall_s"] for result in results)
    return CoreRate(rate, sum(stages_s.values()), stages_s)


class Core:
    """The core as the nodes of a live graph call it; `stages_s` is the processor time of each so far, s."""

    def __init__(self, bag: Path) -> None:
        """Read what a sensor delivers."""
        reader = BagReader(bag)
        playlist = Playlist.of_bag(reader, float("inf"))
        self._sensor, _ = contents(reader)
        nodes = suited(self._sensor)
        values = merged(consumers(nodes), recorded_parameters(reader))
        self._settings = {n: parameters_of(n, values.get(n, {})) for n in ("sar_compression", *nodes, TRACKER)}
        self._estimators = {name: next(one for one in ESTIMATORS.values() if one.node == name) for name in nodes}
        self._followed = ESTIMATORS[self._settings[TRACKER].estimator].node
        self._track = Trajectory([messages.state_from_message(message) for message in playlist.odometry])
        self.dwells = [messages.history_from_messages(frames) for frames in playlist.frames()]
        self._compressor, self._prior = Compressor(), PriorEstimate()
        self._map: ReliefMap | None = None
        self.stages_s = dict.fromkeys(("sar_compression", *nodes, TRACKER, MAPPER), 0.0)

    def process(self, history: PhaseHistory) -> None:
        """All that the graph does with a dwell."""
        began = time.process_time()

        def lap(name: str) -> None:
            nonlocal began
            now = time.process_time()
            self.stages_s[name] += now - began
            began = now

        slc = self._compressor.add(history, self._track, self._sensor, self._settings["sar_compression"])
        lap("sar_compression")
        if slc is None:
            return
        for name, estimator in self._estimators.items():
            made = heights(slc, self._sensor, estimator, self._settings[name])
            if name == self._followed:
                field = made
            lap(name)
        _, _, self._prior = track(field, slc.aperture, self._prior, self._settings[TRACKER])
        lap(TRACKER)
        if self._map is None:
            self._map = ReliefMap(fitting_cell_size(field.grid, slc.aperture), MOST_CELLS)
        self._map.add(field)
        lap(MAPPER)

    def begin_anew(self) -> None:
        """Expect the first dwell again: blocks of a strip follow each other."""
        self._compressor = Compressor()


def _measure(bag: Path, seconds: float) -> None:
    core = Core(bag)
    for history in core.dwells:  # so that all is compiled, and all tables are made
        core.process(history)
    core.stages_s = dict.fromkeys(core.stages_s, 0.0)
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    sys.stdin.readline()
    dwells, began = 0, time.monotonic()
    while time.monotonic() - began < seconds:
        core.begin_anew()
        for history in core.dwells:
            core.process(history)
        dwells += len(core.dwells)
    result = {"dwells": dwells, "wall_s": time.monotonic() - began, "stages_s": core.stages_s}
    sys.stdout.write(json.dumps(result) + "\n")


if __name__ == "__main__":
    _measure(Path(sys.argv[1]), float(sys.argv[2]))
