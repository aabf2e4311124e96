"""The table that `sal-height live` shows: rate, latency and drops of every node."""

from __future__ import annotations

import numpy as np
from rich.console import Group
from rich.table import Table

from sal_height.nodes.account import ACHIEVED, LATENCY_P50, LATENCY_P95, OFFERED
from sal_height.runs.conductor import RECORDER
from sal_height.runs.live import SOURCE, Watched


def live_table(watched: Watched) -> Group:
    """What has been seen of a live graph."""
    table = Table(title=f"{watched.elapsed_s:.0f} s, the sensor delivers {watched.offered_hz:.3g} dwells/s")
    for name, side in (("node", "left"), ("offered/s", "right"), ("achieved/s", "right"), ("p50 ms", "right")):
        table.add_column(name, justify=side)  # type: ignore[arg-type]
    for name in ("p95 ms", "CPU s/s"):
        table.add_column(name, justify="right")
    table.add_column("left out")
    for name, account in watched.accounts.items():
        if name in {SOURCE, RECORDER}:
            continue
        numbers = [account.numbers.get(key) for key in (OFFERED, ACHIEVED, LATENCY_P50, LATENCY_P95)]
        texts = ["" if number is None else f"{number:.1f}" for number in numbers]
        drops = ", ".join(f"{reason}: {count}" for reason, count in {**account.dropped, **account.ignored}.items())
        table.add_row(name, *texts, f"{watched.cpu_per_second(name):.2f}", drops)
    ages = Table(title="from the last pulse to the heights, ms")
    for name in ("topic", "images", "p50", "p95", "p99.9"):
        ages.add_column(name, justify="left" if name == "topic" else "right")
    for topic, values in watched.latencies_s.items():
        if values:
            percentiles = 1e3 * np.percentile(values, [50, 95, 99.9])
            ages.add_row(topic, f"{len(values)}", *(f"{value:.1f}" for value in percentiles))
    return Group(table, ages)
