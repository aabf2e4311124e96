"""Nodes in processes of their own end with the run, however that one ends."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import rasterio
from mcap.reader import make_reader

from sal_height.errors import UserError
from sal_height.runs.ensemble import Ensemble, Member
from sal_height.runs.lead import MOST_AHEAD
from sal_height.runs.processes import adopted_from
from sal_height.runs.replay import replay

NODES_OF_A_RUN = [
    "ml_height",
    "monopulse",
    "recorder",
    "relief_mapper",
    "relief_tracker",
    "sar_compression",
    "simulator",
]
"""Each process is called like its node: it was forked from the run, and did not start anew."""


def wait_for(condition: Callable[[], bool], seconds: float = 60) -> None:
    """Poll, and leave the processors to others between."""
    deadline, never = time.monotonic() + seconds, threading.Event()
    while not condition():
        assert time.monotonic() < deadline
        never.wait(0.05)


def children(parent: int) -> list[int]:
    return [int(pid) for pid in Path(f"/proc/{parent}/task/{parent}/children").read_text().split()]


def runs(process: int) -> bool:
    """Whether a process exists and is no zombie."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(") ")[2][0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


@dataclass(frozen=True)
class Ended:
    """A run with a process for each node that was ended by a signal."""

    out: Path
    status: int
    log: str
    nodes: dict[int, str]
    """Its processes by number, and what they are called in lists of processes."""


