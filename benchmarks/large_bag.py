"""Memory of a replay over a bag of 4 GB, which is made for it and thrown away."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from benchmarks.row import Row, sized
from sal_height.bag.described import FRAMES
from sal_height.bag.reader import BagReader
from sal_height.bag.topics import stamp_ns_of
from sal_height.bag.writer import BagWriter
from sal_height.nodes.playing.playlist import restamped
from sal_height.runs.live.sensor_bag import record_sensor
from sal_height.simulation import load_preset
from sal_height.topics import ODOMETRY

BYTES = sized(4_000_000_000, 1_200_000)

PRESET, DWELLS = sized(("sal_spotlight", 60), ("small", 3))

MOVING = {f"/{FRAMES}", f"/{ODOMETRY}"}
"""Topics whose messages have a stamp that goes on."""

SETTLED, PERIOD_S = 0.25, 0.5
"""Share of the time after which memory is first looked at, and how often it is."""


def replay_memory() -> Iterator[Row]:
    """Growth of the memory of a replay, all nodes in one process, from a quarter of its time on."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bag, size = _repeated(record_sensor(replace(load_preset(PRESET), dwells=DWELLS), 1, folder / "once"), folder)
        words = [sys.executable, "-m", "sal_height", "replay", str(bag), "--out", str(folder / "out")]
        memory = []
        with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as replay:  # noqa: S603
            while replay.poll() is None:
                memory.append(_memory_mb(replay.pid))
                time.sleep(PERIOD_S)
            said = replay.communicate()[0]
        assert replay.returncode == 0, said  # noqa: S101 (it would be no measurement)
    settled = memory[round(SETTLED * len(memory))]
    highest = max(memory[round(SETTLED * len(memory)) :])
    yield Row(
        "replay of a large bag: growth of memory",
        100 * (highest / settled - 1),
        "%",
        "<= 10",
        f"{size / 1e9:.2f} GB of {PRESET} in {PERIOD_S * len(memory):.0f} s: {settled:.0f} MB after a quarter of it, "
        f"{highest:.0f} MB at most",
    )


def _repeated(once: Path, folder: Path) -> tuple[Path, int]:
    """A bag with the dwells of another one again and again, whose stamps go on, without their truth; its bytes."""
    reader, bag = BagReader(once), folder / "large"
    recorded = list(reader.messages())
    stamps = [stamp_ns_of(one.cdr) for one in recorded if one.topic in MOVING]
    period_ns = max(stamps) - min(stamps) + 1_000_000_000
    passes = max(1, BYTES // sum(len(one.cdr) for one in recorded))
    with BagWriter(bag) as out:
        for topic in reader.topics.values():
            out.add_topic(topic.name, topic.type_name, topic.offered_qos)
        for number in range(passes):
            shift_ns = number * period_ns
            for one in recorded:
                cdr = restamped(one.cdr, shift_ns) if one.topic in MOVING else one.cdr
                out.write(one.topic, cdr, one.log_time_ns + shift_ns, one.publish_time_ns + shift_ns)
    return bag, sum(file.stat().st_size for file in bag.glob("*.mcap"))


def _memory_mb(process: int) -> float:
    """Memory of a process alone, without files that it shares, MB; 0 if it has just ended."""
    try:
        lines = Path(f"/proc/{process}/status").read_text(encoding="ascii").splitlines()
    except OSError:
        return 0.0
    return sum(int(line.split()[1]) for line in lines if line.startswith("RssAnon")) * 1024 / 1e6
