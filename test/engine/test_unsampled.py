"""Dwells that cannot be imaged: one clear reason, a count, and the next good dwell exactly as if nothing happened."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from chained import DETECTORS, Chained, reference
from flown_items import SENSOR_INFO, Item, flight_items, frame_items, odometry_items, small_flight
from helpers import assert_one_sentence
from same_items import difference
from scipy.spatial.transform import Rotation

from sal_height.sensor import Sensor


def sparse(sensor: Sensor) -> Sensor:
    """An antenna so small that the pulses do not sample its beams: 1.67 mm apart, allowed are .5 mm."""
    return replace(sensor, elevation_diameter=0.001, azimuth_diameter=0.001, config_hash="")


def short(sensor: Sensor) -> Sensor:
    """An antenna so large that the dwell resolves no more than its beam: 8 cm, needed are 50 cm."""
    return replace(sensor, elevation_diameter=1.0, azimuth_diameter=1.0, config_hash="")


def deep(sensor: Sensor) -> Sensor:
    """Beams over more ground than the frequencies tell apart: 8 beams over 5.4 m of range, the window is 4.8 m."""
    return replace(sensor, elevation_boresights=tuple(np.pi / 4 + (np.arange(8) - 3.5) * 1.55e-4), config_hash="")


def check_next_dwell(chained: Chained) -> None:
    """The second dwell of the flight is processed as if it were the first one."""
    chained.feed(flight_items(small_flight(), dwells=[1])).finish()
    assert {dwell for _, dwell in chained.heights} == {1}
    for (estimator, dwell), one in chained.heights.items():
        assert not difference(replace(one, order=1), reference()[estimator, dwell])


@pytest.mark.parametrize(
    ("spoil", "reason", "limit"),
    [
        (sparse, "aliased in azimuth", "a pulse repetition frequency of 1e+05 Hz"),
        (short, "too few pulses", "longer than half the antenna (0.5 m)"),
        (deep, "aliased in range", "must be spaced 2.763e+07 Hz or less"),
    ],
)
def test_a_dwell_that_does_not_sample_the_scene(spoil: Callable[[Sensor], Sensor], reason: str, limit: str) -> None:
    flight = small_flight()
    flown = replace(flight, sensor=spoil(flight.sensor))
    frames = [
        (port, frame._replace(key=frame.key._replace(sensor=flown.sensor.config_hash)))
        for port, frame in frame_items(flight, 0)
    ]
    chained = Chained().feed([(SENSOR_INFO, flown.sensor), *odometry_items(flight, 0), *frames])
    assert chained.lost() == {reason: DETECTORS}
    assert_one_sentence(chained.hosts["sar_compression"].last_drop, limit)
    check_next_dwell(chained)


def with_states(change: Callable[[Item], Item]) -> Chained:
    """The first dwell with another odometry."""
    flight = small_flight()
    odometry = [change(item) for item in odometry_items(flight, 0)]
    chained = Chained().feed([(SENSOR_INFO, flight.sensor), *odometry, *frame_items(flight, 0)])
    return chained.feed(odometry_items(flight, 0))


def test_a_scene_outside_the_beams() -> None:
    """Heading off by two beamwidths: what was lit is not what the image shows."""

    def turned(item: Item) -> Item:
        return item[0], replace(item[1], orientation=Rotation.from_euler("z", 3.1e-4).as_quat())

    chained = with_states(turned)
    assert chained.lost() == {"Doppler centroid outside the band": DETECTORS}
    assert_one_sentence(chained.hosts["sar_compression"].last_drop, "to each side; attitude")
    check_next_dwell(chained)


def test_a_track_that_jumps() -> None:
    start_ns = frame_items(small_flight(), 0)[0][1].key.stamp_ns

    def jumped(item: Item) -> Item:
        shift = np.array([0.0, 1.0 if item[1].stamp_ns > start_ns else 0.0, 0.0])
        return item[0], replace(item[1], position=item[1].position + shift)

    chained = with_states(jumped)
    assert chained.lost() == {"cannot be processed": DETECTORS}
    assert_one_sentence(chained.hosts["sar_compression"].last_drop, "twist must be the velocity")
    check_next_dwell(chained)
