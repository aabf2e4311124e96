"""A pool with jobs whose outcome is known, as a program: workers are forked, which a process with threads must not do.

It prints what became of the jobs as JSON.
"""

from __future__ import annotations

import gc
import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from sal_height.engine.registry import STAGES
from sal_height.engine.results import DwellKey, Product, Result
from sal_height.engine.stage import Job, Rehearsal, Stage, StageSettings
from sal_height.errors import Rejected
from sal_height.nodes.jobs import JobQueue, QueuedJob
from sal_height.workers.pool import Ahead, Pool, Suits

SETTINGS = StageSettings()
TIMEOUT_S = 60.0


class Doubling(Stage):
    """Doubles arrays, and says which process did; some inputs have it end its process, or wait."""

    usual_name = "doubling"

    def work(self, job: Job) -> Iterator[Result]:
        """The double of the input, and the process."""
        if isinstance(job.inputs, str):
            os.kill(os.getpid(), signal.SIGKILL)
        if isinstance(job.inputs, float):
            time.sleep(job.inputs)
        yield Product("process", os.getpid())
        if isinstance(job.inputs, np.ndarray):
            yield Product("double", 2 * job.inputs)


class Client:
    """A node, as the pool sees it."""

    kind = "doubling"

    def __init__(self, name: str, log: list[str]) -> None:
        self.name, self.log = name, log
        self.jobs = JobQueue()
        self.results: dict[int, Sequence[Any]] = {}
        self.lost: dict[int, str] = {}

    def put(self, number: int, inputs: Any, series: str | None = None) -> None:
        """Have a job wait."""
        size = getattr(inputs, "nbytes", 0)
        job = Job(DwellKey("", number, 0), inputs, SETTINGS, 1, size, series)
        self.jobs.put(QueuedJob(lambda: 0, 1, size, job), 1000, 1e12, "oldest")

    @property
    def waiting_jobs(self) -> int:
        """Jobs that wait."""
        return self.jobs.waiting

    def take_jobs(self, most: int, most_bytes: int, suits: Suits, ahead_s: float) -> Sequence[QueuedJob]:
        """Jobs for a worker."""
        assert ahead_s >= 0
        return self.jobs.take(most, most_bytes, suits)

    def conclude(self, entry: QueuedJob, results: Sequence[Any], cpu_s: float) -> None:
        """Keep results."""
        assert cpu_s >= 0
        self.results[entry.item.dwell.number] = [one.item for one in results]
        self.log.append(self.name)
        self.jobs.note_done()

    def lose(self, entry: QueuedJob, reason: Rejected) -> None:
        """Keep the reason of a loss."""
        self.lost[entry.item.dwell.number] = reason.reason
        self.jobs.note_done()

    def run_here(self, entry: QueuedJob) -> None:
        """No job is of this kind."""
        raise AssertionError(entry)


def until(condition: Callable[[], bool]) -> float:
    """Wait for a condition; the time that it took, s."""
    began, never = time.monotonic(), threading.Event()
    while not condition():
        if time.monotonic() - began > TIMEOUT_S:
            raise TimeoutError
        never.wait(0.005)
    return time.monotonic() - began


def equal_results(memory_bytes: int) -> dict[str, Any]:
    """Arrays that are doubled, by workers with so much shared memory."""
    pool, client = Pool(2, memory_bytes), Client("only", [])
    pool.serve(client, later=False)
    inputs = [np.random.default_rng(number).normal(size=100_000 + number) for number in range(24)]
    for number, array in enumerate(inputs):
        client.put(number, array)
    pool.start()
    pool.wake()
    client.jobs.wait_until_done(TIMEOUT_S)
    equal = [bool(np.array_equal(client.results[n][1], 2 * array)) for n, array in enumerate(inputs)]
    processes = len({results[0] for results in client.results.values()})
    client.results.clear()
    gc.collect()
    free = pool._arena.free_bytes
    pool.close()
    return {"equal": sum(equal), "processes": processes, "free": free}


def lost_worker() -> dict[str, Any]:
    """Jobs before and after one that kills its worker."""
    pool, client = Pool(2), Client("only", [])
    pool.serve(client, later=False)
    pool.start()
    until(lambda: len(pool.worker_pids) == 2)
    before = set(pool.worker_pids)
    client.put(0, "end")
    pool.wake()
    until(lambda: 0 in client.lost)
    back_s = until(lambda: len(set(pool.worker_pids) - before) == 1 and len(pool.worker_pids) == 2)
    for number in range(1, 9):
        client.put(number, 0.01)
    pool.wake()
    client.jobs.wait_until_done(TIMEOUT_S)
    pool.close()
    return {"lost": client.lost, "made": sorted(client.results), "back_s": back_s}


