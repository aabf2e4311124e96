"""What a source announces: dwells are given up exactly when what they lack can no longer arrive, and not before."""

from __future__ import annotations

from typing import Any

import pytest
from driven import Driven, accept, advance, drive, finish, nothing_before
from flown_items import (
    SMALL,
    START_NS,
    at,
    frame_items,
    heights_in,
    images_in,
    key_of,
    ml_stage,
    odometry_items,
    small_flight,
)
from gate import FRAMES, SENSOR, Gate, Gated, Message, another
from helpers import assert_one_sentence
from stage_cases import air_items, calibration_of, stated, transform

from sal_height.engine.adjuster import HeightAdjuster
from sal_height.engine.air import AIR_PARAMETERS, AirSample
from sal_height.engine.compression import Compression
from sal_height.engine.results import Loss
from sal_height.engine.stage import FOREVER_NS
from sal_height.topics import CALIBRATION, ODOMETRY, PHASE_HISTORY, SENSOR_INFO, SLC, TF_STATIC

SECOND = 1_000_000_000


def announced(**settings: Any) -> Gated:
    """A gate whose source has announced that its clock is at 1000 s."""
    gated = Gated(**settings)
    gated.describe()
    gated.announce(0.0)
    return gated


def test_a_dwell_that_lacks_a_channel_is_given_up_when_its_stamp_has_passed() -> None:
    gated = announced()
    gated.feed(0, 0, 2)
    gated.announce(0.0)
    assert not gated.losses
    gated.announce(1e-9)
    assert gated.lost() == {"incomplete dwell": 2}
    assert_one_sentence(gated.losses[0].sentence, "channels [1] did not arrive before the source went on")
    gated.feed(1, 0, 1, 2)
    assert len(gated.whole) == 1


def test_a_dwell_proceeds_without_a_channel_when_its_stamp_has_passed() -> None:
    gated = announced(missing_channels="proceed")
    gated.feed(0, 0, 2)
    gated.feed(1, 0, 1)
    gated.announce(0.0)
    assert not gated.whole
    gated.announce(1.0)
    assert gated.whole == [(0, [0, 2], "supplied")]
    gated.announce(2.0)
    assert gated.whole[1:] == [(1, [0, 1], "supplied")]
    assert gated.warned() == {"missing channels": 2}


def test_too_few_channels_are_dropped_when_the_stamp_has_passed() -> None:
    gated = announced(missing_channels="proceed", min_channels=2)
    gated.feed(0, 0)
    gated.announce(1.0)
    assert gated.lost() == {"incomplete dwell": 1}


def test_channels_that_were_missing_before_are_waited_for_all_the_same() -> None:
    """So that how many dwells wait does not say which channels are in an image."""
    gated = announced(missing_channels="proceed")
    for dwell in range(6):
        gated.feed(dwell, 0, 2)
        gated.announce(dwell + 1.0)
    gated.feed(6, 0, 2)
    assert len(gated.whole) == 6
    gated.feed(6, 1)
    assert gated.whole[6] == (6, [0, 1, 2], "supplied")


def test_no_time_out_counts_once_the_source_announces() -> None:
    """Dwells wait for those that began before them, however long these lack channels."""
    gated = announced(timeout_s=0.1)
    gated.feed(0, 0, 2)
    gated.feed(9, 0, sensor=another(1), stamp=-500.0)
    for number in range(1, 6):
        gated.wait(60.0)
        gated.feed(number, 0, 1, 2, stamp=100.0)
    assert (gated.losses, gated.whole) == ([], [])
    gated.announce(50.0)
    assert gated.lost() == {"incomplete dwell": 2}
    assert len(gated.whole) == 5


def test_a_dwell_that_proceeds_without_a_channel_becomes_a_job_as_soon_as_it_is_supplied() -> None:
    """In its place: before a later dwell that is supplied by the same."""
    gated = announced(missing_channels="proceed")
    gated.supply("wait")
    gated.feed(0, 0, 2)
    gated.feed(1, 0, 1, 2)
    gated.announce(5.0)
    assert (gated.waiting, gated.losses) == (5, [])
    gated.supply("now")
    assert gated.whole == [(0, [0, 2], "now"), (1, [0, 1, 2], "now")]


