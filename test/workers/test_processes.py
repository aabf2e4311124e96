"""Processes that go on with the memory of the one that starts them."""

from __future__ import annotations

import ctypes
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from sal_height.commands import main

REFERENCE = Path(__file__).parents[2] / "bags" / "version_3"

PRELUDE = """
import json, os, signal, sys, threading
from sal_height.workers.processes import Forked, can_fork, use_one_thread
use_one_thread()
"""


def said_by(code: str) -> object:
    """What a program in an interpreter of its own prints as JSON: tests have threads, so that nothing can fork."""
    result = subprocess.run(  # noqa: S603 (our own code)
        [sys.executable, "-c", PRELUDE + code], capture_output=True, text=True, timeout=60, check=False
    )
    assert result.returncode == 0, result.stderr
    return json.loads(result.stdout.splitlines()[-1])  # the middleware may have said something before


def test_a_copy_has_the_memory_of_its_original_its_session_and_a_process_group_of_its_own() -> None:
    """Linux shares the processors out among sessions first, whatever their work."""
    code = """
held = ["from before"]
read, write = os.pipe()
def run():
    held.append("from the copy")
    os.write(write, json.dumps([held, os.getpgrp() == os.getpid(), os.getsid(0), os.getppid()]).encode())
    return 7
copy = Forked(run, "some_node_with_a_long_name")
status = copy.wait(30.0)
said = json.loads(os.read(read, 1000))
print(json.dumps([said[0], said[1], said[2] == os.getsid(0), said[3] == os.getpid(), held, status, copy.poll()]))
"""
    assert said_by(code) == [["from before", "from the copy"], True, True, True, ["from before"], 7, 7]


@pytest.mark.parametrize(
    ("run", "status"),
    [
        ("lambda: sys.exit(3)", 3),
        ("lambda: 1 / 0", 1),
        ("lambda: os.kill(os.getpid(), signal.SIGTERM) or signal.pause()", -15),
    ],
)
def test_a_copy_ends_as_a_program_of_its_own(run: str, status: int) -> None:
    """Whatever the original does about signals, exceptions and its own end."""
    code = f"""
import atexit
atexit.register(lambda: print("end of the original"))
signal.signal(signal.SIGTERM, lambda *_: None)
print(json.dumps(Forked({run}, "node").wait(30.0)))
atexit._clear()
"""
    assert said_by(code) == status


def test_a_copy_writes_past_the_display_of_its_original() -> None:
    code = """
import io
shown = sys.stdout
sys.stdout = io.StringIO()
copy = Forked(lambda: print('"from the copy"') or 0, "node")
sys.stdout, status = shown, copy.wait(30.0)
"""
    assert said_by(code) == "from the copy"


def test_a_copy_is_ended_by_the_signals_that_end_a_process() -> None:
    code = """
copies = [Forked(lambda: signal.pause() or 0, "node") for _ in range(2)]
running = [copy.poll() for copy in copies]
copies[0].terminate()
copies[1].kill()
print(json.dumps([running, [copy.wait(30.0) for copy in copies]]))
copies[0].terminate()
"""
    assert said_by(code) == [[None, None], [-15, -9]]


def test_the_wait_for_a_copy_has_an_end() -> None:
    code = """
import subprocess
copy = Forked(lambda: signal.pause() or 0, "node")
try:
    copy.wait(0.01)
except subprocess.TimeoutExpired:
    print(json.dumps(copy.poll()))
copy.kill()
"""
    assert said_by(code) is None


def test_work_is_done_beside_the_program_or_before_it_goes_on() -> None:
    """The latter where it has other threads."""
    code = """
from sal_height.workers.processes import run_in_copy
done = []
copy = run_in_copy(lambda: done.append(1) or 0, "work")
status = copy.wait(30.0)
ended = threading.Event()
threading.Thread(target=ended.wait).start()
print(json.dumps([status, len(done), run_in_copy(lambda: done.append(1) or 0, "work"), len(done)]))
ended.set()
"""
    assert said_by(code) == [0, 0, None, 1]


def test_nothing_forks_beside_other_threads() -> None:
    """Of Python or of the middleware, or where NumPy may use some; those that rclpy starts are allowed."""
    code = """
import numpy, rclpy
found = [can_fork()]
ended = threading.Event()
thread = threading.Thread(target=ended.wait)
thread.start()
found.append(can_fork())
ended.set()
thread.join()
found.append(can_fork())
os.environ["SAL_HEIGHT_THREADS"] = "2"
found.append(can_fork())
os.environ["SAL_HEIGHT_THREADS"] = "1"
from sal_height.nodes.transport.domain import free_domain
from sal_height.nodes.transport.graph import Graph
with free_domain() as domain, Graph(domain) as graph:
    graph.add(rclpy.create_node("node", context=graph.context))
    found.append(can_fork())
print(json.dumps(found))
"""
    assert said_by(code) == [True, False, True, False, False]


def test_one_thread_is_used_unless_the_environment_says_otherwise() -> None:
    code = "print(json.dumps([os.environ['SAL_HEIGHT_THREADS'], os.environ['OPENBLAS_NUM_THREADS']]))"
    wanted = os.environ | {"SAL_HEIGHT_THREADS": "5"}
    wanted.pop("OPENBLAS_NUM_THREADS", None)
    result = subprocess.run(  # noqa: S603 (our own code)
        [sys.executable, "-c", PRELUDE + code], capture_output=True, text=True, timeout=60, check=True, env=wanted
    )
    assert json.loads(result.stdout) == ["5", "1"]


def test_runs_import_nothing_that_only_pictures_and_statistics_need() -> None:
    code = """
import sal_height.runs.live.live, sal_height.runs.truth.simulate, sal_height.runs.replay.bag_replay
slow = ("matplotlib", "scipy.stats", "scipy.signal", "rasterio", "cyclopts")
print(json.dumps([name for name in slow if name in sys.modules]))
"""
    assert said_by(code) == []


@pytest.mark.parametrize("command", ["adjust", "movers"])
@pytest.mark.parametrize("threads", ["", "2"])
def test_commands_on_dwells_multiply_matrices_in_one_thread(
    command: str, threads: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Unless the environment says otherwise."""
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", threads)
    if not threads:
        monkeypatch.delenv("OPENBLAS_NUM_THREADS")
    (tmp_path / "file").touch()
    assert main([command, str(REFERENCE), "--out", str(tmp_path)]) == 2, "the folder is not empty"
    assert os.environ["OPENBLAS_NUM_THREADS"] == (threads or "1")


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "mallopt"), reason="this C library always gives memory back")
def test_memory_of_messages_is_used_again_for_the_next_ones() -> None:
    """Else each dwell of 2 MB takes more than a hundred new pages."""
    code = """
import resource
from sal_height.workers.processes import prepare_for_messages

def new_pages(dwells):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(dwells):
        messages = [bytearray(132_000) for _ in range(16)]
        del messages
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

prepare_for_messages()
new_pages(20)
print(json.dumps(new_pages(100)))
"""
    assert int(str(said_by(code))) < 500
