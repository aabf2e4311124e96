"""Dwells in a stage: each becomes one job with what it needs, or is dropped for a reason; memory is bounded."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Any

import pytest
from driven import Step, accept
from gate import FRAMES, SENSOR, Gated, Message, another
from helpers import assert_one_sentence

from sal_height.engine.dwells import EARLY_KEPT, GONE_AFTER, REHEARSED_BYTES, SENSORS_KEPT, DwellStage
from sal_height.engine.stage import Rehearsal
from sal_height.topics import SENSOR_INFO


@pytest.fixture
def gated() -> Gated:
    gated = Gated()
    gated.describe()
    return gated


def described(**settings: Any) -> Gated:
    gated = Gated(**settings)
    gated.describe()
    return gated


def sentence(gated: Gated) -> str:
    """The one on the last loss."""
    return gated.losses[-1].sentence


def test_a_dwell_becomes_a_job_with_what_there_is_when_it_becomes_complete(gated: Gated) -> None:
    gated.supply("wait")
    gated.feed(0, 0, 1, 2)
    gated.supply("then")
    gated.supply("later")
    assert gated.whole == [(0, [0, 1, 2], "then")]


def test_jobs_are_numbered_in_the_order_in_which_they_are_made(gated: Gated) -> None:
    gated.feed(0, 0, 1)
    gated.feed(1, 0, 1, 2)
    gated.feed(0, 2)
    assert [(job.dwell.number, job.order) for job in gated.jobs if job.dwell] == [(1, 0), (0, 1)]


def test_a_dwell_of_a_sensor_that_is_forgotten_is_dropped_for_what_it_waits_for(gated: Gated) -> None:
    gated.supply("wait")
    gated.feed(0, 0, 1, 2)
    gated.feed(1, 0)
    early = another(4)
    gated.feed(5, 0, sensor=early)
    for number in range(1, 5):
        gated.describe(another(number))
        gated.feed(100, 0, sensor=another(number))
    lost = {"no supply": 3, "incomplete dwell": 1}
    assert (gated.lost(), gated.waiting) == (lost, 5)
    gated.supply("now")
    gated.feed(5, 1, 2, sensor=early)  # the message that came before its description has been accepted
    assert (gated.lost(), gated.waiting) == (lost, 4)
    assert gated.whole == [(5, [0, 1, 2], "now")]


def test_the_oldest_unfinished_dwell_goes_when_there_are_too_many(gated: Gated) -> None:
    for dwell in range(8):
        gated.feed(dwell, 0)
    assert not gated.losses
    gated.feed(8, 0)
    assert gated.lost() == {"buffer full": 1}
    assert_one_sentence(sentence(gated), "Dwell 0 was the oldest", "waited for channels [1, 2]", "sal-height transport")
    gated.feed(1, 1, 2)
    assert (len(gated.whole), gated.waiting) == (1, 7)


def test_unfinished_dwells_are_bounded_by_memory() -> None:
    gated = described(max_memory_mb=4)
    for dwell in range(4):
        gated.feed(dwell, 0)
    assert not gated.losses
    gated.feed(3, 1)
    assert gated.lost() == {"buffer full": 1}
    assert "4 MB" in sentence(gated)


@pytest.mark.parametrize("announced", [False, True])
def test_dwells_that_may_proceed_and_wait_for_supplies_are_bounded_as_well(announced: bool) -> None:
    """Also those whose channels the source has announced to be gone."""
    gated = described(missing_channels="proceed", max_unfinished_dwells=2)
    gated.supply("wait")
    for dwell in range(6):
        gated.feed(dwell, 0, 1)
        if announced:
            gated.announce(dwell + 0.5)
    assert (gated.lost(), gated.waiting) == ({"no supply": 8}, 4)


def test_messages_without_sensor_info_are_bounded_in_number() -> None:
    gated = Gated()
    for dwell in range(EARLY_KEPT):
        gated.feed(dwell, 0)
    assert not gated.losses
    gated.feed(EARLY_KEPT, 0)
    assert gated.lost() == {"no sensor info": 1}


def test_messages_without_sensor_info_are_bounded_by_memory() -> None:
    gated = Gated(max_memory_mb=4)
    for dwell in range(6):
        gated.feed(dwell, 0)
    assert gated.lost() == {"no sensor info": 2}


def test_descriptions_of_sensors_are_bounded(gated: Gated) -> None:
    for number in range(SENSORS_KEPT):
        gated.describe(another(number))
    gated.feed(1, 0)
    assert gated.waiting == 1  # for a description that is no longer kept
    gated.describe()
    gated.feed(1, 1, 2)
    assert len(gated.whole) == 1


def test_a_sensor_in_use_is_not_pushed_out_by_descriptions_of_others(gated: Gated) -> None:
    gated.feed(0, 0, 1, 2)
    gated.feed(1, 0)
    for number in range(3 * SENSORS_KEPT):
        gated.describe(another(number))
    gated.feed(1, 1, 2)
    assert [dwell for dwell, *_ in gated.whole] == [0, 1]
    assert len(gated.stage._sensors) == SENSORS_KEPT


def test_a_description_that_contradicts_the_first_is_not_used(gated: Gated) -> None:
    gated.describe(replace(SENSOR, pulse_count=SENSOR.pulse_count + 1, config_hash=SENSOR.config_hash))
    assert gated.warned() == {"sensor info": 1}
    assert_one_sentence(gated.notices[0].sentence, repr(SENSOR.config_hash), "stays in force")
    gated.feed(0, 0, 1, 2)
    assert gated.made[0].item[0].sensor is SENSOR


def test_nothing_is_kept_of_sensors_that_are_forgotten(gated: Gated) -> None:
    for number in range(3 * SENSORS_KEPT):
        gated.describe(another(number))
        gated.feed(number, 0, 1, 2, sensor=another(number))
        gated.feed(number + 100, 0, sensor=another(number))
    stage = gated.stage
    assert len(stage._sensors) == SENSORS_KEPT
    assert set(stage._assembler._latest_ns) == set(stage._absences) == set(stage._sensors)
    assert {dwell.key.sensor for dwell in stage._assembler.unfinished()} == set(stage._sensors)


def test_once_messages_have_arrived_no_other_sensor_is_rehearsed(gated: Gated) -> None:
    gated.feed(0, 0, 1, 2)
    gated.describe(another(1))
    gated.feed(1, 0, 1, 2)
    assert gated.stage.rehearsed == [SENSOR.name]


def test_of_many_descriptions_at_once_the_last_is_rehearsed() -> None:
    """One rehearsal at a time, and one for the last description after it: no flood of them can be made."""
    gated = Gated()
    gated.deferred = True
    for number in range(5):
        gated.describe(another(number))
    assert len(gated.jobs) == 1
    assert not gated.stage.is_ready
    gated.process(1)
    assert gated.stage.rehearsed == ["sensor 0", "sensor 4"]
    assert gated.stage.is_ready


def test_a_rehearsal_that_waits_is_left_out_once_messages_have_arrived() -> None:
    gated = Gated()
    gated.deferred = True
    for number in range(2):
        gated.describe(another(number))
    gated.feed(0, 0, sensor=another(1))
    gated.process(1)
    assert gated.stage.rehearsed == ["sensor 0"]
    assert gated.stage.is_ready


def test_large_dwells_are_not_rehearsed() -> None:
    size = SENSOR.dwell_bytes // SENSOR.pulse_count
    for pulses, count in ((REHEARSED_BYTES // size + 1, 0), (REHEARSED_BYTES // size, 1)):
        gated = Gated()
        gated.describe(replace(SENSOR, pulse_count=pulses, config_hash=""))
        assert len(gated.stage.rehearsed) == count
        assert gated.stage.is_ready


def test_an_error_in_a_rehearsal_costs_nothing(gated: Gated, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: Any) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(gated.stage, "rehearse_for", fail)
    gated.describe(another(1))
    assert [job.inputs for job in gated.jobs] == [Rehearsal(SENSOR), Rehearsal(another(1))]
    assert gated.stage.is_ready
    assert not [*gated.all_results()]


def test_an_incomplete_dwell_is_dropped_after_an_idle_wait() -> None:
    gated = described(timeout_s=1.0)
    gated.wait(60.0)  # before it, which does not count
    gated.feed(0, 0, 2)
    gated.wait(1.0)
    assert not gated.losses
    gated.wait(0.1)
    assert gated.lost() == {"incomplete dwell": 2}
    assert_one_sentence(sentence(gated), "channels [1] did not arrive within 1 s")


def test_a_dwell_does_not_time_out_while_the_host_is_working() -> None:
    gated = described(timeout_s=0.2)
    gated.feed(1, 0)
    gated.wait(60.0, busy=True)
    assert not gated.losses
    gated.feed(1, 1, 2)
    assert len(gated.whole) == 1


def test_a_dwell_does_not_time_out_because_a_host_was_held_up() -> None:
    """A tick that comes a minute late counts for two periods at most."""
    gated = described(timeout_s=1.0)
    gated.feed(0, 0)
    gated.now_s += 60.0
    gated.wait(0.1)
    assert not gated.losses


def test_a_dwell_does_not_time_out_while_messages_are_on_their_way() -> None:
    """Of dwells whose stamps are close to each other: the stage is never idle."""
    gated = described(timeout_s=1.0, max_unfinished_dwells=100)
    gated.feed(0, 0)
    for number in range(1, 20):
        gated.wait(0.5)
        gated.feed(number, 0, stamp=number * 0.01)
    assert not gated.losses


@pytest.mark.parametrize("stamp", [0.0, 1e6])
def test_a_dwell_is_dropped_once_the_sensor_has_moved_on(stamp: float) -> None:
    """Also one that is stamped in the far future; a stream that never pauses."""
    gated = described(timeout_s=2.0)
    gated.feed(0, 0, stamp=stamp)
    gated.feed(1, 0, 1, 2, stamp=10.0)
    assert not gated.losses  # later by the stamps, but not by the clock of the host
    for number in range(2, 6):
        gated.wait(0.5)
        gated.feed(number, 0, 1, 2, stamp=10.0)
    assert not gated.losses
    gated.wait(0.1)
    assert gated.lost() == {"incomplete dwell": 1}


def test_a_dwell_waits_while_the_stamps_stand_still() -> None:
    gated = described(timeout_s=1.0)
    gated.feed(0, 0)
    for number in range(1, 20):
        gated.wait(0.5)
        gated.feed(number, 0, 1, 2, stamp=0.1)
    assert not gated.losses


@pytest.mark.parametrize(("described_again", "stamp"), [(False, 0.0), (True, 0.0), (False, 1e6)])
def test_a_message_of_an_unknown_sensor_is_dropped_once_the_sensor_has_moved_on(
    described_again: bool, stamp: float
) -> None:
    """Dwells of a known sensor never pause meanwhile, so that the stage is never idle."""
    gated = described(timeout_s=2.0)
    gated.feed(0, 0, sensor=another(0), stamp=stamp)
    for number in range(1, 5):
        gated.feed(number, 0, 1, 2, stamp=10.0)
        gated.wait(0.5)
        if described_again:
            gated.describe()
    assert not gated.losses
    gated.wait(0.1)
    assert gated.lost() == {"contradicts sensor info": 1}
    assert_one_sentence(sentence(gated), "Dwell 0, channel 0", another(0).config_hash, SENSOR.config_hash)


def test_a_message_of_an_unknown_sensor_waits_while_the_stamps_stand_still() -> None:
    gated = described(timeout_s=0.2)
    gated.feed(0, 0, sensor=another(0))
    for number in range(1, 5):
        gated.wait(0.1)
        gated.feed(number, 0, 1, 2, stamp=0.1)
    assert not gated.losses


def test_messages_without_sensor_info_are_dropped_after_an_idle_wait() -> None:
    gated = Gated(timeout_s=1.0)
    gated.feed(0, 0, 1)
    gated.wait(1.0)
    assert not gated.losses
    gated.wait(0.2)
    assert gated.lost() == {"no sensor info": 2}


def test_a_dwell_is_dropped_for_supplies_that_do_not_arrive() -> None:
    gated = described(timeout_s=1.0)
    gated.supply("wait")
    gated.feed(0, 0, 1, 2)
    gated.wait(1.2)
    assert gated.lost() == {"no supply": 3}
    gated.supply("late")
    gated.feed(1, 0, 1, 2)
    assert gated.whole == [(1, [0, 1, 2], "late")]


def test_without_a_channel_dwells_proceed_if_that_is_allowed() -> None:
    gated = described(timeout_s=1.0, missing_channels="proceed")
    gated.feed(0, 0, 2)
    gated.wait(1.2)
    assert gated.whole == [(0, [0, 2], "supplied")]
    assert [message.channel for message in gated.made[0].item[0].messages] == [0, 1, 2]
    assert gated.warned() == {"missing channels": 1}
    assert_one_sentence(gated.notices[0].sentence, "without channels [1]")
    assert [job.messages for job in gated.jobs if job.dwell] == [2]


def test_too_few_channels_are_dropped() -> None:
    gated = described(timeout_s=1.0, missing_channels="proceed")
    gated.feed(0, 0)
    gated.wait(1.2)
    assert gated.lost() == {"incomplete dwell": 1}


def test_a_dwell_that_may_proceed_is_dropped_for_supplies_that_do_not_arrive() -> None:
    gated = described(timeout_s=1.0, missing_channels="proceed")
    gated.supply("wait")
    gated.feed(0, 0, 1)
    gated.wait(1.2)
    assert gated.lost() == {"no supply": 2}


def test_a_channel_that_is_gone_is_no_longer_waited_for_until_it_returns() -> None:
    gated = described(missing_channels="proceed", max_unfinished_dwells=1)
    for dwell in range(GONE_AFTER + 1):  # each makes its predecessor go
        gated.feed(dwell, 0, 2)
    assert len(gated.whole) == GONE_AFTER + 1  # the last one did not wait
    gated.feed(10, 1, 0)
    assert (len(gated.whole), gated.waiting) == (GONE_AFTER + 1, 2)
    gated.feed(10, 2)
    assert gated.whole[-1] == (10, [0, 1, 2], "supplied")
    assert gated.warned() == {"missing channels": GONE_AFTER + 1}


@pytest.mark.parametrize("part", ["check", "supplies"])
def test_an_error_that_no_input_should_cause_costs_its_message_only(
    gated: Gated, monkeypatch: pytest.MonkeyPatch, part: str
) -> None:
    def fail(*_: Any) -> None:
        raise ZeroDivisionError(part)

    with monkeypatch.context() as broken:
        broken.setattr(gated.stage, part, fail)
        gated.feed(0, 0, 1, 2)
    assert gated.lost() == {"internal error": 3}
    assert "ZeroDivisionError" in gated.losses[0].trace
    gated.feed(1, 0, 1, 2)
    assert len(gated.whole) == 1


def test_an_error_in_the_work_costs_its_dwell_only(gated: Gated, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: Any) -> None:
        raise ZeroDivisionError

    with monkeypatch.context() as broken:
        broken.setattr(gated.stage, "work_on", fail)
        gated.feed(0, 0, 1, 2)
    gated.feed(1, 0, 1, 2)
    (loss,) = gated.losses
    assert (loss.dwell, loss.messages, loss.reason) == (gated.key(0), 3, "internal error")
    assert [dwell for dwell, *_ in gated.whole] == [1]


def test_who_publishes_twice_is_named(gated: Gated) -> None:
    gated.stage.publishers_of = {FRAMES: 2}.__getitem__
    gated.feed(0, 0, 0)
    assert gated.lost() == {"duplicate": 1}
    assert "2 nodes publish frames: each must have channels of its own." in sentence(gated)


def test_a_reset_drops_what_is_unfinished_and_lets_finished_dwells_be_repeated(gated: Gated) -> None:
    gated.feed(0, 0, 1, 2)
    gated.feed(1, 0)
    gated.feed(2, 0, sensor=another(1))
    gated.do(DwellStage.reset)
    assert gated.lost() == {"reset": 2}
    gated.feed(0, 0, 1, 2)
    assert [dwell for dwell, *_ in gated.whole] == [0, 0]


@pytest.mark.parametrize(("step", "reason"), [(DwellStage.abandon, "ended"), (DwellStage.finish, "incomplete dwell")])
def test_what_waits_at_the_end_is_counted(gated: Gated, step: Step, reason: str) -> None:
    gated.feed(1, 0, 2)
    gated.do(step)
    assert gated.lost() == {reason: 2}


@pytest.mark.parametrize("step", [DwellStage.abandon, DwellStage.finish])
def test_messages_without_sensor_info_at_the_end_are_counted(step: Step) -> None:
    gated = Gated()
    gated.feed(1, 0, 2)
    gated.do(step)
    assert sum(gated.lost().values()) == 2
    assert gated.waiting == 0


def test_what_arrives_after_the_end_is_counted(gated: Gated) -> None:
    gated.do(DwellStage.finish)
    gated.feed(0, 0, 1)
    gated.feed(1, 0, 1, 2)
    gated.feed(2, 0, sensor=another(1))
    gated.do(DwellStage.finish)
    assert gated.lost() == {"incomplete dwell": 2, "contradicts sensor info": 1}
    assert len(gated.whole) == 1


def test_messages_of_two_sensors_make_dwells_of_their_own(gated: Gated) -> None:
    """With the same numbers and stamps, in turn."""
    other = another(1)
    gated.describe(other)
    for channel in (0, 1, 2):
        gated.feed(0, channel)
        gated.feed(0, channel, sensor=other)
    assert [one.sensor for one, _ in (made.item for made in gated.made)] == [SENSOR, other]


def test_a_message_on_the_port_of_another_estimator_is_reported(gated: Gated) -> None:
    """A host that joins stages wrongly is told so, and nothing ends."""
    message = Message(gated.key(0), 0)
    gated.stage.receive_other = DwellStage.receive_other.__get__(gated.stage)
    found = gated.do(accept("elsewhere", message))
    assert Counter(one.kind for one in found) == {"internal error": 1}
    assert gated.do(accept(FRAMES, message)) == []
    assert gated.do(accept(SENSOR_INFO, SENSOR)) == []
