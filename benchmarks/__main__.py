"""Measures all rows, prints them and writes bench.json; status 1 if one misses its target.

`python -m benchmarks WORD…` measures only the groups whose name holds a word, and leaves bench.json alone.
"""

from __future__ import annotations

import json
import os
import platform
import sys
from collections.abc import Callable, Iterator
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from benchmarks import (
    array_accuracy,
    array_estimator,
    backprojection,
    beam_calibration,
    calibration_accuracy,
    calibration_node,
    fast_formers,
    figures,
    layover,
    memory,
    psf,
    relief_map,
    relief_tracking,
)
from benchmarks.row import REPEATS, Row
from sal_height.numeric import WORKERS

GROUPS: dict[str, Callable[[], Iterator[Row]]] = {
    "fast-formers": fast_formers.against_fft,
    "backprojection": backprojection.throughput,
    "array-trials": array_estimator.against_random_numbers,
    "array-images": array_estimator.throughput,
    "array-node": array_estimator.node_over_core,
    "array-memory": memory.array_memory,
    "beam-calibration": beam_calibration.from_a_scene,
    "calibration-node": calibration_node.beside_compression,
    "accuracy-calibration": calibration_accuracy.left_of_errors,
    "layover": layover.throughput,
    "psf-targets": psf.target_route,
    "psf-both": psf.both_routes,
    "relief-map": relief_map.throughput,
    "relief-tracking": relief_tracking.throughput,
    "figures": figures.all_figures,
    "memory": memory.peak_memory,
    "accuracy-array": array_accuracy.against_theory,
    "accuracy-array-search": array_accuracy.against_dense_search,
    "accuracy-backprojection": backprojection.accuracy,
    "accuracy-fast-formers": fast_formers.against_backprojection,
}
"""All benchmarks: functions that measure rows. Add one here."""

RESULT = Path("bench.json")


def main(words: list[str]) -> int:
    """Measure, print, write; the exit status."""
    _print(machine())
    rows: list[Row] = []
    for name, measure in GROUPS.items():
        if not words or any(word in name for word in words):
            for row in measure():
                _print(line(row))
                rows.append(row)
    missed = sum(not row.ok for row in rows)
    _print(f"{len(rows) - missed} of {len(rows)} targets met{f', {missed} MISSED' if missed else ''}")
    if not words:
        RESULT.write_text(json.dumps([row.as_json() for row in rows], indent=1, ensure_ascii=False) + "\n", "utf-8")
        _print(f"wrote {RESULT}")
    return 1 if missed else 0


def line(row: Row) -> str:
    """The row as a line of the table, with what it refers to below."""
    unit = "" if row.unit == "1" else f" {row.unit}"
    verdict = "ok" if row.ok else "MISSED"
    return f"{row.name:55} {row.value:9.2f}{unit:15}  {row.target:>8}  {verdict}\n    {row.reference}"


def machine() -> str:
    """What it is measured on, and what else the machine has to do."""
    info = Path("/proc/cpuinfo")
    text = info.read_text(encoding="utf-8") if info.exists() else ""
    models = [entry.partition(":")[2].strip() for entry in text.splitlines() if entry.startswith("model name")]
    libraries = " ".join(_versions("numpy", "scipy", "numba", "pyfftw", "ducc0", "mkl_fft"))
    return (
        f"{models[0] if models else platform.machine()}, {WORKERS} processors, load {os.getloadavg()[0]:.1f}\n"
        f"Python {platform.python_version()}, {libraries}; medians of {REPEATS}, measured in turn"
    )


def _versions(*packages: str) -> Iterator[str]:
    for package in packages:
        try:
            yield f"{package} {version(package)}"
        except PackageNotFoundError:
            continue


def _print(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
