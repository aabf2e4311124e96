"""Accounting: every message that comes in is processed or dropped for a reason."""

from __future__ import annotations

import threading
from collections import Counter, deque

import numpy as np

from sal_height.nodes.account import (
    ACHIEVED,
    DROPPED,
    IGNORED,
    LATENCY_P50,
    LATENCY_P95,
    OFFERED,
    PROCESSED,
    PUBLISHED,
    RECEIVED,
    WAITING,
)

PACE_SAMPLES = 5
"""Samples of the counts, half a second apart, that rates are measured over."""


class Tally:
    """Counts of one stage; safe to use from several threads.

    At any time: received = processed + dropped + waiting.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._received = 0
        self._processed = 0
        self._published = 0
        self._dropped: Counter[str] = Counter()
        self._ignored: Counter[str] = Counter()
        self._noted: Counter[str] = Counter()
        self._latencies: deque[float] = deque(maxlen=1000)
        self.offered = 0
        """Dwells that were complete and handed over for processing."""
        self.finished = 0
        """Dwells that were processed."""

    def receive(self) -> None:
        """A message came in."""
        with self._lock:
            self._received += 1

    def offer(self) -> None:
        """A dwell is complete and handed over for processing."""
        with self._lock:
            self.offered += 1

    def drop(self, messages: int, reason: str) -> None:
        """That many messages were left out."""
        with self._lock:
            self._dropped[reason] += messages

    def ignore(self, reason: str) -> None:
        """A message that is not counted as received (sensor info, odometry) could not be used."""
        with self._lock:
            self._ignored[reason] += 1

    def note(self, event: str) -> None:
        """Something worth counting has happened that costs no message."""
        with self._lock:
            self._noted[event] += 1

    def finish(self, messages: int, published: int, latency_s: float) -> None:
        """That many messages became that many products, `latency_s` after they were complete and handed over."""
        with self._lock:
            self._processed += messages
            self._published += published
            self.finished += bool(messages)
            self._latencies.append(latency_s)

    def summary(self) -> dict[str, int | float]:
        """Counts and latencies by name; `dropped.<reason>` and `ignored.<reason>` for each reason, and events noted."""
        with self._lock:
            dropped = dict(self._dropped)
            ignored = dict(self._ignored)
            noted = dict(self._noted)
            values: dict[str, int | float] = {
                RECEIVED: self._received,
                PROCESSED: self._processed,
                PUBLISHED: self._published,
                WAITING: self._received - self._processed - sum(dropped.values()),
            }
            if self._latencies:
                p50, p95 = np.percentile(self._latencies, [50, 95])
                values |= {LATENCY_P50: round(float(p50) * 1e3, 3), LATENCY_P95: round(float(p95) * 1e3, 3)}
        values |= {f"{DROPPED}{reason}": count for reason, count in sorted(dropped.items())}
        values |= {f"{IGNORED}{reason}": count for reason, count in sorted(ignored.items())}
        return values | dict(sorted(noted.items()))


class Pace:
    """How many dwells come and are processed in a second, over the last seconds."""

    def __init__(self) -> None:
        self._samples: deque[tuple[float, int, int]] = deque(maxlen=PACE_SAMPLES)

    def sample(self, now: float, offered: int, finished: int) -> None:
        """Take note of the counts at the time `now`, s."""
        self._samples.append((now, offered, finished))

    def rates(self) -> dict[str, float]:
        """Dwells offered and achieved in a second, by name; none before two samples."""
        if len(self._samples) < 2:
            return {}
        (began, offered, finished), (ended, offered_now, finished_now) = self._samples[0], self._samples[-1]
        return {
            OFFERED: round((offered_now - offered) / (ended - began), 2),
            ACHIEVED: round((finished_now - finished) / (ended - began), 2),
        }
