"""Nodes in processes of their own end with the program, however that one ends."""

from __future__ import annotations

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
from helpers import few
from mcap.reader import make_reader

from sal_height.bag.reader import BagReader
from sal_height.errors import UserError
from sal_height.graph.ensemble import Ensemble, Member
from sal_height.numeric import available_processors

PROCESSES_OF_LIVE = [
    "live host",
    "paced_player",
    "recorder",
    *(f"worker {n}" for n in range(available_processors())),
    "workers",
]
"""Each process is called like its node or its task: it was forked from the program, and did not start anew."""


def wait_for(condition: Callable[[], bool], seconds: float = 600) -> None:
    """Poll, and leave the processors to others between."""
    deadline, never = time.monotonic() + seconds, threading.Event()
    while not condition():
        assert time.monotonic() < deadline
        never.wait(0.05)


def children(parent: int) -> list[int]:
    """Processes that a process has started, or that these have."""
    own = [int(pid) for pid in Path(f"/proc/{parent}/task/{parent}/children").read_text().split()]
    return [*own, *(other for one in own if runs(one) for other in children(one))]


def runs(process: int) -> bool:
    """Whether a process exists and is no zombie."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(") ")[2][0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


@dataclass(frozen=True)
class Ended:
    """A program that was ended by a signal."""

    out: Path
    status: int
    log: str
    nodes: dict[int, str]
    """Its processes by number, and what they are called in lists of processes."""


def ended(words: list[str], out: Path, bag: Path, number: signal.Signals) -> Ended:
    """Have a program process more dwells than it has time for, and end it once some are recorded."""
    with subprocess.Popen(  # noqa: S603
        [sys.executable, "-m", "sal_height", *words, "--out", str(out)],
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as program:
        wait_for(lambda: bag.is_file() and bag.stat().st_size > 600_000)
        nodes = {node: Path(f"/proc/{node}/comm").read_text().strip() for node in children(program.pid) if runs(node)}
        program.send_signal(number)
        _, log = program.communicate(timeout=600)
    return Ended(out, program.returncode, log, nodes)


def ended_live(folder: Path, number: signal.Signals) -> Ended:
    """The same of a program with a process for each node."""
    words = ["live", "--preset", "small", "--dwells", "90", "--rate", "0.05", "--budget", "30"]
    words += ["--record", "phase_history", "--param", f"relief_mapper.file={folder / 'map.tif'}"]
    return ended(words, folder / "out", folder / "out" / "run" / "bag" / "bag_0.mcap", number)


@pytest.fixture(scope="module")
def interrupted(tmp_path_factory: pytest.TempPathFactory) -> Ended:
    return ended_live(tmp_path_factory.mktemp("interrupted"), signal.SIGINT)


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> Ended:
    return ended_live(tmp_path_factory.mktemp("killed"), signal.SIGKILL)


def assert_is_whole(bag: Path) -> None:
    """Its recorder had time to end it."""
    with bag.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None


@pytest.mark.parametrize(("kind", "status"), few(1, [("killed", -signal.SIGKILL), ("interrupted", 0)]))
def test_no_process_survives_the_program_and_its_files_are_whole(
    kind: str, status: int, request: pytest.FixtureRequest
) -> None:
    ended: Ended = request.getfixturevalue(kind)
    assert sorted(ended.nodes.values()) == PROCESSES_OF_LIVE
    wait_for(lambda: not any(runs(node) for node in ended.nodes))
    assert ended.status == status
    assert "Traceback" not in ended.log
    assert_is_whole(ended.out / "run" / "bag" / "bag_0.mcap")
    with rasterio.open(ended.out.parent / "map.tif") as relief:  # the relief mapper had time, too
        assert relief.read(4).sum() > 0


@pytest.mark.thorough
def test_nodes_in_processes_give_the_same_heights_as_nodes_in_one(
    interrupted: Ended, tmp_path: Path, replay: Any
) -> None:
    """Of the dwells that were cut off, a node may have fewer heights than the replay."""
    bag = interrupted.out / "run" / "bag"
    compared = replay(bag, tmp_path / "replay", {}).compared
    assert set(compared) == {"/ml/height", "/monopulse/height", "/tracked/height"}
    held = BagReader(bag).topics
    for topic, result in compared.items():
        assert result.matched == held[topic].count > 0
        assert not any(one.different for one in result.fields.values())


def test_a_node_whose_parent_has_ended_does_not_begin() -> None:
    nobody = subprocess.Popen([sys.executable, "-c", ""])
    nobody.wait(600)
    words = [sys.executable, "-m", "sal_height.graph.ensemble", "monopulse", str(nobody.pid), '[["monopulse", []]]']
    assert subprocess.run(words, timeout=600, check=False).returncode == 1  # noqa: S603


def test_when_a_node_cannot_be_started_the_others_end(monkeypatch: pytest.MonkeyPatch) -> None:
    real, started = subprocess.Popen, []

    def popen(*arguments: Any, **keywords: Any) -> Any:
        if len(started) == 2:
            raise OSError(11, os.strerror(11))
        started.append(real(*arguments, **keywords))
        return started[-1]

    monkeypatch.setattr(subprocess, "Popen", popen)
    members = [Member(name) for name in ("ml_height", "monopulse", "sar_compression")]
    with pytest.raises(UserError, match="Node sar_compression cannot be started"), Ensemble(members, "each"):
        pass
    assert [process.poll() is None for process in started] == [False, False]
