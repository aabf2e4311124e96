"""A node whose port of shared memory is gone ends, so that it can be started again."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from programs import PROCESSING, Program
from rclpy.node import Node

from sal_height.graph.watch import AccountBook, Watcher
from sal_height.messages.types import DiagnosticArray
from sal_height.nodes.transport.domain import LOOK_S, LOOKS, Ports, ports_read
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.leftovers import SHARED_MEMORY
from sal_height.nodes.transport.message_types import subscribe

STANDS_STILL_S = 3.0
"""Longer than two of the looks after which Fast DDS takes a process for dead by default."""


def own_ports() -> list[Path]:
    return [SHARED_MEMORY / name for name in ports_read()]


def test_ports_that_others_find_are_not_lost(graph: Graph) -> None:
    graph.add(Node("one", context=graph.context))
    watch = Ports()
    assert len(own_ports()) >= 2  # for what is said about topics, and for their messages
    assert all(watch.lost() == [] for _ in range(LOOKS + 1))


def test_a_port_without_its_file_is_lost_after_some_looks_and_found_with_it(graph: Graph) -> None:
    graph.add(Node("one", context=graph.context))
    watch = Ports()
    watch.lost()
    port, aside = own_ports()[0], SHARED_MEMORY / f"aside_{os.getpid()}"
    port.rename(aside)
    try:
        assert [watch.lost() for _ in range(LOOKS)] == [[]] * (LOOKS - 1) + [[port.name]]
        port.write_bytes(b"of another process that made it anew")
        assert watch.lost() == [port.name]
        aside.rename(port)
        assert watch.lost() == []
        port.rename(aside)
        assert watch.lost() == []  # it counts from the beginning
    finally:
        aside.rename(port)


def test_who_watches_a_graph_says_that_nothing_more_can_be_seen(graph: Graph, capfd: Any) -> None:
    watcher = graph.add(Watcher(AccountBook(), context=graph.context))
    (port, *_), aside = own_ports(), SHARED_MEMORY / f"aside_{os.getpid()}"
    port.rename(aside)
    try:
        assert graph.spin_until(lambda: watcher.is_deaf, 60.0)
        graph.spin_for(2 * LOOK_S)
    finally:
        aside.rename(port)
    (sentence,) = [line for line in capfd.readouterr().err.splitlines() if port.name in line]
    assert "The nodes go on, unseen" in sentence


@pytest.fixture
def program(domain_id: int) -> Iterator[Program]:
    """A node in a process of its own."""
    program = Program(PROCESSING, "relief_tracker", domain_id=domain_id)
    yield program
    if program.poll() is None:
        program.kill()
        program.communicate()


def test_a_node_ends_and_says_why(program: Program, graph: Graph) -> None:
    watcher = graph.add(Node("watcher", context=graph.context))
    assert graph.spin_until(lambda: watcher.count_publishers("tracked/height") == 1, 60.0)
    found = ports_read(Path(f"/proc/{program.pid}"))
    for name in found:
        (SHARED_MEMORY / name).unlink()
    _, errors = program.communicate()
    assert program.returncode == 1
    (sentence,) = [line for line in errors.splitlines() if "ERROR" in line]
    assert "of shared memory, through which messages of other processes arrive, is lost" in sentence
    assert any(name in sentence for name in found)


def test_a_node_that_stands_still_keeps_its_ports(program: Program, graph: Graph) -> None:
    """By default, whoever sends to it would make them anew all the time, and it could be lost when it goes on."""
    watcher = graph.add(Node("watcher", context=graph.context))
    accounts: list[DiagnosticArray] = []
    subscribe(watcher, DiagnosticArray, "/diagnostics", accounts.append, 10)
    assert graph.spin_until(lambda: bool(accounts), 60.0)
    found = [SHARED_MEMORY / name for name in ports_read(Path(f"/proc/{program.pid}"))]
    assert len(found) >= 2
    files = [port.stat().st_ino for port in found]
    program.send_signal(signal.SIGSTOP)
    changed = graph.spin_until(lambda: [port.stat().st_ino for port in found] != files, STANDS_STILL_S)
    program.send_signal(signal.SIGCONT)
    assert not changed
    accounts.clear()
    assert graph.spin_until(lambda: bool(accounts), 60.0)
    program.send_signal(signal.SIGTERM)
    program.communicate()
    assert program.returncode == 0
