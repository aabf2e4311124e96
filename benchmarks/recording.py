"""Bags: writing and reading over the mcap package, recording at a rate, and replaying over the core alone.

`python -m benchmarks.recording DOMAIN BYTES MB_PER_S SECONDS` publishes messages of a size at a rate (inf: as fast as
it can), as a sensor does that does not wait, and prints how many it has published.
"""

from __future__ import annotations

import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.reader import SeekingReader
from mcap.writer import CompressionType, Writer
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from std_msgs.msg import UInt8MultiArray

from benchmarks.row import Row, load, medians, sized
from sal_height.bag.info import bag_info
from sal_height.bag.reader import BagReader
from sal_height.bag.writer import BagWriter
from sal_height.nodes.recording.recorder import Recorder
from sal_height.nodes.recording.recorder_parameters import RecorderParameters
from sal_height.nodes.transport.domain import free_domain
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.qos import FRAMES_QOS

TOPIC, TYPE = "/frames", "std_msgs/msg/UInt8MultiArray"

SIZES = sized((130_000, 4_000_000), (1000, 2000))
"""Bytes of a message: a dwell of a small sensor, and of a large one."""

WRITTEN_BYTES = sized(500_000_000, 10_000)

LARGE_BYTES = sized(10_000_000_000, 10_000)

FRACTION = sized(0.8, 0.01)
"""Recorded rate, in parts of that at which messages can be received and written, each alone."""

RECORDED_S, ALONE_S = sized((60.0, 10.0), (0.4, 0.2))
"""Duration of a recording, and of receiving and of writing alone, s."""

LAST_S = sized(5.0, 0.2)
"""In which what is still on the way gets there."""


def over_mcap() -> Iterator[Row]:
    """Writing and reading a bag over the same by the mcap package, the data in the page cache."""
    for size in SIZES:
        with tempfile.TemporaryDirectory() as folder:
            yield from _over_mcap(size, Path(folder))


