"""Position along the flight, which the Doppler of pulses gives up to multiples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sal_height.imaging import Centroid, ImageSettings, Placement, Slc, line_of_sight, with_ambiguous_position
from sal_height.imaging.ambiguous_position import wrapped_variance
from sal_height.pipeline import Compressor
from sal_height.sensor import Sensor
from sal_height.simulation import flight_of, load_preset


def test_the_variance_is_that_of_whole_multiples_of_the_ambiguity() -> None:
    """Of a pointing far better than the ambiguity it is 0, of one far worse its own variance."""
    weights = np.exp(-(np.arange(-9, 10) ** 2) / (2 * 0.6**2))
    assert wrapped_variance(0.6, 1.0) == pytest.approx(float(weights @ np.arange(-9, 10) ** 2 / weights.sum()))
    assert wrapped_variance(3.0, 1.0) == pytest.approx(9.0, rel=1e-6)
    assert wrapped_variance(9.9, 1.0) == pytest.approx(wrapped_variance(10.1, 1.0), rel=0.05)
    assert wrapped_variance(0.124, 1.0) == wrapped_variance(0.0, 1.0) == 0.0
    assert wrapped_variance(0.126, 1.0) < 1e-12


@pytest.fixture(scope="module")
def dwell() -> tuple[Slc, Sensor, float]:
    """Images of a lidar, its sensor, and the ambiguity of the direction of its beams, rad."""
    flight = flight_of(load_preset("small"), seed=1)
    settings = ImageSettings(air="none", rows=30, cols=8)
    slc = Compressor().add(flight.phase_history(0), flight.track(0), flight.sensor, settings)
    assert slc is not None
    speed = float(np.linalg.norm(slc.aperture.velocity))
    return slc, flight.sensor, flight.sensor.wavelength * flight.sensor.pulse_repetition_frequency / (2 * speed)


def moved(slc: Slc, sensor: Sensor, heading: float, stated: float = 0.0) -> float:
    """Standard deviation of the position along the flight by a heading of that standard deviation, m."""
    poses = [np.diag([0.0] * 5 + [sigma**2]) for sigma in (heading, stated)]
    made = with_ambiguous_position(replace(slc, aperture=replace(slc.aperture, covariance=poses[0])), sensor, poses[1])
    added = made.aperture.covariance - poses[0]
    assert np.count_nonzero(added) == np.count_nonzero(added[0, 0])
    return float(np.sqrt(added[0, 0]))


def test_a_heading_that_is_not_known_leaves_the_position_open_and_one_that_is_known_does_not(
    dwell: tuple[Slc, Sensor, float],
) -> None:
    slc, sensor, ambiguity = dwell
    sight = line_of_sight(sensor, slc.aperture)
    reach, of_heading = float(np.linalg.norm(slc.grid.middle - slc.aperture.position)), float(np.hypot(*sight[:2]))
    assert moved(slc, sensor, ambiguity / 20) == 0.0
    assert moved(slc, sensor, 40 * ambiguity) == pytest.approx(40 * ambiguity * of_heading * reach, rel=1e-3)


def test_autofocus_has_taken_what_is_stated_into_account(dwell: tuple[Slc, Sensor, float]) -> None:
    slc, sensor, ambiguity = dwell
    placed = replace(slc, placement=Placement(0.0, 0.0, 0.0, Centroid(0.0, 1e-5)))
    assert moved(placed, sensor, 40 * ambiguity, 40 * ambiguity) == 0.0
    assert moved(placed, sensor, 50 * ambiguity, 30 * ambiguity) == pytest.approx(moved(slc, sensor, 40 * ambiguity))
    by_beams = replace(slc, placement=Placement(0.0, 0.0, 0.0, by_beams=True))
    assert moved(by_beams, sensor, 40 * ambiguity) == 0.0
