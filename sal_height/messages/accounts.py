"""Accounts of nodes from numbers by name: as /diagnostics has them, and as messages had them up to version 2."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

from sal_height.messages.types import Count, NodeAccount

WHOLE: Mapping[str, str] = MappingProxyType(
    {
        "in": "received",
        "processed": "processed",
        "out": "published",
        "waiting": "waiting",
        "jobs": "jobs",
        "dwells": "dwells",
        "untold": "unpublished",
        "calibrations": "calibrations",
        "unwritten": "unwritten",
        "pid": "pid",
    }
)
"""Fields with a whole number by the names of the numbers."""

READY = "ready"
"""Name of a number that is 1 if the node can process the first dwell, and else 0."""

MEASURED = ("offered_hz", "achieved_hz", "latency_p50_ms", "latency_p95_ms", "cpu_s", "memory_mb")
"""Fields with other numbers, which have the same names."""

COUNTED: Mapping[str, str] = MappingProxyType(
    {
        "last_minute.dropped.": "dropped_last_minute",
        "last_minute.ignored.": "ignored_last_minute",
        "dropped.": "dropped",
        "ignored.": "ignored",
        "published.": "published_on",
        "subscribers.": "subscribers",
        "missed.": "missed",
        "recorded.": "recorded",
    }
)
"""Fields with counts by reason, kind or topic, by what the names of the numbers begin with; all others are events."""

EVENTS = "events"

MOST = 2**32 - 1
"""Greatest count that is believed."""


def account_of_numbers(numbers: Mapping[str, float]) -> NodeAccount:
    """The account that numbers say; those that are not finite, or no count where one is due, are left out."""
    account = NodeAccount(offered_hz=math.nan, achieved_hz=math.nan, latency_p50_ms=math.nan, latency_p95_ms=math.nan)
    for name, number in numbers.items():
        if not math.isfinite(number):
            continue
        if name in MEASURED:
            setattr(account, name, float(number))
        elif 0 <= number <= MOST:
            _enter(account, name, int(number))
    return account


def _enter(account: NodeAccount, name: str, count: int) -> None:
    """Enter a count."""
    if name in WHOLE:
        setattr(account, WHOLE[name], count)
    elif name == READY:
        account.ready = count > 0
    else:
        prefix = next((prefix for prefix in COUNTED if name.startswith(prefix)), "")
        field = COUNTED[prefix] if prefix else EVENTS
        getattr(account, field).append(Count(name=name.removeprefix(prefix), count=count))