def _over_mcap(size: int, folder: Path) -> Iterator[Row]:
    count = max(2, WRITTEN_BYTES // size)
    cdr = np.random.default_rng(0).bytes(size)
    name, what = f"{size / 1e6:g} MB", f"{count} messages, {size * count / 1e6:g} MB without compression"
    bare_s, our_s = medians(lambda: _write_bare(folder, cdr, count), lambda: _write(folder, cdr, count))
    yield Row(f"bag written, {name}", bare_s / our_s, "1", ">= 0.9", f"mcap's Writer; {what}")
    bare_s, our_s = medians(lambda: _read_bare(folder), lambda: _read(folder))
    yield Row(f"bag read, {name}", bare_s / our_s, "1", ">= 0.9", f"mcap's SeekingReader, checksums, too; {what}")


def info_of_a_large_bag() -> Iterator[Row]:
    """Time of a summary of a bag, in a process that has imported all."""
    with tempfile.TemporaryDirectory() as folder:
        size = SIZES[-1]
        _write(Path(folder), np.random.default_rng(0).bytes(size), LARGE_BYTES // size)
        began = time.monotonic()
        info = bag_info(Path(folder) / "bag")
        taken_s = time.monotonic() - began
    yield Row("bag info", taken_s, "s", "<= 1", f"a bag of {info.size / 1e9:.3g} GB, {info.count} messages")


def recorded_at_a_rate() -> Iterator[Row]:
    """Messages that a recorder loses of a sensor nearly as fast as can be received and written, and its memory."""
    for size in SIZES:
        written_mb_s, received_mb_s = _rate_of_bare_writer(size), _rate_of_counting(size)
        rate_mb_s = FRACTION * min(written_mb_s, received_mb_s)
        done = _record(size, rate_mb_s)
        what = (
            f"{rate_mb_s:.0f} MB/s of {size / 1e6:g} MB for {RECORDED_S:g} s, {done.published} messages; mcap's Writer "
            f"writes {written_mb_s:.0f} MB/s here, and a node that counts receives {received_mb_s:.0f} MB/s; {load()}"
        )
        name = f"recorder, {size / 1e6:g} MB"
        yield Row(f"{name}: lost", done.published - done.written, "messages", "<= 0", what)
        late = f"{done.published} messages; fewer say that the sensor is short of processors, and is no full load"
        yield Row(f"{name}: published", done.published * size / 1e6 / RECORDED_S / rate_mb_s, "1", ">= 0.95", late)
        most = f"<= {RecorderParameters().max_memory_mb}"
        yield Row(f"{name}: memory", done.memory / 1e6, "MB", most, f"the most, looked at every second; {what}")


def _rate_of_bare_writer(size: int) -> float:
    """Rate at which mcap's Writer writes messages of a size to this disk, MB/s."""
    cdr, count = np.random.default_rng(0).bytes(size), 0
    with tempfile.TemporaryDirectory() as folder, _bare_writer(Path(folder)) as write:
        began = time.monotonic()
        while time.monotonic() - began < ALONE_S:
            write(cdr, count)
            count += 1
    return count * size / 1e6 / (time.monotonic() - began)


def _rate_of_counting(size: int) -> float:
    """Rate at which a node receives messages of a size that it only counts, MB/s."""
    count = 0

    def take(_: bytes) -> None:
        nonlocal count
        count += 1

    with free_domain() as domain, Graph(domain) as graph:
        node = graph.add(Node("counter", context=graph.context))
        node.create_subscription(UInt8MultiArray, TOPIC, take, FRAMES_QOS, raw=True)
        with _sensor(domain, size, math.inf, ALONE_S) as sensor:
            graph.spin_until(lambda: count > 0, 30.0)
            first, began = count, time.monotonic()
            graph.spin_until(lambda: time.monotonic() - began >= 0.8 * ALONE_S, ALONE_S)
            rate_mb_s = (count - first) * size / 1e6 / (time.monotonic() - began)
            graph.spin_until(lambda: sensor.poll() is not None, 60.0)
    return rate_mb_s


@dataclass(frozen=True)
class _Recorded:
    """Result of a recorder: messages published and written, and the most memory that it had, bytes."""

    published: int
    written: int
    memory: int


def _record(size: int, rate_mb_s: float) -> _Recorded:
    with tempfile.TemporaryDirectory() as name, free_domain() as domain, Graph(domain) as graph:
        overrides = [Parameter("topics", value=[TOPIC]), Parameter("node_parameters", value=False)]
        recorder = graph.add(Recorder(Path(name) / "bag", context=graph.context, parameter_overrides=overrides))
        with _sensor(domain, size, rate_mb_s, RECORDED_S) as sensor:
            memory = _own_memory()
            while sensor.poll() is None:
                graph.spin_for(1.0)
                memory = max(memory, _own_memory())
            published = int(sensor.communicate()[0])
        graph.spin_until(lambda: recorder.recorded.get(TOPIC, 0) >= published, LAST_S)
        return _Recorded(published, recorder.recorded.get(TOPIC, 0), memory)


def _sensor(domain: int, size: int, rate_mb_s: float, seconds: float) -> subprocess.Popen[str]:
    """A process that publishes messages of a size at a rate, and prints how many."""
    words = [sys.executable, "-m", "benchmarks.recording", *map(str, (domain, size, rate_mb_s, seconds))]
    return subprocess.Popen(words, stdout=subprocess.PIPE, text=True)  # noqa: S603 (this module)


def _own_memory() -> int:
    """Memory of this process alone, without files that it shares, bytes."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith("RssAnon"))


def _publish(domain: int, size: int, rate_mb_s: float, seconds: float) -> None:
    cdr = serialize_message(UInt8MultiArray(data=np.random.default_rng(0).bytes(size - 16)))
    with Graph(domain) as graph:
        node = graph.add(Node("sensor", context=graph.context))
        publisher = node.create_publisher(UInt8MultiArray, TOPIC, FRAMES_QOS)
        graph.spin_until(lambda: publisher.get_subscription_count() > 0, 30.0)
        began, count, interval_s = time.monotonic(), 0, size / (1e6 * rate_mb_s)
        while (elapsed_s := time.monotonic() - began) < seconds:
            if elapsed_s < count * interval_s:
                time.sleep(count * interval_s - elapsed_s)
            publisher.publish(cdr)
            count += 1
        sys.stdout.write(f"{count}\n")
        sys.stdout.flush()
        graph.spin_for(LAST_S)


def _write_bare(folder: Path, cdr: bytes, count: int) -> None:
    with _bare_writer(folder) as write:
        for number in range(count):
            write(cdr, number)


@contextmanager
def _bare_writer(folder: Path) -> Iterator[Callable[[bytes, int], None]]:
    """A function that writes a message with a time, ns, by mcap's Writer."""
    with (folder / "bare.mcap").open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start("ros2")
        channel = writer.register_channel(TOPIC, "cdr", writer.register_schema(TYPE, "ros2msg", b""))
        yield lambda cdr, time_ns: writer.add_message(channel, time_ns, cdr, time_ns)
        writer.finish()  # type: ignore[no-untyped-call]


def _write(folder: Path, cdr: bytes, count: int) -> None:
    for file in (folder / "bag").glob("*"):
        file.unlink()
    with BagWriter(folder / "bag") as bag:
        bag.add_topic(TOPIC, TYPE)
        for number in range(count):
            bag.write(TOPIC, cdr, number, number)


def _read_bare(folder: Path) -> int:
    with (folder / "bag" / "bag_0.mcap").open("rb") as stream:
        return sum(len(one.data) for _, _, one in SeekingReader(stream, validate_crcs=True).iter_messages())


def _read(folder: Path) -> int:
    return sum(len(one.cdr) for one in BagReader(folder / "bag").messages())


if __name__ == "__main__":
    _publish(int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]), float(sys.argv[4]))
