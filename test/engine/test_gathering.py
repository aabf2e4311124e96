"""Gathering dwells: every message is handed out once or refused with a reason, and what waits stays bounded."""

from __future__ import annotations

import pytest
from helpers import assert_one_sentence, make_sensor

from sal_height.engine.gathering import FINISHED_KEPT, Dwell, DwellAssembler, WaitingClock
from sal_height.engine.results import DwellKey as Key
from sal_height.errors import Rejected

SENSOR = make_sensor()
FIRST, SECOND, THIRD = (Key("hash", number, 1000 * (number + 1)) for number in range(3))


class Assembler(DwellAssembler[str]):
    """With shorter calls."""

    def put(self, key: Key, channel: int, item: str = "", now: float = 0.0, size: int = 0) -> None:
        self.add(key, SENSOR, channel, item, now, size)

    def keys(self) -> list[Key]:
        return [dwell.key for dwell in self.unfinished()]

    def dwell(self, key: Key) -> Dwell[str]:
        return next(dwell for dwell in self.unfinished() if dwell.key == key)


@pytest.fixture
def assembler() -> Assembler:
    return Assembler()


def test_a_dwell_gathers_its_channels_in_whatever_order_they_arrive(assembler: Assembler) -> None:
    for channel in (2, 0):
        assembler.put(FIRST, channel, f"message {channel}", now=channel)
    dwell = assembler.dwell(FIRST)
    assert (dwell.absent, dwell.began) == ([1], 2)
    assembler.put(FIRST, 1, "message 1")
    assert dwell.absent == []
    assert dwell.messages == ["message 0", "message 1", "message 2"]


def test_dwells_stay_until_taken_in_the_order_in_which_they_started(assembler: Assembler) -> None:
    for key in (SECOND, FIRST):
        assembler.put(key, 0)
    assert assembler.keys() == [SECOND, FIRST]
    dwell = assembler.dwell(SECOND)
    assembler.take(dwell)
    assert assembler.keys() == [FIRST]
    assert dwell not in assembler


def test_same_channel_twice_is_a_duplicate_and_the_first_message_counts(assembler: Assembler) -> None:
    assembler.put(FIRST, 0, "first", size=5)
    with pytest.raises(Rejected) as refusal:
        assembler.put(FIRST, 0, "second", size=5)
    assert refusal.value.reason == "duplicate"
    assert_one_sentence(str(refusal.value), "Dwell 0, channel 0")
    assert (assembler.dwell(FIRST).messages, assembler.dwell(FIRST).size) == (["first"], 5)


def test_a_message_of_a_finished_dwell_is_late(assembler: Assembler) -> None:
    assembler.put(FIRST, 0)
    assembler.take(assembler.dwell(FIRST))
    with pytest.raises(Rejected) as refusal:
        assembler.put(FIRST, 1)
    assert refusal.value.reason == "late"
    assert_one_sentence(str(refusal.value), "Dwell 0, channel 1")
    assert assembler.unfinished() == []


def test_same_number_at_another_time_is_another_dwell(assembler: Assembler) -> None:
    """A sensor that starts again counts from 0 again."""
    assembler.put(Key("hash", 0, 1000), 0, "old")
    assembler.put(Key("hash", 0, 9000), 0, "new")
    assert [dwell.messages for dwell in assembler.unfinished()] == [["old"], ["new"]]


def test_the_oldest_dwells_are_too_many(assembler: Assembler) -> None:
    for key in (FIRST, SECOND, THIRD):
        assembler.put(key, 0, size=100)
    assert assembler.surplus(3, 300) == []
    assert [dwell.key for dwell in assembler.surplus(2, 300)] == [FIRST]
    assert [dwell.key for dwell in assembler.surplus(3, 299)] == [FIRST]
    assert [dwell.key for dwell in assembler.surplus(3, 100)] == [FIRST, SECOND]
    assert [dwell.key for dwell in assembler.surplus(3, 1)] == [FIRST, SECOND]  # the newest may always stay
    assembler.take(assembler.dwell(FIRST))
    assert not assembler.is_crowded(2, 200)
    assert assembler.is_crowded(2, 199)


