"""Two sensors that interleave: each gives what it gives alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import chain, zip_longest
from typing import Any

import pytest
from driven import accept, drive, finish
from flown_items import (
    SMALL,
    STRIP,
    Item,
    flight_items,
    heights_in,
    image_items,
    ml_stage,
    noise_strip,
    odometry_items,
    other_sensor,
    small_flight,
)
from same_items import difference
from stage_cases import calibration_of, stated

from sal_height.engine.adjuster import HeightAdjuster
from sal_height.engine.calibrator import PsfCalibration
from sal_height.engine.compression import Compression
from sal_height.engine.dwells import SENSORS_KEPT
from sal_height.engine.movers import MoverDetection
from sal_height.engine.results import Product
from sal_height.engine.stage import Stage
from sal_height.engine.tracker import Tracker
from sal_height.simulation import SimulatedFlight
from sal_height.topics import ODOMETRY, SENSOR_INFO

DWELLS = 4


def second(flight: SimulatedFlight, name: str = "second") -> SimulatedFlight:
    """The flight of another sensor with the same beams, over the same ground at the same time."""
    return replace(flight, sensor=other_sensor(flight.sensor, name))


def interleaved(*streams: Sequence[Item]) -> list[Item]:
    """The items of several streams in turn."""
    return [item for item in chain.from_iterable(zip_longest(*streams)) if item is not None]


def sensor_of(item: Any) -> str:
    """The sensor that a product is of; empty: of no one."""
    if hasattr(item, "calibration"):
        return str(item.calibration.config_hash)
    return str(item.key.sensor) if hasattr(item, "key") else ""


def products_of(stage: Stage, items: Sequence[Item], sensor: str) -> list[Product]:
    """The products of a sensor, whose place in the order of processing is left out."""
    driven = drive(stage, [*(accept(*item) for item in items), finish])
    assert not [one for one in driven.losses if one.dwell and one.dwell.sensor == sensor]
    return [
        replace(one, item=replace(one.item, order=0)) if hasattr(one.item, "order") else one
        for one in driven.made
        if sensor_of(one.item) == sensor
    ]


def heights_with_odometry(flight: SimulatedFlight) -> list[Item]:
    """Heights of every dwell, and odometry well ahead of them."""
    odometry = [item for dwell in range(flight.dwells) for item in odometry_items(flight, dwell)]
    return [(SENSOR_INFO, flight.sensor), *odometry, *(("ml/height", one) for one in heights_in(flight, **SMALL))]


def unweighted(flight: SimulatedFlight) -> list[Item]:
    return image_items(flight, whole=False, range_window="rectangular", **SMALL)


CASES: dict[str, tuple[Callable[[], Stage], Callable[[SimulatedFlight], list[Item]], SimulatedFlight, int]] = {
    "spotlight": (lambda: Compression(Compression.settings(**SMALL)), flight_items, small_flight(DWELLS), DWELLS),
    "strips": (lambda: Compression(Compression.settings(**STRIP)), flight_items, noise_strip(), 4),
    "heights": (
        ml_stage,
        lambda flight: image_items(flight, whole=False, **SMALL),
        small_flight(DWELLS),
        DWELLS,
    ),
    "tracker": (
        lambda: Tracker(Tracker.settings()),
        lambda flight: [("ml/height", one) for one in heights_in(flight, **SMALL)],
        small_flight(DWELLS),
        DWELLS,
    ),
    "adjuster": (
        lambda: HeightAdjuster(HeightAdjuster.settings()),
        heights_with_odometry,
        small_flight(DWELLS),
        DWELLS,
    ),
    "movers": (
        lambda: MoverDetection(MoverDetection.settings()),
        lambda flight: image_items(flight, whole=False, rows=20, cols=48),
        small_flight(DWELLS),
        DWELLS,
    ),
    "calibrator": (
        lambda: PsfCalibration(PsfCalibration.settings(dwells=2, dwell_step=2)),
        unweighted,
        small_flight(DWELLS),
        1,
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_each_gives_what_it_gives_alone(case: str) -> None:
    """One item of a sensor after one of the other."""
    make, items, flight, count = CASES[case]
    flights = flight, second(flight)
    together = interleaved(*map(items, flights))
    for one in flights:
        alone = products_of(make(), items(one), one.sensor.config_hash)
        assert len(alone) == count
        assert not difference(alone, products_of(make(), together, one.sensor.config_hash))


def test_each_has_its_own_calibration() -> None:
    flights = small_flight(DWELLS), second(small_flight(DWELLS))
    calibrations = [calibration_of(one.sensor, gain) for one, gain in zip(flights, (1.1, 1.2), strict=True)]
    items = [*map(stated, calibrations), *interleaved(*map(flight_items, flights))]
    stage = Compression(Compression.settings(**SMALL, calibration="topic"))
    for flight, calibration in zip(flights, calibrations, strict=True):
        made = products_of(stage, items, flight.sensor.config_hash)
        assert {one.item.provenance.calibration_id for one in made} == {calibration.id}
        stage = Compression(Compression.settings(**SMALL, calibration="topic"))


def test_a_strip_goes_on_after_a_spotlight_dwell() -> None:
    """Of a sensor that is elsewhere, and so loses its dwells."""
    strip, spotlight = noise_strip(), small_flight(DWELLS)
    others = [item for item in flight_items(spotlight) if item[0] != ODOMETRY]
    alone, together = (
        products_of(Compression(Compression.settings(**STRIP)), items, strip.sensor.config_hash)
        for items in (flight_items(strip), interleaved(flight_items(strip), others))
    )
    assert not difference(alone, together)


def test_no_more_sensors_are_kept_on_the_heavy_side_than_are_described() -> None:
    """Of one more than that the first starts again; movers of the one that goes are published, not lost."""
    flights = [second(small_flight(3), f"sensor {number}") for number in range(SENSORS_KEPT + 1)]
    movers = MoverDetection(MoverDetection.settings())
    items = [image_items(flight, whole=True, rows=20, cols=48) for flight in flights]
    driven = drive(movers, [accept(*item) for item in chain.from_iterable(items)])
    assert {one.item.key.sensor for one in driven.made} == {flights[0].sensor.config_hash}
    assert len(driven.made) == 3
    assert len(movers._dwells.values()) == SENSORS_KEPT
    driven.do(finish)
    assert len(driven.made) == 3 * len(flights)
    assert movers.unpublished == 0


def test_images_of_another_sensor_are_not_estimated_together() -> None:
    flights = small_flight(DWELLS), second(small_flight(DWELLS))
    items = interleaved(*(image_items(flight, whole=True, **SMALL) for flight in flights))
    together, alone = (drive(ml_stage(), [accept(*item) for item in items], group=group) for group in (8, 1))
    assert len(alone.made) == 2 * DWELLS
    assert not difference(alone.made, together.made)
