"""A dwell can be scheduled to be left out, or to be processed as the first one: every host does it by the stage."""

from __future__ import annotations

import pytest
from driven import Step, accept, drive, finish
from flown_items import heights_in, small_flight
from gate import SUPPLIES, Gated
from same_items import are_same

from sal_height.engine.results import DwellKey, Event
from sal_height.engine.stage import RESETS, Reset
from sal_height.engine.tracker import Tracker
from sal_height.errors import Rejected

REASON = Rejected("overload", "Dwell 1 had waited too long.")


@pytest.fixture
def gated() -> Gated:
    gated = Gated(missing_channels="refuse")
    gated.describe()
    return gated


def test_a_dwell_is_left_out_for_the_stated_reason_and_the_others_are_not(gated: Gated) -> None:
    gated.stage.schedule(gated.key(1), "", REASON)
    for dwell in range(3):
        gated.feed(dwell, 0, 1, 2)
    assert [dwell for dwell, *_ in gated.whole] == [0, 2]
    assert [(one.dwell, one.messages, one.reason, one.sentence) for one in gated.losses] == [
        (gated.key(1), 3, "overload", str(REASON))
    ]
    assert gated.waiting == 0


def test_a_dwell_that_lacks_something_is_lost_for_that_and_not_for_the_stated_reason(gated: Gated) -> None:
    gated.stage.schedule(gated.key(1), "", REASON)
    gated.feed(1, 0, 1)
    gated.do(finish)
    assert [one.reason for one in gated.losses] == ["incomplete dwell"]


def test_settings_before_a_dwell_that_is_left_out_apply_to_the_next(gated: Gated) -> None:
    gated.stage.schedule(gated.key(1), "", REASON)
    gated.stage.change(gated.stage._settings.changed(timeout_s=7.0), before=gated.key(1))
    for dwell in range(3):
        gated.feed(dwell, 0, 1, 2)
    assert [settings.timeout_s for _, settings in (made.item for made in gated.made)] == [5.0, 7.0]


def test_a_reset_is_stated_with_the_next_dwell_and_repeated_before_it() -> None:
    heights = heights_in(small_flight())
    script = [accept("ml/height", one) for one in heights]
    flown = drive(Tracker(Tracker.settings()), [*script[:2], lambda stage: stage.reset(), *script[2:]])
    resets = [one for one in flown.decided if isinstance(one, Event) and one.name == RESETS]
    assert resets == [Event(RESETS, heights[2].key)]
    repeated = drive(Tracker(Tracker.settings()), [reset_before(resets[0].dwell), *script])
    assert are_same(repeated.made, flown.made)
    assert [one for one in repeated.decided if isinstance(one, Event) and one.name == RESETS] == resets


def test_the_tracker_gives_the_heights_that_it_gives_without_the_dwell() -> None:
    heights = heights_in(small_flight())
    script = [accept("ml/height", one) for one in heights]
    left_out = drive(Tracker(Tracker.settings()), [leave_out(heights[1].key), *script])
    without = drive(Tracker(Tracker.settings()), [script[0], *script[2:]])
    assert [one.reason for one in left_out.losses] == ["overload"]
    assert are_same(left_out.made, without.made)
    assert not are_same(left_out.made[1:], drive(Tracker(Tracker.settings()), script).made[2:])


def test_after_a_reset_before_a_dwell_the_tracker_gives_what_a_new_one_gives() -> None:
    heights = heights_in(small_flight())
    script = [accept("ml/height", one) for one in heights]
    restarted = drive(Tracker(Tracker.settings()), [reset_before(heights[2].key), *script])
    first, second = (drive(Tracker(Tracker.settings()), part) for part in (script[:2], script[2:]))
    assert are_same(restarted.made, [*first.made, *second.made])
    assert not are_same(restarted.made[2:], drive(Tracker(Tracker.settings()), script).made[2:])


def test_a_reset_before_a_dwell_keeps_the_messages_that_wait(gated: Gated) -> None:
    gated.stage.schedule(gated.key(1), "", Reset())
    gated.feed(0, 0, 1)
    gated.feed(1, 0, 1, 2)
    gated.feed(0, 2)
    assert sorted(dwell for dwell, *_ in gated.whole) == [0, 1]
    assert not gated.losses


def test_a_reset_is_stated_with_its_dwell_though_others_come_while_that_one_waits(gated: Gated) -> None:
    gated.supply("wait")
    gated.stage.schedule(gated.key(1), "", Reset())
    gated.stage.schedule(gated.key(0), SUPPLIES, "supplied")
    gated.feed(0, 0, 1)
    gated.feed(1, 0, 1, 2)
    gated.feed(0, 2)
    assert [dwell for dwell, *_ in gated.whole] == [0, 1]
    assert [one for one in gated.decided if isinstance(one, Event) and one.name == RESETS] == [
        Event(RESETS, gated.key(1))
    ]


def leave_out(dwell: DwellKey) -> Step:
    return lambda stage: stage.schedule(dwell, "", REASON)


def reset_before(dwell: DwellKey) -> Step:
    return lambda stage: stage.schedule(dwell, "", Reset())
