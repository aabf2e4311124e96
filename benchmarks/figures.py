"""The figures of the SAL paper: how long all of them take."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from benchmarks.row import Row
from sal_height.figures import DEFAULT_TRIALS
from sal_height.figures.catalogue import FIGURES, make_figures, summary


def all_figures() -> Iterator[Row]:
    """One run of `sal-height figures all` as it is by default, with the compilation of what is not compiled yet."""
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        checks = make_figures(list(FIGURES), Path(folder), DEFAULT_TRIALS, seed=1)
        seconds = time.perf_counter() - start
    yield Row(f"all figures of the paper, {DEFAULT_TRIALS} trials", seconds, "s", "<= 180", summary(checks))
