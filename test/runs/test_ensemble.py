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


def test_when_a_node_cannot_be_started_the_others_end(monkeypatch: pytest.MonkeyPatch) -> None:
    real, started = subprocess.Popen, []

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
