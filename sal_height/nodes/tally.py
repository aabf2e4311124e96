"""Accounting: every message that comes in is processed or dropped for a reason."""

from __future__ import annotations

import threading
from collections import Counter, deque

import numpy as np

from sal_height.nodes.account import DROPPED, IGNORED, PROCESSED, PUBLISHED, RECEIVED, WAITING


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

    def receive(self) -> None:
        """A message came in."""
        with self._lock:
            self._received += 1

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
                values |= {"latency_p50_ms": round(float(p50) * 1e3, 3), "latency_p95_ms": round(float(p95) * 1e3, 3)}
        values |= {f"{DROPPED}{reason}": count for reason, count in sorted(dropped.items())}
        values |= {f"{IGNORED}{reason}": count for reason, count in sorted(ignored.items())}
        return values | dict(sorted(noted.items()))
