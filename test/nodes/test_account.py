"""Accounts of nodes, over all their lives."""

from __future__ import annotations

from sal_height.nodes.account import Account


def balance(account: Account) -> int:
    """What is missing in: received = processed + dropped + waiting."""
    return account.received - account.count("processed") - sum(account.dropped.values()) - account.waiting


def test_counts_go_on_in_the_next_life_and_states_are_those_of_the_last() -> None:
    first = Account(
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
    second = Account({"in": 4, "processed": 4, "waiting": 0, "published./slc": 4, "cpu_s": 0.5, "pid": 8})
    both = second.after(first)
    assert balance(first) == balance(second) == balance(both) == 0
    assert (both.received, both.count("processed"), both.waiting) == (14, 10, 0)
    assert both.dropped == {"late": 1, "lost with its process": 3}
    assert both.published == {"slc": 4}
    assert both.numbers["cpu_s"] == 3.0
    assert both.count("pid") == 8
    assert "memory_mb" not in both.numbers
    assert both.last_drop == "Dwell 3 came late."


def test_what_waited_in_every_life_is_lost() -> None:
    lives = [Account({"in": 5, "processed": 3, "waiting": 2, "pid": pid}) for pid in range(3)]
    total = lives[0]
    for life in lives[1:]:
        total = life.after(total)
    assert total.dropped == {"lost with its process": 4}
    assert balance(total) == 0
    assert total.waiting == 2


def test_the_drops_of_the_last_minute_are_told_apart() -> None:
    account = Account({"dropped.late": 9, "last_minute.dropped.late": 2, "last_minute.ignored.odometry": 1})
    assert account.dropped == {"late": 9}
    assert account.lately == {"late": 2, "odometry": 1}
