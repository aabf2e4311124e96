"""Pieces of a street are the same ground if both show what goes on nowhere else."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import thorough

from sal_height.adjustment.comparing import SURE, Rarity, evidence
from sal_height.adjustment.matching import Points

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


@pytest.mark.parametrize("seed", [0, *thorough(1, 2, 3)])
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