def ended_run(out: Path, number: signal.Signals) -> Ended:
    """Run more dwells than it has time for, and end it once some are recorded."""
    words = ["run", "--preset", "small", "--dwells", "90", "--out", str(out), "--processes"]
    bag = out / "bag" / "bag_0.mcap"
    with subprocess.Popen(  # noqa: S603
        [sys.executable, "-m", "sal_height", *words], stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as program:
        wait_for(lambda: bag.is_file() and bag.stat().st_size > 600_000)
        nodes = {node: Path(f"/proc/{node}/comm").read_text().strip() for node in children(program.pid)}
        program.send_signal(number)
        _, log = program.communicate(timeout=60)
    return Ended(out, program.returncode, log, nodes)


@pytest.fixture(scope="module")
def interrupted(tmp_path_factory: pytest.TempPathFactory) -> Ended:
    return ended_run(tmp_path_factory.mktemp("interrupted") / "run", signal.SIGINT)


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> Ended:
    return ended_run(tmp_path_factory.mktemp("killed") / "run", signal.SIGKILL)


@pytest.mark.parametrize(("kind", "status"), [("interrupted", 130), ("killed", -signal.SIGKILL)])
def test_no_process_survives_the_run_and_its_files_are_whole(
    kind: str, status: int, request: pytest.FixtureRequest
) -> None:
    ended: Ended = request.getfixturevalue(kind)
    assert sorted(ended.nodes.values()) == NODES_OF_A_RUN
    wait_for(lambda: not any(runs(node) for node in ended.nodes))
    assert ended.status == status
    assert "Traceback" not in ended.log
    with (ended.out / "bag" / "bag_0.mcap").open("rb") as stream:  # the recorder had time to end it
        summary = make_reader(stream).get_summary()
    assert summary is not None
    with rasterio.open(ended.out / "relief_map.tif") as relief:  # so had the relief mapper
        assert relief.read(4).sum() > 0


def test_an_interrupted_run_says_so_in_its_report(interrupted: Ended) -> None:
    report = json.loads((interrupted.out / "report.json").read_text())
    assert report["interrupted"] is True
    assert 1 <= report["dwells"] < 90


def test_nodes_in_processes_give_the_same_heights_as_nodes_in_one(interrupted: Ended, tmp_path: Path) -> None:
    """Of the dwells that were cut off, a node may have more or fewer heights than the replay."""
    compared = replay(interrupted.out / "bag", tmp_path / "replay", {"sar_compression": {"timeout_s": 3.0}}).compared
    assert set(compared) == {"/ml/height", "/monopulse/height", "/tracked/height"}
    dwells = json.loads((interrupted.out / "report.json").read_text())["dwells"]
    for result in compared.values():
        assert result.matched >= dwells - 1 - MOST_AHEAD
        assert not any(one.different for one in result.fields.values())


def test_a_node_whose_parent_has_ended_does_not_begin() -> None:
    nobody = subprocess.Popen([sys.executable, "-c", ""])
    nobody.wait(60)
    words = [sys.executable, "-m", "sal_height.runs.ensemble", "monopulse", "monopulse", str(nobody.pid)]
    assert subprocess.run(words, timeout=60, check=False).returncode == 1  # noqa: S603


CANNOT_BE_COPIED = """
import sys, threading
from rclpy.node import Node
from sal_height.runs.ensemble import Ensemble, Member

if __name__ == "__main__":
    threading.Thread(target=threading.Event().wait, daemon=True).start()
    with Ensemble([Member("near", "ml_height"), Member("monopulse")], True) as ensemble:
        watcher = ensemble.graph.add(Node("watcher", context=ensemble.graph.context))
        up = ensemble.graph.spin_until(lambda: {"near", "monopulse"} <= set(watcher.get_node_names()), 60.0)
        print("up" if up else "down", flush=True)
        ensemble.graph.spin_for(60.0)
"""

THIRD_FORK_FAILS = """
import errno, os, sys
from sal_height.runs import starter

real, numbers = os.fork, []

def fork():
    if len(numbers) == 2:
        raise OSError(errno.EAGAIN, os.strerror(errno.EAGAIN))
    numbers.append(real())
    return numbers[-1]

os.fork = fork
status = starter.main()
print(*numbers, sep="\\n", file=sys.stderr)
sys.exit(status)
"""


def test_nodes_of_a_process_that_cannot_be_copied_are_its_own_and_end_with_it() -> None:
    program = subprocess.Popen([sys.executable, "-c", CANNOT_BE_COPIED], stdout=subprocess.PIPE, text=True)  # noqa: S603
    with program:
        assert program.stdout
        assert program.stdout.readline() == "up\n"
        nodes = {node: Path(f"/proc/{node}/comm").read_text().strip() for node in children(program.pid)}
        assert sorted(nodes.values()) == ["monopulse", "near"]
        program.kill()
    wait_for(lambda: not any(runs(node) for node in nodes))


def test_when_a_copy_cannot_be_made_the_others_end(capfd: pytest.CaptureFixture[str]) -> None:
    """Otherwise this process, which adopts what the starter leaves, would be their parent."""
    members = json.dumps([{"name": name} for name in ("ml_height", "monopulse", "sar_compression")])
    with pytest.raises(UserError, match="ended with status 2; its message is above"):
        adopted_from([sys.executable, "-c", THIRD_FORK_FAILS, str(os.getpid()), members])
    said, *others = capfd.readouterr().err.splitlines()
    assert said.startswith("Node sar_compression cannot be started in a process of its own: ")
    assert len(others) == 2
    assert not set(map(int, others)) & set(children(os.getpid()))


def test_what_was_to_start_the_nodes_may_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sal_height.runs.ensemble.STARTER", "no_such_program")
    with (
        pytest.raises(UserError, match="ended with status 1; its message is above"),
        Ensemble([Member("monopulse")], True),
    ):
        pass


def test_when_a_node_cannot_be_started_the_others_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each begins anew, because a starter that works in several threads cannot be copied either."""
    monkeypatch.setenv("SAL_HEIGHT_THREADS", "2")
    real, started = subprocess.Popen, list[Any]()

    def popen(*arguments: Any, **keywords: Any) -> Any:
        if len(started) == 2:
            raise OSError(11, os.strerror(11))
        started.append(real(*arguments, **keywords))
        return started[-1]

    monkeypatch.setattr(subprocess, "Popen", popen)
    members = [Member(name) for name in ("ml_height", "monopulse", "sar_compression")]
    with pytest.raises(UserError, match="Node sar_compression cannot be started"), Ensemble(members, True):
        pass
    assert [process.poll() is None for process in started] == [False, False]
