"""Time in which a node that starts beside running ones finds them all, as one does that is started again after a fault.

`python -m benchmarks.late_node run DOMAIN NUMBER` is the running nodes: it makes as many, says so, and goes on until
its input ends. With `hear` instead of `run`, it is a node that says so once it has heard each of them.
"""

from __future__ import annotations

import os
import select
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from rclpy.node import Node
from std_msgs.msg import UInt8

from benchmarks.row import Row, load, sized
from sal_height.nodes.transport.domain import free_domain
from sal_height.nodes.transport.graph import Graph

RUNNING = sized(8, 1)
"""Running nodes, each a participant of its own, as in a graph of separate processes."""

REPEATS = sized(5, 1)

TICK_S = 0.05

DEAD_S = 0.5
"""Time for which a node that was killed is absent, as `live --supervise` has it."""

ALONE_S = sized(2.0, 0.0)
"""Time they run before the late node starts: a participant announces itself often in its first half second."""

DEADLINE_S = 30.0


def late_node() -> Iterator[Row]:
    """The slowest of some late nodes counts."""
    found_s = [_found_after_s() for _ in range(REPEATS)]
    yield Row(
        "a late node finds the running ones",
        max(found_s),
        "s",
        "<= 1",
        f"the slowest of {REPEATS} nodes that start when {RUNNING} have run for {ALONE_S:g} s; Fast DDS announces a "
        f"running node every 3 s by default; {load()}",
    )


def restarted_node() -> Iterator[Row]:
    """The slowest of some nodes that are started again counts, with the start of Python."""
    heard_s = [_heard_after_s() for _ in range(REPEATS)]
    yield Row(
        "a node that was killed receives the running ones again",
        max(heard_s),
        "s",
        "<= 3",
        f"the slowest of {REPEATS} nodes that are started {DEAD_S:g} s after one was killed, which had heard {RUNNING} "
        f"others; from its start; {load()}",
    )


def _found_after_s() -> float:
    """Time from the start of a late node until it has found the running ones, s; infinity: not in time."""
    with free_domain() as domain, _program("run", domain):
        time.sleep(ALONE_S)
        began = time.monotonic()
        with Graph(domain) as graph:
            late = graph.add(Node("late", context=graph.context))
            found = graph.spin_until(lambda: len(late.get_node_names()) > RUNNING, DEADLINE_S)
            return time.monotonic() - began if found else float("inf")


def _heard_after_s() -> float:
    """Time from the start of a node in place of one that was killed, until it has heard the running ones, s."""
    with free_domain() as domain, _program("run", domain):
        with _program("hear", domain) as first:
            time.sleep(ALONE_S)
            first.kill()
        time.sleep(DEAD_S)
        began = time.monotonic()
        with _program("hear", domain):
            return time.monotonic() - began


@contextmanager
def _program(what: str, domain: int) -> Iterator[subprocess.Popen[bytes]]:
    """This module as a program that has said something, and is ended by the end of its input."""
    words = [sys.executable, "-m", __name__, what, str(domain), str(RUNNING)]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as program:  # noqa: S603 (ours)
        assert program.stdout  # noqa: S101 (it is a pipe)
        program.stdout.readline()
        yield program
        program.communicate()


def _run(domain: int, number: int) -> None:
    """Nodes, each of which publishes its number again and again."""
    graphs = [Graph(domain) for _ in range(number)]
    nodes = [graph.add(Node(f"running_{index}", context=graph.context)) for index, graph in enumerate(graphs)]
    publishers = [node.create_publisher(UInt8, "tick", 10) for node in nodes]
    _say("running")
    while not select.select([sys.stdin], [], [], TICK_S)[0]:
        for index, publisher in enumerate(publishers):
            publisher.publish(UInt8(data=index))
    os._exit(0)  # nothing is held


def _hear(domain: int, number: int) -> None:
    """A node that says so once it has heard all others."""
    heard: set[int] = set()
    with Graph(domain) as graph:
        node = graph.add(Node("listener", context=graph.context))
        node.create_subscription(UInt8, "tick", lambda message: heard.add(message.data), 10)
        graph.spin_until(lambda: len(heard) == number, DEADLINE_S)
        _say("heard" if len(heard) == number else "deaf")
        sys.stdin.read()


def _say(word: str) -> None:
    sys.stdout.write(f"{word}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    {"run": _run, "hear": _hear}[sys.argv[1]](int(sys.argv[2]), int(sys.argv[3]))