def series() -> dict[str, Any]:
    """Jobs of a series, whose worker ends among them, and others."""
    pool, client = Pool(2), Client("only", [])
    pool.serve(client, later=False)
    for number in range(12):
        client.put(number, 0.01, "strip")
        client.put(100 + number, 0.01)
    pool.start()
    pool.wake()
    client.jobs.wait_until_done(TIMEOUT_S)
    first = [client.results[number][0] for number in range(12)]
    os.kill(first[0], signal.SIGKILL)
    until(lambda: first[0] not in pool.worker_pids)
    for number in range(12, 16):
        client.put(number, 0.01, "strip")
    pool.wake()
    client.jobs.wait_until_done(TIMEOUT_S)
    after = [client.results[number][0] for number in range(12, 16) if number in client.results]
    order = list(client.results)
    pool.close()
    return {
        "processes": len(set(first)),
        "after": len(set(after)),
        "moved": first[0] not in after,
        "in_order": order == sorted(order, key=lambda number: number % 100 + number // 100 / 2),
        "lost": client.lost,
        "accounted": len(client.results) + len(client.lost),
    }


def rehearsal() -> dict[str, Any]:
    """A rehearsal, which each worker works on, and which is concluded once."""
    pool, client = Pool(3), Client("only", [])
    pool.serve(client, later=False)
    client.put(0, Rehearsal())
    pool.start()
    until(lambda: len(pool.worker_pids) == 3)
    pool.wake()
    client.jobs.wait_until_done(TIMEOUT_S)
    pool.close()
    return {"concluded": client.log, "made": len(client.results)}


def order() -> dict[str, Any]:
    """What a single worker does first that finds jobs of both kinds, after one that took a while."""
    log: list[str] = []
    pool = Pool(1)
    first, later = Client("first", log), Client("later", log)
    pool.serve(first, later=False)
    pool.serve(later, later=True)
    pool.start()
    until(lambda: len(pool.worker_pids) == 1)
    first.put(0, 0.3)
    pool.wake()
    until(lambda: not first.waiting_jobs)
    for number in range(1, 4):
        first.put(number, 0.0)
        later.put(number, 0.0)
    pool.wake()
    until(lambda: len(log) == 7)
    pool.close()
    return {"log": log}


def one_after_the_other() -> dict[str, Any]:
    """Jobs of two workers, of which one is slow at first, and in the end killed."""
    pool, client = Pool(2), Client("only", [])
    pool.serve(client, later=False)
    pool.start()
    until(lambda: len(pool.worker_pids) == 2)
    for number, seconds in enumerate((0.4, 0.0, 0.0, 0.0, 0.0)):
        client.put(number, seconds)
        pool.wake()
        until(lambda: not client.waiting_jobs)
    client.jobs.wait_until_done(TIMEOUT_S)
    order, processes = list(client.results), {results[0] for results in client.results.values()}
    for number, inputs in ((5, "end"), (6, 0.0), (7, 0.0)):
        client.put(number, inputs)
        pool.wake()
        until(lambda: not client.waiting_jobs)
    client.jobs.wait_until_done(TIMEOUT_S)
    pool.close()
    return {"order": order, "processes": len(processes), "after": list(client.results)[5:], "lost": client.lost}


def without_keeper() -> dict[str, Any]:
    """What a pool says when the process that starts workers is killed."""
    pool, client = Pool(2), Client("only", [])
    pool.serve(client, later=False)
    pool.start()
    until(lambda: len(pool.worker_pids) == 2)
    before = pool.failure
    pool._keeper._process.kill()
    until(lambda: bool(pool.failure))
    said = pool.failure
    pool.close()
    return {"before": before, "said": "the process that starts workers has ended" in said}


def hiccup() -> dict[str, Any]:
    """Time that is expected of dwells, of which one in thirty took long."""
    ahead = Ahead()
    for number in range(30):
        job = Job(DwellKey("", number, 0), None, SETTINGS)
        ahead.begin([job], float(number))
        ahead.end([job], number + (5.0 if number == 20 else 0.1))
    return {"expected_s": round(ahead.expected_s, 6)}


def main() -> None:
    """Run what the arguments name."""
    STAGES["doubling"] = Doubling  # type: ignore[index]
    outcomes = {
        "plenty": lambda: equal_results(100_000_000),
        "scarce": lambda: equal_results(1_000_000),
        "lost_worker": lost_worker,
        "series": series,
        "rehearsal": rehearsal,
        "order": order,
        "one_after_the_other": one_after_the_other,
        "without_keeper": without_keeper,
        "hiccup": hiccup,
    }
    sys.stdout.write(json.dumps({name: outcomes[name]() for name in sys.argv[1:]}))


if __name__ == "__main__":
    main()
