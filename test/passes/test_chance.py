"""Points that change between passes: they get no heights, and no pass is tied by chance."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import few
from pass_scenes import SETTINGS, SMALL, amplitudes, reflectors, shown
from scipy.spatial import cKDTree

from sal_height.elevation import ESTIMATORS
from sal_height.errors import UserError
from sal_height.passes import (
    GOTCHA_ELEVATIONS,
    OF_POINTS,
    PassHeights,
    ReferencePoint,
    heights_from_passes,
    simulated_passes,
)

PASSES = len(GOTCHA_ELEVATIONS)


def flown_over(rng: np.random.Generator, points: np.ndarray, turns: np.ndarray, references: int = 0) -> PassHeights:
    """Heights of points whose phases in the passes are turned by so much, (passes, points); the first are known."""
    each = amplitudes(rng, len(points), 23.0) * np.exp(1j * turns)
    passes = simulated_passes(SMALL, points, each, 1.0, rng, phases=rng.uniform(-np.pi, np.pi, PASSES))
    known = [ReferencePoint(place, ties=True) for place in points[:references]]
    ml = ESTIMATORS["ml"]
    return heights_from_passes(passes, np.zeros(3), ml, ml.settings(**OF_POINTS), SETTINGS, known)


@pytest.mark.parametrize("seed", few(1, [1, 2, 4]))
def test_passes_whose_points_have_all_changed_are_refused(seed: int) -> None:
    """A tie by chance gave 16 to 19 of the 40 points heights that were wrong by metres."""
    rng = np.random.default_rng(seed)
    points = reflectors(rng, 40)
    with pytest.raises(UserError, match=r"cannot be tied by their phases: \d+ of 4\d bright points agree.*random"):
        flown_over(rng, points, rng.uniform(-np.pi, np.pi, (PASSES, 40)))


def test_points_that_stayed_get_heights_and_those_that_changed_none() -> None:
    """Three of four have changed, and three references have not. By chance 2 of 150 that changed got one, 5 by default.

    Default is a fraction of power that may be left, as ground in a pixel leaves it; a point does not.
    """
    rng = np.random.default_rng(4)
    points, changed = reflectors(rng, 40), np.arange(40) >= 10
    result = flown_over(rng, points, rng.uniform(-np.pi, np.pi, (PASSES, 40)) * changed, references=3)
    found = result.found.points
    apart, nearest = cKDTree(shown(points)).query(shown(found.positions))
    assert np.all(apart < 0.3)
    assert not changed[nearest].any()
    assert len(set(nearest.tolist())) >= 9
    errors = found.height - points[nearest][:, 2]
    assert np.all(np.abs(errors) < 4 * found.total_sigma), errors / found.total_sigma
    assert any(sentence.startswith("Only ") and "agree on the phases" in sentence for sentence in result.warnings)


def test_points_that_only_tremble_tie_the_passes() -> None:
    """By 0.4 rad: most agree, which random phases do not."""
    rng = np.random.default_rng(6)
    points = reflectors(rng, 40)
    result = flown_over(rng, points, rng.normal(0, 0.4, (PASSES, 40)), references=3)
    assert result.tie.points > 25
    assert result.tie.uncertainty == pytest.approx(0.4, abs=0.1)
    assert not any(sentence.startswith("Only ") for sentence in result.warnings)


@pytest.mark.parametrize("count", few(1, [7, 5]))
def test_a_tie_of_a_few_points_is_not_compared_with_itself(count: int) -> None:
    """Of fewer points than passes: their phases are given to others all the same."""
    rng = np.random.default_rng(3)
    points = reflectors(rng, count)
    result = flown_over(rng, points, np.zeros((PASSES, count)))
    assert result.tie.points == count
    assert len(result.found.points.height) == count
