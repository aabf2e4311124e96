"""A replay by the program, with a process for each node, all of which begin with what the program has imported."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any


def replayed(bag: Path, out: Path, *options: str) -> dict[str, Any]:
    """The report of a replay without losses, whose heights are those recorded unless parameters are given."""
    command = [sys.executable, "-m", "sal_height", "replay", str(bag), "--out", str(out), "--processes", *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)  # noqa: S603 (ours)
    assert done.returncode == 0, done.stdout + done.stderr
    report: dict[str, Any] = json.loads((out / "report.json").read_text())
    return report


def verdicts(report: dict[str, Any]) -> dict[str, tuple[str, int]]:
    """Verdict and number of the height images that were compared, by topic."""
    return {topic: (one["verdict"], one["matched"]) for topic, one in report["comparison"]["topics"].items()}
