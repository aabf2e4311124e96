"""Assembling dwells: every frame is handed out once or refused with a reason, and the buffer stays bounded."""

from __future__ import annotations

import pytest
from helpers import assert_one_sentence

from sal_height.errors import Rejected
from sal_height.nodes.dwell import DwellAssembler

FIRST, SECOND, THIRD = (0, 1000), (1, 2000), (2, 3000)


@pytest.fixture
def assembler() -> DwellAssembler[str]:
    return DwellAssembler(capacity=2, timeout=5.0)


def test_dwell_is_complete_when_all_detectors_have_come_in_whatever_order(assembler: DwellAssembler[str]) -> None:
    for detector in (2, 0):
        assembler.add(FIRST, detector, f"frame {detector}", now=1.0)
        assert assembler.complete(3) == []
    assembler.add(FIRST, 1, "frame 1", now=2.0)
    (dwell,) = assembler.complete(3)
    assert (dwell.key, dwell.began) == (FIRST, 1.0)
    assert assembler.take(dwell) == ["frame 0", "frame 1", "frame 2"]
    assert assembler.complete(3) == []


def test_complete_dwells_stay_until_taken_and_come_oldest_first(assembler: DwellAssembler[str]) -> None:
    for key in (SECOND, FIRST):
        assembler.add(key, 0, "frame", now=0.0)
    assert [dwell.key for dwell in assembler.complete(1)] == [SECOND, FIRST]  # in the order they began
    assert [dwell.key for dwell in assembler.complete(1)] == [SECOND, FIRST]


def test_same_detector_twice_is_a_duplicate_and_the_first_frame_counts(assembler: DwellAssembler[str]) -> None:
    assembler.add(FIRST, 0, "first", now=0.0)
    with pytest.raises(Rejected) as refusal:
        assembler.add(FIRST, 0, "second", now=0.0)
    assert refusal.value.reason == "duplicate"
    assert_one_sentence(str(refusal.value), "Dwell 0, detector 0")
    assert assembler.take(assembler.complete(1)[0]) == ["first"]


def test_frame_of_a_finished_dwell_is_late(assembler: DwellAssembler[str]) -> None:
    assembler.add(FIRST, 0, "frame", now=0.0)
    assembler.take(assembler.complete(1)[0])
    with pytest.raises(Rejected) as refusal:
        assembler.add(FIRST, 1, "frame", now=0.0)
    assert refusal.value.reason == "late"
    assert_one_sentence(str(refusal.value), "Dwell 0, detector 1")
    assert assembler.overdue(1e9) == []


def test_same_number_at_another_time_is_another_dwell(assembler: DwellAssembler[str]) -> None:
    """A sensor that starts anew counts from 0 again."""
    assembler.add((0, 1000), 0, "old", now=0.0)
    assembler.add((0, 9000), 0, "new", now=0.0)
    assert [dwell.items for dwell in assembler.complete(1)] == [{0: "old"}, {0: "new"}]


def test_dwell_is_overdue_after_the_timeout_counted_from_its_first_frame(assembler: DwellAssembler[str]) -> None:
    assembler.add(FIRST, 0, "frame", now=10.0)
    assembler.add(SECOND, 0, "frame", now=12.0)
    assembler.add(FIRST, 1, "frame", now=14.9)
    assert assembler.overdue(15.0) == []
    assert [dwell.key for dwell in assembler.overdue(15.1)] == [FIRST]
    assert [dwell.key for dwell in assembler.overdue(17.1)] == [FIRST, SECOND]
    assert assembler.take(assembler.overdue(15.1)[0]) == ["frame", "frame"]
    assert [dwell.key for dwell in assembler.overdue(17.1)] == [SECOND]


def test_oldest_dwell_beyond_the_capacity_is_overdue_at_once(assembler: DwellAssembler[str]) -> None:
    for key in (FIRST, SECOND):
        assembler.add(key, 0, "frame", now=0.0)
    assert assembler.overdue(0.0) == []
    assembler.add(THIRD, 0, "frame", now=0.0)
    assert [dwell.key for dwell in assembler.overdue(0.0)] == [FIRST]


def test_forgetting_lets_finished_dwells_come_again(assembler: DwellAssembler[str]) -> None:
    assembler.add(FIRST, 0, "frame", now=0.0)
    assembler.take(assembler.complete(1)[0])
    assembler.forget_finished()
    assembler.add(FIRST, 0, "again", now=0.0)
    assert assembler.take(assembler.complete(1)[0]) == ["again"]


def test_memory_of_finished_dwells_is_bounded(assembler: DwellAssembler[str]) -> None:
    for number in range(100):
        assembler.add((number, number), 0, "frame", now=0.0)
        assembler.take(assembler.complete(1)[0])
    assembler.add((0, 0), 0, "frame", now=0.0)  # so long ago that it is taken for a new one
    with pytest.raises(Rejected):
        assembler.add((99, 99), 0, "frame", now=0.0)
