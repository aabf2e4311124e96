"""Procedure from passes to the heights of bright points, each step one line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sal_height.elevation import ElevationEstimator, HeightSettings
from sal_height.errors import UserError
from sal_height.numeric import F64, Bool, ShortRepr
from sal_height.passes.array import Ambiguity, PassArray, ambiguity_of
from sal_height.passes.boxes import Lattice, Registered, registered
from sal_height.passes.flown import LEAST_PASSES, Pass, together
from sal_height.passes.points import PointDetections, find_points
from sal_height.passes.settings import PassSettings
from sal_height.passes.tie import Candidates, Tie, loosest, tie_passes

ESTIMATORS_OF_PASSES = ("ml", "capon")
"""Estimators of elevation that accept complex beams, and test of a single look if one scatterer explains it."""

OF_POINTS: Mapping[str, Any] = {"range_looks": 1, "azimuth_looks": 1, "misfit_fraction": 0.0}
"""Settings of the estimators for points: one look, whose residuals are noise and errors of the passes only.

The misfit that is allowed for ground, as parts of a pixel differ in elevation, would give heights to points that have
changed between the passes.
"""


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


@dataclass(frozen=True, eq=False)
class ReferencePoint(ShortRepr):
    """A point of known position.

    Attributes:
        position: position in map, shape (3,), m.
        ties: True if the passes may be tied by it; False: it is only compared with.
    """

    position: F64
    ties: bool = False


@dataclass(frozen=True, eq=False)
class PassHeights(ShortRepr):
    """Heights from passes, and the result of each step.

    Attributes:
        array: passes that were used, at their estimated positions.
        shifts: shifts that registration removed, in range and along the flight, (passes, 2), m.
        tie: tie of the passes.
        ambiguity: ambiguity of heights at the middle of the scene.
        found: points.
        warnings: warning about each pass or reference point that was left out.
    """

    array: PassArray
    shifts: F64
    tie: Tie
    ambiguity: Ambiguity
    found: PointDetections
    warnings: tuple[str, ...]


def heights_from_passes(
    passes: Sequence[Pass],
    centre: F64,
    estimator: ElevationEstimator,
    height_settings: HeightSettings,
    settings: PassSettings,
    references: Sequence[ReferencePoint] = (),
) -> PassHeights:
    """Heights of bright points from several passes.

    Args:
        passes: passes of one receiver each, over the same ground.
        centre: centre of the scene in map, shape (3,), m.
        estimator: estimator of elevation, which must accept complex beams.
        height_settings: settings of the estimator.
        settings: settings of the volume, and of the tie of the passes.
        references: points of known position.

    Raises:
        UserError: too few passes go together, too few points tie them, or these agree no better than by chance.
    """
    # The passes that see the same ground, from the same azimuths and in the same band.
    flown, refused = together(passes, centre)
    array, warnings = PassArray.of(flown, centre, settings), list(refused)
    # Their images on one grid, and on each other.
    seen = registered(array, settings)
    # Their phases, from bright points; passes that do not share these are left out.
    candidates = Candidates.of(seen, settings)
    candidates, lacking = _with_references(candidates, seen, references, settings)
    warnings += lacking
    kept, unfit = _fit_together(candidates, seen.lattice.array, settings)
    warnings += unfit
    if not kept.all():
        array = PassArray.of(tuple(one for one, good in zip(flown, kept, strict=True) if good), centre, settings)
        seen = registered(array, settings)
        candidates, _ = _with_references(Candidates.of(seen, settings), seen, references, settings)
    tie = tie_passes(candidates, seen.lattice.array, settings)
    warnings += check_tie(tie, candidates, seen.lattice.array, settings, np.random.default_rng(0))
    if np.isfinite(tie.elsewhere):
        warnings.append(
            "The reference points are not used: from what they state, every point may as well be "
            f"{abs(tie.elsewhere):.3g} m {'higher' if tie.elsewhere > 0 else 'lower'}; more of them would decide, or "
            "passes at other elevations."
        )
    elif tie.references < (given := int(np.isfinite(candidates.known).sum())):
        warnings.append(
            f"Of {given} reference points that were found {tie.references} agree with the other points, and tie them."
        )
    # Heights of bright points, in the whole volume.
    array, tie = tie.placed(seen.lattice.array)
    lattice, least = Lattice.of(array, settings), 10 ** (settings.least_power_db / 10)
    found = find_points(lattice, tie, seen.background, estimator, height_settings, least)
    # Heights that the passes confuse.
    steering = lattice.steering(centre)
    climb = steering.metres * float(array.axes[2, 2])
    reach = max(settings.highest_m - settings.lowest_m, 3 * steering.beamwidth * climb)
    return PassHeights(array, seen.shifts, tie, ambiguity_of(steering, climb, reach), found, tuple(warnings))


def _fit_together(candidates: Candidates, array: PassArray, settings: PassSettings) -> tuple[Bool, list[str]]:
    """The passes that can be tied by their phases, and a warning about each other one.

    Raises:
        UserError: too few can.
    """
    kept, sentences = np.ones(len(array.passes), np.bool_), list[str]()
    while True:
        some = np.flatnonzero(kept)
        part = replace(array, passes=tuple(array.passes[number] for number in some))
        worst, coherence, points = loosest(candidates.of_passes(kept), part, settings)
        if coherence >= settings.least_coherence:
            return kept, sentences
        sentences.append(
            f"Pass {array.passes[some[worst]].name} is left out: its phase cannot be tied to the others; it shares "
            f"their phase in {points} bright points by {coherence:.2g} of what is usual, and "
            f"{settings.least_coherence:g} is needed (least_coherence)."
        )
        kept[some[worst]] = False
        if kept.sum() < LEAST_PASSES:
            raise UserError(f"Fewer than {LEAST_PASSES} passes can be tied by their phases. {sentences[0]}")


def _with_references(
    candidates: Candidates, seen: Registered, references: Sequence[ReferencePoint], settings: PassSettings
) -> tuple[Candidates, list[str]]:
    """The candidates, with known heights at reference points that tie, and a warning about each that is missing."""
    array, sentences = seen.lattice.array, []
    known, sigma = candidates.known.copy(), candidates.known_sigma.copy()
    for one in references:
        if not one.ties:
            continue
        slant_range, along, elevation = array.seen(one.position)
        ranges, ways, _ = array.seen(candidates.positions)
        off = np.hypot(ranges - slant_range, ways - along)
        near = int(np.argmin(off))
        if off[near] > settings.reference_radius_m:
            east, north, up = one.position.tolist()
            sentences.append(
                f"The reference point at {east:g}, {north:g}, {up:g} m is not used: the nearest bright point is "
                f"{off[near]:.3g} m from its expected position (reference_radius_m is "
                f"{settings.reference_radius_m:g})."
            )
            continue
        known[near] = (elevation - candidates.elevations[near]) / candidates.beamwidths[near]
        metre = ranges[near] * np.sin(candidates.elevations[near]) * candidates.beamwidths[near]
        sigma[near] = settings.reference_sigma_m / metre
    return replace(candidates, known=known, known_sigma=sigma), sentences
