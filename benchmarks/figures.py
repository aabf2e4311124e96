"""The figures of the papers: how long all of them take."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from benchmarks.row import Row, sized
from sal_height.figures import DEFAULT_TRIALS
from sal_height.figures.paper_figures import FIGURES, make_figures, summary

NAMES = sized(list(FIGURES), ["fig3"])


def all_figures() -> Iterator[Row]:
    """One run of `sal-height figures all` as it is by default, with the compilation of what is not compiled yet."""
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        checks = make_figures(NAMES, Path(folder), DEFAULT_TRIALS, seed=1)
        seconds = time.perf_counter() - start
    yield Row(f"all figures of the papers, {DEFAULT_TRIALS} trials", seconds, "s", "<= 180", summary(checks))
