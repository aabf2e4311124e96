"""The process that starts workers, where some of them cannot work."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from sal_height.workers import keeper
from sal_height.workers.keeper import Keeper, no_shared_memory
from sal_height.workers.sending import Worker

TIMEOUT_S = 60.0


@contextmanager
def one_worker() -> Iterator[Keeper]:
    """A process that starts one worker, time after time."""
    started = Keeper(1, no_shared_memory(), {})
    started.starts.settimeout(TIMEOUT_S)
    try:
        yield started
    finally:
        started.close()


def next_worker(started: Keeper) -> Worker:
    """The next worker, which ends as its connection is closed."""
    worker = started.started_worker()
    worker.pipe.close()
    return worker


def test_a_worker_that_fails_ends_and_is_replaced(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Whatever its error: it must not start workers, as the process does that it is a copy of."""

    def fail(*_: Any) -> None:
        raise OSError("no such device")

    monkeypatch.setattr(keeper, "serve", fail)
    with one_worker() as started:
        workers = [next_worker(started) for _ in range(4)]
    assert [worker.number for worker in workers] == [0] * 4
    assert len({worker.pid for worker in workers}) == 4
    assert "no such device" in capfd.readouterr().err


def test_a_worker_of_which_nobody_was_notified_is_ended_and_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    """As where there are too many open files for the connection to it."""
    fails, send = iter([False, True, False, False]), socket.send_fds

    def send_if_possible(*args: Any) -> int:
        if next(fails):
            raise OSError
        return send(*args)

    monkeypatch.setattr(socket, "send_fds", send_if_possible)
    with one_worker() as started:
        workers = [next_worker(started) for _ in range(3)]
    assert [worker.number for worker in workers] == [0] * 3
