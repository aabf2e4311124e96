"""Picture of the latency of every node over the time of a live run, as the nodes published it on /diagnostics."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from sal_height.bag.reader import BagReader
from sal_height.graph.catalogue import HEIGHTS
from sal_height.io import writing
from sal_height.numeric import F64
from sal_height.picture import look_of, page
from sal_height.runs.replay.judge import published_latencies

LATENCIES = "latency.png"
"""File in the folder of a live run."""

OTHERS = (("black", "-"), ("black", "--"), ("0.5", "-"), ("0.5", "--"), ("black", ":"), ("0.5", ":"))
"""Colours and lines of nodes that make no heights."""


def draw_run(folder: Path) -> bool:
    """Draw latency.png of a live run in its `folder`, which has bag and report.json.

    Returns:
        True if any node has published its latency.

    Raises:
        UserError: the bag cannot be read, or the picture not be written.
    """
    latencies = published_latencies(BagReader(folder / "bag"))
    if latencies:
        budget_s = float(json.loads((folder / "report.json").read_text())["latency_budget_s"])
        with writing(folder / LATENCIES):
            draw_latencies(latencies, budget_s, folder / LATENCIES)
    return bool(latencies)


def _looks(nodes: Sequence[str]) -> dict[str, tuple[str, Any]]:
    """Colour and line of each node; a height node has those of its estimator."""
    kinds = {node: HEIGHTS.get(node.rpartition("/")[2]) for node in nodes}
    others = [node for node, prefix in kinds.items() if prefix is None]
    looks = {node: OTHERS[number % len(OTHERS)] for number, node in enumerate(others)}
    return looks | {node: look_of(prefix)[:2] for node, prefix in kinds.items() if prefix is not None}


def draw_latencies(latencies: Mapping[str, F64], budget_s: float, path: Path) -> None:
    """Write a PNG: median and 95th percentile of each node's latency over time, and the latency budget of a dwell."""
    looks = _looks(list(latencies))
    with page(path, 2.9) as figure:
        panels = figure.subplots(1, 2, sharex=True, sharey=True)
        for axes, row, title in zip(panels, (1, 2), ("median", "95th percentile"), strict=True):
            for node, published in latencies.items():
                colour, line = looks[node]
                axes.plot(published[0], published[row], color=colour, ls=line, label=node)
            axes.axhline(1e3 * budget_s, color="0.8", lw=2.5, label="budget of a dwell, for all nodes")
            axes.set(title=f"{title} of the last thousand dwells", xlabel="time (s)", yscale="log")
            axes.yaxis.set_major_formatter("{x:g}")
            axes.grid()
        panels[0].set_ylabel("latency (ms)")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
