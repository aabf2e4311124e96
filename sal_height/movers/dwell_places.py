"""Where each dwell shows a target, if its image does not lie exactly where navigation and autofocus put it.

The image of dwell n, and the beam in it, lie farther along the flight by an error e_n of the standard deviation s_n,
which other dwells do not share. The image of a target is then w t_n + e_n - e_0 farther than in the middle dwell, w
being the drift. Where it is brightest in each dwell tells that sum, and w follows by least squares. The covariance of
the differences of errors has s_n^2 on its diagonal, and s_0^2 everywhere (Kay, Fundamentals of Statistical Signal
Processing I, 1993, section 4.5). What remains is what the images are off.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sal_height.movers.dwell_course import Course
from sal_height.movers.dwell_images import COLUMN_STEPS
from sal_height.movers.dwell_paths import DwellPaths
from sal_height.numeric import F64, Bool, Index

WITHIN = 4.0
"""Standard deviations of the difference of two errors within which it is looked for."""

COLUMN_ERROR = 0.12
"""Standard deviation of the place in a dwell by its brightest step, in columns: that of the response and of steps."""

LEAST_POWER = 0.1
"""Of a target in a dwell over that in the middle one, from which its place there counts: ground is less bright."""

MOST_POWER = 5.0
"""The same: the middle dwell sees it about as well as any, and what is still brighter is something else."""

KNOWN = 5.0
"""Greatest standard deviation of a velocity along the flight that is told, m/s."""


@dataclass(frozen=True, eq=False)
class Placed:
    """A course of which each dwell shows its part where it is brightest.

    Attributes:
        course: along the places in the dwells.
        sigma: standard deviation of its velocity along the flight, m/s.
        known: whether that velocity is known well enough to be told.
        tried: logarithm of the number of places that were tried in all dwells, a column apart: so many more hypotheses.
    """

    course: Course
    sigma: float
    known: bool
    tried: float = 0.0


def in_place(paths: DwellPaths, course: Course) -> Placed:
    """The course about one, with its parts where the dwells show them.

    Args:
        paths: of what does not drive along the flight.
        course: of the target.
    """
    column, seconds = paths.dwells[paths.middle].grid.col_spacing, paths.seconds
    others = seconds != 0
    apart = np.where(others, np.hypot(paths.errors, paths.errors[paths.middle]), 0.0)
    reach = WITHIN * apart + column * np.abs(seconds) / np.abs(seconds[others]).min()
    tried = float(np.sum(np.log1p(2 * reach / column)))
    most = int(np.ceil(COLUMN_STEPS * reach.max() / column))
    steps = np.arange(-most, most + 1)
    shifts = column / COLUMN_STEPS * steps.astype(np.float64)
    powers, backgrounds = _powers(course, steps), course.sight.backgrounds
    # The likeliest place: brightness, and how far it is from where the course has it.
    prior = (shifts[:, None] / np.hypot(apart, column)) ** 2 / 2
    there = (np.abs(shifts[:, None]) <= reach) & ((powers <= MOST_POWER * powers[most, paths.middle]) | ~others)
    score = np.where(there, powers / backgrounds - prior, -np.inf)
    best = score.argmax(axis=0)
    bright = powers[best, np.arange(len(seconds))] * np.isfinite(backgrounds)
    used = others & (bright >= LEAST_POWER * bright[paths.middle])
    if not np.any(used):
        used = others & (bright == bright[others].max())
    drifts = course.paths.drifts + shifts[best]
    drift, sigma = _slope(paths, drifts, used)
    drift = min(drift, (1 - LEAST_POWER) * paths.flight_speed)
    along = paths.along_of(drift)
    sigma /= 2 * (1 - along / paths.flight_speed)
    known = sigma <= KNOWN
    if not known:
        # Nothing faster than what is looked for: a uniform distribution by its variance.
        trust = paths.fastest**2 / (paths.fastest**2 + 3 * sigma**2)
        along, sigma = trust * along, float(np.sqrt(trust)) * sigma
    offsets = np.where(used, drifts - paths.driving(along).drifts, 0.0)
    there = paths.driving(along, offsets)
    sight = there.sight(course.sight.place, course.sight.elevation)
    return Placed(Course.of(there, sight, course.row, np.array([course.speed])), sigma, known, tried)


def _powers(course: Course, steps: Index) -> F64:
    """Power on a course under the squint that is best there, so many steps farther along the flight.

    Returns:
        Shape (steps, dwells).
    """
    paths, sight, near = course.paths, course.sight, course.paths.lobes.near
    amplitudes = paths.lobes.amplitudes[near, :, sight.elevation]
    amplitudes = amplitudes / np.maximum(np.linalg.norm(amplitudes, axis=-1, keepdims=True), 1e-12)
    weights, places = course.path[0][0], paths.places(sight.place)
    powers = np.zeros((len(steps), len(paths.dwells)))
    for number, dwell in enumerate(paths.dwells):
        columns = (dwell.shows(places[number])[1] + steps) % dwell.steps
        rows = np.clip(sight.numbers[number], 0, dwell.grid.rows - 1)
        pixels = dwell.pixels[:, rows[:, None], columns]
        along = np.einsum("r,crs->sc", weights[number], pixels)
        powers[:, number] = np.max(np.abs(along @ amplitudes[:, number].conj().T) ** 2, axis=-1)
    return powers


def _slope(paths: DwellPaths, drifts: F64, used: Bool) -> tuple[float, float]:
    """Velocity of the drift by some dwells, and its standard deviation, m/s.

    It is not less than the dwells differ by.
    """
    column = paths.dwells[paths.middle].grid.col_spacing
    seconds, errors = paths.seconds[used], paths.errors[used]
    covariance = np.diag(errors**2 + (COLUMN_ERROR * column) ** 2) + paths.errors[paths.middle] ** 2
    weights = np.linalg.solve(covariance, seconds)
    information = float(weights @ seconds)
    drift = float(weights @ drifts[used]) / information
    left = drifts[used] - drift * seconds
    misfit = float(left @ np.linalg.solve(covariance, left)) / max(1, len(seconds) - 1)
    return drift, float(np.sqrt(max(1.0, misfit) / information))
