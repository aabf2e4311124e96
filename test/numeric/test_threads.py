"""Threads: as many as the process may use, on every operating system, started once and kept."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sal_height.errors import UserError
from sal_height.numeric import WORKERS, in_parallel, in_threads, threads


@pytest.fixture
def three(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Three threads, on every machine."""
    monkeypatch.setattr(threads, "WORKERS", 3)
    threads._helpers.cache_clear()
    yield
    threads._helpers.cache_clear()


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ({}, 8),
        ({"cpu.max": "max 100000\n"}, 8),
        ({"cpu.max": "250000 100000\n"}, 2),
        ({"cpu.max": "50000 100000\n"}, 1),
        ({"cpu.max": "9900000 100000\n"}, 8),
        ({"cpu.max": ""}, 8),
        ({"cpu/cpu.cfs_quota_us": "-1\n", "cpu/cpu.cfs_period_us": "100000\n"}, 8),
        ({"cpu/cpu.cfs_quota_us": "350000\n", "cpu/cpu.cfs_period_us": "100000\n"}, 3),
        ({"cpu/cpu.cfs_quota_us": "350000\n"}, 8),
    ],
)
def test_processors_are_those_of_affinity_and_of_the_container(
    files: dict[str, str], expected: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "cpu").mkdir()
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    monkeypatch.setattr(threads, "CONTROL_GROUPS", tmp_path)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _pid: set(range(8)))
    assert threads.available_processors() == expected


def number_in_a_new_process(code: str, **environment: str) -> int:
    """What a new process prints after running `code`, which defines `number`."""
    result = subprocess.run(  # noqa: S603 (our own code)
        [sys.executable, "-c", f"{code}\nprint(number)"],
        capture_output=True, text=True, check=False, timeout=60, env={**os.environ, **environment},
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    return int(result.stdout)


def test_it_can_be_imported_where_there_is_no_affinity() -> None:
    """On macOS and Windows."""
    code = "import os; del os.sched_getaffinity; from sal_height.numeric import WORKERS as number"
    assert number_in_a_new_process(code, SAL_HEIGHT_THREADS="") >= 1


def test_a_variable_sets_the_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(threads.THREADS_VARIABLE, "5")
    assert threads.number_of_threads() == 5


@pytest.mark.parametrize("text", ["0", "-1", "two", "1.5"])
def test_a_variable_that_is_no_number_of_threads_is_refused(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(threads.THREADS_VARIABLE, text)
    with pytest.raises(UserError, match=f"SAL_HEIGHT_THREADS is '{text}'; it must be a number of threads, 1 or more"):
        threads.number_of_threads()


@pytest.mark.parametrize("count", [0, 1, 2, 7, 1000])
@pytest.mark.parametrize("least", [1, 5, 10_000])
def test_every_item_is_worked_on_once(count: int, least: int) -> None:
    done = np.zeros(count, int)

    def work(part: slice) -> None:
        done[part] += 1

    in_parallel(work, count, least)
    assert np.all(done == 1)


@pytest.mark.usefixtures("three")
def test_few_items_are_left_to_the_calling_thread() -> None:
    workers = []
    in_parallel(lambda _: workers.append(threading.get_ident()), 100, 100)
    assert workers == [threading.get_ident()]
    assert not threads._helpers.cache_info().currsize


@pytest.mark.usefixtures("three")
def test_results_are_in_the_order_of_the_arguments() -> None:
    assert in_threads(pow, range(50), [2] * 50) == [number**2 for number in range(50)]


@pytest.mark.usefixtures("three")
def test_work_is_done_at_the_same_time_in_the_caller_and_in_helpers() -> None:
    """Each of three waits for the two others, which takes three threads."""
    meeting = threading.Barrier(3, timeout=30)

    def meet(_: int) -> int:
        meeting.wait()
        return threading.get_ident()

    once, again = in_threads(meet, range(3)), in_threads(meet, range(3))
    assert len(set(once)) == 3
    assert threading.get_ident() in once
    assert set(once) == set(again)


@pytest.mark.usefixtures("three")
def test_work_that_asks_for_help_itself_is_finished() -> None:
    """It would wait forever for helpers that all wait."""

    def sums(number: int) -> int:
        return sum(in_threads(sum, [range(n + number) for n in range(20)]))

    assert in_threads(sums, range(20)) == [sum(sum(range(n + m)) for n in range(20)) for m in range(20)]


@pytest.mark.usefixtures("three")
@pytest.mark.parametrize("place", [0, 5, 39])
def test_an_exception_is_raised_and_the_rest_is_not_begun(place: int) -> None:
    begun = []

    def work(number: int) -> None:
        begun.append(number)
        if number == place:
            raise UserError("This one fails.")

    with pytest.raises(UserError, match="This one fails"):
        in_threads(work, range(40))
    assert place in begun
    in_threads(begun.append, range(3))  # the threads are still there


@pytest.mark.usefixtures("three")
def test_an_exception_of_a_helper_is_raised_in_the_caller() -> None:
    meeting, caller = threading.Barrier(2, timeout=30), threading.get_ident()

    def fail_elsewhere(_: int) -> None:
        meeting.wait()
        if threading.get_ident() != caller:
            raise UserError("The helper fails.")

    with pytest.raises(UserError, match="The helper fails"):
        in_threads(fail_elsewhere, range(2))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork on Windows")
def test_a_forked_process_starts_threads_of_its_own() -> None:
    """Those of its parent do not live in it, and nobody would do what they are asked for."""
    code = """
import os, threading, warnings
from sal_height.numeric import in_threads
warnings.simplefilter("ignore")
def idents():
    meeting = threading.Barrier(3, timeout=30)
    return in_threads(lambda _: (meeting.wait(), threading.get_ident())[1], range(3))
idents()
child = os.fork()
if not child:
    os._exit(len(set(idents())))
number = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
"""
    assert number_in_a_new_process(code, SAL_HEIGHT_THREADS="3") == 3


def test_threads_do_not_grow_in_number() -> None:
    before = threading.active_count()
    for _ in range(20):
        in_parallel(lambda _: None, 1000)
    assert threading.active_count() <= max(before, before + WORKERS - 1)


@pytest.mark.usefixtures("three")
def test_callers_in_several_threads_all_get_their_results() -> None:
    results: dict[int, Any] = {}

    def call(number: int) -> None:
        results[number] = [in_threads(pow, range(10), [number] * 10) for _ in range(20)]

    callers = [threading.Thread(target=call, args=(number,)) for number in range(4)]
    for caller in callers:
        caller.start()
    for caller in callers:
        caller.join()
    assert results == {number: [[n**number for n in range(10)]] * 20 for number in range(4)}
