"""Assembling dwells: every message is handed out once or refused with a reason, and the buffer stays bounded."""

from __future__ import annotations

import pytest
from helpers import assert_one_sentence, make_sensor

from sal_height.errors import Rejected
from sal_height.nodes.dwell import FINISHED_KEPT, Dwell, DwellAssembler, Key, WaitingClock

SENSOR = make_sensor()
FIRST, SECOND, THIRD = (Key("hash", number, 1000 * (number + 1)) for number in range(3))


class Assembler(DwellAssembler[str]):
    """With shorter calls."""

    def take_in(self, key: Key, channel: int, item: str = "", now: float = 0.0, size: int = 0) -> None:
        self.add(key, SENSOR, channel, item, now, size)

    def keys(self) -> list[Key]:
        return [dwell.key for dwell in self.held()]

    def dwell(self, key: Key) -> Dwell[str]:
        return next(dwell for dwell in self.held() if dwell.key == key)


@pytest.fixture
def assembler() -> Assembler:
    return Assembler()


def test_a_dwell_gathers_its_channels_in_whatever_order_they_come(assembler: Assembler) -> None:
    for channel in (2, 0):
        assembler.take_in(FIRST, channel, f"message {channel}", now=channel)
    dwell = assembler.dwell(FIRST)
    assert (dwell.absent, dwell.began) == ([1], 2)
    assembler.take_in(FIRST, 1, "message 1")
    assert dwell.absent == []
    assert dwell.messages == ["message 0", "message 1", "message 2"]


def test_dwells_stay_until_taken_in_the_order_they_began(assembler: Assembler) -> None:
    for key in (SECOND, FIRST):
        assembler.take_in(key, 0)
    assert assembler.keys() == [SECOND, FIRST]
    dwell = assembler.dwell(SECOND)
    assembler.take(dwell)
    assert assembler.keys() == [FIRST]
    assert dwell not in assembler


def test_same_channel_twice_is_a_duplicate_and_the_first_message_counts(assembler: Assembler) -> None:
    assembler.take_in(FIRST, 0, "first", size=5)
    with pytest.raises(Rejected) as refusal:
        assembler.take_in(FIRST, 0, "second", size=5)
    assert refusal.value.reason == "duplicate"
    assert_one_sentence(str(refusal.value), "Dwell 0, channel 0")
    assert (assembler.dwell(FIRST).messages, assembler.dwell(FIRST).size) == (["first"], 5)


def test_a_message_of_a_finished_dwell_is_late(assembler: Assembler) -> None:
    assembler.take_in(FIRST, 0)
    assembler.take(assembler.dwell(FIRST))
    with pytest.raises(Rejected) as refusal:
        assembler.take_in(FIRST, 1)
    assert refusal.value.reason == "late"
    assert_one_sentence(str(refusal.value), "Dwell 0, channel 1")
    assert assembler.held() == []


def test_same_number_at_another_time_is_another_dwell(assembler: Assembler) -> None:
    """A sensor that starts anew counts from 0 again."""
    assembler.take_in(Key("hash", 0, 1000), 0, "old")
    assembler.take_in(Key("hash", 0, 9000), 0, "new")
    assert [dwell.messages for dwell in assembler.held()] == [["old"], ["new"]]


def test_the_oldest_dwells_are_too_many(assembler: Assembler) -> None:
    for key in (FIRST, SECOND, THIRD):
        assembler.take_in(key, 0, size=100)
    assert assembler.surplus(3, 300) == []
    assert [dwell.key for dwell in assembler.surplus(2, 300)] == [FIRST]
    assert [dwell.key for dwell in assembler.surplus(3, 299)] == [FIRST]
    assert [dwell.key for dwell in assembler.surplus(3, 100)] == [FIRST, SECOND]
    assert [dwell.key for dwell in assembler.surplus(3, 1)] == [FIRST, SECOND]  # the newest may always stay
    assembler.take(assembler.dwell(FIRST))
    assert not assembler.is_crowded(2, 200)
    assert assembler.is_crowded(2, 199)


def test_a_dwell_is_passed_once_later_ones_of_the_same_sensor_come(assembler: Assembler) -> None:
    assembler.take_in(Key("hash", 0, 0), 0)
    assembler.take_in(Key("other", 9, 10_000_000_000), 0)
    dwell = assembler.held()[0]
    assert not assembler.is_passed(dwell, 5.0)
    assembler.take_in(Key("hash", 1, 5_000_000_000), 0)
    assert not assembler.is_passed(dwell, 5.0)
    assembler.take_in(Key("hash", 2, 5_000_000_001), 0)
    assert assembler.is_passed(dwell, 5.0)


def test_a_dwell_with_a_wrong_stamp_is_passed_and_ages_no_other(assembler: Assembler) -> None:
    assembler.take_in(Key("hash", 0, 0), 0)
    assembler.take_in(Key("hash", 7, 10**18), 0)
    assembler.take_in(Key("hash", 1, 1_000_000_000), 0)
    right, wrong, _ = assembler.held()
    assert assembler.is_passed(wrong, 5.0)
    assert not assembler.is_passed(right, 5.0)


def test_forgetting_lets_finished_dwells_of_that_sensor_come_again(assembler: Assembler) -> None:
    other = FIRST._replace(config_hash="other")
    for key in (FIRST, other):
        assembler.take_in(key, 0)
        assembler.take(assembler.dwell(key))
    assembler.forget_finished("hash")
    assembler.take_in(FIRST, 0, "again")
    assert assembler.dwell(FIRST).messages == ["again"]
    with pytest.raises(Rejected):
        assembler.take_in(other, 0)


@pytest.mark.parametrize("anew", [False, True])
def test_memory_of_finished_dwells_is_bounded(assembler: Assembler, anew: bool) -> None:
    if anew:
        assembler.forget_finished("hash")
    keys = [Key("hash", number, number) for number in range(FINISHED_KEPT + 1)]
    for key in keys:
        assembler.take_in(key, 0)
        assembler.take(assembler.dwell(key))
    assembler.take_in(keys[0], 0)  # so long ago that it is taken for a new one
    with pytest.raises(Rejected):
        assembler.take_in(keys[-1], 0)


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
