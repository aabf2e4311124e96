"""A source that is started again with another sensor, an hour later or earlier, is followed; nothing else restarts."""

from __future__ import annotations

from dataclasses import replace

import pytest
from chained import Chained, reference
from flown_items import START_NS, flight_items, small_flight
from same_items import difference

from sal_height.engine.height_items import Heights
from sal_height.simulation import SimulatedFlight, flight_of, load_preset

HOUR_NS = 3_600_000_000_000
STRIP_DWELLS = 4
"""Blocks of which the last completes an image of the strip."""


def six_detectors() -> SimulatedFlight:
    preset = load_preset("small")
    return flight_of(replace(preset, sensor=replace(preset.sensor, detectors=6)), seed=8)


def strip() -> SimulatedFlight:
    return flight_of(replace(load_preset("sal_stripmap"), dwells=STRIP_DWELLS), seed=9)


OTHERS = {"fewer detectors": (six_detectors, 2), "another mode": (strip, STRIP_DWELLS)}
"""What makes the flight of another sensor, and how many of its dwells arrive."""


def last_heights(chained: Chained, flight: SimulatedFlight, dwells: int, later_ns: int) -> list[Heights]:
    """The heights of the last dwell of a flight that starts at another time."""
    chained.heights.clear()
    chained.feed(flight_items(flight, START_NS + later_ns, range(dwells)))
    return [chained.heights[name, dwells - 1] for name in ("monopulse", "ml")]


def same_but_time(one: Heights, other: Heights) -> bool:
    """Whether heights are the same but for the stamp and the place in the order of processing."""
    return not difference(replace(one, key=other.key, order=other.order), other)


@pytest.mark.parametrize(("other", "later_ns"), [("fewer detectors", HOUR_NS), ("another mode", -HOUR_NS)])
def test_another_sensor_is_followed_and_the_first_one_again(other: str, later_ns: int) -> None:
    make, dwells = OTHERS[other]
    changed = make()
    chained = Chained()
    first = last_heights(chained, small_flight(), 1, 0)
    made = last_heights(chained, changed, dwells, later_ns)
    again = last_heights(chained, small_flight(), 1, 2 * later_ns)
    for images in (first, again):
        assert all(same_but_time(image, reference()[image.estimator, 0]) for image in images)
    assert not any(chained.lost(name) for name in chained.hosts)
    alone = Chained().feed(flight_items(changed, START_NS + later_ns, range(dwells))).finish()
    assert all(same_but_time(ours, alone.heights[ours.estimator, dwells - 1]) for ours in made)
    assert {image.provenance.config_hash for image in made} == {changed.sensor.config_hash}
