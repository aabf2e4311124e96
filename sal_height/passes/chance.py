"""Test of a tie of passes against chance: some points agree on phases of passes whatever the phases are.

With a phase for each pass and an elevation for each point as unknowns, a quarter of points with random phases agree on
the best choice. Their number and error are measured by the points themselves: in each pass their phases are permuted at
random, so that few belong together (a permutation test: Good, Permutation, Parametric and Bootstrap Tests of
Hypotheses, 2005). Points that have changed between passes do no better than that.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sal_height.errors import UserError
from sal_height.passes.array import PassArray
from sal_height.passes.settings import PassSettings
from sal_height.passes.tie import Candidates, Tie, tie_passes


def check_tie(
    tie: Tie, points: Candidates, array: PassArray, settings: PassSettings, rng: np.random.Generator
) -> list[str]:
    """A warning where less than half of the points agree on the phases of the passes.

    A tie is accepted if the error of amplitudes is below 0.7 times that by chance, or the number of points above twice
    that by chance. Of 40 points in 8 passes 10 +- 3 agree by chance, with an error of 0.55 +- 0.05.

    Args:
        tie: tie of the passes.
        points: candidates by which it was found.
        array: passes.
        settings: settings of the tie.
        rng: generator of the permutations, of which there are four.

    Raises:
        UserError: points of random phases agree as well.
    """
    count = len(points.samples)
    errors, numbers = [], [0]
    for _ in range(4):
        phases = rng.permuted(points.samples / np.abs(points.samples), axis=0)
        nowhere = np.full(count, np.nan)
        mixed = replace(points, samples=np.abs(points.samples) * phases, known=nowhere, known_sigma=nowhere)
        try:
            by_chance = tie_passes(mixed, array, settings)
        except UserError:  # too few agree
            continue
        errors.append(by_chance.uncertainty)
        numbers.append(by_chance.points)
    if errors and tie.uncertainty > 0.7 * np.mean(errors) and tie.points < 2 * max(numbers):
        raise UserError(
            f"The passes cannot be tied by their phases: {tie.points} of {count} bright points agree on them, to "
            f"{tie.uncertainty:.2f} of their amplitude, as points of random phases do ({max(numbers)}, to "
            f"{np.mean(errors):.2f}); the points have changed between the passes, or most of them are several in one "
            "pixel."
        )
    if tie.points >= 0.5 * count:
        return []
    few = (
        f"Only {tie.points} of {count} bright points agree on the phases of the passes; the others have changed "
        "between them, lie beyond tie_reach_m, or are several in one pixel. Points that have changed get no height "
        "but for one or two of a hundred that agree by chance."
    )
    return [few]
