"""Writes what `python -m benchmarks real-time growth` has measured into docs/size_your_computer.md and its picture.

    python -m benchmarks real-time growth --out bench.json
    python -m benchmarks.sizing bench.json

The text around the tables stays as it is: each table stands between two comments that name it.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from scipy.optimize import nnls

DOCUMENT = Path(__file__).parents[1] / "docs" / "size_your_computer.md"
PICTURE = DOCUMENT.with_name("growth.png")

Numbers = Mapping[str, Any]

SHOWN = 15
"""Characters that Linux shows of the name of a process."""

MODEL: Mapping[str, Mapping[str, Callable[[Numbers], float]]] = {
    "compression": {
        "dwell": lambda _: 1.0,
        "detector · pulse · sample": lambda p: p["detectors"] * p["samples"],
    },
    "monopulse": {
        "dwell": lambda _: 1.0,
        "pixel": lambda p: p["pixels"],
        "pixel · look · detector²": lambda p: p["pixels"] * p["looks"] * p["detectors"] ** 2,
    },
    "ml": {
        "dwell": lambda _: 1.0,
        "pixel": lambda p: p["pixels"],
        "pixel · look · detector²": lambda p: p["pixels"] * p["looks"] * p["detectors"] ** 2,
        "pixel · detector³": lambda p: p["pixels"] * p["detectors"] ** 3,
    },
    **{
        stage: {
            "dwell": lambda p: p["dwells"],
            "pixel": lambda p: p["dwells"] * p["pixels"],
        }
        for stage in ("tracker", "map", "ground")
    },
}
"""Parts of the time of each stage: units of work by name, and how many of them a measured point has."""


def constants(points: Mapping[str, Sequence[Numbers]]) -> dict[str, dict[str, float]]:
    """Processor time of each unit of work, s: non-negative, of the least relative errors over all points of a stage."""
    found = {}
    for stage, units in MODEL.items():
        if stage in points:
            seconds = np.array([point["seconds"] for point in points[stage]])
            work = np.array([[count(point) for count in units.values()] for point in points[stage]])
            scale = work.max(axis=0)
            times, _ = nnls(work / scale / seconds[:, None], np.ones(len(seconds)))
            found[stage] = dict(zip(units, (times / scale).tolist(), strict=True))
    return found


def tables(rows: Sequence[Numbers]) -> dict[str, str]:
    """The tables of the document by their names, as far as they have been measured."""
    graphs = [row["details"] for row in rows if row["name"].startswith("real time, ")]
    transports = {
        row["details"]["preset"]: row["details"] for row in rows if row["name"].startswith("real time over the limit, ")
    }
    points: dict[str, list[Numbers]] = {}
    for row in rows:
        if row["group"] == "growth":
            points.setdefault(row["details"]["stage"], []).extend(row["details"]["points"])
    made: dict[str, str] = {}
    speedups = [row["details"]["speedup"] for row in rows if "speedup" in row.get("details", {})]
    measured = [(graph, transports[graph["preset"]]) for graph in graphs if graph["preset"] in transports]
    if measured:
        made |= {
            "cores": _cores(measured),
            "processes": _processes(graphs),
            "transport": _transport(measured, speedups),
        }
    if points:
        made["constants"] = _constants(constants(points))
    return made


def _cores(measured: Sequence[tuple[Numbers, Numbers]]) -> str:
    head = (
        "preset",
        "dwells/s",
        "processors",
        "of these core",
        "transport",
        "cold caches, shared cores",
        "memory (GB)",
        "in (MB/s)",
        "recorded (MB/s)",
        "rate on this machine",
    )
    lines = []
    for graph, idle in measured:
        hz = graph["dwells_hz"]
        used, core, transport = (
            hz * sum(values.values())
            for values in (graph["cpu_s_per_dwell"], graph["core_s_per_dwell"], idle["transport_cpu_s_per_dwell"])
        )
        lines.append(
            (
                f"`{graph['preset']}`",
                f"{hz:.3g}",
                f"{used:.2g}",
                f"{core:.2g}",
                f"{transport:.2g}",
                f"{max(0.0, used - core - transport):.2g}",
                f"{1e-9 * graph['memory_bytes']:.1f}",
                f"{1e-6 * hz * graph['frame_bytes_per_dwell']:.3g}",
                f"{1e-6 * hz * graph['recorded_bytes_per_dwell']:.3g}",
                f"{graph['rate']:.2f}" if graph["rate"] < 1 else f"{graph['rate']:.0f}",
            )
        )
    return _table(head, lines)


def _processes(graphs: Sequence[Numbers]) -> str:
    names = list(dict.fromkeys(name for graph in graphs for name in graph["cpu_s_per_dwell"]))
    whole = {name[:SHOWN]: name for graph in graphs for name in graph["core_s_per_dwell"]}

    def line(name: str) -> tuple[str, ...]:
        times = (1e3 * graph["cpu_s_per_dwell"].get(name, 0.0) for graph in graphs)
        return f"`{whole.get(name, name)}`", *(f"{time:.1f}" for time in times)

    lines = [line(name) for name in names]
    return _table(("ms of a processor for a dwell", *(f"`{graph['preset']}`" for graph in graphs)), lines)


def _transport(measured: Sequence[tuple[Numbers, Numbers]], speedups: Sequence[float]) -> str:
    """Processor time of a message and of a MB of phase history, of the least relative errors; and two factors."""
    work = np.array([[graph["messages_per_dwell"], 1e-6 * graph["frame_bytes_per_dwell"]] for graph, _ in measured])
    seconds = np.array([sum(idle["transport_cpu_s_per_dwell"].values()) for _, idle in measured])
    (message, megabyte), _ = nnls(work / seconds[:, None], np.ones(len(seconds)))
    factors = [
        (sum(graph["cpu_s_per_dwell"].values()) - sum(idle["transport_cpu_s_per_dwell"].values()))
        / sum(graph["core_s_per_dwell"].values())
        for graph, idle in measured
    ]
    lines = [
        ("transport: a message of the sensor (frame or odometry)", f"{1e3 * message:.2g} ms"),
        ("transport: a MB of phase history", f"{1e3 * megabyte:.2g} ms"),
        ("F: processor time of the core in a running graph over that alone", _spread(factors)),
    ]
    if speedups:
        lines.append(("work of all processors of this machine over that of one", _spread(speedups)))
    return _table(("what", "measured"), lines)


def _spread(values: Sequence[float]) -> str:
    return f"{np.median(values):.2g} ({min(values):.2g} to {max(values):.2g})"


def _constants(found: Mapping[str, Mapping[str, float]]) -> str:
    lines = [(stage, unit, _time(value)) for stage, units in found.items() for unit, value in units.items() if value]
    return _table(("stage", "for each", "processor time"), lines)


def _time(seconds: float) -> str:
    for scale, unit in ((1e3, "ms"), (1e6, "µs"), (1e9, "ns")):
        if seconds * scale >= 1:
            return f"{seconds * scale:.3g} {unit}"
    return f"{seconds * 1e12:.3g} ps"


def _table(head: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    return "\n".join(f"| {' | '.join(line)} |" for line in (head, ["---"] * len(head), *lines))


def draw(rows: Sequence[Numbers], path: Path) -> None:
    """Every curve of the group growth, with its law as a dotted line through its last point."""
    mpl.use("Agg")
    curves = [row["details"] for row in rows if row["group"] == "growth"]
    panels = list(dict.fromkeys(curve["over"] for curve in curves))
    picture = Figure(figsize=(4.2 * len(panels), 4.2), layout="constrained")
    for panel, over in zip(picture.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        for number, curve in enumerate(curve for curve in curves if curve["over"] == over):
            x = np.array([point[over] for point in curve["points"]], dtype=np.float64)
            y = 1e3 * np.array([point["seconds"] for point in curve["points"]])
            panel.loglog(x, y, ".-", color=f"C{number}", label=f"{curve['stage']}, law {curve['law']:g}")
            panel.loglog(x, y[-1] * (x / x[-1]) ** curve["law"], ":", color=f"C{number}", linewidth=0.8)
        panel.set(title=f"with {over}", xlabel=over)
        panel.grid(alpha=0.3)
        panel.legend(fontsize="x-small")
    picture.axes[0].set_ylabel("processor time (ms)")
    picture.savefig(path, dpi=110)


def filled(text: str, made: Mapping[str, str]) -> str:
    """The document with the tables that have been made in the places of the old ones.

    Raises:
        ValueError: the document has no place for one.
    """
    for name, table in made.items():
        place = re.compile(rf"(<!-- measured: {name} -->\n).*?(<!-- end -->)", re.DOTALL)
        if not place.search(text):
            raise ValueError(f"{DOCUMENT.name} has no place for the table {name!r}.")
        text = place.sub(lambda match, table=table: f"{match[1]}\n{table}\n\n{match[2]}", text)  # type: ignore[misc]
    return text


def main(results: Path) -> None:
    """Bring document and picture up to date with a file of results."""
    rows = json.loads(results.read_text(encoding="utf-8"))
    DOCUMENT.write_text(filled(DOCUMENT.read_text(encoding="utf-8"), tables(rows)), encoding="utf-8")
    if any(row["group"] == "growth" for row in rows):
        draw(rows, PICTURE)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
