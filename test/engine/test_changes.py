"""Changes of settings, calibrations and mountings belong to a dwell: they take effect with its job, and not before."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from driven import Driven, Step, accept, drive, finish
from flown_items import (
    SMALL,
    START_NS,
    at,
    flight_items,
    frame_items,
    heights_in,
    images_in,
    key_of,
    ml_stage,
    odometry_items,
    small_flight,
)
from gate import SUPPLIES, Gated
from same_items import are_same
from scipy.spatial.transform import Rotation
from stage_cases import calibration_of, stated, transform

from sal_height.engine.calibrations import CALIBRATIONS_ARRIVED, StatedCalibration
from sal_height.engine.calibrator import PsfCalibration
from sal_height.engine.chain import Chain
from sal_height.engine.compression import Compression
from sal_height.engine.heights import height_stage
from sal_height.engine.results import Event, Product
from sal_height.engine.tracker import Tracker
from sal_height.geometry import Mounting
from sal_height.topics import CALIBRATION, ODOMETRY, SENSOR_INFO, SLC, TF_STATIC


@pytest.fixture
def gated() -> Gated:
    gated = Gated(missing_channels="refuse")
    gated.describe()
    return gated


def settings_of(gated: Gated) -> dict[int, Any]:
    """The settings of the job of each dwell."""
    return {whole.key.number: settings for whole, settings in (made.item for made in gated.made)}


def other(gated: Gated, **values: Any) -> Any:
    return gated.stage._settings.changed(**values)


def test_settings_hold_from_the_dwell_on_that_they_belong_to(gated: Gated) -> None:
    changed = other(gated, timeout_s=7.0)
    gated.stage.change(changed, before=gated.key(1))
    for dwell in range(3):
        gated.feed(dwell, 0, 1, 2)
    assert [settings.timeout_s for settings in settings_of(gated).values()] == [5.0, 7.0, 7.0]


def test_without_a_dwell_settings_hold_from_the_next_job_on(gated: Gated) -> None:
    gated.feed(0, 0, 1, 2)
    gated.feed(1, 0, 1)
    gated.stage.change(other(gated, timeout_s=7.0))
    gated.feed(1, 2)
    assert [settings.timeout_s for settings in settings_of(gated).values()] == [5.0, 7.0]


def test_several_changes_before_a_dwell_are_made_in_their_order(gated: Gated) -> None:
    for seconds in (7.0, 8.0):
        gated.stage.change(other(gated, timeout_s=seconds), before=gated.key(1))
        gated.stage.schedule(gated.key(1), SUPPLIES, f"{seconds:g}")
    gated.feed(1, 0, 1, 2)
    assert (settings_of(gated)[1].timeout_s, gated.whole[0][2]) == (8.0, "8")


def test_a_change_holds_from_its_dwell_on_also_where_an_earlier_one_still_waits_for_a_channel(gated: Gated) -> None:
    """The order is that in which jobs are made: the earlier dwell becomes one after the change."""
    gated.stage.schedule(gated.key(1), SUPPLIES, "changed")
    gated.feed(0, 0, 1)
    gated.feed(1, 0, 1, 2)
    gated.feed(0, 2)
    assert gated.whole == [(1, [0, 1, 2], "changed"), (0, [0, 1, 2], "changed")]


def test_a_change_does_not_take_effect_while_its_dwell_waits(gated: Gated) -> None:
    """For a channel, or for supplies that the change does not bring."""
    gated.stage.schedule(gated.key(1), SUPPLIES, "wait")
    gated.stage.change(other(gated, timeout_s=7.0), before=gated.key(1))
    gated.feed(1, 0, 1)
    gated.feed(0, 0, 1, 2)
    gated.feed(1, 2)  # whole now, but with the change there are no supplies
    gated.feed(2, 0, 1, 2)
    assert gated.whole == [(0, [0, 1, 2], "supplied"), (2, [0, 1, 2], "supplied")]
    assert {settings.timeout_s for settings in settings_of(gated).values()} == {5.0}
    assert gated.waiting == 3
    assert not [one for one in gated.all_results() if isinstance(one, Event)]


def test_a_dwell_does_not_wait_for_what_is_scheduled_before_it(gated: Gated) -> None:
    gated.supply("wait")
    gated.stage.schedule(gated.key(1), SUPPLIES, "scheduled")
    gated.feed(0, 0, 1, 2)
    gated.feed(1, 0, 1, 2)
    assert gated.whole[0] == (1, [0, 1, 2], "scheduled")
    gated.feed(2, 0, 1, 2)
    assert [dwell for dwell, *_ in gated.whole] == [1, 0, 2]


@pytest.mark.parametrize("lost", ["a channel is missing", "an error", "too many"])
def test_what_was_scheduled_before_a_dwell_that_is_lost_holds_for_the_next(gated: Gated, lost: str) -> None:
    gated.stage.schedule(gated.key(1), SUPPLIES, "changed")
    if lost == "an error":
        gated.stage.supplies = lambda *_: 1 / 0
        gated.feed(1, 0, 1, 2)
        del gated.stage.supplies
    elif lost == "too many":
        gated.stage.change(other(gated, max_unfinished_dwells=1))
        gated.feed(1, 0)
        gated.feed(9, 0)
    else:
        gated.feed(1, 0, 1)
        gated.announce(2.0)
    gated.feed(2, 0, 1, 2)
    assert gated.losses
    assert gated.whole == [(2, [0, 1, 2], "changed")]


def test_whether_a_dwell_may_proceed_is_as_scheduled_before_it(gated: Gated) -> None:
    proceeding = other(gated, missing_channels="proceed")
    gated.stage.change(proceeding, before=gated.key(1))
    gated.stage.change(other(gated), before=gated.key(3))
    for dwell in range(4):
        gated.feed(dwell, 0, 1)
    gated.announce(9.0)
    assert [dwell for dwell, *_ in gated.whole] == [1, 2]
    assert gated.lost() == {"incomplete dwell": 4}


def test_what_is_scheduled_and_cannot_be_used_is_reported_and_costs_nothing(gated: Gated) -> None:
    gated.stage.schedule(gated.key(0), SENSOR_INFO, "no sensor")
    gated.feed(0, 0, 1, 2)
    assert gated.warned() == {"internal error": 1}
    assert len(gated.whole) == 1


# The compression.


def compressed(script: list[Step], **settings: Any) -> Driven:
    return drive(Compression(Compression.settings(**{**SMALL, **settings})), script)


def of(driven: Driven, dwell: int) -> Any:
    """The images of a dwell."""
    return next(one.item for one in driven.made if one.item.key.number == dwell)


def scheduled(dwell: int, port: str, item: Any) -> Step:
    return lambda stage: stage.schedule(key_of(small_flight(), dwell), port, item)


def test_images_change_with_the_settings_of_their_dwell() -> None:
    narrow = Compression.settings(**{**SMALL, "cols": 6})
    flown = [accept(*item) for item in flight_items(small_flight())]
    driven = compressed([scheduled(3, "", narrow), *flown])
    assert [one.item.slc.grid.cols for one in driven.made] == [8, 8, 8, 6, 6, 6]
    alone = drive(Compression(narrow), flown)
    assert all(are_same(of(driven, dwell), of(alone, dwell)) for dwell in (3, 4, 5))
    plain = compressed(flown)
    assert all(are_same(of(driven, dwell), of(plain, dwell)) for dwell in (0, 1, 2))


def test_odometry_that_completes_two_dwells_leaves_a_change_between_them() -> None:
    flight = small_flight()
    script = [accept(SENSOR_INFO, flight.sensor)]
    for dwell in (0, 1):
        script += [accept(*item) for item in frame_items(flight, dwell)]
    states = [item for dwell in (0, 1) for item in odometry_items(flight, dwell)]
    driven = compressed(script, max_odometry_gap_s=1.0)
    driven.do(scheduled(1, "", Compression.settings(**{**SMALL, "cols": 6}, max_odometry_gap_s=1.0)))
    for item in (states[0], states[-1]):
        assert not driven.made
        driven.do(accept(*item))
    assert [one.item.slc.grid.cols for one in driven.made] == [8, 6]


def test_a_calibration_is_applied_from_the_dwell_on_that_it_belongs_to() -> None:
    """Also where an earlier dwell still waits for a channel, and becomes a job only after it."""
    flight = small_flight()
    first, second = (calibration_of(flight.sensor, gain) for gain in (1.1, 1.2))
    script = [accept(SENSOR_INFO, flight.sensor), accept(*stated(first)), scheduled(2, *stated(second))]
    *others, late = frame_items(flight, 1)
    for dwell in range(4):
        frames = others if dwell == 1 else frame_items(flight, dwell)
        script += [accept(*item) for item in (*odometry_items(flight, dwell), *frames)]
    driven = compressed([*script, accept(*late)], calibration="topic")
    applied = {one.item.key.number: one.item.provenance.calibration_id for one in driven.made}
    assert applied == {0: first.id, 2: second.id, 3: second.id, 1: second.id}
    assert [one.item.order for one in driven.made] == [0, 1, 2, 3]


def test_a_dwell_has_what_holds_when_its_job_is_made_whatever_arrives_while_that_waits() -> None:
    flight = small_flight()
    first, second = (calibration_of(flight.sensor, gain) for gain in (1.1, 1.2))
    stage = Compression(Compression.settings(**SMALL, calibration="topic"))
    script = [accept(*stated(first)), *(accept(*item) for item in flight_items(flight, dwells=[0]))]
    driven = drive(stage, [])
    driven.deferred = True
    for step in script:
        driven.do(step)
    driven.do(accept(*stated(second)))
    stage.change(stage._settings.changed(rows=12))
    driven.process(1)
    (made,) = driven.made
    assert (made.item.provenance.calibration_id, made.item.slc.grid.rows) == (first.id, 20)


def test_a_dwell_waits_for_air_as_the_settings_of_its_own_say() -> None:
    flown = [accept(*item) for item in flight_items(small_flight(), dwells=range(3))]
    heard = Compression.settings(**{**SMALL, "air": "topics"})
    driven = drive(Compression(heard), [scheduled(1, "", heard.changed(air="none")), *flown])
    assert [one.item.key.number for one in driven.made] == [1, 0, 2]  # after the change dwell 0 need not wait either


def test_the_mounting_that_was_used_is_stated_and_can_be_used_again() -> None:
    """A flight with a mounting from transforms, and one with that mounting stated: equal in all but two settings."""
    flight = small_flight()
    turn, arm = Rotation.from_euler("x", 2e-5), (0.3, -0.2, 0.1)
    flown = [accept(*item) for item in flight_items(flight, dwells=[0, 1])]
    transforms = [
        accept(TF_STATIC, transform("base_link", "pod", arm)),
        accept(TF_STATIC, transform("pod", "sensor", turn=turn)),
    ]
    driven = compressed([*transforms, *flown], mounting_from_tf=True)
    used = of(driven, 0).provenance.compression
    assert used["used_mounting.frame_id"] == "sensor"
    assert used["used_mounting.lever_arm"] == pytest.approx(arm)
    mounting = Mounting("sensor", used["used_mounting.lever_arm"], used["used_mounting.rotation"])
    again = compressed([lambda stage: stage.state_mounting(flight.sensor.config_hash, mounting), *flown])
    assert are_same(of(again, 0).slc.images, of(driven, 0).slc.images)
    assert of(again, 0).provenance.compression["used_mounting.rotation"] == used["used_mounting.rotation"]
    plain = compressed(flown)
    assert not any(name.startswith("used_mounting") for name in of(plain, 0).provenance.compression)
    assert not are_same(of(plain, 0).slc.aperture.position, of(driven, 0).slc.aperture.position)


# Stages after it.


def test_images_find_the_calibration_that_is_scheduled_before_their_dwell() -> None:
    """They were made with it, and nothing else brings it."""
    flight = small_flight()
    calibration = calibration_of(flight.sensor, width_factor=1.05)
    flown = [accept(*item) for item in flight_items(flight, dwells=[0, 1])]
    images = [one.item for one in compressed([scheduled(1, *stated(calibration)), *flown], calibration="topic").made]
    assert [one.provenance.calibration_id for one in images] == ["", calibration.id]
    for whole in (True, False):
        script = [scheduled(1, *stated(calibration)), accept(SENSOR_INFO, flight.sensor)]
        script += [accept(SLC, item) for one in images for item in ([one] if whole else one.channels())]
        driven = drive(ml_stage(), script)
        assert len(driven.made) == 2
        assert [one.name for one in driven.decided if isinstance(one, Event)] == [CALIBRATIONS_ARRIVED]


def test_heights_are_tracked_with_the_settings_of_their_dwell() -> None:
    heights = heights_in(small_flight(), **SMALL)
    given = Tracker.settings(correlation_length_m=5.0, relief_sigma_m=2.0)
    script: list[Step] = [scheduled(2, "", given), *(accept("ml/height", one) for one in heights)]
    driven = drive(Tracker(Tracker.settings()), script)
    stages = [one.item.provenance.stages["relief_tracker"] for one in driven.made]
    assert [one["prior.length"] == pytest.approx(5.0) for one in stages] == [False, False, True, True, True, True]


# Feedback.


def test_a_calibration_that_is_made_in_a_chain_counts_from_the_next_dwell_on() -> None:
    """In spite of estimators that would take several dwells at once: the chain does not run ahead."""
    flight = small_flight()
    ml = height_stage("ml")
    settings = [
        Compression.settings(**SMALL, range_window="rectangular", calibration="topic"),
        ml.settings(),
        PsfCalibration.settings(dwells=2, dwell_step=1),
    ]
    chain = Chain([Compression(settings[0]), ml(settings[1]), PsfCalibration(settings[2])], settings)
    applied, calibrations = [], []
    for item in flight_items(flight):
        for made in chain.feed(*item):
            if isinstance(made.result, Product) and made.result.port == "ml/height":
                applied.append(made.result.item.provenance.calibration_id)
            elif isinstance(made.result, Product) and made.result.port == CALIBRATION:
                calibrations.append(made.result.item.calibration.id)
    assert len(calibrations) == 1
    assert applied == ["", "", *calibrations * 4]


def test_a_calibration_of_a_file_is_published_and_applied_from_the_first_dwell_on() -> None:
    flight = small_flight()
    calibration = calibration_of(flight.sensor)
    stage = Compression(Compression.settings(**SMALL, calibration="any.npz"), {CALIBRATION: calibration})
    script: list[Step] = [lambda stage: stage.start(START_NS)]
    driven = drive(stage, [*script, *(accept(*item) for item in flight_items(flight, dwells=[0]))])
    published, images = (one.item for one in driven.made)
    assert published == StatedCalibration(calibration, START_NS)
    assert images.provenance.calibration_id == calibration.id
    assert [port.name for port in stage.outputs(stage._settings)] == [SLC, CALIBRATION]


def test_images_of_other_settings_are_not_estimated_together() -> None:
    """Four of six jobs, which wait, belong to settings that were changed in between."""
    flight = small_flight()
    ml = height_stage("ml")
    fine = ml.settings(range_looks=1)
    script = [accept(SENSOR_INFO, flight.sensor), scheduled(2, "", fine), scheduled(4, "", ml.settings())]
    script += [accept(SLC, one) for one in images_in(flight, **SMALL)]
    together, alone = (drive(ml(ml.settings()), script, group=group) for group in (8, 1))
    assert are_same(together.results, alone.results)
    assert [one.item.looks[0] for one in together.made] == [2, 2, 1, 1, 2, 2]


def test_a_state_of_the_platform_is_no_change() -> None:
    """Odometry can be scheduled like anything else: it arrives then."""
    flight = small_flight()
    *states, (port, last) = odometry_items(flight, 0)
    script = [accept(SENSOR_INFO, flight.sensor), *(accept(*item) for item in states[:-1])]
    driven = compressed([*script, scheduled(0, port, at(replace(last), 0))])
    driven.deliver(frame_items(flight, 0))
    driven.do(finish)
    assert [one.item.key.number for one in driven.made] == [0]
    assert port == ODOMETRY
    assert np.isfinite(driven.made[0].item.slc.images).all()
