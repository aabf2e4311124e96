"""Calibrations on trial: adopted by the first dwell that tests them, or refused before any image has them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from driven import Driven, Step, accept, drive, scheduled_before
from flown_items import (
    EXACT_ODOMETRY,
    START_NS,
    STRIP,
    Item,
    flight_items,
    frame_items,
    images_in,
    key_of,
    noise_strip,
    odometry_items,
    small_flight,
)
from helpers import assert_one_sentence
from stage_cases import calibration_of, stated

from sal_height.calibration import Calibration
from sal_height.engine.calibrations import (
    CALIBRATION_REFUSED,
    CALIBRATIONS_ADOPTED,
    ChosenCalibrations,
)
from sal_height.engine.compression import Compression
from sal_height.engine.image_items import Images
from sal_height.engine.results import Event
from sal_height.sensor import Sensor
from sal_height.simulation import SimulatedFlight, flight_of, load_preset
from sal_height.topics import CALIBRATION, SENSOR_INFO

IMAGE: dict[str, Any] = {"rows": 46, "cols": 12, "air": "none", **EXACT_ODOMETRY}


@pytest.fixture(scope="module")
def flight() -> SimulatedFlight:
    return small_flight(3)


def of_gains(sensor: Sensor, gains_db: Sequence[float]) -> Calibration:
    response = np.repeat(10 ** (np.array(gains_db)[:, None] / 20), sensor.sample_count, axis=1).astype(complex)
    return calibration_of(sensor, response=response)


def right(flight: SimulatedFlight) -> Calibration:
    """That of a sensor that is as described, but for its measured errors."""
    return of_gains(flight.sensor, (0.05 * np.random.default_rng(1).standard_normal(8)).tolist())


def foreign(flight: SimulatedFlight, seed: int = 5) -> Calibration:
    """That of another instrument."""
    return of_gains(flight.sensor, (3.0 * np.random.default_rng(seed).standard_normal(8)).tolist())


def compressed(
    flight: SimulatedFlight, first: Iterable[Item], *, script: Sequence[Step] = (), **options: Any
) -> Driven:
    """A compression that has received calibrations before a flight."""
    steps = [*script, *(accept(*item) for item in (*first, *flight_items(flight)))]
    settings = Compression.settings(**IMAGE, calibration="topic")
    return drive(Compression(settings), steps, worker=Compression(settings), pickled=True, **options)


def applied(driven: Driven) -> list[str]:
    """Calibrations of the images."""
    return [one.item.provenance.calibration_id for one in driven.made if isinstance(one.item, Images)]


def adopted(driven: Driven) -> int:
    return sum(isinstance(one, Event) and one.name == CALIBRATIONS_ADOPTED for one in driven.all_results())


@pytest.mark.parametrize("deferred", [False, True])
def test_one_of_another_instrument_is_in_no_image(flight: SimulatedFlight, deferred: bool) -> None:
    """The images are those without it, to the bit, whether the stage learns of it before the next dwell or not."""
    calibration = foreign(flight)
    driven = compressed(flight, [stated(calibration)], deferred=deferred)
    assert applied(driven) == [""] * 3
    for one, plain in zip(driven.made, images_in(flight, **IMAGE), strict=True):
        np.testing.assert_array_equal(one.item.slc.images, plain.slc.images)
        np.testing.assert_array_equal(one.item.slc.noise_power, plain.slc.noise_power)
    assert driven.warned() == {CALIBRATION_REFUSED: 1}
    (notice,) = driven.notices
    assert notice.dwell is None, "a calibration could not be used; the dwell is as good as without"
    parts = (
        f"Dwell 0: Calibration {calibration.id} is refused: with it the gains of the channels",
        "description of the sensor",
    )
    assert_one_sentence(notice.sentence, *parts)


@pytest.mark.parametrize("deferred", [False, True])
def test_one_that_is_right_is_adopted_from_the_first_dwell_on(flight: SimulatedFlight, deferred: bool) -> None:
    calibration = right(flight)
    driven = compressed(flight, [stated(calibration)], deferred=deferred)
    assert applied(driven) == [calibration.id] * 3
    assert (adopted(driven), driven.warned()) == (1, {})


def test_dwells_follow_each_other_until_one_has_decided(flight: SimulatedFlight) -> None:
    """So that copies of the stage, side by side, apply the same; the others are independent of each other."""
    driven = compressed(flight, [stated(right(flight))])
    assert [job.series for job in driven.jobs if job.dwell] == ["sar_compression trial", None, None]
    late = compressed(flight, [stated(right(flight))], deferred=True)
    assert [job.series for job in late.jobs if job.dwell] == ["sar_compression trial"] * 3


def test_the_one_in_use_stays_where_the_next_is_refused(flight: SimulatedFlight) -> None:
    first, second = right(flight), foreign(flight)
    change = scheduled_before(key_of(flight, 1), *stated(second))
    driven = compressed(flight, [stated(first)], script=[change])
    assert applied(driven) == [first.id] * 3
    assert driven.warned() == {CALIBRATION_REFUSED: 1}
    assert f"with calibration {first.id} by" in driven.notices[0].sentence


def test_where_the_one_in_use_is_wrong_too_the_next_is_adopted(flight: SimulatedFlight) -> None:
    """Nothing says which is worse; heights have their doubts. The first one has replaced a worse description."""
    wrong = [foreign(flight, seed) for seed in (5, 6)]
    stage = Compression(Compression.settings(**IMAGE, calibration="topic"))
    choice = stage._received
    choice.receive(wrong[0])
    choice.follow(choice.of(flight.sensor), [Event(CALIBRATIONS_ADOPTED)])
    driven = drive(stage, [accept(*stated(wrong[1])), *(accept(*item) for item in flight_items(flight))])
    assert applied(driven) == [wrong[1].id] * 3
    assert driven.warned() == {}


def test_one_that_is_published_again_is_not_tried_again(flight: SimulatedFlight) -> None:
    calibration = right(flight)
    again = scheduled_before(key_of(flight, 2), *stated(calibration))
    driven = compressed(flight, [stated(calibration)], script=[again])
    assert [job.series for job in driven.jobs if job.dwell] == ["sar_compression trial", None, None]
    assert (applied(driven), adopted(driven)) == ([calibration.id] * 3, 1)


def test_one_that_was_refused_is_tried_again_if_it_is_published_again(flight: SimulatedFlight) -> None:
    calibration = foreign(flight)
    again = scheduled_before(key_of(flight, 2), *stated(calibration))
    assert compressed(flight, [stated(calibration)], script=[again]).warned() == {CALIBRATION_REFUSED: 2}


def test_strips_go_on_as_without_one_that_is_refused() -> None:
    """Their first image decides, to which several blocks contribute."""
    strip = flight_of(replace(load_preset("sal_stripmap"), dwells=4), 3)
    calibration, image = foreign(strip), {**IMAGE, "cols": 128}
    items = flight_items(strip)
    made = {}
    for name, first in (("plain", []), ("foreign", [stated(calibration)]), ("right", [stated(right(strip))])):
        stage = Compression(Compression.settings(**image, calibration="topic"))
        made[name] = drive(stage, [accept(*item) for item in (*first, *items)])
    assert made["foreign"].warned() - made["plain"].warned() == {CALIBRATION_REFUSED: 1}
    assert applied(made["foreign"]) == [""] * 2
    assert applied(made["right"]) == [right(strip).id] * 2
    for one, plain in zip(made["foreign"].made, made["plain"].made, strict=True):
        np.testing.assert_array_equal(one.item.slc.images, plain.item.slc.images)


@pytest.mark.parametrize(("cols", "before"), [(256, 3), (128, 4)])
def test_a_strip_has_no_seam_where_a_calibration_arrives_amid_it(cols: int, before: int) -> None:
    """The strip without it goes on until that with it has an image, which completes at other blocks than the former."""
    strip = flight_of(replace(load_preset("sal_stripmap"), dwells=7), 3)
    image: dict[str, Any] = {**IMAGE, "cols": cols}
    items = [accept(*item) for item in flight_items(strip)]

    def made(first: Sequence[Step] = ()) -> Driven:
        return drive(Compression(Compression.settings(**image, calibration="topic")), [*first, *items])

    plain = made()
    refused = made([scheduled_before(key_of(strip, before), *stated(foreign(strip)))])
    assert (refused.lost(), applied(refused)) == ({}, [""] * len(plain.made))
    for one, other in zip(refused.made, plain.made, strict=True):
        np.testing.assert_array_equal(one.item.slc.images, other.item.slc.images)
    adopted_one = made([scheduled_before(key_of(strip, before), *stated(right(strip)))])
    along = [(float(one.item.slc.grid.origin[0]), one.item.slc.grid.cols) for one in adopted_one.made]
    spacing = adopted_one.made[0].item.slc.grid.col_spacing
    for (start, number), (next_start, _) in pairwise(along):
        assert next_start <= start + (number + 0.5) * spacing, "columns are missing"
    assert applied(adopted_one)[-1] == right(strip).id
    assert adopted_one.warned() == plain.warned()


def test_as_many_strips_as_without_trials_are_kept_at_once() -> None:
    """Of noise, so that all calibrations stay on trial; blocks of the sensors take turns."""
    strips = [noise_strip(4, name=name) for name in "abcd"]
    settings: dict[str, Any] = {**STRIP, "calibration": "topic"}
    stage = Compression(Compression.settings(**settings))
    items: list[Item] = [item for strip in strips for item in ((SENSOR_INFO, strip.sensor), stated(right(strip)))]
    items += [item for dwell in range(4) for strip in strips for item in frame_items(strip, dwell)]
    driven = drive(
        stage,
        [
            accept(*item)
            for item in (*(item for dwell in range(4) for item in odometry_items(strips[0], dwell)), *items)
        ],
    )
    assert Counter(applied(driven)) == {right(strip).id: 2 for strip in strips}


@pytest.mark.parametrize("deferred", [False, True])
def test_one_that_follows_at_once_is_compared_with_what_the_former_trial_has_adopted(
    flight: SimulatedFlight, deferred: bool
) -> None:
    """Whether the stage has learnt of the outcome of the first trial or not."""
    first, second = right(flight), foreign(flight)
    change = scheduled_before(key_of(flight, 1), *stated(second))
    driven = compressed(flight, [stated(first)], script=[change], deferred=deferred)
    assert applied(driven) == [first.id] * 3
    assert driven.warned() == {CALIBRATION_REFUSED: 1}
    assert f"with calibration {first.id} by" in driven.notices[0].sentence
    assert isinstance(driven.stage, Compression)
    in_use = driven.stage._received.of(flight.sensor).in_use
    assert in_use is not None
    assert in_use.id == first.id


def test_the_one_in_use_is_tried_again_where_another_one_may_have_been_adopted(flight: SimulatedFlight) -> None:
    """Whether the outcome of the other trial is known yet depends on the machine, and must not decide."""
    choice = ChosenCalibrations()
    first, second = right(flight), foreign(flight)
    choice.receive(first)
    choice.follow(choice.of(flight.sensor), [Event(CALIBRATIONS_ADOPTED)])
    choice.receive(second)
    on_trial = choice.of(flight.sensor)
    choice.receive(first)
    again = choice.of(flight.sensor)
    assert (again.on_trial, again.first_open) == (first, on_trial.trial)
    choice.follow(on_trial, [Event(CALIBRATIONS_ADOPTED)])
    assert choice.of(flight.sensor) == again._replace(in_use=second)


def test_no_two_trials_have_one_number(flight: SimulatedFlight) -> None:
    """Also if a sensor has been forgotten meanwhile, for more sensors are calibrated than are kept."""
    choice, numbers = ChosenCalibrations(), set()
    sensors = [flight.sensor, *(replace(flight.sensor, name=name, config_hash="") for name in "abcd")]
    for sensor in (*sensors, flight.sensor):
        choice.receive(of_gains(sensor, [0.1] * 8))
        numbers.add(choice.of(sensor).trial)
    assert len(numbers) == 6


def test_one_of_a_file_is_tried_as_well(flight: SimulatedFlight) -> None:
    calibration = foreign(flight)
    settings = Compression.settings(**IMAGE, calibration="any.npz")
    script: list[Step] = [lambda stage: stage.start(START_NS), *(accept(*item) for item in flight_items(flight))]
    driven = drive(Compression(settings, {CALIBRATION: calibration}), script)
    assert applied(driven) == [""] * 3
    assert driven.warned() == {CALIBRATION_REFUSED: 1}
