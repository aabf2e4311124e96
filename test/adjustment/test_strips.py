"""Strips are placed where they are or left where navigation puts them, in bags and as their images come."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import few
from made_up_strips import SENSOR, Strips, strips
from window_runs import WindowRun, run_through

from sal_height.adjustment import Adjustment, AdjustmentSettings, AdjustmentWindow, adjust
from sal_height.numeric import F64

SETTINGS = AdjustmentSettings(boresight_sigma_rad=0.0, lever_arm_sigma_m=0.0, jitter_rad=1e-7)
MOST = 25.0
"""Square of an error of three numbers over its variance: by chance one of 70 000."""

ANYWHERE = few(6, [(each, west_m, seed) for seed in (1, 2) for each in (2, 3) for west_m in (-2.7, -1.5, 0.3)])
"""Images of a strip, where it begins, and errors."""

BOTH_ENDS = [(2, -2.7, 1), (3, 0.3, 1)]
BOTH_ENDS_FIRST = [*BOTH_ENDS, *(case for case in ANYWHERE if case not in BOTH_ENDS)]
"""The same in another order."""


def over(errors: F64, covariances: F64) -> F64:
    return np.array([e @ np.linalg.solve(c + 1e-8 * np.eye(3), e) for e, c in zip(errors, covariances, strict=True)])


def adjusted(flown: Strips) -> tuple[Adjustment, F64, F64]:
    """Errors of the images against the mean of all, m, and their covariances."""
    found = adjust(flown.images, SENSOR.mounting, SETTINGS)
    errors = found.shifts[0] - flown.shifts
    return found, errors - errors.mean(axis=0), found.spread[0]


@pytest.mark.parametrize(("each", "west_m", "seed"), ANYWHERE)
def test_a_short_strip_is_placed_right_or_not_at_all(each: int, west_m: float, seed: int) -> None:
    """Of four strips: each image within what is stated, wherever on the street they are."""
    found, errors, covariances = adjusted(strips(4, each, west_m, seed))
    assert np.all(over(errors, covariances) < MOST)
    assert found.contradictions == 0


def test_short_strips_that_show_enough_come_together_and_others_stay_where_navigation_puts_them() -> None:
    """Of a street with a car and its end: 2 mm in height. Of the long side of a car: odometry, 70 cm."""
    _, errors, covariances = adjusted(strips(4, 4, 0.3, 1))
    assert np.sqrt(np.mean(errors[:, 2] ** 2)) < 0.002
    _, _, unknown = adjusted(strips(4, 4, -1.5, 1))
    assert np.sqrt(np.mean(unknown[:, 2, 2])) > 0.7
    assert np.sqrt(np.mean(covariances[:, 2, 2])) < 0.01


def told(flown: Strips, most: int = 1000) -> WindowRun:
    return run_through(AdjustmentWindow(SENSOR.mounting, SETTINGS, most), flown.images)


@pytest.mark.parametrize(("each", "west_m", "seed"), few(2, BOTH_ENDS_FIRST))
def test_images_are_within_what_is_stated_as_they_come(each: int, west_m: float, seed: int) -> None:
    """From the first image on, whether or not enough of its strip has come."""
    flown = strips(4, each, west_m, seed)
    found = told(flown)
    assert np.all(over(found.shifts - flown.shifts, found.covariances) < MOST)


@pytest.mark.parametrize("seed", few(1, [1, 2]))
def test_images_come_together_once_enough_of_their_strip_has_come(seed: int) -> None:
    """The first images with the error of odometry, 1 m and more, and its sigma; from the fourth on within 3 mm."""
    flown = strips(4, 8, 0.3, seed)
    found = told(flown)
    off, sigma = found.shifts - flown.shifts, np.sqrt(found.covariances[:, 2, 2])
    errors, sigmas = off[:, 2].reshape(4, 8), sigma.reshape(4, 8)
    assert np.ptp(flown.shifts[:, 2]) > 1.0
    assert np.ptp(errors[:, 3:]) < 0.003, errors
    assert np.all(sigmas[:, 3:] < 0.11)
    assert np.any(sigmas[1:, 0] > 0.9)


def test_a_strip_is_compared_as_a_whole_once_and_each_image_once() -> None:
    """What was said of it when it was shorter does not count again: with each strip before it, one and one each."""
    flown = strips(3, 8, 0.3, 1)
    window = AdjustmentWindow(SENSOR.mounting, SETTINGS, 1000)
    for image in flown.images:
        window.add(image)
    found = window.adjustment.comparisons
    wholes = [one for one in found if len(one.dwells[0]) > 1]
    assert len(wholes) == 3
    assert len(found) - len(wholes) == 8 + 2 * 8


@pytest.mark.thorough
def test_strips_that_are_held_no_more_have_told_what_they_knew() -> None:
    """With one strip held and one that grows, heights are the same within 3 mm; twice gives the same bits."""
    flown = strips(6, 4, 0.3, 1)
    short, again, whole = told(flown, 4), told(flown, 4), told(flown)
    assert short.kept <= 8
    np.testing.assert_array_equal(short.shifts, again.shifts)
    np.testing.assert_allclose(short.shifts[-2:, 2], whole.shifts[-2:, 2], atol=0.003)
