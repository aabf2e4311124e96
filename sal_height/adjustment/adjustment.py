"""The adjustment of dwells: navigation and mounting such that overlapping height images agree.

First joined dwells are compared with those of other passes, which finds them wherever navigation leaves them; then,
with what that told, each dwell by itself. Every comparison gives an equation between the displacements of the dwells
that met (`observed.displacement`), every Doppler centroid another, and what navigation and mounting are known to be are
the others: a sparse linear least-squares problem. Comparisons that contradict the others lose weight (Student's t with
FREEDOM degrees of freedom), so that a wrong one does no harm.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from sal_height.adjustment.drift import STATE, Drift
from sal_height.adjustment.equations import Equation, Form, Solution, System, mean_form
from sal_height.adjustment.matching import REFERENCE, Points, match
from sal_height.adjustment.observed import (
    COMMON,
    Layout,
    ObservedDwell,
    centroid,
    common_prior,
    displacement,
    own_priors,
    seen,
    vibration_of,
)
from sal_height.adjustment.reference import UNKNOWN_GROUND, References
from sal_height.adjustment.settings import AdjustmentSettings
from sal_height.geometry import Mounting
from sal_height.numeric import F64, in_threads

FREEDOM = 4.0
"""Of Student's t: the fewer, the sooner a comparison loses weight."""

ROUNDS = 6
"""Solutions after which the weights hardly change."""

REACH_SIGMAS = 4.0
"""Standard deviations up to which a shift is looked for."""

SURPLUS_SPACINGS = 2.0
"""By which it is looked for farther than that, in spacings of points."""

ROUGH_POINTS, FINE_POINTS = 300, 800
"""Most points that are compared of joined dwells, whose search is far and rough, and of single ones."""


