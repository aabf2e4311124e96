"""Jobs of a chain on worker processes: their order, their series, and workers that end."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection
from typing import Any, ClassVar

import numpy as np
import pytest
from helpers import refused

from sal_height.engine.results import DwellKey, Product, Result
from sal_height.engine.stage import Job, Port, Stage, StageSettings
from sal_height.errors import UserError
from sal_height.runs.chain import side_by_side
from sal_height.runs.chain.side_by_side import AHEAD, TOGETHER, SideBySide, _together
from sal_height.workers.sending import BYTES_TOGETHER

SETTINGS = StageSettings()
IN, SQUARE, SUM = (Port(name, float, name) for name in ("in", "square", "sum"))


class FromPortToPort(Stage):
    """A stage that accepts what arrives on one port, and makes products for another one."""

    ports: ClassVar[tuple[Port, Port]]

    @classmethod
    def inputs(cls, settings: Any) -> Sequence[Port]:  # noqa: ARG003
        return cls.ports[:1]

    @classmethod
    def outputs(cls, settings: Any) -> Sequence[Port]:  # noqa: ARG003
        return cls.ports[1:]


class Squares(FromPortToPort):
    """Squares numbers, and numbers its jobs of each series; the input -1 has it end its process."""

    usual_name = "squares"
    ports = IN, SQUARE
    is_parallel = True

    def __init__(self) -> None:
        super().__init__(SETTINGS)
        self._before: dict[str, int] = {}

    def receive(self, port: str, item: tuple[float, str | None]) -> None:  # noqa: ARG002
        value, series = item
        self.add_job(DwellKey("", int(value), 0), value, series=series)

    def work(self, job: Job) -> Iterator[Result]:
        if job.inputs < 0:
            os.kill(os.getpid(), signal.SIGKILL)
        if job.series is not None:
            self._before[job.series] = self._before.get(job.series, -1) + 1
        size = 100_000 if job.inputs % 3 else 10  # those of the others are made sooner
        yield Product("square", (np.full(size, job.inputs) ** 2, self._before.get(job.series or ""), os.getpid()))


class Sums(FromPortToPort):
    """Sums of all squares so far."""

    usual_name = "sums"
    ports = SQUARE, SUM
    total = 0.0

    def receive(self, port: str, item: Any) -> None:  # noqa: ARG002
        self.add_job(DwellKey("", int(item[0][0]), 0), item, series="sums")

    def work(self, job: Job) -> Iterator[Result]:
        self.total += job.inputs[0][-1]
        yield Product("sum", (self.total, os.getpid()))


def products(inputs: Sequence[tuple[float, str | None]], jobs: int = 2) -> dict[str, list[Any]]:
    """Products of both stages, by their ports."""
    made: dict[str, list[Any]] = {"square": [], "sum": []}
    with SideBySide([Squares(), Sums(SETTINGS)], [SETTINGS, SETTINGS], jobs) as chain:
        steps = [chain.start(), *(chain.feed("in", item) for item in inputs), chain.finish()]
        for one in (one for step in steps for one in step):
            made[one.result.port].append(one.result.item)
    return made


def test_results_are_handed_on_in_the_order_of_the_jobs() -> None:
    made = products([(float(number), None) for number in range(100)])
    assert [square[0][0] for square in made["square"]] == [number**2 for number in range(100)]
    assert [total for total, _ in made["sum"]] == list(np.cumsum(np.arange(100.0) ** 2))
    assert len({process for _, _, process in made["square"]}) == 3  # this one, and the workers from the second job on
    assert {process for _, process in made["sum"]} == {os.getpid()}


def test_jobs_of_a_series_go_to_one_worker_in_their_order_with_what_was_kept_before_it_started() -> None:
    names = ("first", "second")
    made = products([(float(number), names[number % 2]) for number in range(60)])["square"]
    assert [place for _, place, _ in made] == [number // 2 for number in range(60)]
    processes = [{process for _, _, process in made[first::2]} - {os.getpid()} for first in (0, 1)]
    assert [len(one) for one in processes] == [1, 1]
    assert processes[0] != processes[1]


def test_a_worker_that_ends_ends_the_run() -> None:
    with refused(UserError, "A worker process has ended", "use fewer --jobs"):
        products([(1.0, None), (2.0, None), (-1.0, None), (3.0, None)])


@pytest.mark.parametrize("possible", [0, 1, 2])
def test_workers_that_cannot_be_started_end_the_run(
    monkeypatch: pytest.MonkeyPatch, possible: int, capfd: pytest.CaptureFixture[str]
) -> None:
    """The process that starts them, the first one, or the second one."""
    left, fork = [None] * possible, os.fork

    def fork_if_possible() -> int:
        if not left:
            raise BlockingIOError
        left.pop()
        return fork()

    monkeypatch.setattr(os, "fork", fork_if_possible)
    with refused(UserError, "cannot be started", "use fewer --jobs"):
        products([(1.0, None), (2.0, None)])
    assert not capfd.readouterr().err


def test_memory_that_cannot_be_reserved_ends_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(side_by_side, "MEMORY_BYTES", 1 << 62)
    with refused(UserError, "cannot be started", "use fewer --jobs"):
        products([(1.0, None), (2.0, None)])


def test_no_worker_starts_where_no_stage_has_jobs_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse() -> int:
        raise BlockingIOError

    monkeypatch.setattr(os, "fork", refuse)
    with SideBySide([Sums(SETTINGS)], [SETTINGS], 2) as chain:
        made = [one.result for number in range(3) for one in chain.feed("square", (np.full(1, number), 0))]
    assert [product.item[0] for product in made if isinstance(product, Product)] == [0, 1, 3]


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_results_that_cannot_be_read_end_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """As where there is no memory for them."""
    read = Connection.recv_bytes

    def read_by_main_thread(pipe: Connection) -> bytes:
        if threading.current_thread() is not threading.main_thread():
            raise MemoryError
        return read(pipe)

    monkeypatch.setattr(Connection, "recv_bytes", read_by_main_thread)
    with refused(UserError, "A worker process has ended"):
        products([(1.0, None), (2.0, None)])


class OneSlow(Squares):
    """Squares of which the second waits until it may go on."""

    def __init__(self) -> None:
        super().__init__()
        self.may_go_on, self.let = os.pipe()

    def work(self, job: Job) -> Iterator[Result]:
        if job.inputs == 1:
            os.read(self.may_go_on, 1)
        yield from super().work(job)


class Patient(SideBySide):
    """Lets the slow job go on only when all other workers have nothing left to do."""

    unfinished = 0
    """Number of jobs without a result then."""

    def _receive(self, *, waits: bool = False) -> None:
        if waits and not self.unfinished and sum(bool(worker.sent) for worker in self._workers) == 1:
            self.unfinished = len(self._unfinished)
            os.write(self.stages[0].let, b"x")  # type: ignore[attr-defined]
        super()._receive(waits=waits)


def test_results_that_wait_for_a_slow_job_are_limited() -> None:
    """The other worker makes no more of them then, and the order remains."""
    stage = OneSlow()
    with Patient([stage], [SETTINGS], 2) as chain:
        steps = [chain.start(), *(chain.feed("in", (float(number), None)) for number in range(300)), chain.finish()]
        made = [one.result for step in steps for one in step]
    assert [product.item[0][0] for product in made if isinstance(product, Product)] == [n**2 for n in range(300)]
    assert 2 * AHEAD * TOGETHER < chain.unfinished <= 4 * AHEAD * TOGETHER + 1
    os.close(stage.may_go_on)
    os.close(stage.let)


def test_large_jobs_are_sent_one_by_one() -> None:
    """Images of many of them would fill the memory."""
    sizes = (0, BYTES_TOGETHER // TOGETHER, BYTES_TOGETHER // 2, BYTES_TOGETHER // 2 + 1, 10 * BYTES_TOGETHER)
    assert [_together([Job(None, None, None, size=size)]) for size in sizes] == [TOGETHER, TOGETHER, 2, 1, 1]
