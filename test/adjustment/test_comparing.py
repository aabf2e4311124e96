"""Which chains are compared with each other, and which pieces of a street are the same ground."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import few

from sal_height.adjustment import UNKNOWN_GROUND, AdjustmentSettings, ObservedDwell, Stated, adjust
from sal_height.adjustment.comparing import (
    STRIP_POINTS,
    SURE,
    DwellChain,
    Rarity,
    _Compared,
    compared,
    evidence,
    joined,
)
from sal_height.adjustment.matching import GriddedSurface, Match, Points, match
from sal_height.adjustment.network import Comparison, Network
from sal_height.imaging import Placement
from sal_height.numeric import F64
from sal_height.rehearsal import made_up_heights
from sal_height.simulation import load_preset

SENSOR = load_preset("sal_stripmap").make_sensor()
SETTINGS = AdjustmentSettings(boresight_sigma_rad=0.0, lever_arm_sigma_m=0.0, strip_dwells=1)


def images_after(seconds: float, *, sliding: bool) -> list[ObservedDwell]:
    """Two images of level ground with a block of 1 m in its corner, one so long after the other."""
    images = []
    for time in (0.0, seconds):
        field, aperture = made_up_heights(np.random.default_rng(0))
        stated = Stated(time, 1e-4 * np.eye(6), 1e-6 * np.eye(3))
        aperture = replace(aperture, sliding=sliding)
        image = ObservedDwell.seen_from(aperture, field, Placement(0.0, 0.0, 0.0), stated, SENSOR)
        in_corner = np.all(image.points.place[:, :2] > image.points.middle[:2], axis=1)
        place = image.points.place + in_corner[:, None] * [0.0, 0.0, 1.0]
        images.append(replace(image, points=replace(image.points, place=place)))
    return images


def compared_after(
    seconds: float, *, sliding: bool, alone: bool = False, only: slice = slice(None), position_m: float = 0.01
) -> list[Comparison]:
    """Comparisons of them, of the second image by itself, or of some of its points, whose place is known so well."""
    network = Network(SENSOR.mounting, SETTINGS)
    first, second = images_after(seconds, sliding=sliding)
    points = second.points
    points = Points(*(one[only] for one in (points.place, points.sigma, points.cnr_db, points.dwell)), points.spacing)
    for image, sigma in ((first, 0.01), (replace(second, points=points), position_m)):
        pose = np.diag([sigma**2] * 3 + [1e-12] * 3)
        network.add(replace(image, stated=replace(image.stated, pose=pose, velocity=1e-8 * np.eye(3))))
    chains = joined(network.dwells, SETTINGS)
    known = network.solved(chains)
    first, second = (DwellChain.of(chain, network, known) for chain in chains)
    return list(compared(second, [first], network, known, UNKNOWN_GROUND, STRIP_POINTS, [second] if alone else []))


@pytest.mark.parametrize(("seconds", "sliding", "count"), [(0.9, True, 0), (1.1, True, 1), (0.9, False, 1)])
def test_a_strip_is_not_compared_with_what_it_goes_on_from(seconds: float, sliding: bool, count: int) -> None:
    """Within `strip_s`, 1 s, its images show other ground; dwells of spotlight may show the same."""
    assert len(compared_after(seconds, sliding=sliding)) == count


@pytest.mark.parametrize(("sliding", "count"), [(True, 2), (False, 1)])
def test_images_of_strips_are_compared_as_part_of_their_strip_and_alone_and_dwells_once(
    sliding: bool, count: int
) -> None:
    stated = Stated(0.0, np.diag([1e-4] * 3 + [1e-12] * 3), 1e-8 * np.eye(3))
    images = [
        replace(image, stated=replace(stated, seconds=image.stated.seconds))
        for image in images_after(60.0, sliding=sliding)
    ]
    assert len(adjust(images, SENSOR.mounting, SETTINGS).comparisons) == count


def points_of(count: int) -> Points:
    """Level ground."""
    place = np.column_stack([np.arange(count) % 30, np.arange(count) // 30, np.zeros(count)])
    return Points(place, np.full(count, 0.1), np.zeros(count), np.zeros(count, int), 1.0)


def rank_one(information: F64) -> bool:
    values = np.linalg.eigvalsh(information)
    return bool(values[1] < 1e-4 * values[2])


def test_a_strip_as_a_whole_gives_its_position_its_images_their_height_and_dwells_both() -> None:
    cases = (True, False), (True, True), (False, True)
    place, height, both = (
        compared_after(60.0, sliding=sliding, alone=alone)[0].equation.information for sliding, alone in cases
    )
    assert place[2, 2] < 1e-3
    assert place[1, 1] > 100
    assert rank_one(height)
    assert height[2, 2] > 100
    assert not rank_one(both)


@pytest.mark.parametrize(("only", "count"), [(slice(None), 1), (slice(0, None, 4), 0)])
def test_a_strip_is_placed_where_enough_of_it_fits(only: slice, count: int) -> None:
    """Not by 90 of its 360 points; a dwell is compared all the same."""
    assert len(compared_after(60.0, sliding=True, only=only)) == count
    assert len(compared_after(60.0, sliding=False, only=only)) == 1


@pytest.mark.parametrize(("share", "clear"), [(0.39, False), (0.41, True)])
def test_a_match_of_a_strip_is_clear_from_a_share_of_the_smaller_image_on(share: float, clear: bool) -> None:
    """And if it is within what was known: 3.5 standard deviations, of 10 cm and 1 cm, and not 4.5."""
    chain = DwellChain({}, points_of(1000), np.zeros(2), np.zeros(2))
    met = _Compared(chain.points.surface, 2000, {}, np.zeros(3), 0.01 * np.eye(3))
    found = Match(np.array([0.3, 0.0, 0.0]), 1e4 * np.eye(3), ({0: 1.0}, {1: 1.0}), share)
    assert met.is_clear(found, chain) == clear
    assert replace(met, count=500).is_clear(replace(found, share=share / 2), chain) == clear
    far = (replace(found, shift=np.array([0.0, sigmas * np.hypot(0.1, 0.01), 0.0]), share=0.5) for sigmas in (3.5, 4.5))
    assert [met.is_clear(one, chain) for one in far] == [True, False]


@pytest.mark.parametrize(("position_m", "count"), [(0.05, 1), (1.0, 0)])
def test_images_of_strips_tell_no_height_where_their_place_is_not_known(position_m: float, count: int) -> None:
    assert len(compared_after(60.0, sliding=True, alone=True, position_m=position_m)) == count


def test_of_a_strip_is_said_what_either_density_says(monkeypatch: pytest.MonkeyPatch) -> None:
    """And of its images, but not of dwells."""
    kinds = []

    def noted(points: Points, surface: GriddedSurface, reach: F64, kind: int) -> Match | None:
        kinds.append(kind)
        return match(points, surface, reach, kind)

    monkeypatch.setattr("sal_height.adjustment.comparing.match", noted)
    for sliding, alone in ((True, False), (True, True), (False, False), (False, True)):
        assert compared_after(60.0, sliding=sliding, alone=alone)
    assert kinds == [2, 2, 1, 1]


SPACING = 0.1


def seen(west: float, seed: int, ends: tuple[float, ...], long: float = 2.0) -> Points:
    """Two metres of a street with kerbs and a row of cars, which begin and end at some places; noise of 2 cm."""
    rng = np.random.default_rng(seed)
    east, north = (one.ravel() for one in np.meshgrid(np.arange(west, west + long, SPACING), np.arange(-3, 3, SPACING)))
    height = np.where(np.abs(north) > 2.0, 0.12, 0.0)
    height = np.where((np.abs(north) < 0.9) & (np.searchsorted(ends, east) % 2 == 1), 1.4, height)
    place = np.column_stack([east, north, height + 0.02 * rng.standard_normal(east.size)])
    return Points(place, np.full(east.size, 0.02), np.zeros(east.size), np.zeros(east.size, int), SPACING)


def told(one: Points, other: Points, shift_m: float) -> float:
    return evidence(one, Rarity.of(one), other, np.array([shift_m, 0.0, 0.0]))


def test_a_street_without_ends_tells_nothing() -> None:
    for shift_m in (0.0, 1.0):
        assert abs(told(seen(0.0, 1, ()), seen(0.0, 2, ()), shift_m)) < 0.1 * SURE


def test_an_end_that_both_show_is_recognised() -> None:
    one, other = seen(0.0, 1, (0.8,)), seen(0.3, 2, (0.8,))
    assert told(one, other, 0.0) > 3 * SURE


@pytest.mark.parametrize("seed", few(1, [0, 1, 2, 3]))
def test_an_end_is_recognised_in_a_longer_image(seed: int) -> None:
    """Which alone would be shifted farther: both are shifted as far."""
    one, other = seen(0.0, 1 + seed, (0.8,)), seen(-0.5, 20 + seed, (0.8,), long=4.0)
    assert np.linalg.norm(Rarity.of(other).elsewhere) > 1.3 * np.linalg.norm(Rarity.of(one).elsewhere)
    assert told(one, other, 0.0) > 25 * SURE


def test_an_end_that_only_one_shows_is_not_enough() -> None:
    one, other = seen(0.0, 1, (0.6,)), seen(9.0, 2, ())
    assert told(one, other, -9.0) < 0.2 * SURE


def test_too_few_points_tell_nothing() -> None:
    one, few = seen(0.0, 1, (0.8,)), seen(0.0, 2, (0.8,), long=0.1)
    few = Points(few.place[:8], few.sigma[:8], few.cnr_db[:8], few.dwell[:8], SPACING)
    assert told(few, one, 0.0) == told(one, few, 0.0) == 0.0