@dataclass(frozen=True, eq=False)
class Strip:
    """Dwells that follow each other, joined.

    Attributes:
        dwells: their numbers.
        points: of all of them that hang together.
        low: least east and north, m, shape (2,); infinite without points.
        high: greatest east and north, m, shape (2,); minus infinite without points.
    """

    dwells: range
    points: Points
    low: F64
    high: F64

    @property
    def middle(self) -> int:
        """Number of the dwell in the middle."""
        return self.dwells[len(self.dwells) // 2]

    @classmethod
    def of(cls, dwells: range, observed: Sequence[ObservedDwell], shifts: F64) -> Strip:
        """Dwells by their numbers, each less its shift (m), shape (all dwells, 3)."""
        points = Points.joined([observed[number].points.connected for number in dwells]).moved(shifts)
        east_north = points.place[:, :2]
        low, high = east_north.min(axis=0, initial=np.inf), east_north.max(axis=0, initial=-np.inf)
        return cls(dwells, points, low, high)


@dataclass(frozen=True, eq=False)
class Comparison:
    """What a comparison of two images tells of the displacements of their dwells.

    Attributes:
        dwells: shares of the dwells of the one image, and of those of the other; REFERENCE: known ground.
        equation: between the displacements.
        between: displacement of the one from the other, without what edges make of it.
        is_target: whether a reference target was seen.
    """

    dwells: tuple[Mapping[int, float], Mapping[int, float]]
    equation: Equation
    between: Form
    is_target: bool = False

    @property
    def is_absolute(self) -> bool:
        """Whether the ground was known."""
        return REFERENCE in self.dwells[1]


@dataclass(frozen=True, eq=False)
class Adjustment:
    """Navigation and mounting that fit best.

    Attributes:
        layout: of the unknowns.
        solution: their values and covariance.
        displacements: of the dwells, as forms of the unknowns.
        comparisons: of dwells that overlap.
    """

    layout: Layout
    solution: Solution
    displacements: list[Form]
    comparisons: list[Comparison]

    @property
    def common(self) -> tuple[F64, F64]:
        """What all dwells share (`observed.common_prior`), and its covariance."""
        columns = self.layout.common
        (covariance,) = self.solution.covariance([Form(columns, np.eye(COMMON), np.zeros(COMMON))])
        return self.solution.unknowns[columns], covariance

    @property
    def shifts(self) -> tuple[F64, F64]:
        """How far east, north and up (m) the surfaces of each dwell lie off, shape (dwells, 3), and the covariance."""
        shifts = [form.at(self.solution.unknowns) for form in self.displacements]
        return np.array(shifts), np.array(self.solution.covariance(self.displacements))

    @property
    def spread(self) -> tuple[F64, F64]:
        """Covariance of each dwell's shift against the mean of all, m^2, shape (dwells, 3, 3), and of that mean."""
        forms = self.displacements
        middle = mean_form(dict.fromkeys(range(len(forms)), 1 / len(forms)), forms)
        apart = self.solution.covariance([form.minus([(1.0, middle)]) for form in forms])
        return np.array(apart), self.solution.covariance([middle])[0]

    @property
    def differences(self) -> tuple[F64, F64]:
        """How far dwells that were compared lie apart as published, and once adjusted, m, shape (comparisons, 3)."""
        apart = [
            (told := one.equation.right + one.between.constant, told - one.between.at(self.solution.unknowns))
            for one in self.comparisons
        ]
        before, after = np.array(apart).reshape(-1, 2, 3).swapaxes(0, 1)
        return before, after

    @property
    def knots(self) -> F64:
        """Errors of the navigation at the knots of `layout.drift`, shape (knots, STATE)."""
        return self.solution.unknowns[: STATE * len(self.layout.drift.seconds)].reshape(-1, STATE)


def adjust(
    dwells: Sequence[ObservedDwell],
    mounting: Mounting,
    settings: AdjustmentSettings,
    references: References = UNKNOWN_GROUND,
) -> Adjustment:
    """Adjust dwells to each other, and to what is known of the ground.

    Args:
        dwells: in the order of time.
        mounting: of their sensor, as described.
        settings: what is known beforehand.
        references: targets, and an elevation model.
    """
    dwells = [replace(dwell, points=dwell.points.numbered(number)) for number, dwell in enumerate(dwells)]
    layout = Layout(Drift.over(np.array([dwell.seconds for dwell in dwells]), settings.correlation_s), len(dwells))
    forms = [displacement(number, dwell, layout, mounting) for number, dwell in enumerate(dwells)]
    # Navigation, mounting and Doppler centroids, and what each dwell has of its own.
    known = [*layout.drift.priors([dwell.stated for dwell in dwells]), common_prior(dwells, layout, settings)]
    centroids = (centroid(number, dwell, layout, settings) for number, dwell in enumerate(dwells))
    known += [told for told in centroids if told is not None]
    vibration = vibration_of(dwells, _joined(dwells, settings))
    solution = solve([*known, *own_priors(dwells, layout, settings, vibration)], [], layout)

    def solved(comparisons: Sequence[Comparison], before: Solution) -> Solution:
        own = own_priors(dwells, layout, settings, vibration, before)
        return solve([*known, *own], [one.equation for one in comparisons], layout)

    # Comparisons: first of joined dwells, then, where these have put them, of single ones; and of targets.
    joined = list(_joined(dwells, settings))
    whole = [[strip] for strip in joined]
    single = [[range(number, number + 1) for number in strip] for strip in joined]
    found = list(_compared(dwells, forms, layout, solution, settings, references, whole, ROUGH_POINTS))
    solution = solved(found, solution)
    found = list(_compared(dwells, forms, layout, solution, settings, references, single, FINE_POINTS))
    found += _sighted(dwells, forms, solution, settings, references)
    return Adjustment(layout, solved(found, solution), forms, found)


def solve(known: Sequence[Equation], compared: Sequence[Equation], layout: Layout) -> Solution:
    """The unknowns that fit all equations best; those in `compared` lose weight if they contradict the others."""
    system, weights = System([*known, *compared], layout.count), np.ones(len(known) + len(compared))
    solution = system.solved(weights)
    for _ in range(ROUNDS if compared else 0):
        mismatch = system.mismatches(solution.unknowns)[len(known) :]
        weights[len(known) :] = (FREEDOM + 3) / (FREEDOM + mismatch)
        solution = system.solved(weights)
    return solution


def _compared(
    dwells: Sequence[ObservedDwell],
    forms: Sequence[Form],
    layout: Layout,
    known: Solution,
    settings: AdjustmentSettings,
    references: References,
    parts: Sequence[Sequence[range]],
    most_points: int,
) -> Iterator[Comparison]:
    """Compare the parts of each strip with strips that were flown before, and with the terrain."""
    shifts = np.array([form.at(known.unknowns) for form in forms])
    edges = [seen(dwell, form, layout) for dwell, form in zip(dwells, forms, strict=True)]
    strips = [Strip.of(range(own[0].start, own[-1].stop), dwells, shifts) for own in parts]
    in_threads(attrgetter("points.surface"), [strip for strip in strips if strip.points.place.size])  # kept for later
    for number, (strip, own) in enumerate(zip(strips, parts, strict=True)):
        others, middle = _partners(strip, strips[:number], settings), forms[strip.middle]
        relative = [middle.minus([(1.0, forms[other.middle])]) for other in others]
        reach, *reaches = _reaches(known, [middle, *relative], strip.points.spacing, settings)
        surfaces = [other.points.surface for other in others]
        if (
            references.terrain
            and strip.points.place.size
            and (ground := references.terrain.around(strip.points, reach))
        ):
            surfaces, reaches = [ground, *surfaces], [reach, *reaches]
        chosen = [Strip.of(part, dwells, shifts).points.thinned(most_points) for part in own]
        pairs = [(points, *other) for points in chosen for other in zip(surfaces, reaches, strict=True)]
        matches = in_threads(match, *zip(*pairs, strict=True)) if pairs else []
        for first in range(0, len(matches), max(1, len(surfaces))):
            found = [one for one in matches[first : first + len(surfaces)] if one is not None]
            for one in found:
                moved, between = (_between(one.dwells, of) for of in (forms, edges))
                # The noise of the dwell itself is in all its comparisons: half of the variance of each.
                information = 2 / (len(found) + 1) * one.information
                right = moved.at(known.unknowns) + one.shift
                yield Comparison(one.dwells, between.equals(right, information), moved)


def _between(dwells: tuple[Mapping[int, float], Mapping[int, float]], forms: Sequence[Form]) -> Form:
    """How far some dwells lie off from others, by their shares."""
    one, two = (mean_form(shares, forms) for shares in dwells)
    return one.minus([(1.0, two)])


def _sighted(
    dwells: Sequence[ObservedDwell],
    forms: Sequence[Form],
    known: Solution,
    settings: AdjustmentSettings,
    references: References,
) -> Iterator[Comparison]:
    """Find the reference targets in the dwells."""
    if not references.targets:
        return
    reaches = _reaches(known, forms, dwells[0].points.spacing, settings)
    for number, (dwell, form, reach) in enumerate(zip(dwells, forms, reaches, strict=True)):
        for target in references.targets:
            equation = target.sighted(dwell.points, form, form.at(known.unknowns), reach)
            if equation is not None:
                yield Comparison(({number: 1.0}, {REFERENCE: 1.0}), equation, form, is_target=True)


def _reaches(known: Solution, forms: Sequence[Form], spacing: float, settings: AdjustmentSettings) -> list[F64]:
    """How far displacements, or differences of them, may be from what is known, m, shape (3,) each."""
    most, surplus = settings.reach_spacings * spacing, SURPLUS_SPACINGS * spacing
    deviations = (np.sqrt(np.diag(covariance)) for covariance in known.covariance(forms))
    return [np.minimum(REACH_SIGMAS * deviation + surplus, most) for deviation in deviations]


def _joined(dwells: Sequence[ObservedDwell], settings: AdjustmentSettings) -> Iterator[range]:
    """Numbers of dwells that follow each other closely."""
    first = 0
    for number in range(1, len(dwells) + 1):
        is_full = number == len(dwells) or number - first == settings.strip_dwells
        if is_full or dwells[number].seconds - dwells[first].seconds > settings.strip_s:
            yield range(first, number)
            first = number


def _partners(strip: Strip, earlier: Sequence[Strip], settings: AdjustmentSettings) -> list[Strip]:
    """The latest of earlier strips that may have seen the same ground."""
    reach = settings.reach_spacings * strip.points.spacing
    near = [
        other
        for other in earlier
        if np.all(other.low <= strip.high + reach) and np.all(other.high >= strip.low - reach)
    ]
    return near[-settings.partners :]
