"""`sal-height top`: what is seen of the nodes of a running graph."""

from __future__ import annotations

import io
import subprocess
import sys
import time
from collections.abc import Callable

import pytest
from rclpy.node import Node
from rich.console import Console

from sal_height.commands import main
from sal_height.graph.watch import MOST_NODES, AccountBook, Watcher
from sal_height.messages.types import DiagnosticArray, DiagnosticStatus, KeyValue
from sal_height.nodes.accounts.account import DIAGNOSTICS
from sal_height.nodes.processing import PROCESSING
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.message_types import class_of, publish
from sal_height.runs.live.live_table import node_table

DEADLINE_S = 60.0


def told(
    name: str, level: bytes = DiagnosticStatus.OK, message: str = "processing", **values: object
) -> DiagnosticArray:
    items = [KeyValue(key=key.replace("__", "."), value=str(value)) for key, value in values.items()]
    return DiagnosticArray(status=[DiagnosticStatus(level=level, name=name, message=message, values=items)])


def drawn(book: AccountBook, now: float) -> str:
    """The table on a terminal of 80 columns."""
    console = Console(file=io.StringIO(), width=80)
    console.print(node_table(book, now, "nodes"))
    text: str = console.file.getvalue()  # type: ignore[attr-defined]
    return text


def test_rates_of_processor_time_are_those_of_the_last_seconds() -> None:
    book = AccountBook()
    for half_second in range(20):
        cpu_s = 0.1 * half_second if half_second < 10 else 1.0 + 0.4 * (half_second - 10)
        book.take(told("ml_height", cpu_s=cpu_s, pid=1), 0.5 * half_second)
    assert book.entries["ml_height"].cpu_per_second == pytest.approx(0.8)


def test_a_node_that_was_started_again_goes_on_counting_and_its_rates_begin_anew() -> None:
    book = AccountBook()
    book.take(told("ml_height", **{"in": 8, "processed": 5, "waiting": 3, "cpu_s": 50.0, "pid": 1}), 0.0)
    book.take(told("ml_height", **{"in": 2, "processed": 2, "waiting": 0, "cpu_s": 1.0, "pid": 2}), 5.0)
    entry = book.entries["ml_height"]
    assert entry.lives == 2
    assert (entry.account.received, entry.account.processed) == (10, 7)
    assert entry.account.dropped == {"lost with its process": 3}
    assert entry.cpu_per_second == 0.0
    assert "ml_height was started 2 times." in drawn(book, 5.0)


def test_the_table_fits_a_terminal_and_says_what_is_wrong() -> None:
    book = AccountBook()
    numbers = {"offered_hz": 85.93, "latency_p50_ms": 5.25, "memory_mb": 249.2, "cpu_s": 1}
    book.take(told("aircraft/lidar/sar_compression", **numbers), 9)
    book.take(
        told(
            "aircraft/lidar/ml_height",
            DiagnosticStatus.WARN,
            "12 dropped",
            dropped__overload=12,
            last_minute__dropped__overload=4,
        ),
        9,
    )
    book.take(told("aircraft/lidar/gone_long_ago"), 2)
    text = drawn(book, 9.5)
    assert "nodes, in namespace aircraft/lidar" in text
    assert max(len(line) for line in text.splitlines()) <= 80
    line = next(line for line in text.splitlines() if "sar_compression" in line).split()
    assert line == ["sar_compression", "ok", "85.9", "5.2", "0.00", "249"]
    assert "ml_height has left out in the last minute (in all): overload 4 (12)." in " ".join(text.split())
    assert "ml_height says: 12 dropped" in text
    assert "gone_long_ago publishes nothing any more." in text


def test_a_silent_node_is_gone_once_the_graph_no_longer_has_it() -> None:
    book = AccountBook()
    book.take(told("lidar/sar_compression"), 0.0)
    book.take(told("driver: temperature"), 0.0)
    book.note_nodes({"lidar/sar_compression", "driver"}, 10.0)
    text = " ".join(drawn(book, 10.0).split())
    assert "sar_compression stale" in text
    assert "sar_compression says: no account for 10 s; the node is there, and too busy, or stands still" in text
    assert "driver: temperature gone" in text
    book.note_nodes({"driver"}, 11.0)
    assert "sar_compression gone" in " ".join(drawn(book, 11.0).split())
    book.take(told("lidar/sar_compression"), 12.0)
    book.note_nodes({"lidar/sar_compression"}, 13.0)
    assert "sar_compression ok" in " ".join(drawn(book, 13.0).split())


def test_the_watcher_sees_which_nodes_the_graph_has(graph: Graph) -> None:
    """A node that publishes no second account is there until it is destroyed."""
    book = AccountBook()
    graph.add(Watcher(book, context=graph.context))
    node = Node("busy", namespace="/lidar", context=graph.context)
    publisher = node.create_publisher(class_of(DiagnosticArray), DIAGNOSTICS, 10)
    assert spun_until(graph, lambda: publisher.get_subscription_count() > 0)
    publish(publisher, told("lidar/busy"))
    assert spun_until(graph, lambda: "lidar/busy" in book.entries and book.entries["lidar/busy"].is_there)
    assert not book.entries["lidar/busy"].is_gone(time.monotonic() + 100.0)
    node.destroy_node()
    assert spun_until(graph, lambda: book.entries["lidar/busy"].is_gone(time.monotonic() + 100.0))


def test_names_without_end_take_no_memory_without_end() -> None:
    book = AccountBook()
    for number in range(2 * MOST_NODES):
        book.take(told(f"node_{number}"), 0.0)
    assert len(book.entries) == MOST_NODES
    book.take(told("node_0", message="still here"), 1.0)
    assert book.entries["node_0"].message == "still here"


def spun_until(graph: Graph, condition: Callable[[], bool]) -> bool:
    return graph.spin_until(condition, DEADLINE_S)


def test_top_shows_the_nodes_of_a_domain(graph: Graph, domain_id: int) -> None:
    for make in (PROCESSING["sar_compression"], PROCESSING["relief_tracker"]):
        graph.add(make(context=graph.context))
    words = [sys.executable, "-m", "sal_height", "top", "--domain", str(domain_id), "--seconds", "3"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as program:  # noqa: S603
        assert spun_until(graph, lambda: program.poll() is not None)
        said, errors = program.communicate()
    assert (program.returncode, errors) == (0, "")
    assert said.count("sar_compression") >= 2
    assert "waiting for" in said
    assert "/phase_history" in said
    assert "relief_tracker" in said


def test_top_says_if_there_is_nobody(domain_id: int, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["top", "--domain", str(domain_id), "--seconds", "1"]) == 1
    assert "No node publishes /diagnostics" in capsys.readouterr().err
