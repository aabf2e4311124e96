"""Losses of nodes, and accounts from numbers by name, as in /diagnostics and in messages up to version 2."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from sal_height.engine.results import DwellKey, Loss
from sal_height.messages.basics import to_stamp
from sal_height.messages.types import Count, DwellLoss, Header, NodeAccount

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
"""Fields with counts by reason, kind or topic, by prefix of the names of the numbers; all others are events."""

EVENTS = "events"

UNKNOWN: Mapping[str, float] = MappingProxyType(
    dict.fromkeys(("offered_hz", "achieved_hz", "latency_p50_ms", "latency_p95_ms"), math.nan)
)
"""Fields that are NaN where they are not stated."""


def account_of_numbers(numbers: Mapping[str, float]) -> NodeAccount:
    """The account that numbers state; those that are not finite, or not a count where one is expected, are left out."""
    fields = fields_of_numbers(numbers)
    for name in (*COUNTED.values(), EVENTS):
        fields[name] = [Count(name=key, count=count) for key, count in fields.get(name, {}).items()]
    return NodeAccount(**{**UNKNOWN, **fields})


def fields_of_numbers(numbers: Mapping[str, float]) -> dict[str, Any]:
    """The fields of the account that numbers state, with counts by name as dictionaries, without absent fields."""
    fields: dict[str, Any] = {}
    most = 2**32 - 1  # greatest valid count
    for name, number in numbers.items():
        if not math.isfinite(number):
            continue
        if name in MEASURED:
            fields[name] = float(number)
        elif 0 <= number <= most:
            _enter(fields, name, int(number))
    return fields


def _enter(fields: dict[str, Any], name: str, count: int) -> None:
    """Enter a count."""
    if name in WHOLE:
        fields[WHOLE[name]] = count
    elif name == READY:
        fields["ready"] = count > 0
    else:
        prefix = next((prefix for prefix in COUNTED if name.startswith(prefix)), "")
        field = COUNTED[prefix] if prefix else EVENTS
        fields.setdefault(field, {})[name.removeprefix(prefix)] = count


def loss_to_message(node: str, loss: Loss, stamp_ns: int) -> DwellLoss:
    """The message of a loss.

    Args:
        node: name of the node with its namespace.
        loss: loss of the node.
        stamp_ns: time of the loss, ns.
    """
    key = loss.dwell or DwellKey("", 0, 0)
    return DwellLoss(
        header=Header(stamp=to_stamp(max(0, stamp_ns))),
        node=node,
        of_dwell=loss.dwell is not None,
        config_hash=key.sensor,
        dwell=key.number,
        dwell_stamp=to_stamp(key.stamp_ns),
        messages=loss.messages,
        reason=loss.reason,
        sentence=loss.sentence,
    )
