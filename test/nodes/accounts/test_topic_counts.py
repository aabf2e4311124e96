"""What became of the messages of a recorded topic."""

from __future__ import annotations

import pytest

from sal_height.nodes.accounts.account import ON_THE_WAY, TopicCounts


def of(*numbers: int | None, publishers: int = 1) -> TopicCounts:
    counts = TopicCounts()
    for number in numbers:
        counts.receive(number, lambda: publishers)
    return counts


@pytest.mark.parametrize(
    ("numbers", "missed"),
    [
        ((1, 2, 3), 0),
        ((7, 8, 9), 0),  # published before the recorder was there
        ((1, 2, 5, 6, 8), 3),
        ((1, 2, 1, 2), 0),  # the publisher was started again
        ((1, 2, 1, 4), 2),
        ((None, None), 0),
    ],
)
def test_messages_that_never_came_are_told_by_the_numbers_of_the_others(
    numbers: tuple[int | None, ...], missed: int
) -> None:
    counts = of(*numbers)
    assert (counts.received, counts.left_out[ON_THE_WAY]) == (len(numbers), missed)


def test_the_numbers_of_several_publishers_tell_nothing() -> None:
    assert of(1, 1, 5, 2, 6, publishers=2).left_out == {}


def test_what_a_publisher_leaves_that_has_ended_is_counted_as_before() -> None:
    """A recorder that falls behind reads the last messages when their publisher is no longer there."""
    assert of(1, 2, 5, publishers=0).left_out == {ON_THE_WAY: 2}
    counts = of(1, 1, 5, 2, 6, publishers=2)
    counts.receive(9, lambda: 0)
    assert counts.left_out == {}


def test_the_bag_gets_all_counts() -> None:
    counts = of(1, 2, 4)
    counts.written = 3
    assert counts.as_json() == {"received": 3, "written": 3, "left_out": {ON_THE_WAY: 1}}


def test_all_that_did_not_come_is_missed_also_before_the_first_one() -> None:
    assert of(7, 8, 10).missed == 7
    assert of(1, 2, 1, 2).missed == 0  # of a publisher that was started again


def test_latched_messages_that_newer_ones_replace_are_not_lost() -> None:
    counts = TopicCounts(latched=True)
    for number in (2, 5):
        counts.receive(number, lambda: 1)
    assert (counts.received, counts.left_out) == (2, {})
    assert counts.missed == 3
