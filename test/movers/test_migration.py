"""Targets that move by rows while the beam passes: place, height and speed, and no false ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import few
from test_detection import NORTH, mover, strip

from sal_height.movers import Looked, Mover, MoverSettings
from sal_height.movers.migration import about_ranges
from sal_height.pipeline import movers
from sal_height.simulation.scene import PointScatterer

PERIOD = 15.5e-3
"""Of the velocity: wavelength times half the pulse repetition frequency, m/s."""


def car(
    speed: float, remainder: float, power_db: float, seed: int = 0, height: float = 0.8
) -> tuple[float, list[Looked]]:
    """What is found of a point whose image is in the middle of the strip, and its radial velocity near a speed, m/s."""
    radial = remainder + PERIOD * round(speed / PERIOD)
    point = PointScatterer(100 * remainder, 0.0, height, 10 ** (power_db / 10), radial_velocity=radial)
    flight, images = strip(seed, point)
    return radial, [movers(slc, flight.sensor, MoverSettings(false_alarm_rate=1e-2)) for slc in images]


@pytest.mark.parametrize(("speed", "remainder"), few(2, [(-14.0, 2e-3), (-9.0, -4e-3), (7.0, 0.0), (12.0, -3e-3)]))
def test_a_car_gets_place_height_and_speed(speed: float, remainder: float) -> None:
    """In 11 ms of the beam that is 0.8 to 1.5 rows of 10 cm."""
    radial, seen = car(speed, remainder, 30.0)
    (one,) = [one for each in seen for one in each.movers]
    assert one.walks
    assert abs(one.walk_velocity - radial) < 4 * one.walk_sigma
    assert one.walk_sigma < 0.8
    assert abs(one.radial_velocity - remainder) < 4 * one.velocity_sigma
    errors = one.position - [100 * remainder, 0.0, 0.8]
    assert np.all(np.abs(errors) < 4 * np.sqrt(np.diag(one.covariance)))
    assert one.height == pytest.approx(0.8, abs=0.03)
    assert not one.resolved


@pytest.mark.thorough
def test_errors_of_cars_are_those_that_are_stated() -> None:
    """The rms over sigma of 5 cars, whose own standard error is a third of it."""
    over = []
    for seed in range(5):
        speed, remainder = (-1) ** seed * (6.0 + 2 * seed), (seed - 2) * 2e-3
        radial, seen = car(speed, remainder, 30.0, seed + 20)
        found = [one for each in seen for one in each.movers if one.walks]
        over += [
            (
                (one.position[0] - 100 * remainder) / np.sqrt(one.covariance[0, 0]),
                (one.height - 0.8) / one.sigma,
                (one.walk_velocity - radial) / one.walk_sigma,
            )
            for one in found
        ]
    assert len(over) >= 4
    assert np.all(np.sqrt(np.mean(np.square(over), axis=0)) < 2.0)
    assert np.all(np.abs(over) < 5)


def test_the_migration_is_as_unsure_as_the_rate_of_the_doppler() -> None:
    """Blocks that autofocus has placed to 15 mm each smear the image by 8.5 of 155 cells: 5.5 % of 14 m/s."""
    radial = -14.0
    flight, images = strip(0, PointScatterer(0.0, 0.0, 0.8, 1e3, radial_velocity=radial))
    sigmas = []
    for beams_error in (0.0, 1.5e-4):
        placed = [replace(slc, placement=replace(slc.placement, beams_error=beams_error)) for slc in images]
        (one,) = [one for slc in placed for one in movers(slc, flight.sensor, MoverSettings()).movers]
        assert np.isnan(one.along_velocity)
        assert abs(one.walk_velocity - radial) < 4 * one.walk_sigma
        sigmas.append(one.walk_sigma)
    # Points in neighbouring rows turn a migration by 0.3 m/s, and by 1 m/s where blocks are blurred.
    added = np.linalg.norm([0.055 * radial, 1.0])
    assert sigmas[1] == pytest.approx(np.hypot(sigmas[0], added), rel=0.1)


def test_what_stands_still_does_not_migrate() -> None:
    """Pairs of points in neighbouring cells; of 200 to 300 bright pixels 5 % may be taken for movers."""
    rng = np.random.default_rng([77, 3])
    points = []
    for east in np.linspace(-0.6, 0.4, 6):
        north, height, power = rng.uniform(-1.2, 1.2), rng.uniform(0.2, 1.6), 10 ** rng.uniform(1.8, 3.6)
        points.append(PointScatterer(east, north, height, power))
        nearer = rng.uniform(0.02, 0.11)
        beside = east + rng.uniform(-0.012, 0.012)
        points.append(PointScatterer(beside, north - nearer, height - nearer, power * 10 ** rng.uniform(-0.5, 0.5)))
    flight, images = strip(3, *points)
    settings = MoverSettings(false_alarm_rate=0.05, prominence_db=5.0)
    seen = [movers(slc, flight.sensor, settings) for slc in images]
    candidates = sum(one.candidates for one in seen)
    assert candidates > 200
    assert sum(one.walks for each in seen for one in each.movers) <= 1
    assert sum(len(each.movers) for each in seen) <= 0.05 * candidates


def test_slow_ones_do_not_migrate() -> None:
    flight, images = strip(0, mover(5e-3, 30.0, 0.5))
    seen = [movers(slc, flight.sensor, MoverSettings(false_alarm_rate=1e-2)) for slc in images]
    (one,) = [one for each in seen for one in each.movers]
    assert not one.walks
    assert abs(one.walk_velocity) < 5 * one.walk_sigma < 5


def test_speeds_that_are_not_looked_for() -> None:
    """None at 0; and no more than 6 rows, of 0.1 m, over the time of the bins, 11 ms: 57 m/s."""
    flight, (slc, *_) = strip(1)
    fastest = [movers(slc, flight.sensor, MoverSettings(fastest_mps=speed)).fastest for speed in (0.0, 20.0, 500.0)]
    assert fastest[:2] == [0.0, 20.0]
    assert fastest[2] == pytest.approx(56.6, abs=0.5)


def test_the_migration_resolves_an_ambiguity_that_is_longer_than_its_error() -> None:
    at = Mover(np.zeros(3), np.eye(3), 0.0, 0.01, 2.0, 0.1, 15.0, 33.0, 1.0, 0.0, 1.0, True, 50.0, 20.0, 1, 1)
    assert at.resolved
    assert at.without_ambiguity().radial_velocity == pytest.approx(32.0)
    assert replace(at, walk_velocity=-12.0).without_ambiguity().radial_velocity == pytest.approx(-13.0)
    assert not replace(at, walk_sigma=1.6).resolved


def test_rows_are_about_their_ranges() -> None:
    """A point between two rows has the same phase in both; as images are, 0.64 turns lie between them."""
    flight, images = strip(0, PointScatterer(0.05, NORTH, 0.0, 1e6))
    power = np.abs(images[1].images) ** 2
    _, row, col = np.unravel_index(power.argmax(), power.shape)
    rows = [row - 1, row] if power[:, row - 1, col].sum() > power[:, row + 1, col].sum() else [row, row + 1]

    def turned(image: np.ndarray) -> float:
        return float(np.angle(np.sum(image[:, rows[1], col] * image[:, rows[0], col].conj())))

    assert abs(turned(about_ranges(images[1].images, images[1], flight.sensor))) < 0.1
    assert abs(turned(images[1].images)) > 1
