"""Progress of long work: a bar in a terminal, plain lines in a log."""

from __future__ import annotations

import sys
from typing import Any

from tqdm import tqdm

LINES_S = 10.0
"""Least time between two lines of a log, s; the first and the last state are always printed."""

LINE = "{desc}: {n_fmt} of {total_fmt} {unit} after {elapsed}{postfix}"


class Bar(tqdm):  # type: ignore[misc] # (tqdm has no types)
    """The bar of tqdm, with its arguments; where stderr is no terminal, lines without carriage returns."""

    monitor_interval = 0  # no thread that refreshes slow bars: it would prevent `workers.processes.Forked`

    def __init__(self, *args: Any, **options: Any) -> None:
        if not sys.stderr.isatty():
            options |= {"file": Lines(), "bar_format": LINE, "mininterval": LINES_S, "miniters": 1, "position": 0}
        super().__init__(*args, **options)


class Lines:
    """Output of a bar in which each state is a line of stderr."""

    def write(self, text: str) -> None:
        """Write the state without what moves the cursor."""
        if state := text.strip():
            sys.stderr.write(f"{state}\n")

    def flush(self) -> None:
        """Flush stderr."""
        sys.stderr.flush()
