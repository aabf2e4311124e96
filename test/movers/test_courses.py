"""Targets of any course: their smear and migration, and what stands still in their path."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_detection import looked, strip

from sal_height.movers import MoverSettings, StripMovers
from sal_height.movers.courses import Bright, Courses
from sal_height.movers.migration import Migrations
from sal_height.movers.search import Search
from sal_height.movers.spectrum import Bins
from sal_height.numeric import C128, F64
from sal_height.pipeline import strip_with_movers
from sal_height.simulation.scene import PointScatterer

PIXELS, ROWS = 256, 20


def courses_of(*targets: tuple[float, float, float, float, float], seed: int = 0) -> Courses:
    """The search in noise of power 1 with targets of amplitude, row, place (cells), speed (m/s) and smear (cells)."""
    flight, (slc, *_) = strip(0)
    slc = replace(slc, grid=replace(slc.grid, cols=PIXELS, rows=ROWS))
    sensor, rng = flight.sensor, np.random.default_rng(seed)
    bins, chip = Bins.of(slc, sensor, PIXELS, 0.1), Bins.of(slc, sensor, 64, 0.1)
    noise = rng.standard_normal((8, ROWS, len(bins.numbers), 2)) @ [1, 1j] * np.sqrt(0.5)
    beam = sensor.beams.response(float(np.mean(sensor.beams.span)), bins.aspects)
    rows = Migrations.of(Search(np.zeros((8, ROWS, PIXELS), np.complex128), sensor.beams, bins), slc, sensor, 20.0)
    for amplitude, row, place, speed, smear in targets:
        weights: F64 = rows.weights(np.arange(ROWS), np.array([row]), np.array([speed]))[0]
        phase = np.exp(1j * np.pi * (smear * bins.frequencies**2 - 2 * place * bins.frequencies))
        noise += amplitude * beam.T[:, None] * (weights * phase)
    images: C128 = bins.image(noise)
    search = Search(images, sensor.beams, bins)
    smears: F64 = 12.0 * np.arange(-8, 9, dtype=np.float64)
    return Courses(Migrations.of(search, slc, sensor, 20.0), chip, smears, (0, PIXELS))


def test_a_target_of_any_course_is_a_candidate_and_is_focused() -> None:
    """Dimmer than the noise in each pixel: its power is spread over 50 cells and two rows."""
    courses = courses_of((1.0, 9.3, 14.0, 8.0, -57.0))
    near = [one for one in courses.candidates(60.0) if abs(one.row - 9) <= 1]
    (bright,) = near
    assert bright.col == pytest.approx(PIXELS // 2 + 14, abs=6)
    assert bright.smear == pytest.approx(-57, abs=12)
    one = courses.look(bright, 40.0)
    assert one is not None
    assert one.row == pytest.approx(9.3, abs=0.1)
    assert one.place == pytest.approx(14.0, abs=0.3)
    assert abs(one.speed[0] - 8.0) < 4 * one.speed[1] < 4
    assert abs(one.smear[0] + 57.0) < 4 * one.smear[1] + 0.5 < 3


def test_what_a_few_points_explain_does_not_move() -> None:
    """One, and three in the rows and columns of a path, each 20 dB brighter than a mover that is found."""
    at_rest = [(10.0, 9.0, 10.0, 0.0, 0.0), (9.0, 9.7, 30.0, 0.0, 0.0), (8.0, 8.4, -5.0, 0.0, 0.0)]
    for number in (1, 3):
        courses = courses_of(*at_rest[:number])
        for bright in courses.candidates(20.0):
            assert courses.look(bright, 40.0) is None
        for smear in (-36.0, -12.0, 12.0, 36.0):
            assert courses.look(Bright(9, PIXELS // 2 + 10, 5.0, smear, 4), 40.0) is None


def test_a_mover_is_found_among_brighter_points_at_rest() -> None:
    """They are 5 dB brighter, in its rows and between the ends of its smear."""
    courses = courses_of((1.5, 9.3, 0.0, 8.0, -60.0), (2.6, 9.0, 10.0, 0.0, 0.0), (2.6, 9.6, -12.0, 0.0, 0.0))
    found = courses.look(Bright(9, PIXELS // 2, 10.0, -60.0, 4), 40.0)
    assert found is not None
    assert found.smear[0] == pytest.approx(-60, abs=2)


def test_noise_has_no_movers() -> None:
    for seed in range(3):
        courses = courses_of(seed=seed)
        assert [one for bright in courses.candidates(12.0) if (one := courses.look(bright, 40.0))] == []


def test_azimuth_ambiguities_of_a_bright_mover_are_not_published() -> None:
    """They are 1.55 m from it, beyond the next image."""
    point = PointScatterer(-0.35, 0.45, 1.15, 10**3.2, radial_velocity=-1.66, along_velocity=9.14)
    assert len([one for each in looked(0, point, rate=1e-3, dwells=7) for one in each.movers]) == 1


@pytest.mark.parametrize("seed", [1, 23])
def test_points_at_rest_do_not_move_where_autofocus_places_the_images(seed: int) -> None:
    """Pairs of points in neighbouring rows and cells, and odometry that states an error of 5 mm/s."""
    rng = np.random.default_rng(seed)
    points = []
    for east in (-0.5, 0.0, 0.5):
        north, height, power = rng.uniform(-1, 1), rng.uniform(0.2, 1.0), 10 ** rng.uniform(2.5, 3.8)
        points.append(PointScatterer(east, north, height, power))
        points.append(PointScatterer(east + 0.02, north - 0.06, height - 0.06, 0.7 * power))
    flight, images = strip(seed, *points, erring=5e-3)
    search, found = StripMovers[None](MoverSettings()), []
    for slc in images:
        assert slc.placement.beams_error > 0
        found += search.add(strip_with_movers(slc, flight.sensor, MoverSettings()), None)
    found += search.end()
    assert sum(one.candidates for _, one in found if one) > 10
    assert not [mover for _, one in found if one for mover in one.movers]
