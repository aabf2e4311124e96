"""The graph beside a sensor that does not wait: `sal-height live`, with every node in a process of its own.

The sensor is played from memory. Besides heights and diagnostics, its phase history is recorded.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.row import Row, sized
from sal_height.bag.reader import BagReader
from sal_height.elevation import ESTIMATORS
from sal_height.imaging import ImageSettings
from sal_height.nodes.account import CPU
from sal_height.nodes.playlist import Playlist
from sal_height.pipeline import Compressor, heights
from sal_height.relief import PriorEstimate, track
from sal_height.runs.conductor import Execution
from sal_height.runs.ensemble import suited
from sal_height.runs.live import SOURCE, Live, Watched, live
from sal_height.runs.sensor_bag import record_sensor
from sal_height.simulation import Preset, SimulatedFlight, flight_of, load_preset

PRESETS = ("sal_spotlight", "sal_stripmap", "xband_relief", "xband_sumdiff")

DWELLS = sized(32, 4)
SECONDS = sized(20.0, 2.0)
LONG_SECONDS = sized(60.0, 2.0)

TRIALS = sized(6, 1)
"""Rates that are tried at most."""

STEP = 0.7
"""From one rate that is tried to the next."""

SLOWEST_RATE_HZ = 20.0
"""Sensors that deliver fewer dwells in a second are played faster: 20 s would not hold enough of them."""


def sustained() -> Iterator[Row]:
    """The highest rate at which no dwell is left out; what the graph takes beside the core; latency at half of it."""
    for name in PRESETS:
        preset = replace(load_preset(name), dwells=DWELLS)
        with tempfile.TemporaryDirectory() as folder:
            bag = record_sensor(preset, 1, Path(folder, "sensor"))
            rate_hz = Playlist.of_bag(BagReader(bag), np.inf).dwell_rate_hz
            rate, seen = _sustained_rate(bag, Path(folder), max(1.0, SLOWEST_RATE_HZ / rate_hz))
            core = core_of(flight_of(preset, 1), preset)
            load = _load(seen)
            yield Row(
                f"real time, {name}",
                0.0 if _left_out(seen) else rate,
                "1",
                ">= 1",
                f"seconds of the sensor in a second without any drop, {SECONDS:g} s long; the sensor delivers "
                f"{rate_hz:.3g} dwells/s; processor seconds per second: {load}",
            )
            used = sum(_cpu(seen, node) for node in seen.accounts if node != SOURCE) * seen.elapsed_s
            dwells = max(seen.accounts["sar_compression"].numbers["processed"] / preset.sensor.detectors, 1)
            yield Row(
                f"graph in separate processes over the core, {name}",
                used / dwells / core,
                "1",
                "<= 1.25",
                f"processor time a dwell: {1e3 * used / dwells:.1f} ms in all nodes but the source, "
                f"{1e3 * core:.1f} ms in the core alone",
            )
            slow = _watch(bag, Path(folder, "half"), rate / 2, LONG_SECONDS)
            yield from _latency(name, slow, rate / 2)


def _sustained_rate(bag: Path, folder: Path, most: float) -> tuple[float, Watched]:
    """The highest rate of those tried, `most` first, at which no dwell is left out, or the last; and what was seen."""
    for trial in range(TRIALS):
        rate = most * STEP**trial
        seen = _watch(bag, folder / f"trial_{trial}", rate, SECONDS)
        if not _left_out(seen):
            break
    return rate, seen


def _left_out(seen: Watched) -> int:
    """Messages that any node has dropped."""
    return sum(sum(account.dropped.values()) for account in seen.accounts.values())


def _watch(bag: Path, folder: Path, rate: float, seconds: float) -> Watched:
    execution = Execution(processes=True, record=("phase_history",))
    return live(bag, folder, {}, Live(rate, seconds), execution, lambda _: None)


def _cpu(seen: Watched, node: str) -> float:
    return seen.cpu_per_second(node) if CPU in seen.accounts[node].numbers else 0.0


def _load(seen: Watched) -> str:
    return ", ".join(f"{node} {_cpu(seen, node):.2f}" for node in seen.accounts if _cpu(seen, node))


def _latency(name: str, seen: Watched, rate: float) -> Iterator[Row]:
    """From the last pulse of a dwell to its heights."""
    for topic, ages in seen.latencies_s.items():
        p50, p95, p999 = 1e3 * np.percentile(ages, [50, 95, 99.9]) if ages else 3 * [np.nan]
        budget = 1e3 * max(0.2, 3 / seen.offered_hz)
        yield Row(
            f"latency of {topic}, {name}, p99.9",
            p999,
            "ms",
            f"<= {budget:.0f}",
            f"at a rate of {rate:.2f} for {seen.elapsed_s:.0f} s, {len(ages)} images; p50 {p50:.1f}, p95 {p95:.1f} ms",
        )


def core_of(flight: SimulatedFlight, preset: Preset) -> float:
    """Median processor time of the core for a dwell, all default steps, s."""
    images = ImageSettings(rows=preset.image.rows, cols=preset.image.cols)
    estimators = {e.node: e for e in ESTIMATORS.values()}
    chosen = [estimators[node] for node in suited(flight.sensor, preset.estimators)]
    compressor, prior, times = Compressor(), PriorEstimate(), []
    for dwell in range(preset.dwells):
        history, states = flight.phase_history(dwell), flight.track(dwell)
        began = time.process_time()
        slc = compressor.add(history, states, flight.sensor, images)
        if slc is None:
            continue
        for estimator in chosen:
            settings = estimator.settings(range_looks=preset.looks[0], azimuth_looks=preset.looks[1])
            field = heights(slc, flight.sensor, estimator, settings)
            if estimator.name == "ml":
                _, _, prior = track(field, slc.aperture, prior)
        times.append(time.process_time() - began)
    return float(np.median(times))
