"""Replays by the program, through nodes and without: processor time of a further dwell, of a start, and of two jobs."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from mcap.reader import SeekingReader
from mcap.writer import CompressionType, Writer

from benchmarks.core_limit import core_rate
from benchmarks.row import Row, load, sized
from sal_height.bag.reader import BagReader
from sal_height.bag.writer import BagWriter
from sal_height.graph.reporting import PRESET as PRESET_NAME
from sal_height.graph.reporting import SEED
from sal_height.nodes.playing.playlist import restamped
from sal_height.runs.live.sensor_bag import record_sensor
from sal_height.simulation import load_preset
from sal_height.workers.processes import ONE_THREAD

PRESET, FEW, TIMES = sized(("sal_spotlight", 32, 9), ("small", 2, 2))
"""Dwells of a flight, and how often it is flown in the other bag; the start of the program counts for neither."""

STRIPS = sized(("sal_stripmap", 40), ("small", 4))

TURN_NS = 2_000_000_000
"""Time between the ends and starts of repeated flights, ns."""

CORE_S = sized(5.0, 0.1)
"""Time that the core works alone, s."""

REPEATS = sized(3, 1)
"""Of which the least counts: other programs only add to it."""

WAYS = {"through nodes": (), "by calls": ("--jobs", "1")}


class Cost(NamedTuple):
    """Processor time of a program and its children, and the time that it took, s."""

    cpu_s: float
    wall_s: float


def without_truth(simulated: Path, folder: Path, times: int = 1) -> Path:
    """A bag as a sensor records it: its heights are compared with no truth, which takes longer than all else.

    Args:
        simulated: the bag of a flight.
        folder: folder of the new one.
        times: number of times that the same is flown.
    """
    reader = BagReader(simulated)
    known = {name: text for name, text in reader.custom_data.items() if name not in (PRESET_NAME, SEED)}
    with BagWriter(folder, known) as bag:
        for topic in reader.topics.values():
            bag.add_topic(topic.name, topic.type_name, topic.offered_qos)
        recorded = list(reader.messages())
        period_ns = recorded[-1].log_time_ns - recorded[0].log_time_ns + TURN_NS
        for later_ns in range(0, times * period_ns, period_ns):
            for one in recorded:
                cdr = restamped(one.cdr, later_ns) if later_ns else one.cdr
                bag.write(one.topic, cdr, one.log_time_ns + later_ns, one.publish_time_ns + later_ns)
    return folder


def over_core() -> Iterator[Row]:
    """Cost of a further dwell over the core alone, cost of a replay of one dwell, and gain of a second job."""
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        one, few = _flown(folder, PRESET, 1), _flown(folder, PRESET, FEW)
        many, dwells = without_truth(few, folder / "many", TIMES), FEW * TIMES
        cores_s = [core_rate(few, CORE_S, 1).cpu_s]
        copy_s = min(_copy_s(many, folder) for _ in range(REPEATS)) / dwells
        of_ways = {}
        for way, words in WAYS.items():
            of_ways[way] = {bag: _least(bag, folder, words) for bag in (one, few, many)}
            cores_s.append(core_rate(few, CORE_S, 1).cpu_s)
        core_s = min(cores_s)
        for way, costs in of_ways.items():
            further_s = (costs[many].cpu_s - costs[few].cpu_s) / (dwells - FEW)
            yield Row(
                f"replay {way}, {PRESET}: a further dwell over the core",
                further_s / core_s,
                "1",
                "<= 1.15",
                f"processor time of {dwells} dwells without that of {FEW}: {1e3 * further_s:.2f} ms a dwell; core "
                f"{1e3 * core_s:.2f} ms, and {1e3 * copy_s:.2f} ms to copy its messages by mcap alone, as every replay "
                f"does; {load()}",
            )
            yield Row(
                f"replay {way}, {PRESET}: one dwell",
                costs[one].cpu_s,
                "s",
                "<= 4",
                f"processor time with the start of the program; {costs[one].wall_s:.1f} s; {load()}",
            )
        for bag, name, count in ((many, PRESET, dwells), (_flown(folder, *STRIPS), *STRIPS)):
            alone, together = (_least(bag, folder, ("--jobs", jobs)) for jobs in ("1", "2"))
            if bag == many:
                first, second = (_least(few, folder, ("--jobs", jobs)) for jobs in ("1", "2"))
                yield Row(
                    f"replay of {count} dwells of {name} without the first {FEW}, one job over two",
                    (alone.wall_s - first.wall_s) / (together.wall_s - second.wall_s),
                    "1",
                    ">= 1.7",
                    f"{alone.wall_s - first.wall_s:.1f} s by one job, {together.wall_s - second.wall_s:.1f} s by two; "
                    f"the first {FEW} take {first.wall_s:.1f} s with the start of the program; {load()}",
                )
            yield Row(
                f"replay of {count} dwells of {name}, one job over two",
                alone.wall_s / together.wall_s,
                "1",
                ">= 1.7",
                f"{alone.wall_s:.1f} s by one job, {together.wall_s:.1f} s by two; {load()}",
            )


def _flown(folder: Path, name: str, dwells: int) -> Path:
    simulated = record_sensor(replace(load_preset(name), dwells=dwells), 1, folder / f"simulated_{name}_{dwells}")
    return without_truth(simulated, folder / f"{name}_{dwells}")


def _copy_s(bag: Path, folder: Path) -> float:
    """Processor time that it takes to read the messages of a bag of one file and to write them to another, s."""
    began = time.process_time()
    with (bag / f"{bag.name}_0.mcap").open("rb") as source, (folder / "copy.mcap").open("wb") as made:
        writer, channels = Writer(made, compression=CompressionType.NONE), dict[int, int]()
        writer.start()
        for schema, channel, message in SeekingReader(source, validate_crcs=True).iter_messages():
            if channel.id not in channels and schema is not None:
                own = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, own)
            writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
        writer.finish()  # type: ignore[no-untyped-call]
    return time.process_time() - began


def _least(bag: Path, folder: Path, words: tuple[str, ...]) -> Cost:
    """The least cost of some replays of a bag."""
    found = []
    for _ in range(REPEATS):
        with tempfile.TemporaryDirectory(dir=folder) as out:
            found.append(_replay(bag, Path(out), words))
    return Cost(min(one.cpu_s for one in found), min(one.wall_s for one in found))


def _replay(bag: Path, out: Path, words: tuple[str, ...]) -> Cost:
    command = [sys.executable, "-m", "sal_height", "replay", str(bag), "--out", str(out), *words]
    began = time.monotonic()
    with (out.parent / "replay.log").open("w") as log:
        program = subprocess.Popen(command, stdout=log, stderr=log, env={**os.environ, **ONE_THREAD})  # noqa: S603
        _, status, used = os.wait4(program.pid, 0)
        program.returncode = os.waitstatus_to_exitcode(status)
    if program.returncode:
        raise RuntimeError(f"A replay has failed: {(out.parent / 'replay.log').read_text()}")
    return Cost(used.ru_utime + used.ru_stime, time.monotonic() - began)
