"""Accounts of nodes, over all their lives."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sal_height.messages import deserialize, serialize
from sal_height.messages.types import DiagnosticArray, NodeAccount
from sal_height.nodes.accounts.account import RECORDER, Account


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(3)


def balance(account: Account) -> int:
    """What is missing in: received = processed + dropped + waiting."""
    return account.received - account.processed - sum(account.dropped.values()) - account.waiting


def test_counts_go_on_in_the_next_life_and_states_are_those_of_the_last() -> None:
    first = Account.of_numbers(
        {
            "in": 10,
            "processed": 6,
            "waiting": 3,
            "dropped.late": 1,
            "cpu_s": 2.5,
            "memory_mb": 80,
            "pid": 7,
            "ready": 1,
        },
        "Dwell 3 came late.",
    )
    second = Account.of_numbers({"in": 4, "processed": 4, "waiting": 0, "published./slc": 4, "cpu_s": 0.5, "pid": 8})
    both = second.after(first)
    assert balance(first) == balance(second) == balance(both) == 0
    assert (both.received, both.processed, both.waiting) == (14, 10, 0)
    assert both.dropped == {"late": 1, "lost with its process": 3}
    assert both.published_on == {"slc": 4}
    assert both.cpu_s == 3.0
    assert both.pid == 8
    assert "memory_mb" not in both.numbers
    assert both.last_drop == "Dwell 3 came late."


def test_what_waited_in_every_life_is_lost() -> None:
    lives = [Account.of_numbers({"in": 5, "processed": 3, "waiting": 2, "pid": pid}) for pid in range(3)]
    total = lives[0]
    for life in lives[1:]:
        total = life.after(total)
    assert total.dropped == {"lost with its process": 4}
    assert balance(total) == 0
    assert total.waiting == 2


def test_the_drops_of_the_last_minute_are_told_apart() -> None:
    account = Account.of_numbers({"dropped.late": 9, "last_minute.dropped.late": 2, "last_minute.ignored.odometry": 1})
    assert account.dropped == {"late": 9}
    assert account.lost_last_minute == {"late": 2, "odometry": 1}


def test_an_account_is_the_same_on_both_topics(rng: np.random.Generator) -> None:
    counts = {name: {"another": 4, "some reason": 3} for name in ("dropped", "ignored", "events")}
    topics = {name: {"ml/height": 5} for name in ("published_on", "subscribers", "missed", "recorded")}
    account = Account(
        9, 8, 7, 1, 2, True, 3, 0, 5, **counts, **topics, offered_hz=2.5, cpu_s=0.25, pid=77, last_drop="So."
    )
    account = replace(account, latency_p50_ms=float(rng.random()), dropped_last_minute={"some reason": 1})
    diagnostics, message = (make("a/b", 3_000_000_001) for make in (account.to_diagnostics, account.to_progress))
    (status,) = deserialize(serialize(diagnostics), DiagnosticArray).status
    assert account.numbers["published./ml/height"] == 5
    assert repr(Account.of_status(status)) == repr(account)
    assert {one.name for one in message.published_on} == {"/ml/height"}
    assert (message.node, message.header.stamp.sec, message.header.stamp.nanosec) == ("a/b", 3, 1)
    assert repr(Account.of_message(deserialize(serialize(message), NodeAccount))) == repr(account)


def test_what_is_not_known_of_a_node_is_not_told_on_diagnostics() -> None:
    assert Account().numbers == {"in": 0, "processed": 0, "out": 0, "waiting": 0, "jobs": 0, "ready": 0}
    assert Account(kind=RECORDER).numbers == {"unwritten": 0}
    assert Account.of_numbers({"unwritten": 3}).kind == RECORDER
    assert Account.of_numbers({"temperature": 3}).numbers == {"temperature": 3}
    assert Account.of_numbers({"waiting": 0, "in": math.inf, "dropped.late": -3}) == Account.of_numbers({"waiting": 0})
