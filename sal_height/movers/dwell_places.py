"""Position of a target in each dwell, if images have offsets that navigation and autofocus leave.

The image of dwell n, and the beam in it, are offset along the flight by an error e_n of the standard deviation s_n,
which other dwells do not share. The image of a target is then w t_n + e_n - e_0 farther than in the middle dwell, w
being the drift. That sum is measured where it is brightest in each dwell, and w follows by least squares. The
covariance of the differences of errors has s_n^2 on its diagonal, and s_0^2 everywhere (Kay, Fundamentals of
Statistical Signal Processing I, 1993, section 4.5). The remainder is the offset of the images.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sal_height.movers.dwell_course import Course
from sal_height.movers.dwell_images import COLUMN_STEPS
from sal_height.movers.dwell_paths import DwellPaths
from sal_height.numeric import F64, Bool, Index

LEAST_POWER = 0.1
"""Least power of a target in a dwell over that in the middle one for its position to count: ground is less bright."""


@dataclass(frozen=True, eq=False)
class Placed:
    """A course through the brightest positions in each dwell.

    Attributes:
        course: course along the positions in the dwells.
        sigma: standard deviation of its velocity along the flight, m/s.
        known: True if that velocity is known well enough to be published.
        tried: logarithm of the number of positions that were tried in all dwells, a column apart, as hypotheses.
    """

    course: Course
    sigma: float
    known: bool
    tried: float = 0.0


def in_place(paths: DwellPaths, course: Course) -> Placed:
    """The course through the brightest positions about another one.

    They are searched within 4 sigma of the difference of two errors, and a column. A position that is 5 times as bright
    as the middle dwell has it, which sees it about as well as any, is that of another target.

    Args:
        paths: paths of targets that do not move along the flight.
        course: course of the target.
    """
    column, seconds = paths.dwells[paths.middle].grid.col_spacing, paths.seconds
    others = seconds != 0
    apart = np.where(others, np.hypot(paths.errors, paths.errors[paths.middle]), 0.0)
    reach = 4 * apart + column * np.abs(seconds) / np.abs(seconds[others]).min()
    tried = float(np.sum(np.log1p(2 * reach / column)))
    most = int(np.ceil(COLUMN_STEPS * reach.max() / column))
    steps = np.arange(-most, most + 1)
    shifts = column / COLUMN_STEPS * steps.astype(np.float64)
    powers, backgrounds = _powers(course, steps), course.sight.backgrounds
    # The likeliest position: brightness, and distance from the course.
    prior = (shifts[:, None] / np.hypot(apart, column)) ** 2 / 2
    there = (np.abs(shifts[:, None]) <= reach) & ((powers <= 5 * powers[most, paths.middle]) | ~others)
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
    known = sigma <= 5.0  # m/s
    if not known:
        # Nothing faster than is searched: a uniform distribution by its variance.
        trust = paths.fastest**2 / (paths.fastest**2 + 3 * sigma**2)
        along, sigma = trust * along, float(np.sqrt(trust)) * sigma
    offsets = np.where(used, drifts - paths.driving(along).drifts, 0.0)
    there = paths.driving(along, offsets)
    sight = there.sight(course.sight.place, course.sight.elevation)
    return Placed(Course.of(there, sight, course.row, np.array([course.speed])), sigma, known, tried)


def _powers(course: Course, steps: Index) -> F64:
    """Power on a course under the squint that is best there, at a number of steps farther along the flight.

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

    The latter is not less than the differences of the dwells. A brightest step has an error of 0.12 columns, by the
    response and by steps.
    """
    column = paths.dwells[paths.middle].grid.col_spacing
    seconds, errors = paths.seconds[used], paths.errors[used]
    covariance = np.diag(errors**2 + (0.12 * column) ** 2) + paths.errors[paths.middle] ** 2
    weights = np.linalg.solve(covariance, seconds)
    information = float(weights @ seconds)
    drift = float(weights @ drifts[used]) / information
    left = drifts[used] - drift * seconds
    misfit = float(left @ np.linalg.solve(covariance, left)) / max(1, len(seconds) - 1)
    return drift, float(np.sqrt(max(1.0, misfit) / information))
