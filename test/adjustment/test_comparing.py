"""Which chains are compared with each other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from sal_height.adjustment import UNKNOWN_GROUND, AdjustmentSettings, ObservedDwell, Stated, adjust
from sal_height.adjustment.comparing import ROUGH_POINTS, Chain, compared, joined, whole
from sal_height.adjustment.matching import Match
from sal_height.adjustment.network import Comparison, Network
from sal_height.imaging import Placement
from sal_height.numeric import F64
from sal_height.rehearsal import made_up_heights
from sal_height.simulation import load_preset

SENSOR = load_preset("sal_stripmap").make_sensor()
SETTINGS = AdjustmentSettings(boresight_sigma_rad=0.0, lever_arm_sigma_m=0.0, strip_dwells=1)


def images_after(seconds: float, *, sliding: bool) -> list[ObservedDwell]:
    """Two images of level ground with a step of 1 m, one so long after the other."""
    images = []
    for time in (0.0, seconds):
        field, aperture = made_up_heights(np.random.default_rng(0))
        stated = Stated(time, 1e-4 * np.eye(6), 1e-6 * np.eye(3))
        aperture = replace(aperture, sliding=sliding)
        image = ObservedDwell.seen_from(aperture, field, Placement(0.0, 0.0, 0.0), stated, SENSOR)
        place = image.points.place + np.where(image.points.place[:, 1:2] > image.points.middle[1], [0.0, 0.0, 1.0], 0.0)
        images.append(replace(image, points=replace(image.points, place=place)))
    return images


def compared_after(seconds: float, *, sliding: bool, of: Callable[[Match], Match] = whole) -> list[Comparison]:
    """Comparisons of them."""
    network = Network(SENSOR.mounting, SETTINGS)
    for image in images_after(seconds, sliding=sliding):
        network.add(image)
    chains = joined(network.dwells, SETTINGS)
    known = network.solved(chains)
    first, second = (Chain.of(chain, network, known) for chain in chains)
    return list(compared(second, [second], [first], network, known, UNKNOWN_GROUND, ROUGH_POINTS, of))


@pytest.mark.parametrize(("seconds", "sliding", "count"), [(0.9, True, 0), (1.1, True, 1), (0.9, False, 1)])
def test_a_strip_is_not_compared_with_what_it_goes_on_from(seconds: float, sliding: bool, count: int) -> None:
    """Within `strip_s`, 1 s, its images show other ground; dwells of spotlight may show the same."""
    assert len(compared_after(seconds, sliding=sliding)) == count


def rank_one(information: F64) -> bool:
    values = np.linalg.eigvalsh(information)
    return bool(values[1] < 1e-4 * values[2])


def test_comparisons_tell_what_of_a_match_is_wanted() -> None:
    every, place, height = (
        compared_after(60.0, sliding=True, of=of)[0].equation for of in (whole, Match.of_place, Match.of_height)
    )
    np.testing.assert_allclose(place.right, every.right)
    np.testing.assert_allclose(place.information + height.information, every.information, atol=1e-4)
    assert not rank_one(every.information)
    assert rank_one(height.information)


def test_images_of_strips_tell_only_how_high_they_are_and_dwells_all_that_they_say() -> None:
    """Joined images of strips tell the rest: the place of the step."""
    strips, dwells = (
        [one.equation.information for one in adjust(images, SENSOR.mounting, SETTINGS).comparisons]
        for images in (images_after(60.0, sliding=True), images_after(60.0, sliding=False))
    )
    place, height = strips
    (every,) = dwells
    assert place[2, 2] < 1e-3
    assert place[1, 1] > 100
    assert rank_one(height)
    assert height[2, 2] > 100
    assert not rank_one(every)
