"""The graph beside a sensor that does not wait: `sal-height live`, in the live host.

The sensor is played from memory. Besides heights and diagnostics, its phase history is recorded. What the graph
sustains is set against the two limits of the machine, measured in the same run: transport alone (the same player,
recorder and messages, with nodes that do nothing), and the core alone (the functions of the pipeline on all processors,
without messages).
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.core_limit import CoreRate, core_rate
from benchmarks.live_runs import Nodes, Seen, highest_rate, watch
from benchmarks.row import Row, load, sized
from sal_height.bag.described import FRAMES
from sal_height.bag.reader import BagReader
from sal_height.nodes.playing.playlist import Playlist
from sal_height.nodes.processing import PROCESSING
from sal_height.numeric import WORKERS
from sal_height.runs.live.sensor_bag import record_sensor
from sal_height.simulation import load_preset

PRESETS = sized(("sal_spotlight", "sal_stripmap", "sal_realistic", "xband_relief", "xband_sumdiff"), ("small",))
ENDURANCE = sized("sal_spotlight", "small")

DWELLS = sized(32, 2)
SECONDS = sized(20.0, 1.2)
CORE_SECONDS = sized(10.0, 0.2)
LATENCY_SECONDS = sized(60.0, 2.0)
ENDURANCE_SECONDS = sized(600.0, 2.0)
MINUTE_S = sized(60.0, 0.6)

ENDURING = sized(Nodes.HOST, Nodes.TOGETHER)
"""Processes of the graph whose endurance is measured."""

SEARCHED = sized(True, False)
"""True if the rate of endurance is searched for."""

OVERLOAD = 1.4
"""Rate at overload, over the highest that is sustained."""

NEARLY = 0.9
"""Rate at which the latency is measured, over the highest that is sustained."""

SHARE_OF_CORE = sized(0.4, 0.05)
"""Rate that is tried first, over that of the core alone."""


@dataclass(frozen=True)
class Sensor:
    """A sensor as a bag, and what the core achieves on its dwells.

    Attributes:
        name: name of its preset.
        bag: bag of what it delivers.
        dwells_hz: dwells in a second.
        frame_bytes: size of the phase history of a dwell, bytes.
        messages: frames and odometry of a dwell.
        core: rate and processor time of the core.
    """

    name: str
    bag: Path
    dwells_hz: float
    frame_bytes: float
    messages: float
    core: CoreRate

    @classmethod
    def of_preset(cls, name: str, folder: Path) -> Sensor:
        """Simulate the dwells of a preset, and measure the core."""
        bag = record_sensor(replace(load_preset(name), dwells=DWELLS), 1, folder / "sensor")
        playlist = Playlist.of_bag(BagReader(bag), np.inf)
        frame_bytes = sum(len(item.cdr) for item in playlist.items if item.topic == FRAMES) / playlist.dwells
        messages = len(playlist.items) / playlist.dwells
        return cls(name, bag, playlist.dwell_rate_hz, frame_bytes, messages, core_rate(bag, CORE_SECONDS))

    @property
    def core_rate(self) -> float:
        """Seconds of the sensor in a second that the core alone processes on all processors."""
        return self.core.dwells_hz / self.dwells_hz

    @property
    def first_guess(self) -> float:
        """Rate that is tried first."""
        return SHARE_OF_CORE * self.core_rate

    def half_of(self, rate: float) -> float:
        """Half of the rate that is sustained; of a low guess, if none that was tried is."""
        return rate / 2 if rate else self.first_guess / 10

    def sustained(self) -> tuple[float, Seen]:
        """The highest rate at which no dwell is left out, and what was seen at it."""
        return highest_rate(lambda rate: watch(self.bag, rate, SECONDS), self.first_guess)

    def transported(self, guess: float) -> tuple[float, Seen]:
        """The highest rate at which nodes that do nothing leave no dwell out, and what was seen at it."""
        return highest_rate(lambda rate: watch(self.bag, rate, SECONDS, Nodes.IDLE), guess)


def sustained() -> Iterator[Row]:
    """The highest rate without any drop; its share of the limits; the graph over the core; overload; latency."""
    for name in PRESETS:
        with tempfile.TemporaryDirectory() as folder:
            sensor = Sensor.of_preset(name, Path(folder))
            rate, seen = sensor.sustained()
            yield _real_time(sensor, rate, seen)
            yield from _shares(sensor, rate)
            yield from _over_core(sensor, rate, seen)
            if rate < 1:  # a sensor that the machine keeps up with does not overload it
                too_fast = OVERLOAD * seen.offered_hz / sensor.dwells_hz
                yield _overload(sensor, seen, watch(sensor.bag, too_fast, SECONDS))
            near = NEARLY * rate or sensor.first_guess / 10
            yield from _latency(sensor, near, watch(sensor.bag, near, LATENCY_SECONDS))


def endurance() -> Iterator[Row]:
    """Ten minutes at half the rate that is sustained: latency and drops, and what the processes grow."""
    with tempfile.TemporaryDirectory() as folder:
        sensor = Sensor.of_preset(ENDURANCE, Path(folder))
        half = sensor.half_of(sensor.sustained()[0] if SEARCHED else 0.0)
        seen = watch(sensor.bag, half, ENDURANCE_SECONDS, ENDURING, record=())
    yield _growth(sensor, half, seen)
    yield from _latency(sensor, half, seen)


def _real_time(sensor: Sensor, rate: float, seen: Seen) -> Row:
    stages = seen.usage.cpu_per_second
    per_sensor_second = {name: used * sensor.dwells_hz / seen.offered_hz for name, used in stages.items()}
    recorded = seen.recorded_bytes / (seen.offered_hz * seen.elapsed_s)
    return Row(
        f"real time, {sensor.name}",
        rate,
        "1",
        ">= 1",
        f"seconds of the sensor in a second, the highest rate without any drop in {SECONDS:g} s; the sensor delivers "
        f"{sensor.dwells_hz:.3g} dwells/s; processor seconds for a second of the sensor: {_listed(per_sensor_second)}; "
        f"{1e-6 * recorded * sensor.dwells_hz:.3g} MB recorded for it; {load()}",
        {
            "preset": sensor.name,
            "dwells_hz": sensor.dwells_hz,
            "rate": rate,
            "frame_bytes_per_dwell": sensor.frame_bytes,
            "messages_per_dwell": sensor.messages,
            "recorded_bytes_per_dwell": recorded,
            "cpu_s_per_dwell": {name: used / sensor.dwells_hz for name, used in per_sensor_second.items()},
            "core_s_per_dwell": sensor.core.stages_s,
            "memory_bytes": seen.memory_bytes,
        },
    )


def _shares(sensor: Sensor, rate: float) -> Iterator[Row]:
    """Of what transport or core alone would achieve, and of what both would on the same processors."""
    transported, idle = sensor.transported(sensor.core_rate)
    limit = min(transported, sensor.core_rate)
    yield Row(
        f"real time over the limit, {sensor.name}",
        rate / limit if limit else np.nan,
        "1",
        ">= 0.8",
        f"{rate:.3g} of the lower one of two limits: transport alone {transported:.3g} (nodes that do nothing, "
        f"{_listed(idle.usage.cpu_per_second)} processors busy at it), the core alone on {WORKERS} processors "
        f"{sensor.core_rate:.3g} seconds of the sensor in a second; {load()}",
        {
            "preset": sensor.name,
            "transport_rate": transported,
            "transport_cpu_s_per_dwell": {
                name: used / idle.offered_hz for name, used in idle.usage.cpu_per_second.items()
            },
            "core_rate": sensor.core_rate,
        },
    )


def _over_core(sensor: Sensor, rate: float, seen: Seen) -> Iterator[Row]:
    yield Row(
        f"real time over the core, {sensor.name}",
        rate / sensor.core_rate,
        "1",
        ">= 0.55",
        f"the highest rate without any drop in {SECONDS:g} s, {rate:.3g}, over that of the core alone on {WORKERS} "
        f"processors, {sensor.core_rate:.3g} seconds of the sensor in a second; {load()}",
    )
    used_s = sum(seen.usage.cpu_per_second.values()) / (seen.offered_hz * seen.achieved)
    yield Row(
        f"processor time over the core, {sensor.name}",
        used_s / sensor.core.cpu_s,
        "1",
        "<= 1.6",
        f"processor time a dwell, player, recorder and the program included: {1e3 * used_s:.1f} ms at a rate of "
        f"{rate:.3g}; {1e3 * sensor.core.cpu_s:.1f} ms in the core alone, on {WORKERS} processors at the same time; "
        f"{load()}",
    )
    yield Row(
        f"memory of a live graph, {sensor.name}",
        1e-9 * seen.memory_bytes,
        "GB",
        "<= 1.2",
        f"of all processes, what they share counted once, at a rate of {rate:.3g}; {load()}",
    )
    half = sensor.half_of(rate)
    whole, one = watch(sensor.bag, half, SECONDS, Nodes.TOGETHER), core_rate(sensor.bag, CORE_SECONDS, 1)
    used_s = sum(whole.usage.cpu_per_second.values()) - whole.beside_s / whole.usage.seconds
    together = used_s / whole.offered_hz
    yield Row(
        f"graph in one process over the core, {sensor.name}",
        together / one.cpu_s,
        "1",
        "<= 1.1",
        f"processor time a dwell: {1e3 * together:.1f} ms without source and recorder, at a rate of {half:.3g}; "
        f"{1e3 * one.cpu_s:.1f} ms in the core alone, in one process; {WORKERS} of these at the same time process "
        f"{sensor.core.dwells_hz / one.dwells_hz:.2f} times as many dwells as one; {load()}",
        {"preset": sensor.name, "speedup": sensor.core.dwells_hz / one.dwells_hz},
    )


def _overload(sensor: Sensor, before: Seen, seen: Seen) -> Row:
    """Fraction of the heights that is left when dwells arrive much faster than they can be processed."""
    topic = f"{PROCESSING['relief_tracker'].product}/height"
    made_hz, sustained_hz = (len(one.latencies_s[topic]) / one.elapsed_s for one in (seen, before))
    p50, p999 = 1e3 * np.percentile(seen.latencies_s[topic] or [np.nan], [50, 99.9])
    return Row(
        f"overload, {sensor.name}",
        made_hz / sustained_hz if sustained_hz else np.nan,
        "1",
        ">= 0.95",
        f"tracked heights in a second, {made_hz:.3g}, when {OVERLOAD:g} times as many dwells come as are sustained "
        f"({seen.offered_hz:.3g} in a second), over those then, {sustained_hz:.3g}; {seen.left_out} messages dropped, "
        f"{seen.in_parts} of them for others of their dwell did not come; latency p50 {p50:.0f}, p99.9 {p999:.0f} ms; "
        f"{load()}",
    )


def _latency(sensor: Sensor, rate: float, seen: Seen) -> Iterator[Row]:
    """From the last pulse of a dwell to its heights."""
    for topic, ages in seen.latencies_s.items():
        p50, p95, p999 = 1e3 * np.percentile(ages, [50, 95, 99.9]) if ages else 3 * [np.nan]
        budget = 1e3 * max(0.2, 3 / seen.offered_hz)
        yield Row(
            f"latency of {topic}, {sensor.name}, p99.9",
            p999,
            "ms",
            f"<= {budget:.0f}",
            f"from the last pulse of a dwell, at a rate of {rate:.3g} for {seen.elapsed_s:.0f} s: {len(ages)} "
            f"images, {seen.left_out} messages dropped; p50 {p50:.1f}, p95 {p95:.1f} ms; {load()}",
        )


def _growth(sensor: Sensor, rate: float, seen: Seen) -> Row:
    """From the median of the second minute to that of the last one, of the process that grows most."""
    samples = seen.usage.samples
    begin_s, end_s = samples[0].at_s, samples[-1].at_s
    second = [one.resident for one in samples if MINUTE_S <= one.at_s - begin_s < 2 * MINUTE_S]
    last = [one.resident for one in samples if end_s - one.at_s < MINUTE_S]
    before, after = (
        {name: float(np.median([resident[name] for resident in minute])) for name in minute[0]}
        for minute in (second, last)
    )
    growth = {name: 100 * (after[name] / before[name] - 1) for name in before}
    shown = ", ".join(f"{name} {growth[name]:+.2f} % of {1e-6 * before[name]:.0f} MB" for name in growth)
    return Row(
        f"endurance, {sensor.name}, growth of memory",
        max(growth.values()),
        "%",
        "<= 1",
        f"resident memory in the last minute over that in the second one, of the process that grows most; {shown}; "
        f"{seen.elapsed_s:.0f} s at a rate of {rate:.3g}, phase history not recorded, {seen.left_out} messages "
        f"dropped; {load()}",
    )


def _listed(seconds: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {used:.2g}" for name, used in seconds.items())
