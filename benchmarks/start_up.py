"""From the command to the first height: every node in a process of its own, bytecode and numba's cache kept."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from benchmarks.row import Row, sized

PRESETS = sized(("sal_spotlight", "sal_stripmap"), ("small",))
STARTS = sized(5, 1)
WARM_UP = sized(1, 0)
"""Starts before those that count: the first one may compile."""

RATE = 0.1
"""Seconds of the sensor in a second, at which no dwell is left out."""

STEPS = {
    "tables": "imports and tables",
    "dwells": "what is left to simulate",
    "ready": "nodes",
    "first height": "first dwell",
}
"""Steps of the start that `live` reports, and the causes of the time from one to the next."""


def first_height() -> Iterator[Row]:
    """The fastest start counts: every start takes at least as long, and longer on a machine with other work."""
    for name in PRESETS:
        with tempfile.TemporaryDirectory() as folder:
            starts = [_start(name, Path(folder, str(number))) for number in range(WARM_UP + STARTS)]
        best = min(starts[WARM_UP:], key=lambda start: start["first height"])
        ends = [0.0, *(best[step] for step in STEPS)]
        parts = ", ".join(
            f"{what} {end - begin:.2f} s" for what, begin, end in zip(STEPS.values(), ends, ends[1:], strict=False)
        )
        yield Row(
            f"start to the first height of sal-height live, {name}",
            best["first height"],
            "s",
            "<= 3",
            f"the fastest of {STARTS} starts, load {os.getloadavg()[0]:.1f}: {parts}",
        )


def _start(preset: str, out: Path) -> dict[str, float]:
    """Start a live graph in an interpreter of its own, and end it; the times that its report states."""
    words = ["live", "--preset", preset, "--rate", str(RATE), "--seconds", "1", "--out", str(out)]
    keeping = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    command = [sys.executable, "-m", "sal_height", *words]
    subprocess.run(command, check=True, capture_output=True, env=keeping)  # noqa: S603 (our own program)
    start: dict[str, float] = json.loads((out / "run" / "report.json").read_text(encoding="utf-8"))["start_s"]
    return start