@pytest.mark.parametrize("missing_channels", ["refuse", "proceed"])
def test_what_waits_for_supplies_is_given_up_when_the_port_has_ended(missing_channels: str) -> None:
    gated = announced(missing_channels=missing_channels)
    gated.supply("wait")
    gated.feed(0, 0, 1, 2)
    gated.feed(1, 0, 1)
    gated.do(nothing_before(FRAMES, FOREVER_NS))
    first = {"refuse": {"no supply": 3, "incomplete dwell": 2}, "proceed": {"no supply": 5}}[missing_channels]
    assert (gated.lost(), gated.waiting) == (first, 0)


def test_messages_of_a_sensor_that_will_not_be_described_are_dropped() -> None:
    """Those that wait, and those that arrive later."""
    gated = announced()
    gated.feed(0, 0, sensor=another(1))
    gated.do(nothing_before(SENSOR_INFO, 5))
    assert not gated.losses
    gated.do(nothing_before(SENSOR_INFO, FOREVER_NS))
    gated.feed(0, 1, sensor=another(1))
    assert (gated.lost(), gated.waiting) == ({"contradicts sensor info": 2}, 0)


def test_the_latest_announcement_counts_when_a_clock_has_started_again() -> None:
    gated = announced()
    gated.announce(500.0)
    gated.announce(0.0)
    gated.feed(3, 0, 1)
    gated.announce(3.0)
    gated.feed(3, 2)
    assert len(gated.whole) == 1


def test_at_the_end_everything_is_given_up_in_the_order_in_which_it_arrived() -> None:
    gated = announced()
    gated.feed(2, 0)
    gated.feed(1, 0)
    gated.do(finish)
    assert [one.dwell.number for one in gated.losses] == [2, 1]


# The compression.


def waiting_for_odometry(frames: int = 1, **settings: Any) -> Driven:
    """The frames of the first dwells have arrived, and of the odometry all but that which ends the first of them."""
    flight = small_flight()
    driven = drive(Compression(Compression.settings(**{**SMALL, **settings})), [accept(SENSOR_INFO, flight.sensor)])
    driven.deliver(odometry_items(flight, 0)[:-2])
    for dwell in range(frames):
        driven.deliver(frame_items(flight, dwell))
    assert not driven.made
    return driven


