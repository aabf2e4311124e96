"""Accounting: every message that is received is processed or dropped for a reason."""

from __future__ import annotations

import math
import os
import re
import threading
import time
from bisect import bisect_left, insort
from collections import Counter, deque
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from sal_height.nodes.accounts.account import CALIBRATIONS, DWELLS, Account

_RESIDENT = re.compile(r"(RssAnon|RssFile):\s+(\d+) kB")

OF_NODE = {"jobs", "ready"}
"""Numbers of an account that do not follow from counts."""


def process_numbers() -> dict[str, Any]:
    """Processor time, s, number, and memory, MB (Linux), of this process, as fields of an account.

    Memory is what is resident without shared memory: most of that is the messages of other processes.
    """
    numbers: dict[str, Any] = {"cpu_s": round(time.process_time(), 3), "pid": os.getpid()}
    with suppress(OSError):
        status = Path("/proc/self/status").read_text(encoding="utf-8")
        resident = {name: int(kilobytes) for name, kilobytes in _RESIDENT.findall(status)}
        numbers["memory_mb"] = round(sum(resident.values()) * 1024 / 1e6, 1)
    return numbers


class Tally:
    """Counts of one stage; safe to use from several threads.

    At any time: received = processed + dropped + waiting.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Count; `clock` returns the time, s, for the counts of the last minute."""
        self._clock = clock
        self._lock = threading.Lock()
        self._received = 0
        self._processed = 0
        self._published = 0
        self._dropped: Counter[str] = Counter()
        self._ignored: Counter[str] = Counter()
        self._noted: Counter[str] = Counter()
        self._dropped_lately, self._ignored_lately = LastMinute(), LastMinute()
        self._latencies = Latest(1000)
        self.offered = 0
        """Dwells that were complete and handed over for processing."""
        self.finished = 0
        """Dwells that were processed."""

    def receive(self, messages: int = 1) -> None:
        """Messages were received."""
        with self._lock:
            self._received += messages

    def offer(self) -> None:
        """A dwell is complete and handed over for processing."""
        with self._lock:
            self.offered += 1

    def drop(self, messages: int, reason: str) -> None:
        """That many messages were left out."""
        with self._lock:
            self._dropped[reason] += messages
            self._dropped_lately.add(self._clock(), reason, messages)

    def ignore(self, reason: str) -> None:
        """A message that is not counted as received (sensor info, odometry) could not be used."""
        with self._lock:
            self._ignored[reason] += 1
            self._ignored_lately.add(self._clock(), reason, 1)

    def note(self, event: str, times: int = 1) -> None:
        """Something worth counting has happened that costs no message."""
        with self._lock:
            self._noted[event] += times

    def finish(self, messages: int, published: int, latency_s: float) -> None:
        """That many messages became that many products, `latency_s` after they were complete and handed over.

        Work of the node's own, which consumes no message, has no latency.
        """
        with self._lock:
            self._processed += messages
            self._published += published
            if messages:
                self.finished += 1
                self._latencies.add(latency_s)

    def account(self) -> Account:
        """The counts, and the latencies if there are any."""
        with self._lock:
            now, events = self._clock(), dict(self._noted)
            latencies = [
                1e3 * self._latencies.quantile(share) if self._latencies else math.nan for share in (0.5, 0.95)
            ]
            return Account(
                received=self._received,
                processed=self._processed,
                published=self._published,
                waiting=self._received - self._processed - sum(self._dropped.values()),
                dwells=events.pop(DWELLS, 0),
                calibrations=events.pop(CALIBRATIONS, 0),
                dropped=dict(self._dropped),
                ignored=dict(self._ignored),
                dropped_last_minute=dict(self._dropped_lately.counts(now)),
                ignored_last_minute=dict(self._ignored_lately.counts(now)),
                events=events,
                latency_p50_ms=round(latencies[0], 3),
                latency_p95_ms=round(latencies[1], 3),
            )

    def summary(self) -> dict[str, float]:
        """Counts and latencies by their names on /diagnostics."""
        return {name: number for name, number in self.account().numbers.items() if name not in OF_NODE}


class Latest:
    """The latest of many numbers, in their order: their quantiles, which are asked for after each, take no time."""

    def __init__(self, most: int) -> None:
        """Keep up to `most` numbers."""
        self._most = most
        self._numbers: deque[float] = deque()
        self._ascending: list[float] = []

    def __len__(self) -> int:
        return len(self._ascending)

    def add(self, number: float) -> None:
        """Keep a number, and forget the earliest if there are too many."""
        self._numbers.append(number)
        insort(self._ascending, number)
        if len(self._numbers) > self._most:
            del self._ascending[bisect_left(self._ascending, self._numbers.popleft())]

    def quantile(self, share: float) -> float:
        """The number that this fraction of them are below, linear between two of them."""
        place = share * (len(self._ascending) - 1)
        low, rest = self._ascending[int(place)], place % 1.0
        return low + rest * (self._ascending[int(place) + 1] - low) if rest else low


class LastMinute:
    """Counts by name of the last minute, in steps of a second; memory does not grow with what is counted."""

    def __init__(self) -> None:
        self._seconds: deque[tuple[int, Counter[str]]] = deque()

    def add(self, now: float, name: str, count: int) -> None:
        """Count at the time `now`, s."""
        second = int(now)
        if not self._seconds or self._seconds[-1][0] != second:
            self._forget(now)
            self._seconds.append((second, Counter()))
        self._seconds[-1][1][name] += count

    def counts(self, now: float) -> Counter[str]:
        """Counts of the minute before `now`, s."""
        self._forget(now)
        return sum((counts for _, counts in self._seconds), Counter())

    def _forget(self, now: float) -> None:
        while self._seconds and self._seconds[0][0] <= int(now) - 60:
            self._seconds.popleft()


class Pace:
    """Rates of counts over the last seconds."""

    def __init__(self) -> None:
        self._samples: deque[tuple[float, ...]] = deque(maxlen=5)  # half a second apart

    def sample(self, now: float, *counts: float) -> None:
        """Note the counts at the time `now`, s."""
        self._samples.append((now, *counts))

    def rates(self) -> list[float]:
        """Rate of each count, 1/s; empty before two samples at different times."""
        if len(self._samples) < 2 or self._samples[-1][0] <= self._samples[0][0]:
            return []
        (began, *first), (ended, *last) = self._samples[0], self._samples[-1]
        return [(after - before) / (ended - began) for before, after in zip(first, last, strict=True)]
