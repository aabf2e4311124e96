"""The compression: orders in which frames and odometry may arrive, clocks that step, time-outs, the air of dwells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby
from typing import Any

import numpy as np
import pytest
from driven import Driven, Step, accept, advance, drive, finish, nothing_before
from flown_items import (
    SMALL,
    START_NS,
    STRIP,
    Item,
    at,
    flight_items,
    frame_items,
    noise_strip,
    odometry_items,
    samples_of,
    small_flight,
)
from helpers import assert_one_sentence
from same_items import are_same, difference
from stage_cases import air_items

from sal_height.engine.compression import Compression
from sal_height.engine.frame_items import Frame, history_of, samples_in_line
from sal_height.engine.image_items import Images
from sal_height.engine.results import Event
from sal_height.engine.stage import FOREVER_NS, Stage
from sal_height.engine.track import Arrival
from sal_height.geometry import height_of
from sal_height.topics import ODOMETRY, PHASE_HISTORY, SENSOR_INFO

SECOND = 1_000_000_000
DWELLS = 3
DETECTORS = 8


def compressed(items: Sequence[Item], **settings: Any) -> Driven:
    stage = Compression(Compression.settings(**{**SMALL, **settings}))
    return drive(stage, [accept(*item) for item in items])


def flown(**settings: Any) -> list[Images]:
    """The images of a flight when all arrives in order."""
    return [one.item for one in compressed(flight_items(small_flight(), dwells=range(DWELLS)), **settings).made]


def sorted_images(driven: Driven) -> list[Images]:
    """The images in the order of their stamps, with the places in the order of processing of a flight in order."""
    images = sorted((one.item for one in driven.made), key=lambda one: one.key.stamp_ns)
    return [replace(one, order=number) for number, one in enumerate(images)]


def frames(dwells: Sequence[int] = range(DWELLS)) -> list[Item]:
    return [item for dwell in dwells for item in frame_items(small_flight(), dwell)]


def odometry(dwells: Sequence[int] = range(DWELLS)) -> list[Item]:
    return [item for dwell in dwells for item in odometry_items(small_flight(), dwell)]


def sensor() -> list[Item]:
    return [(SENSOR_INFO, small_flight().sensor)]


def reordered(items: Sequence[Item]) -> list[Item]:
    """Every two neighbours in turn."""
    return [items[number ^ 1] for number in range(len(items) // 2 * 2)] + list(items[len(items) // 2 * 2 :])


ORDERS = {
    "frames before odometry": lambda: [*sensor(), *frames(), *odometry()],
    "odometry before frames": lambda: [*sensor(), *odometry(), *frames()],
    "the sensor last": lambda: [*frames(), *odometry(), *sensor()],
    "dwells backwards": lambda: [*sensor(), *frames()[::-1], *odometry()],
    "channels in turn": lambda: [
        *sensor(),
        *odometry(),
        *(one for c in range(DETECTORS) for one in frames()[c::DETECTORS]),
    ],
    "odometry twice": lambda: [*sensor(), *odometry(), *odometry(), *frames()],
    "odometry out of order": lambda: [*sensor(), *reordered(odometry()), *frames()],
    "frames and odometry in turn": lambda: [
        *sensor(),
        *(one for pair in zip(odometry(), frames(), strict=False) for one in pair),
        *frames()[len(odometry()) :],
        *odometry()[len(frames()) :],
    ],
}


@pytest.mark.parametrize("order", ORDERS)
def test_images_are_the_same_in_whatever_order_frames_and_odometry_arrive(order: str) -> None:
    driven = compressed(ORDERS[order]())
    assert not driven.losses
    assert not difference(flown(), sorted_images(driven))


def together(items: Sequence[Item]) -> list[Step]:
    """Items that arrive, and of the odometry all that nothing else arrives between, together."""
    steps: list[Step] = []
    for port, group in groupby(items, key=lambda item: item[0]):
        found = [item for _, item in group]
        if port == ODOMETRY:
            steps.append(lambda stage, states=found: stage.accept_odometry(samples_of(states), 0.0))  # type: ignore[misc]
        else:
            steps += [accept(port, item) for item in found]
    return steps


@pytest.mark.parametrize("order", ORDERS)
def test_odometry_that_is_accepted_together_decides_what_it_does_one_by_one(order: str) -> None:
    one_by_one, stage = compressed(ORDERS[order]()), Compression(Compression.settings(**SMALL))
    driven = drive(stage, together(ORDERS[order]()))
    assert not difference(sorted_images(one_by_one), sorted_images(driven))
    assert driven.decided == one_by_one.decided


def test_odometry_is_awaited_from_the_frames_of_a_dwell_until_it_has_arrived() -> None:
    stage = compressed([*sensor(), *odometry([0])[:1]]).stage
    assert isinstance(stage, Compression)
    assert not stage.awaits_odometry
    for item in frames([0]):
        stage.accept(*item)
    assert stage.awaits_odometry
    stage.accept_odometry(samples_of([state for _, state in odometry([0])[1:]]), 0.0)
    assert not stage.awaits_odometry


def test_odometry_is_not_awaited_for_a_dwell_that_was_dropped() -> None:
    """Its host would look for it hundreds of times a second, for ever."""
    driven = compressed([*sensor(), *frames([0])], timeout_s=0.5)
    driven.play(advance(0.1 * moment) for moment in range(20))
    assert driven.lost() == {"odometry gap": DETECTORS}
    assert isinstance(driven.stage, Compression)
    assert not driven.stage.awaits_odometry
    driven.deliver(frames([1]))
    driven.do(advance(2.0))
    assert driven.stage.awaits_odometry


def test_frames_that_arrive_twice_are_counted_and_change_nothing() -> None:
    """A frame of a dwell that still waits is a duplicate, one of a dwell that is done is late."""
    items = [*sensor(), *odometry([0]), *(one for item in frames([0]) for one in (item, item))]
    driven = compressed(items)
    assert driven.lost() == {"duplicate": DETECTORS - 1, "late": 1}
    assert not difference(flown()[:1], sorted_images(driven))


def test_a_frame_that_is_late_costs_its_dwell_once_that_was_given_up_and_nothing_else() -> None:
    *others, late = frames([0])
    driven = compressed([*sensor(), *odometry(), *others, *frames([1])], timeout_s=1.0)
    for second in range(10):
        driven.do(advance(second / 5, busy=False))
    assert driven.lost() == {"incomplete dwell": DETECTORS - 1}
    driven.do(accept(*late))
    assert driven.lost() == {"incomplete dwell": DETECTORS - 1, "late": 1}
    assert are_same(driven.made[0].item.slc, flown()[1].slc)


def test_odometry_that_never_arrives_costs_dwells_after_a_wait() -> None:
    driven = compressed([*sensor(), *frames([0])], timeout_s=1.0)
    for step in range(7):
        driven.do(advance(step * 0.2, busy=False))
        assert bool(driven.losses) == (step > 5)
    assert driven.lost() == {"odometry gap": DETECTORS}
    assert_one_sentence(driven.losses[0].sentence, "Dwell 0", "no sample was received (is its QoS compatible?)")


@pytest.mark.parametrize("is_together", [False, True])
def test_a_dwell_does_not_time_out_while_its_odometry_is_on_the_way(is_together: bool) -> None:
    driven = compressed([*sensor(), *frames([0])], timeout_s=0.5)
    for number, item in enumerate(odometry([0])[:-1]):
        assert not driven.made
        for tick in range(2):
            driven.do(advance(0.4 * number + 0.2 * tick, busy=False))
        driven.play(together([item]) if is_together else [accept(*item, 0.4 * number + 0.2)])
    assert len(driven.made) == 1


def test_odometry_that_goes_on_after_a_gap_does_not_keep_a_dwell_waiting() -> None:
    """What arrives is later than all that the dwell needs."""
    driven = compressed([*sensor(), *frames([0])], timeout_s=0.5)
    _, last = odometry([0])[-1]
    for number in range(4):
        driven.do(accept(ODOMETRY, at(last, SECOND + 5_000_000 * number), 0.2 * number))
        driven.do(advance(0.2 * number, busy=False))
    assert driven.lost() == {"odometry gap": DETECTORS}
    assert_one_sentence(driven.losses[0].sentence, "samples are kept from 1.0", "s after its first pulse")


def test_odometry_of_another_clock_is_named() -> None:
    other = [(ODOMETRY, at(state, -START_NS)) for _, state in odometry()]
    driven = drive(compressed([*sensor(), *other, *frames([0])]).stage, [finish])
    assert_one_sentence(driven.losses[0].sentence, "frames and odometry have different clocks")


def test_a_gap_in_the_odometry_is_bridged_and_counted_or_refused() -> None:
    states = [odometry([0])[number] for number in (0, 1, -1)]
    bridged = compressed([*sensor(), *states, *frames([0])], odometry_interval_s=0.001)
    assert Event("odometry.bridged") in bridged.decided
    assert np.trace(bridged.made[0].item.slc.aperture.covariance) > 0
    refused = compressed([*sensor(), *states, *frames([0])], max_odometry_gap_s=0.001)
    refused.do(finish)
    assert refused.lost() == {"odometry gap": DETECTORS}


# Clocks.


@pytest.mark.parametrize("later_s", [-3600, -10, 3600])
def test_a_clock_that_starts_again_is_a_new_start(later_s: int) -> None:
    """The same flight at another time, without a word: the images are the same, and nothing is lost."""
    start_ns = START_NS + later_s * SECOND
    driven = compressed(flight_items(small_flight(), dwells=range(DWELLS)))
    driven.deliver(flight_items(small_flight(), start_ns, range(DWELLS))[1:])
    assert not driven.losses
    assert driven.warned() == ({"odometry out of time": 1})
    assert Event("odometry.restarted") in driven.decided
    first, again = (driven.made[number : number + DWELLS] for number in (0, DWELLS))
    for one, other in zip(first, again, strict=True):
        moved = replace(other.item, key=one.item.key, order=one.item.order, source=one.item.source)
        assert not difference(one.item, moved)


def test_announcements_of_before_a_clock_started_again_give_up_nothing_of_after_it() -> None:
    driven = compressed(flight_items(small_flight(), dwells=range(DWELLS)))
    for port in (ODOMETRY, PHASE_HISTORY):
        driven.do(nothing_before(port, START_NS + SECOND))
    start_ns = START_NS - 10 * SECOND
    for port in (ODOMETRY, PHASE_HISTORY):
        driven.do(nothing_before(port, start_ns - SECOND))
    for item in flight_items(small_flight(), start_ns, range(DWELLS))[1:]:
        driven.do(accept(*item))
        driven.do(nothing_before(PHASE_HISTORY, start_ns - SECOND))
    assert not driven.losses
    assert len(driven.made) == 2 * DWELLS


def test_one_wrong_stamp_costs_nothing() -> None:
    items = [
        *sensor(),
        *odometry([0]),
        (ODOMETRY, at(odometry([0])[0][1], -SECOND * 1000)),
        *odometry([1, 2]),
        *frames(),
    ]
    driven = compressed(items)
    assert driven.warned() == {"odometry out of time": 1}
    assert_one_sentence(driven.notices[0].sentence, "s after the latest one", "if the next sample continues it")
    assert not difference(flown(), sorted_images(driven))


def test_known_fault_a_clock_that_steps_back_by_less_than_a_second_costs_the_dwells_around_the_step() -> None:
    """Odometry of after the step is sorted among that of before it, and the track that results jumps to and fro.

    Dwells after the step should be imaged as if the source had started again.
    """
    back_ns = 20_000_000
    driven = compressed(flight_items(small_flight(), dwells=range(DWELLS)))
    later_ns = START_NS + small_flight().dwell_start_ns(DWELLS) - back_ns
    driven.deliver(flight_items(small_flight(), later_ns, range(DWELLS))[1:])
    arrivals = {one.name.removeprefix("odometry.") for one in driven.decided if isinstance(one, Event)}
    assert Arrival.REORDERED.value in arrivals
    assert Arrival.RESTARTED.value not in arrivals
    assert driven.lost() == {"cannot be processed": 2 * DETECTORS}
    assert_one_sentence(driven.losses[0].sentence, "twist must be the velocity")
    assert [one.dwell.number for one in driven.losses] == [0, 1]
    assert len(driven.made) == 2 * DWELLS - 2


# Strips.


def blocks() -> list[Item]:
    return flight_items(noise_strip())


def strip_images(driven: Driven) -> list[Images]:
    return [one.item for one in driven.made]


def test_samples_lie_where_those_of_the_dwell_before_lay_and_no_image_changes() -> None:
    """As messages have them, those of each channel lie somewhere else."""
    stage = Compression(Compression.settings(**SMALL))
    driven = drive(stage, [accept(*item) for item in scattered(flight_items(small_flight(), dwells=[0, 1]))])
    (before,) = stage._spare
    driven.deliver(scattered(flight_items(small_flight(), dwells=[2])[1:]))
    (after,) = stage._spare
    assert after is before
    assert np.array_equal(after, history_of([frame for _, frame in frames([2])]).samples)
    assert not any(np.shares_memory(after, one.item.slc.images) for one in driven.made)
    assert not difference(flown(), [one.item for one in driven.made])


def scattered(items: Sequence[Any]) -> list[Any]:
    """Items of a flight whose frames lie somewhere else each."""
    return [
        (port, item._replace(samples=item.samples.copy()) if isinstance(item, Frame) else item) for port, item in items
    ]


def test_samples_that_lie_in_line_are_not_copied_and_give_the_same_images() -> None:
    stage = Compression(Compression.settings(**SMALL))
    driven = drive(stage, [accept(*item) for item in flight_items(small_flight(), dwells=[0, 1, 2])])
    assert not stage._spare
    assert not difference(flown()[:3], [one.item for one in driven.made])


def test_samples_are_in_line_only_if_each_begins_where_the_one_before_ends() -> None:
    lying = [frame for _, frame in frames([0])]
    found = samples_in_line(lying)
    assert found is not None
    assert np.array_equal(found, history_of(lying).samples)
    assert not found.flags.writeable
    assert samples_in_line(lying[::-1]) is None
    assert samples_in_line([*lying[:-1], lying[-1]._replace(samples=lying[-1].samples.copy())]) is None
    assert samples_in_line([frame._replace(encoding="complex_int16") for frame in lying]) is None


def test_blocks_of_a_strip_are_in_one_series_and_spotlight_dwells_in_none() -> None:
    strip = compressed(blocks(), **STRIP)
    spotlight = compressed(flight_items(small_flight(), dwells=[0]))
    assert {job.series for job in strip.jobs if job.dwell} == {"sar_compression strip"}
    assert [job.series for job in spotlight.jobs if job.dwell] == [None]


def test_a_reset_starts_a_new_strip() -> None:
    items = blocks()
    driven = compressed(items, **STRIP)
    driven.do(Stage.reset)
    driven.deliver(items)
    half = len(driven.made) // 2
    assert half > 0
    for one, other in zip(strip_images(driven)[:half], strip_images(driven)[half:], strict=True):
        assert not difference(one, replace(other, order=one.order))


def test_a_block_that_is_lost_ends_a_strip_and_the_next_begins_one() -> None:
    """Of six blocks three make an image: without the third the last three do."""
    whole = compressed(blocks(), **STRIP)
    assert [one.key.number for one in strip_images(whole)] == [2, 3, 4, 5]
    gone = [item for item in blocks() if not (item[0] == PHASE_HISTORY and item[1].key.number == 2)]
    assert [one.key.number for one in strip_images(compressed(gone, **STRIP))] == [5]


def test_other_settings_begin_a_strip_and_a_shortfall_is_reported_once() -> None:
    driven = compressed(blocks(), **STRIP)
    assert driven.warned() == {"strip incomplete": 1}
    assert driven.notices[0].dwell == driven.jobs[1].dwell


# Air.


HEARD = {"air": "topics", "map_height_m": 120.0}


def used_air(images: Images) -> dict[str, float]:
    """The air of a dwell, as its provenance says."""
    beginning = "heard_air."
    stated = images.provenance.compression
    return {name.removeprefix(beginning): one for name, one in stated.items() if name.startswith(beginning)}


def test_images_are_those_of_the_same_numbers_as_settings() -> None:
    """Bit by bit, with a probe on the platform."""
    (heard,) = compressed([*air_items(START_NS - 2 * SECOND), *sensor(), *odometry([0]), *frames([0])], **HEARD).made
    before = [state for _, state in odometry([0]) if state.stamp_ns <= frames([0])[0][1].key.stamp_ns][-1]
    assert used_air(heard.item) == {
        "air_height_m": pytest.approx(120.0 + float(height_of(before.position)), abs=1e-6),
        "air_pressure_pa": 65_000.0,
        "air_temperature_k": 265.65,
    }
    numbers = {**used_air(heard.item), "air": "measured", "map_height_m": 120.0}
    (stated,) = compressed([*sensor(), *odometry([0]), *frames([0])], **numbers).made
    assert not difference(heard.item.slc, stated.item.slc)
    assert not are_same(heard.item.slc.images, flown()[0].slc.images), "air has an effect"
    said = heard.item.provenance.compression
    assert (said["air"], said["air_temperature_k"]) == ("topics", 288.15), "what was set stays as it was set"
    assert (heard.item.air_delay, flown()[0].air_delay) == ("removed", flown(air="none")[0].air_delay)


def test_each_dwell_has_the_air_of_its_own_time_however_early_that_of_the_next_arrives() -> None:
    first, second = (frame_items(small_flight(), dwell)[0][1].key.stamp_ns - SECOND for dwell in (0, 1))
    air = [*air_items(second, kelvin=264.15), *air_items(first, kelvin=265.15), *air_items(first - 1, kelvin=266.15)]
    driven = compressed([*air, *sensor(), *odometry(), *frames([0, 1])], **HEARD)
    assert [used_air(one.item)["air_temperature_k"] for one in driven.made] == [265.15, 264.15]


def test_a_dwell_becomes_a_job_with_the_first_air_that_arrives() -> None:
    driven = compressed([*sensor(), *odometry([0]), *frames([0])], **HEARD)
    pressure, temperature = air_items(START_NS + SECOND)
    driven.do(accept(*pressure))
    assert not driven.made
    driven.do(accept(*temperature))
    assert len(driven.made) == 1


def test_a_dwell_without_air_is_given_up_and_the_next_one_is_processed() -> None:
    driven = compressed([air_items(START_NS)[0], *sensor(), *odometry(), *frames([0])], **HEARD, timeout_s=0.5)
    for step in range(6):
        driven.do(advance(step * 0.2, busy=False))
    assert driven.lost() == {"no air": DETECTORS}
    assert_one_sentence(
        driven.losses[0].sentence, "Dwell 0", "nothing was received on air/temperature;", "set air to standard"
    )
    driven.deliver([*air_items(START_NS), *frames([1])])
    assert [one.item.key.number for one in driven.made] == [1]


def test_air_of_long_ago_is_not_used() -> None:
    driven = compressed([*air_items(START_NS - 90 * SECOND), *sensor(), *odometry(), *frames([0])], **HEARD)
    assert not driven.made
    driven.do(finish)
    assert driven.lost() == {"no air": DETECTORS}
    assert_one_sentence(
        driven.losses[0].sentence, "air/pressure is stamped", "s before its first pulse", "(air_max_age_s)"
    )


def test_air_that_arrived_before_it_was_asked_for_is_known() -> None:
    stage = Compression(Compression.settings(**{**SMALL, **HEARD, "air": "none"}))
    script: list[Step] = [
        accept(*item) for item in (*air_items(START_NS - 2 * SECOND), *sensor(), *odometry(), *frames([0]))
    ]
    driven = drive(stage, script)
    stage.change(stage._settings.changed(air="topics"))
    driven.deliver(frames([1]))
    assert [used_air(one.item).get("air_temperature_k") for one in driven.made] == [None, 265.65]


def test_a_reset_forgets_odometry_and_what_waits_for_it_but_not_the_air() -> None:
    driven = compressed([*air_items(START_NS - 2 * SECOND), *sensor(), *odometry(), *frames([0])], **HEARD)
    driven.do(Stage.reset)
    driven.deliver(frames([1]))
    assert len(driven.made) == 1
    driven.deliver(odometry())
    assert [one.item.key.number for one in driven.made] == [0, 1]
    driven.do(nothing_before(ODOMETRY, FOREVER_NS))
    assert not driven.losses
