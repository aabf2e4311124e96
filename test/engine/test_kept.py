"""What is kept of descriptions, and of sensors: a bounded number, and those in use."""

from __future__ import annotations

from copy import copy
from types import SimpleNamespace
from typing import Any

from flown_items import ml_stage

from sal_height.engine.calibrations import CALIBRATIONS_KEPT, StatedCalibration
from sal_height.engine.kept import Kept, RecentValues
from sal_height.topics import CALIBRATION


def test_the_oldest_goes_if_none_is_in_use() -> None:
    kept = Kept[int](3)
    assert [kept.put(name, number) for number, name in enumerate("abcde")] == [None, None, None, "a", "b"]
    assert list(kept) == ["c", "d", "e"]
    assert kept.use("a") is None


def test_what_is_in_use_stays_however_many_others_arrive() -> None:
    kept = Kept[int](3)
    kept.put("used", 1)
    assert kept.use("used") == 1
    for number in range(100):
        kept.put(str(number), number)
        assert len(kept) <= 3
    assert kept.use("used") == 1
    assert set(kept) == {"98", "99", "used"}


def test_of_those_in_use_the_one_goes_whose_last_use_is_longest_ago() -> None:
    kept = Kept[str](3)
    for name in "abc":
        kept.put(name, name)
        kept.use(name)
    kept.use("a")
    assert kept.put("d", "d") == "b"
    assert list(kept) == ["d", "c", "a"]
    assert kept.put("e", "e") == "d"  # never used


def test_a_new_value_of_a_name_takes_the_place_of_the_old_one() -> None:
    kept = Kept[int](2)
    kept.put("a", 1)
    kept.use("a")
    assert kept.put("a", 2) is None
    assert kept.put("b", 3) is None
    assert kept.put("b", 4) is None
    assert (kept.use("a"), kept.use("b")) == (2, 4)


def test_a_copy_keeps_what_it_is_given_for_itself() -> None:
    kept = Kept[int](2)
    kept.put("a", 1)
    copied = copy(kept)
    copied.put("a", 2)
    copied.use("a")
    assert (kept.get("a"), copied.get("a")) == (1, 2)
    assert (kept.is_in_use, copied.is_in_use) == (False, True)


def test_values_are_made_when_they_are_asked_for_and_those_asked_for_last_stay() -> None:
    latest = RecentValues[list[int]](2, list)
    for name in "abc":
        latest.of(name).append(ord(name))
    assert latest.of("a") is latest.of("a")
    assert latest.take_surplus() == [[ord("b")]]
    assert latest.values() == [[ord("c")], [ord("a")]]
    assert latest.of("b") == []
    assert latest.take_all() == [[ord("c")], [ord("a")], []]
    assert latest.values() == []


def test_a_stage_keeps_the_last_calibrations() -> None:
    stage: Any = ml_stage()
    for number in range(CALIBRATIONS_KEPT + 1):
        stage.accept(CALIBRATION, StatedCalibration(SimpleNamespace(id=str(number))))  # type: ignore[arg-type]
    assert list(stage._calibrations._kept) == [str(number) for number in range(1, CALIBRATIONS_KEPT + 1)]
