"""Nodes in processes of their own end with the run, however that one ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import rasterio
from mcap.reader import make_reader

from sal_height.errors import UserError
from sal_height.nodes.graph import Graph
from sal_height.runs.ensemble import Ensemble


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


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGKILL])
def test_no_process_survives_the_run(number: signal.Signals, tmp_path: Path) -> None:
    out = tmp_path / "run"
    words = ["run", "--preset", "small", "--dwells", "90", "--out", str(out), "--processes"]
    bag = out / "bag" / "bag_0.mcap"
    with subprocess.Popen(  # noqa: S603
        [sys.executable, "-m", "sal_height", *words], stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL
    ) as program:
        wait_for(lambda: bag.is_file() and bag.stat().st_size > 300_000)
        nodes = children(program.pid)
        program.send_signal(number)
        status = program.wait(60)
    assert len(nodes) == 7
    wait_for(lambda: not any(runs(node) for node in nodes))
    assert status == {signal.SIGHUP: 130, signal.SIGKILL: -signal.SIGKILL}[number]
    with bag.open("rb") as stream:  # whole, for the recorder had time to end it
        summary = make_reader(stream).get_summary()
    assert summary is not None
    with rasterio.open(out / "relief_map.tif") as relief:  # so had the relief mapper
        assert relief.read(4).sum() > 0


def test_a_node_whose_parent_has_ended_does_not_begin() -> None:
    nobody = subprocess.Popen([sys.executable, "-c", ""])
    nobody.wait(60)
    words = [sys.executable, "-m", "sal_height.runs.ensemble", "monopulse", str(nobody.pid)]
    assert subprocess.run(words, timeout=60, check=False).returncode == 1  # noqa: S603


def test_when_a_node_cannot_be_started_the_others_end(graph: Graph, monkeypatch: pytest.MonkeyPatch) -> None:
    real, started = subprocess.Popen, []

    def popen(*arguments: Any, **keywords: Any) -> Any:
        if len(started) == 2:
            raise OSError(11, os.strerror(11))
        started.append(real(*arguments, **keywords))
        return started[-1]

    monkeypatch.setattr(subprocess, "Popen", popen)
    names = ["ml_height", "monopulse", "sar_compression"]
    with pytest.raises(UserError, match="Node sar_compression cannot be started"), Ensemble(graph, names, {}, True):
        pass
    assert [process.poll() is None for process in started] == [False, False]
