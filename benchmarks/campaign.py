"""Campaigns: how much more two workers do than one, and what handing out the work takes."""

from __future__ import annotations

import dataclasses
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from distributed import Client, LocalCluster

from benchmarks.replaying import without_truth
from benchmarks.row import Row, load, sized
from sal_height.runs.campaign.batch import Campaign, Workers, attempt, run_campaign
from sal_height.runs.live.sensor_bag import record_sensor
from sal_height.simulation import load_preset
from sal_height.workers.processes import ONE_THREAD

PRESET, DWELLS, COPIES = sized(("sal_spotlight", 60, 16), ("small", 1, 2))
"""Number of times that a bag is processed, under another name each time."""

WORKERS = sized((1, 2), (1, 1))
"""Those that are compared."""

TASKS = sized(2000, 10)


def scaling() -> Iterator[Row]:
    """Time of a campaign by one worker over that by two, which run already and have processed a bag before."""
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        simulated = record_sensor(dataclasses.replace(load_preset(PRESET), dwells=DWELLS), 1, folder / "simulated")
        bag = without_truth(simulated, folder / "flight")
        taken_s = {workers: _campaign_s(bag, folder / str(workers), workers) for workers in set(WORKERS)}
        one_s, two_s = (taken_s[workers] for workers in WORKERS)
    yield Row(
        "batch on two workers over one",
        one_s / two_s,
        "1",
        ">= 1.8",
        f"{COPIES} bags of {DWELLS} dwells of {PRESET}: {one_s:.1f} s by one worker, {two_s:.1f} s by two; {load()}",
    )


def scheduling() -> Iterator[Row]:
    """Time that Dask takes for a task of a campaign in addition to the work itself."""
    address = "127.0.0.1:0"
    with (
        LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=address, env=ONE_THREAD) as cluster,
        Client(cluster) as client,
    ):
        client.submit(attempt, len, "", pure=False).result()
        began = time.monotonic()
        client.gather([client.submit(attempt, len, "", pure=False) for _ in range(TASKS)])
        task_s = (time.monotonic() - began) / TASKS
    yield Row("scheduling of a task", 1e3 * task_s, "ms", "<= 5", f"{TASKS} tasks without work by one worker; {load()}")


def _campaign_s(bag: Path, folder: Path, workers: int) -> float:
    """Time that a number of workers take, s; what they make is in the folder."""
    address = "127.0.0.1:0"
    with LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=address, env=ONE_THREAD) as cluster:
        hired = Workers(scheduler=cluster.scheduler_address)
        run_campaign(Campaign([bag] * 2 * workers), folder / "first", hired)
        began = time.monotonic()
        rows = run_campaign(Campaign([bag] * COPIES), folder / "out", hired)
        taken_s = time.monotonic() - began
    assert not any(row["failure"] or row["dropped"] for row in rows)  # noqa: S101 (it would be no measurement)
    return taken_s
