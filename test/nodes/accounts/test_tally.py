"""Accounting: at any time, received = processed + dropped + waiting."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from threading import Barrier, Event

import numpy as np
import pytest

from sal_height.nodes.accounts.tally import LastMinute, Latest, Pace, Tally


def test_counts_and_reasons() -> None:
    tally = Tally()
    for _ in range(10):
        tally.receive()
    tally.drop(1, "wrong size")
    tally.drop(2, "late")
    tally.drop(1, "late")
    tally.finish(3, published=1, latency_s=0.02)
    tally.ignore("bad odometry")
    tally.ignore("bad odometry")
    assert tally.summary() == {
        "in": 10,
        "processed": 3,
        "out": 1,
        "waiting": 3,
        "latency_p50_ms": 20.0,
        "latency_p95_ms": 20.0,
        "dropped.late": 3,
        "dropped.wrong size": 1,
        "ignored.bad odometry": 2,  # not received in the sense of the balance
        "last_minute.dropped.late": 3,
        "last_minute.dropped.wrong size": 1,
        "last_minute.ignored.bad odometry": 2,
    }


def test_the_last_minute_forgets_what_is_older_and_the_counts_do_not() -> None:
    now = [100.0]
    tally = Tally(clock=lambda: now[0])
    for second in range(90):
        now[0] = 100.0 + second
        tally.drop(2, "late")
        tally.ignore("odometry")
    summary = tally.summary()
    assert summary["last_minute.dropped.late"] == 120
    assert summary["last_minute.ignored.odometry"] == 60
    assert summary["dropped.late"] == 180
    now[0] += 60.0
    assert not [name for name in tally.summary() if name.startswith("last_minute.")]


def test_the_last_minute_takes_no_more_memory_than_a_minute() -> None:
    lately = LastMinute()
    for tick in range(100_000):
        lately.add(tick * 0.01, "late", 1)
    assert len(lately._seconds) <= 60
    assert lately.counts(999.99) == {"late": 6000}


def test_nothing_finished_has_no_latency() -> None:
    assert Tally().summary() == {"in": 0, "processed": 0, "out": 0, "waiting": 0}


def test_latencies_are_percentiles_of_the_last_thousand() -> None:
    tally = Tally()
    tally.finish(1, 1, latency_s=1e6)
    for milliseconds in range(1000):
        tally.finish(1, 1, latency_s=milliseconds / 1e3)
    summary = tally.summary()
    assert summary["latency_p50_ms"] == pytest.approx(499.5)
    assert summary["latency_p95_ms"] == pytest.approx(0.95 * 999)


@pytest.mark.parametrize("count", [1, 2, 7, 8, 23])
def test_quantiles_are_those_of_the_latest_numbers(count: int) -> None:
    numbers, latest = np.random.default_rng(count).integers(0, 9, count).tolist(), Latest(8)
    for number in numbers:
        latest.add(number)
    assert len(latest) == min(count, 8)
    for share in (0.0, 0.3, 0.5, 0.95, 1.0):
        assert latest.quantile(share) == pytest.approx(np.quantile(numbers[-8:], share))


def test_balance_holds_at_any_time_under_several_threads() -> None:
    threads, rounds = 4, 3000
    tally, barrier, done = Tally(), Barrier(threads + 1), Event()

    def work(number: int) -> None:
        barrier.wait()
        for i in range(rounds):
            tally.receive()
            tally.receive()
            tally.drop(1, f"reason {number % 2}")
            if i % 2:
                tally.finish(1, published=2, latency_s=1e-3)

    def watch() -> int:
        barrier.wait()
        looks = 0
        while not done.is_set() or looks == 0:
            summary = tally.summary()
            dropped = sum(value for key, value in summary.items() if key.startswith("dropped."))
            assert summary["in"] == summary["processed"] + dropped + summary["waiting"]
            assert 0 <= summary["waiting"] <= summary["in"]
            assert summary["out"] == 2 * summary["processed"]
            looks += 1
        return looks

    with ThreadPoolExecutor(threads + 1) as pool:
        watcher = pool.submit(watch)
        for worker in [pool.submit(work, number) for number in range(threads)]:
            worker.result()
        done.set()
        assert watcher.result() > 0
    summary = tally.summary()
    total = threads * rounds
    assert (summary["in"], summary["processed"], summary["waiting"]) == (2 * total, total // 2, total // 2)
    assert (summary["dropped.reason 0"], summary["dropped.reason 1"]) == (total // 2, total // 2)


def test_the_pace_is_that_of_the_last_samples() -> None:
    pace = Pace()
    assert pace.rates() == []
    for second in range(100):
        pace.sample(second / 2, 40 * second, 20 * second if second < 90 else 1800 + 10 * (second - 90))
    assert pace.rates() == [80.0, 20.0]


def test_dwells_offered_and_finished_are_counted_beside_their_messages() -> None:
    tally = Tally()
    for _ in range(3):
        tally.offer()
    tally.finish(16, 1, 0.1)
    tally.finish(0, 1, 0.1)  # a map that was published
    assert (tally.offered, tally.finished) == (3, 1)
