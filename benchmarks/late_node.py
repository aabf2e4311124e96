"""How soon a node that starts beside running ones finds them all, as one does that is started again after a fault.

`python -m benchmarks.late_node DOMAIN NUMBER` is the running nodes: it makes as many, says so, and waits for the end of
its input.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator

from rclpy.node import Node

from benchmarks.row import Row, load, sized
from sal_height.nodes.domain import free_domain
from sal_height.nodes.graph import Graph

RUNNING = sized(8, 1)
"""Running nodes, each a participant of its own, as in a graph of separate processes."""

REPEATS = sized(5, 1)

ALONE_S = sized(2.0, 0.0)
"""How long they run before the late node starts: a participant announces itself often in its first half second."""

DEADLINE_S = 10.0


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


def _found_after_s() -> float:
    """Time from the start of a late node until it has found the running ones, s; infinity: not in time."""
    with free_domain() as domain:
        words = [sys.executable, "-m", __name__, str(domain), str(RUNNING)]
        with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as others:  # noqa: S603 (ours)
            assert others.stdout  # noqa: S101 (it is a pipe)
            others.stdout.readline()
            time.sleep(ALONE_S)
            began = time.monotonic()
            with Graph(domain) as graph:
                late = graph.add(Node("late", context=graph.context))
                found = graph.spin_until(lambda: len(late.get_node_names()) > RUNNING, DEADLINE_S)
                found_s = time.monotonic() - began if found else float("inf")
            others.communicate()
    return found_s


def _run(domain: int, number: int) -> None:
    graphs = [Graph(domain) for _ in range(number)]
    for index, graph in enumerate(graphs):
        graph.add(Node(f"running_{index}", context=graph.context))
    sys.stdout.write("running\n")
    sys.stdout.flush()
    sys.stdin.read()
    os._exit(0)  # nothing is held


if __name__ == "__main__":
    _run(int(sys.argv[1]), int(sys.argv[2]))
