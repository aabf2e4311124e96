"""What processes that were killed leave in shared memory."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from rclpy.node import Node

from sal_height.nodes.transport import leftovers
from sal_height.nodes.transport.domain import LOOKS, Ports, first_port, free_domain, ports_read
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.leftovers import LOCK, SEGMENT, SHARED_MEMORY, avoid_dead_ports, remove_orphans
from sal_height.nodes.transport.middleware import ENOUGH

PROGRAM = """
from rclpy.node import Node
from sal_height.nodes.transport.graph import Graph
with Graph() as graph:
    graph.add(Node("one", context=graph.context))
    print("begun", flush=True)
    input()
"""

Start = Callable[[int], "subprocess.Popen[str]"]


@pytest.fixture
def start() -> Iterator[Start]:
    """Starts programs with a node in a domain, which are ended in the end."""
    programs: list[subprocess.Popen[str]] = []

    def begin(domain: int) -> subprocess.Popen[str]:
        program = subprocess.Popen(  # noqa: S603 (our own program)
            [sys.executable, "-c", PROGRAM],
            env=os.environ | {"ROS_DOMAIN_ID": str(domain)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        programs.append(program)
        assert program.stdout is not None
        # Fast DDS logs to the standard output, too, where another process is just taking the same port.
        assert any(line == "begun\n" for line in program.stdout)
        return program

    yield begin
    for program in programs:
        if program.poll() is None:
            program.communicate("\n", timeout=60)


def killed(program: subprocess.Popen[str]) -> None:
    program.kill()
    program.communicate(timeout=60)


def folder_of(program: subprocess.Popen[str]) -> Path:
    return Path(f"/proc/{program.pid}")


def segments(program: subprocess.Popen[str]) -> set[str]:
    """Names of the segments that a program has in its memory."""
    maps = (folder_of(program) / "maps").read_text()
    files = [file for file in SHARED_MEMORY.glob("fastrtps_*") if not file.name.endswith(LOCK)]
    return {file.name for file in files if "port" not in file.name and f"{file}\n" in maps}


def exist(names: set[str]) -> bool:
    return all((SHARED_MEMORY / name).exists() for name in names)


def test_segments_of_a_killed_process_are_given_back_and_those_of_others_stay(
    start: Start, domain_id: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = start(domain_id)
    with free_domain() as second_domain:
        other = start(second_domain)
    first, second = segments(one), segments(other)
    assert first
    assert second
    assert not first & second
    assert max((SHARED_MEMORY / name).stat().st_size for name in first) >= ENOUGH
    killed(one)
    remove_orphans()
    assert exist(first)  # young: its process might not have locked it yet
    monkeypatch.setattr(leftovers, "YOUNG_S", 0.0)
    remove_orphans()
    assert not any(exist({name}) for name in first)
    assert exist(second)


def of_domain(ports: set[str], domain: int) -> set[str]:
    """The ports of a domain; those of lower numbers, from 7000 on, any process on this machine may take again."""
    return {name for name in ports if int(name.removeprefix(f"{SEGMENT}port")) >= first_port(domain)}


def test_who_starts_takes_no_port_of_a_killed_process(start: Start, domain_id: int) -> None:
    """Others send to nobody through them, until they find out."""
    first = start(domain_id)
    before = of_domain(ports_read(folder_of(first)), domain_id)
    assert before
    killed(first)
    after = of_domain(ports_read(folder_of(start(domain_id))), domain_id)
    assert after
    assert not before & after
    assert exist(before)


def test_a_dead_port_stays_locked_when_another_process_that_avoids_it_ends(start: Start, domain_id: int) -> None:
    program = start(domain_id)
    dead = SHARED_MEMORY / (max(of_domain(ports_read(folder_of(program)), domain_id)) + LOCK)
    killed(program)
    with dead.open() as other, dead.open() as middleware:
        fcntl.flock(other, fcntl.LOCK_SH)
        avoid_dead_ports()
        other.close()
        with pytest.raises(BlockingIOError):
            fcntl.flock(middleware, fcntl.LOCK_EX | fcntl.LOCK_NB)


def test_ports_that_are_avoided_are_not_lost_ones_and_are_removed_in_time(
    start: Start, graph: Graph, domain_id: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    graph.add(Node("one", context=graph.context))
    own, program = ports_read(), start(domain_id)
    dead = of_domain(ports_read(folder_of(program)), domain_id)
    killed(program)
    for _ in range(2):
        avoid_dead_ports()
        assert exist(dead)
        assert ports_read() == own
    watch = Ports()
    assert all(watch.lost() == [] for _ in range(LOOKS + 1))
    monkeypatch.setattr(leftovers, "FORGOTTEN_S", 0.0)
    avoid_dead_ports()
    assert not any(exist({name}) or exist({name + LOCK}) for name in dead)
    assert exist(own)


def test_who_removes_segments_locks_no_port(start: Start, domain_id: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Or another process that starts meanwhile would not find out that it is dead."""
    program = start(domain_id)
    ports = ports_read(folder_of(program))
    killed(program)
    locked = list[Path]()
    within = leftovers._locked
    monkeypatch.setattr(leftovers, "_locked", lambda file, kind: (locked.append(file), within(file, kind))[1])
    remove_orphans()
    assert locked
    assert not {file.name.removesuffix(LOCK) for file in locked} & ports