def test_a_dwell_waits_for_odometry_as_long_as_that_may_be_close_enough() -> None:
    """0.5 s after the last sample before its last pulse."""
    driven = waiting_for_odometry()
    last_ns = odometry_items(small_flight(), 0)[-3][1].stamp_ns
    driven.do(nothing_before(ODOMETRY, last_ns + SECOND // 2))
    assert not driven.losses
    driven.do(nothing_before(ODOMETRY, last_ns + SECOND // 2 + 1000))
    assert driven.lost() == {"odometry gap": 8}


def test_a_dwell_is_covered_by_a_sample_right_after_the_announcement() -> None:
    driven = waiting_for_odometry()
    port, state = odometry_items(small_flight(), 0)[-1]
    driven.do(nothing_before(ODOMETRY, state.stamp_ns))
    driven.do(accept(port, state))
    assert [one.port for one in driven.made] == [SLC]


def test_a_dwell_that_odometry_has_passed_with_a_gap_is_given_up() -> None:
    driven = waiting_for_odometry(max_odometry_gap_s=0.002)
    driven.deliver(odometry_items(small_flight(), 0)[-2:])
    assert not driven.losses
    driven.do(nothing_before(ODOMETRY, odometry_items(small_flight(), 0)[-1][1].stamp_ns))
    assert driven.lost() == {"odometry gap": 8}
    assert_one_sentence(driven.losses[0].sentence, "there are 0.005 s between two")


def test_odometry_that_never_arrives_costs_all_dwells_at_its_end_and_not_before() -> None:
    flight = small_flight()
    driven = drive(Compression(Compression.settings(**SMALL)), [accept(SENSOR_INFO, flight.sensor)])
    for dwell in range(3):
        driven.deliver(frame_items(flight, dwell))
        driven.do(nothing_before(PHASE_HISTORY, key_of(flight, dwell).stamp_ns + 1))
    assert not driven.losses
    driven.do(nothing_before(ODOMETRY, FOREVER_NS))
    assert driven.lost() == {"odometry gap": 24}
    assert_one_sentence(driven.losses[0].sentence, "no sample was received")


def test_odometry_that_starts_after_a_dwell_gives_it_up_at_once() -> None:
    """And not those that it may cover."""
    flight = small_flight()
    script = [accept(SENSOR_INFO, flight.sensor), *(accept(*item) for d in (0, 1) for item in frame_items(flight, d))]
    driven = drive(Compression(Compression.settings(**SMALL)), script)
    first_ns = key_of(flight, 0).stamp_ns
    driven.do(nothing_before(ODOMETRY, first_ns + 1))
    assert driven.lost() == {"odometry gap": 8}
    for dwell in (0, 1):
        for port, item in odometry_items(flight, dwell):
            if item.stamp_ns > first_ns:
                driven.do(accept(port, item))
    assert [one.item.key.number for one in driven.made] == [1]


def test_time_does_not_give_up_a_dwell_where_the_source_announces() -> None:
    driven = waiting_for_odometry(timeout_s=0.1)
    driven.do(nothing_before(ODOMETRY, START_NS))
    for second in range(100):
        driven.do(advance(float(second), busy=False))
    assert not driven.losses


def without_air(driven: Driven) -> Driven:
    driven.deliver(odometry_items(small_flight(), 0)[-2:])
    assert not driven.made
    return driven


def test_a_dwell_waits_for_the_air_that_may_still_be_used() -> None:
    """A lidar needs no humidity: nobody has to say that there is none."""
    driven = without_air(waiting_for_odometry(air="topics", air_max_age_s=60.0))
    driven.do(nothing_before("air/humidity", FOREVER_NS))
    for port in ("air/pressure", "air/temperature"):
        driven.do(nothing_before(port, START_NS + 60 * SECOND))
    assert not driven.losses
    driven.deliver(air_items(START_NS + 60 * SECOND))
    assert len(driven.made) == 1


@pytest.mark.parametrize("port", ["air/pressure", "air/temperature"])
def test_a_dwell_is_given_up_once_a_quantity_of_the_air_cannot_arrive_in_time(port: str) -> None:
    driven = without_air(waiting_for_odometry(air="topics", air_max_age_s=60.0))
    driven.do(nothing_before(port, START_NS + 60 * SECOND + 1))
    assert driven.lost() == {"no air": 8}


def test_air_that_cannot_be_is_given_up_once_no_other_can_arrive() -> None:
    driven = without_air(waiting_for_odometry(air="topics"))
    driven.deliver(air_items(START_NS - 2 * SECOND, pascal=700.0))
    driven.do(nothing_before("air/pressure", START_NS + 61 * SECOND))
    assert not driven.losses  # another temperature may still arrive
    driven.do(nothing_before("air/temperature", START_NS + 61 * SECOND))
    assert driven.lost() == {"no air": 8}


def test_air_that_is_there_is_used_whatever_is_announced() -> None:
    driven = waiting_for_odometry(air="topics")
    for port in AIR_PARAMETERS:
        driven.do(nothing_before(port, FOREVER_NS))
    driven.do(accept("air/pressure", AirSample(START_NS, 65_000.0)))
    driven.do(accept("air/temperature", AirSample(START_NS, 265.65)))
    driven.deliver(odometry_items(small_flight(), 0)[-2:])
    assert len(driven.made) == 1


def test_a_dwell_waits_for_the_frame_of_its_sensor_until_no_transform_can_arrive() -> None:
    driven = waiting_for_odometry(mounting_from_tf=True)
    driven.deliver(odometry_items(small_flight(), 0)[-2:])
    driven.do(nothing_before(PHASE_HISTORY, FOREVER_NS))
    driven.do(nothing_before(ODOMETRY, FOREVER_NS))
    assert not driven.losses
    driven.do(nothing_before(TF_STATIC, FOREVER_NS))
    assert driven.lost() == {"no mounting": 8}
    assert_one_sentence(driven.losses[0].sentence, "where 'sensor' (sensor_info, mounting.frame_id) is in 'base_link'")


def test_a_transform_makes_a_job_of_the_dwell_that_waits_for_it() -> None:
    driven = waiting_for_odometry(mounting_from_tf=True)
    driven.deliver(odometry_items(small_flight(), 0)[-2:])
    driven.do(accept(TF_STATIC, transform("base_link", "sensor")))
    assert len(driven.made) == 1


# Stages after the compression.


@pytest.mark.parametrize("whole", [False, True], ids=["channels", "whole dwells"])
def test_images_wait_for_the_calibration_that_they_were_made_with(whole: bool) -> None:
    """Alike if they arrive channel by channel, or as whole dwells."""
    flight = small_flight()
    calibration = calibration_of(flight.sensor)
    made = Compression(Compression.settings(**SMALL, calibration="topic"))
    script = [accept(*stated(calibration)), accept(SENSOR_INFO, flight.sensor)]
    for dwell in (0, 1):
        script += [accept(*item) for item in (*odometry_items(flight, dwell), *frame_items(flight, dwell))]
    images = [one.item for one in drive(made, script).made]
    assert {one.provenance.calibration_id for one in images} == {calibration.id}

    def driven() -> Driven:
        script = [accept(SENSOR_INFO, flight.sensor)]
        for one in images:
            script += [accept(SLC, item) for item in ([one] if whole else one.channels())]
        return drive(ml_stage(), script)

    served = driven()
    assert (served.made, served.losses) == ([], [])
    served.do(accept(*stated(calibration)))
    assert [one.item.key.number for one in served.made] == [0, 1]

    unserved = driven()
    unserved.do(nothing_before(SLC, FOREVER_NS))
    assert not unserved.losses
    unserved.do(nothing_before(CALIBRATION, FOREVER_NS))
    assert unserved.lost() == {"no calibration": 16}
    assert_one_sentence(unserved.losses[0].sentence, f"made with calibration '{calibration.id}'")


@pytest.mark.parametrize("whole", [False, True], ids=["channels", "whole dwells"])
def test_images_wait_for_the_description_of_their_sensor(whole: bool) -> None:
    flight = small_flight()
    images = images_in(flight, **SMALL)[0]
    script = [accept(SLC, item) for item in ([images] if whole else images.channels())]
    served = drive(ml_stage(), [*script, accept(SENSOR_INFO, flight.sensor)])
    assert len(served.made) == 1
    unserved = drive(ml_stage(), [*script, finish])
    assert unserved.lost() == {"no sensor info": 8}


@pytest.mark.parametrize("again", [False, True])
def test_images_that_arrive_twice_are_used_once(again: bool) -> None:
    """As whole dwells; a description that arrives again is that of a sensor that starts again."""
    flight = small_flight()
    images, described = images_in(flight, **SMALL)[0], accept(SENSOR_INFO, flight.sensor)
    repeated = [described] if again else []
    script = [described, accept(SLC, images), *repeated, accept(SLC, images)]
    driven = drive(ml_stage(), script)
    assert (len(driven.made), driven.lost()) == ((2, {}) if again else (1, {"late": 8}))


def test_images_of_too_few_channels_are_refused() -> None:
    flight = small_flight()
    images = images_in(flight, **SMALL)[0]
    few = type(images).joined(images.channels()[:7])
    driven = drive(ml_stage(), [accept(SENSOR_INFO, flight.sensor), accept(SLC, few)])
    assert driven.lost() == {"wrong size": 7}
    assert_one_sentence(driven.losses[0].sentence, "there are 7 channels; SensorInfo has 8")


def waiting_heights() -> Driven:
    """Heights of a dwell whose odometry ends before it."""
    flight = small_flight()
    script = [accept(SENSOR_INFO, flight.sensor)]
    script += [accept(*item) for item in odometry_items(flight, 0)[:-2]]
    return drive(
        HeightAdjuster(HeightAdjuster.settings()), [*script, accept("ml/height", heights_in(flight, **SMALL)[0])]
    )


def test_heights_are_adjusted_as_soon_as_odometry_covers_their_dwell() -> None:
    driven = waiting_heights()
    port, state = odometry_items(small_flight(), 0)[-1]
    driven.do(nothing_before(ODOMETRY, state.stamp_ns))
    assert (driven.made, driven.losses) == ([], [])
    driven.do(accept(port, at(state, 0)))
    assert "adjusted/height" in {one.port for one in driven.made}


def test_heights_are_given_up_once_no_odometry_can_arrive() -> None:
    driven = waiting_heights()
    driven.do(nothing_before("ml/height", FOREVER_NS))
    assert not driven.losses
    driven.do(nothing_before(ODOMETRY, FOREVER_NS))
    assert [(type(one), one.reason) for one in driven.losses] == [(Loss, "odometry gap")]


def test_a_gate_takes_whole_dwells_of_no_kind() -> None:
    """A stage that declares none takes every item for a message of a channel."""
    gated = Gated()
    gated.describe()
    assert not Gate.whole_kind
    gated.do(accept(FRAMES, Message(gated.key(0), 0)))
    assert gated.waiting == 1
    assert gated.stage._sensors.get(SENSOR.config_hash) is SENSOR