def test_a_dwell_is_passed_once_later_ones_of_the_same_sensor_arrive(assembler: Assembler) -> None:
    assembler.put(Key("hash", 0, 0), 0)
    assembler.put(Key("other", 9, 10_000_000_000), 0)
    dwell = assembler.unfinished()[0]
    assert not assembler.is_passed(dwell, 5.0)
    assembler.put(Key("hash", 1, 5_000_000_000), 0)
    assert not assembler.is_passed(dwell, 5.0)
    assembler.put(Key("hash", 2, 5_000_000_001), 0)
    assert assembler.is_passed(dwell, 5.0)


def test_a_dwell_with_a_wrong_stamp_is_passed_and_ages_no_other(assembler: Assembler) -> None:
    assembler.put(Key("hash", 0, 0), 0)
    assembler.put(Key("hash", 7, 10**18), 0)
    assembler.put(Key("hash", 1, 1_000_000_000), 0)
    right, wrong, _ = assembler.unfinished()
    assert assembler.is_passed(wrong, 5.0)
    assert not assembler.is_passed(right, 5.0)


def test_after_forgetting_finished_dwells_of_that_sensor_are_accepted_again(assembler: Assembler) -> None:
    other = FIRST._replace(sensor="other")
    for key in (FIRST, other):
        assembler.put(key, 0)
        assembler.take(assembler.dwell(key))
    assembler.forget_finished("hash")
    assembler.put(FIRST, 0, "again")
    assert assembler.dwell(FIRST).messages == ["again"]
    with pytest.raises(Rejected):
        assembler.put(other, 0)


@pytest.mark.parametrize("again", [False, True])
def test_memory_of_finished_dwells_is_bounded(assembler: Assembler, again: bool) -> None:
    if again:
        assembler.forget_finished("hash")
    keys = [Key("hash", number, number) for number in range(FINISHED_KEPT + 1)]
    for key in keys:
        assembler.put(key, 0)
        assembler.take(assembler.dwell(key))
    assembler.put(keys[0], 0)  # so long ago that it is taken for a new one
    with pytest.raises(Rejected):
        assembler.put(keys[-1], 0)


def test_the_waiting_clock_runs_only_while_there_is_nothing_to_do() -> None:
    clock = WaitingClock()
    for now in (10.0, 10.1, 10.2):
        clock.tick(now, busy=False)
    assert clock.waited_s == pytest.approx(0.2)
    clock.restart()
    clock.tick(10.3, busy=False)
    assert clock.waited_s == pytest.approx(0.1)
    clock.tick(10.4, busy=True)
    assert clock.waited_s == 0.0


def test_the_waiting_clock_does_not_count_what_a_process_was_held_up() -> None:
    clock = WaitingClock()
    clock.tick(0.0, busy=False)
    clock.tick(60.0, busy=False)
    assert clock.waited_s <= 0.2


def test_an_item_that_is_all_messages_makes_a_dwell_whole(assembler: Assembler) -> None:
    dwell = assembler.add_whole(FIRST, SENSOR, "all", 0.0, 30)
    assert (dwell.is_whole, dwell.absent, dwell.count, dwell.content, dwell.size) == (True, [], 3, "all", 30)
    assert assembler.is_crowded(1, 29)
    assembler.take(dwell)
    with pytest.raises(Rejected) as refusal:
        assembler.add_whole(FIRST, SENSOR, "all", 0.0)
    assert refusal.value.reason == "late"
    assert_one_sentence(str(refusal.value), "Dwell 0: the dwell was finished")


@pytest.mark.parametrize("first", ["whole", "a channel"])
def test_messages_that_are_in_an_item_already_are_duplicates(assembler: Assembler, first: str) -> None:
    def add(what: str) -> None:
        if what == "whole":
            assembler.add_whole(FIRST, SENSOR, "all", 0.0)
        else:
            assembler.put(FIRST, 1)

    add(first)
    count = assembler.dwell(FIRST).count
    for what in ("whole", "a channel"):
        with pytest.raises(Rejected) as refusal:
            add(what)
        assert refusal.value.reason == "duplicate"
    assert assembler.dwell(FIRST).count == count
