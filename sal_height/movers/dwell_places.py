"""Position of a target in each dwell, if images have offsets that navigation and autofocus leave.

The image of dwell n, and the beam in it, are offset along the flight by an error e_n of the standard deviation s_n,
which other dwells do not share. The image of a target is then w t_n + e_n - e_0 farther than in the middle dwell, w
being the drift. That sum is measured where it is brightest in each dwell, and w follows by least squares. The
covariance of the differences of errors has s_n^2 on its diagonal, and s_0^2 everywhere (Kay, Fundamentals of
Statistical Signal Processing I, 1993, section 4.5). The remainder is the offset of the images.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sal_height.movers.dwell_images import COLUMN_STEPS
from sal_height.movers.dwell_paths import LEAST_PART, Course, DwellPaths, Sight
from sal_height.movers.likelihood import MODEL_ERROR, ratio_in_dwells, ratio_over_rows
from sal_height.movers.migration import FINE_STEP
from sal_height.numeric import C128, F64, Bool, Index

NEIGHBOURS = 3
"""Number of targets at rest in the same rows that may together look like one that migrates."""

DEPTHS = (0.35, 0.7, 1.4, 2.8)
"""Rms widths in range of clouds at rest, in addition to thin ones, rows."""


def standing_instead(
    paths: DwellPaths, driving: DwellPaths, bright: tuple[F64, int], row: float, speed: float
) -> list[float]:
    """Logarithms of the likelihoods of targets at rest at the positions of one that moves along the flight.

    There is one at each position, that of the middle dwell first, as shown by the dwell that has the moving one there.
    In the other dwells the response of bright targets there is removed from these columns.

    Args:
        paths: paths of targets that do not move along the flight.
        driving: paths of those that do.
        bright: position (m) in the middle dwell, and number of its elevation.
        row: row in the middle dwell over that of a target at rest.
        speed: velocity of the migration, m/s.
    """
    column = paths.dwells[paths.middle].grid.col_spacing
    places, taken, likelihoods = driving.places(bright[0]), list[int](), list[float]()
    least_apart = 0.75  # least distance of the positions of images that may show different targets, columns
    for dwell in np.argsort(np.abs(paths.seconds), kind="stable").tolist():
        apart = np.abs(driving.drifts - driving.drifts[dwell]) / column
        sight = paths.sight(places[dwell], bright[1])
        if np.all(apart[taken] >= least_apart) and np.isfinite(sight.backgrounds[dwell]):
            sight, shares = _cleared(paths, sight, places, np.where(apart >= least_apart, apart, np.inf))
            there = row + speed * float(paths.seconds[dwell]) / paths.depth
            likelihoods.append(_standing(paths, sight, dwell, there, shares))
            taken.append(dwell)
    return likelihoods


def _cleared(paths: DwellPaths, sight: Sight, places: F64, apart: F64) -> tuple[Sight, F64]:
    """Pixels without the response of targets at distances of columns, at positions (m) in each dwell.

    Returns:
        The pixels, with noise of the same power; the fraction of the amplitude of a target there that they have.
    """
    near = np.isfinite(apart)
    shared = np.where(near, paths.response_along(np.where(near, apart, 0.0)), 0.0)
    shares = np.sqrt(1 - shared**2)
    adjacent = np.array(
        [
            one.column(rows, one.shows(place)[1])[0]
            for one, rows, place in zip(paths.dwells, sight.numbers, places, strict=True)
        ]
    )
    spectra = (sight.spectra - shared[:, None, None] * adjacent) / shares[:, None, None]
    return replace(sight, spectra=spectra.astype(np.complex64)), shares


def _standing(paths: DwellPaths, sight: Sight, dwell: int, row: float, shares: F64) -> float:
    """Logarithm of the likelihood of a target at rest at a position, as a dwell shows it in a row.

    Args:
        paths: paths of targets that do not move along the flight.
        sight: pixels around the position.
        dwell: number of the dwell that shows it.
        row: row over that of a target at rest at the position.
        shares: fractions of the amplitude of a target there that the pixels have, shape (dwells,).
    """
    squints = paths.ambiguous(sight)
    matched, gains = paths.matched_each(sight, squints, dwell, row)
    path = paths.path(sight, row, np.zeros(1))
    likelihoods = paths.ratios(matched, shares * gains, path, squints)
    return max(float(likelihoods.max()), glinting(paths, sight, path, squints, shares))


def glinting(paths: DwellPaths, sight: Sight, path: tuple[F64, F64], still: Index, shares: F64 | float = 1.0) -> float:
    """Logarithm of the likelihood of a target at rest with its centre at another elevation in each dwell.

    Several scatterers in one cell are such a target, as speckle.
    """
    along = np.einsum("nr,nrc->nc", path[0][0], sight.spectra)
    amplitudes = paths.lobes.amplitudes[still]
    squares = np.sum(np.abs(amplitudes) ** 2, axis=-1)
    floor = MODEL_ERROR * squares.max()
    seen = np.abs(np.sum(amplitudes.conj() * along[:, None], axis=-1)) ** 2 / (squares + floor)
    best = seen.argmax(axis=-1)[..., None]
    matched, gains = (np.take_along_axis(one, best, -1)[..., 0] for one in (seen, squares + floor))
    strengths, gains = np.sqrt(matched / sight.backgrounds), np.sqrt(gains / sight.backgrounds)
    return float(ratio_in_dwells(strengths, shares * path[1][0] * gains).max())


def several(
    paths: DwellPaths, sight: Sight, standing: C128, gains: F64, still: Index, row: float, speed: float
) -> float:
    """Logarithm of the likelihood of targets at rest in different rows of the migration."""
    adjacent = abs(speed) * float(np.abs(paths.seconds).max()) / abs(paths.depth) + 1.0
    places: F64 = row + np.arange(-adjacent, adjacent + FINE_STEP / 2, 2 * FINE_STEP, dtype=np.float64)
    return max(_greedy(paths, sight, standing[[one]], gains[[one]], still[[one]], places) for one in range(len(still)))


def _greedy(paths: DwellPaths, sight: Sight, standing: C128, gains: F64, still: Index, places: F64) -> float:
    """The same for one squint: the brightest first, each without the response of those before it."""
    weights, parts = paths.path(sight, places, np.zeros(1))
    found = np.zeros((len(paths.dwells), 0, weights.shape[-1]))
    total = best = 0.0
    for _ in range(NEIGHBOURS):
        left = weights - np.einsum("wnk,nkr->wnr", np.einsum("wnr,nkr->wnk", weights, found), found)
        norms = np.linalg.norm(left, axis=-1)
        left = np.where((norms > LEAST_PART)[..., None], left / np.maximum(norms, 1e-12)[..., None], 0.0)
        energy = np.sum(np.abs(paths.on_path(standing, left)[:, 0]) ** 2, axis=-1)
        one = int(energy.argmax())
        if not energy[one] > 0:
            break
        shown = parts * np.where(norms > LEAST_PART, norms, 0.0)
        total += float(paths.ratios(standing, gains, (left[[one]], shown[[one]]), still)[0, 0])
        best = max(best, total)
        found = np.concatenate([found, left[one][:, None]], axis=1)
    return best


def deep(sight: Sight, standing: C128, gains: F64, row: float) -> float:
    """Logarithm of the likelihood of a cloud at rest that is spread over range."""
    there = sight.numbers - (sight.still + row)[:, None]
    shares = np.exp(-(there**2) / (2 * np.square(DEPTHS)[:, None, None])) * sight.inside
    shares = shares / np.maximum(shares.sum(axis=-1, keepdims=True), 1e-12)
    return max(ratio_over_rows(np.abs(one), gain, shares) for one, gain in zip(standing, gains, strict=True))


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
    # Least power of a target in a dwell over that in the middle one for its position to count: ground is less bright.
    least_power = 0.1
    used = others & (bright >= least_power * bright[paths.middle])
    if not np.any(used):
        used = others & (bright == bright[others].max())
    drifts = course.paths.drifts + shifts[best]
    drift, sigma = _slope(paths, drifts, used)
    drift = min(drift, (1 - least_power) * paths.flight_speed)
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
