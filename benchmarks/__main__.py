"""Measures speed, memory and accuracy against their targets: `python -m benchmarks --help`."""

from __future__ import annotations

import json
import os
import platform
import sys
import traceback
from collections.abc import Iterator, Sequence
from fnmatch import fnmatchcase
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

from benchmarks.row import QUICK, Row

GROUPS = {
    "fast-formers": "fast_formers:against_fft",
    "backprojection": "backprojection:throughput",
    "array-trials": "array_estimator:against_random_numbers",
    "array-images": "array_estimator:throughput",
    "small-dwell": "small_dwell:against_large_images",
    "array-node": "array_estimator:node_over_core",
    "array-memory": "memory:array_memory",
    "beam-calibration": "beam_calibration:from_a_scene",
    "calibration-node": "calibration_node:beside_compression",
    "accuracy-calibration": "calibration_accuracy:left_of_errors",
    "layover": "layover:throughput",
    "honest": "honest:coverage",
    "honest-maps": "honest_maps:coverage",
    "honest-offsets": "honest_maps:offsets",
    "fit": "goodness_of_fit:found",
    "emitters": "narrow_band:found",
    "trials": "calibration_trials:refused",
    "platform": "imperfect_platform:coverage",
    "adjustment": "adjusting:brought_together",
    "passes": "several_passes:coverage",
    "movers": "moving:found_without_being_told",
    "psf-targets": "psf:target_route",
    "psf-both": "psf:both_routes",
    "accuracy-superposition": "superposition:false_alarms",
    "superposition-power": "superposition:power",
    "relief-map": "relief_map:throughput",
    "ground": "ground:throughput",
    "exports": "exporting:exports",
    "imports": "importing:imports",
    "relief-tracking": "relief_tracking:throughput",
    "bag-files": "recording:over_mcap",
    "bag-info": "recording:info_of_a_large_bag",
    "recorder": "recording:recorded_at_a_rate",
    "replay": "replaying:over_core",
    "large-bag": "large_bag:replay_memory",
    "batch": "campaign:scaling",
    "batch-tasks": "campaign:scheduling",
    "start-up": "start_up:first_height",
    "late-node": "late_node:late_node",
    "restarted-node": "late_node:restarted_node",
    "killed-stage": "killed_stage:killed_stage",
    "real-time": "real_time:sustained",
    "endurance": "real_time:endurance",
    "figures": "figures:all_figures",
    "growth": "growth:growth",
    "simulator": "simulator:over_transforms",
    "memory": "memory:peak_memory",
    "accuracy-array": "array_accuracy:against_theory",
    "accuracy-array-search": "array_accuracy:against_dense_search",
    "accuracy-backprojection": "backprojection:accuracy",
    "accuracy-fast-formers": "fast_formers:against_backprojection",
}
"""All groups of benchmarks: module and function that yields rows. Add one here."""

app = App(name="python -m benchmarks", help_format="plaintext", default_parameter=Parameter(negative=()))


@app.default
def benchmarks(
    groups: Annotated[tuple[str, ...], Parameter(name="GROUP", show_default=False)] = (),
    /,
    *,
    out: Annotated[Path, Parameter(metavar="FILE")] = Path("bench.json"),
    list_groups: Annotated[bool, Parameter(name="--list", show_default=False)] = False,
    quick: Annotated[bool, Parameter(show_default=False)] = False,
) -> int:
    """Measure speed, memory and accuracy, and print each number beside its target.

    Rows are written to the file as they come. The exit status is 1 if a target is missed or a group failed.

    Args:
        groups: Groups to measure; * stands for any text. Default: all.
        out: File of the results.
        list_groups: List the groups instead.
        quick: Try out one row of each group at a small size; its number means nothing, and the exit status is 1 only
            if a group fails.
    """
    chosen = [name for name in GROUPS if not groups or any(fnmatchcase(name, group) for group in groups)]
    unknown = [group for group in groups if not any(fnmatchcase(name, group) for name in GROUPS)]
    if unknown:
        sys.stderr.write(f"There is no group {', '.join(unknown)}; --list shows all groups.\n")
        return 2
    if list_groups:
        _print("\n".join(chosen))
        return 0
    if quick:
        os.environ[QUICK] = "1"  # before the groups are imported, and for their child processes
    return _measure(chosen, out, quick)


def _measure(chosen: Sequence[str], out: Path, quick: bool) -> int:
    """Measure groups, print and write their rows as they come; the exit status."""
    _print(machine())
    entries: list[dict[str, object]] = []
    failed = []
    for name in chosen:
        try:
            for row in rows_of(name):
                entries.append({"group": name, **row.as_json()})
                out.write_text(json.dumps(entries, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
                _print(line(row))
                if quick:
                    break
        except Exception:  # noqa: BLE001 (the other groups are still of interest)
            failed.append(name)
            _print(traceback.format_exc())
    missed = sum(not entry["ok"] for entry in entries)
    _print(f"{len(entries) - missed} of {len(entries)} targets met{f', {missed} MISSED' if missed else ''}; see {out}")
    if failed:
        _print(f"FAILED: {', '.join(failed)}")
    return 1 if failed or (missed and not quick) else 0


def rows_of(group: str) -> Iterator[Row]:
    """The rows of a group, each measured when it is asked for."""
    module, function = GROUPS[group].split(":")
    rows: Iterator[Row] = getattr(import_module(f"benchmarks.{module}"), function)()
    return rows


def line(row: Row) -> str:
    """The row as a line of the table, with what it refers to below."""
    unit = "" if row.unit == "1" else f" {row.unit}"
    verdict = "ok" if row.ok else "MISSED"
    return f"{row.name:55} {row.value:9.2f}{unit:15}  {row.target:>8}  {verdict}\n    {row.reference}"


def machine() -> str:
    """The machine that is measured on, its load, and the versions that matter for speed."""
    from sal_height.numeric import WORKERS  # noqa: PLC0415 (--help and --list need no NumPy)

    info = Path("/proc/cpuinfo")
    text = info.read_text(encoding="utf-8") if info.exists() else ""
    models = [entry.partition(":")[2].strip() for entry in text.splitlines() if entry.startswith("model name")]
    libraries = " ".join(f"{package} {version(package)}" for package in ("numpy", "scipy", "numba"))
    return (
        f"{models[0] if models else platform.machine()}, {WORKERS} processors, load {os.getloadavg()[0]:.1f}\n"
        f"Python {platform.python_version()}, {libraries}; medians of repeated measurements, taken in turn"
    )


def _print(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(app(result_action="return_value"))
