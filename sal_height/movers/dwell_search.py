"""What a bright pixel of a dwell is, by what the dwells before and after show: where it was, and how it went on.

What stands still has one place, one row and the squint of its place in all images. A mover has any squint within the
beam; it walks through rows, and its image along the flight (`dwell_paths`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import logsumexp

from sal_height.movers.dwell_course import Course
from sal_height.movers.dwell_images import COLUMN_STEPS
from sal_height.movers.dwell_paths import DwellPaths, Sight
from sal_height.movers.dwell_places import Placed, in_place
from sal_height.movers.dwell_still import deep, glinting, several, standing_instead
from sal_height.movers.likelihood import HYPOTHESES, MODEL_ERROR, ratio_in_dwells
from sal_height.movers.migration import FINE_STEP
from sal_height.numeric import C128, F64, Index, vertex

FINE_SQUINTS = 5
"""Steps of the squint of what is found, in one of these."""

WALK_STEP = 0.25
"""Of the walk from dwell to dwell in the search, in rows."""

BESIDE_WALK = 4
"""Steps of the walk to each side of that by which another dwell shows a bright pixel."""

WALK_ERROR = 0.01
"""Standard deviation of the walk from dwell to dwell that the response leaves, in rows."""

DRIFT_STEP, DRIFT_STEPS = 0.25, 6
"""Of the drift from dwell to dwell, in columns, and how many of them to each side it is looked for."""

DRIFT_ERROR = 0.1
"""Standard deviation of the drift from dwell to dwell that the response leaves, in columns."""

SAME_COLUMNS = 1.0
"""Up to which pixels of dwells that follow each other are taken for those of what does not drive along the flight."""

LEAST_GAIN = 0.1
"""Of the beam over the greatest, as a power, with which a dwell counts in the elevation."""

MIGRATING = 5.0
"""Standard deviations of the velocity of the walk, or along the flight, from which what moves is taken to walk."""

KNOWN_PART = 0.9
"""Of the likelihood of bright targets, to which their responses are known."""

LEAST_SHARE = 0.1
"""Of the likelihood of what drives along the flight that the dwell must have whose bright pixel is looked at."""

ROUNDING = 1e-6
"""By how much two logarithms of one likelihood may differ."""


@dataclass(frozen=True)
class Pair:
    """How a target would move of which two dwells show a bright pixel in different columns.

    Attributes:
        along: velocity along the flight, m/s.
        walk: velocity of the walk through rows, m/s.
    """

    along: float
    migration: float


@dataclass(frozen=True, eq=False)
class DwellDetection:
    """The best walk of a target, and how much likelier it is than what stands still.

    Attributes:
        row: in the middle dwell, in fractions.
        squint: under which that saw it, and its standard deviation, rad.
        walk: velocity of its walk, and its standard deviation, m/s.
        along: velocity along the flight, and its standard deviation, m/s.
        tells_along: whether that is known well enough to be told.
        walks: whether it was found by these, and else by its squint.
        ratio: twice the logarithm of the likelihood ratio against what does not walk, or against what stands still.
        elevation: and its standard deviation, rad.
        cnr: power over the background in the middle dwell.
        still_squint: of what stands still in the same pixel, rad.
        place: of that, in map, m, shape (3,).
    """

    row: float
    squint: tuple[float, float]
    migration: tuple[float, float]
    along: tuple[float, float]
    along_known: bool
    migrates: bool
    ratio: float
    elevation: tuple[float, float]
    cnr: float
    still_squint: float
    place: F64

    @property
    def goes(self) -> bool:
        """Whether its walk or its velocity along the flight is beyond what they may be off."""
        return max(abs(value) / sigma for value, sigma in (self.migration, self.along)) > MIGRATING


@dataclass(frozen=True, eq=False)
class DwellSearch:
    """The search about a dwell.

    Attributes:
        paths: of targets that do not drive along the flight.
    """

    paths: DwellPaths

    @cached_property
    def speeds(self) -> F64:
        """Velocities of the walks that are looked for, m/s: 0 is in their middle."""
        step = WALK_STEP * self.paths.speed_of_row
        count = int(np.ceil(self.paths.fastest / step))
        return step * np.arange(-count, count + 1, dtype=np.float64)

    @cached_property
    def along_of_column(self) -> float:
        """Velocity along the flight of what has its image a column farther in the next dwell, m/s."""
        paths = self.paths
        column = paths.dwells[paths.middle].grid.col_spacing
        return column / 2 / float(np.min(np.abs(paths.seconds[paths.seconds != 0])))

    @property
    def drifts(self) -> int:
        """Number of velocities along the flight that can be told apart."""
        return 1 + 2 * int(np.ceil(self.paths.fastest / self.along_of_column))

    def look(self, row: int, step: int, bright: Mapping[int, Index], rate: float) -> DwellDetection | None:
        """What is bright in a row and at a step of the middle dwell.

        Args:
            row: of the pixel.
            step: along the row.
            bright: rows and columns of what is bright in other dwells, by their number.
            rate: of false alarms.

        Returns:
            None: it does not move, or is at an end of the array or of the rows.
        """
        paths, near = self.paths, self.paths.lobes.near
        place = paths.place_of(row, step)
        if place is None:
            return None
        sight = paths.sight(*place)
        matched = paths.matched(sight, near)
        still = paths.ambiguous(sight)
        standing, ground_gains = paths.matched_each(sight, still)
        fine = self._brightest(sight, matched[0])
        # Without a walk: under any squint, and under that of what stands still.
        at_rest = paths.path(sight, fine, np.zeros(1))
        lagging = float(paths.ratios(*matched, at_rest, near).max())
        ground = max(
            float(paths.ratios(standing, ground_gains, at_rest, still).max()), glinting(paths, sight, at_rest, still)
        )
        migrating = Course.matched_by(paths, sight, matched, fine, self.speeds)
        # What drives along the flight, against one that stands still at each place where it would be.
        driving = self._driving(place, fine, bright)
        if driving and driving.likelihood > migrating.likelihood:
            steered = self._steered(driving)
            needed = 2 * (np.log(HYPOTHESES * len(self.speeds) * self.drifts / rate) + steered.tried)
            if (ratio := self._ratio_of_driving(steered.course, place, lagging)) >= needed:
                return self._moving(steered, ratio, rate)
            if 2 * (steered.course.likelihood - lagging) > needed:
                return None  # it may be one or the other
        # The best of the walks, against all that does not walk.
        needed = 2 * np.log(HYPOTHESES * len(self.speeds) / rate)
        ratio = 2 * (migrating.likelihood - max(lagging, ground))
        if ratio > needed:
            rows = several(paths, sight, standing, ground_gains, still, fine, migrating.speed)
            cloud = deep(sight, standing, ground_gains, fine)
            ratio = 2 * (migrating.likelihood - max(lagging, ground, rows, cloud))
        if ratio >= needed:
            return self._moving(self._steered(migrating), ratio, rate)
        # What only lags.
        lags = Course.matched_by(paths, sight, matched, fine, np.zeros(1))
        if paths.unsure:
            return self._lagging(self._steered(lags), rate)
        ratio = 2 * (lags.likelihood - ground)
        return (
            self._described(self._steered(lags), ratio, migrates=False)
            if ratio >= 2 * np.log(HYPOTHESES / rate)
            else None
        )

    def _moving(self, steered: Placed, ratio: float, rate: float) -> DwellDetection | None:
        """What was found by its walk; if images are so unsure that it may have none, what lags."""
        found = self._described(steered, ratio, migrates=True)
        if found is None or found.goes:
            return found
        if not self.paths.unsure:
            return None
        return self._lagging(self._steered(replace(steered.course, speed=0.0)), rate)

    def _lagging(self, steered: Placed, rate: float) -> DwellDetection | None:
        """What only lags, against what stands still in images that lie where they show it."""
        course, paths, sight = steered.course, steered.course.paths, steered.course.sight
        still = paths.ambiguous(sight)
        standing, gains = paths.matched_each(sight, still)
        ground = float(paths.ratios(standing, gains, course.path, still).max())
        ratio = 2 * (course.likelihood - max(ground, glinting(paths, sight, course.path, still)))
        # Places count twice, as what fades by chance has bright ground beside it.
        if ratio < 2 * (np.log(HYPOTHESES / rate) + 2 * steered.tried):
            return None
        return self._described(steered, ratio, migrates=False)

    def _ratio_of_driving(self, driving: Course, place: tuple[F64, int], lagging: float) -> float:
        """Twice the logarithm of the likelihood ratio of what drives along the flight against what stands still.

        Args:
            driving: the course.
            place: of what stands still, m, and number of its elevation.
            lagging: logarithm of the likelihood of what only lags.

        Returns:
            0: others may be bright where it would be, or most of it is in other dwells, which see it better.
        """
        here, *elsewhere = standing_instead(self.paths, driving.paths, place, driving.row, driving.speed)
        own = driving.likelihood - driving.likelihood_of_others
        if driving.likelihood - lagging <= KNOWN_PART * sum(elsewhere) or own <= LEAST_SHARE * driving.likelihood:
            return 0.0
        return 2 * (driving.likelihood - here - sum(elsewhere))

    def _driving(self, place: tuple[F64, int], row: float, bright: Mapping[int, Index]) -> Course | None:
        """The likeliest course along the flight from a place and a row; None: there is none.

        Args:
            place: m, and number of the elevation (`DwellPaths.place_of`).
            row: over that of what stands still there.
            bright: rows and columns of what is bright in other dwells, by their number.
        """
        courses = []
        for pair in self._pairs(place[0], bright):
            driving = self.paths.driving(pair.along)
            courses.append(Course.of(driving, driving.sight(*place), row, pair.migration + self._velocities_nearby))
        return max(courses, key=lambda one: one.likelihood, default=None)

    @cached_property
    def _velocities_nearby(self) -> F64:
        """Walks beside the one of a pair that are looked for, over that, m/s."""
        return WALK_STEP * self.paths.speed_of_row * np.arange(-BESIDE_WALK, BESIDE_WALK + 1, dtype=np.float64)

    def _pairs(self, place: F64, bright: Mapping[int, Index]) -> list[Pair]:
        """How what would stand still at a place (m) would move if it is what other dwells show in another column."""
        paths, pairs = self.paths, []
        for number, pixels in bright.items():
            dwell, seconds = paths.dwells[number], float(paths.seconds[number])
            still, there = dwell.shows(place)
            half = dwell.steps // 2
            columns = ((COLUMN_STEPS * pixels[:, 1] - there + half) % dwell.steps - half) / COLUMN_STEPS
            migrates = (pixels[:, 0] - still) * paths.depth / seconds
            for column, migration in zip(columns.tolist(), migrates.tolist(), strict=True):
                along = paths.along_of(column * dwell.grid.col_spacing / seconds)
                if abs(column) > SAME_COLUMNS and abs(migration) <= paths.fastest and abs(along) <= paths.fastest:
                    pairs.append(Pair(along, migration))
        return pairs

    def _belongs_elsewhere(self, course: Course) -> bool:
        """Whether what another dwell shows of a walk is likelier with another row of the middle one, or another squint.

        A bright pixel that stands still would otherwise be tied to a mover that the next dwell shows beside it, and a
        mover be told in each dwell that sees it through a sidelobe.
        """
        paths, sight, near = course.paths, course.sight, course.paths.lobes.near
        everywhere = np.arange(len(paths.lobes.squints))
        matched, gains = paths.matched_each(sight, everywhere)
        matched[near], gains[near] = course.moving, course.gains
        path = paths.path(sight, course.row, np.array([course.speed]))
        own = paths.ratios(matched[near], gains[near], path, near)[0]
        powers = np.abs(paths.on_path(matched[near], path[0])[0, int(own.argmax())]) ** 2 * (paths.seconds != 0)
        tied = paths.seconds[int(powers.argmax())]
        speeds = np.append(self.speeds, course.speed)
        rows: F64 = course.row + (course.speed - speeds) * tied / paths.depth
        rivals = paths.ratios(matched, gains, paths.path(sight, rows, speeds), everywhere)
        return bool(rivals.max() > own.max() + ROUNDING)

    def _steered(self, course: Course) -> Placed:
        """The course about one whose velocity along the flight is the likeliest."""
        if self.paths.unsure:
            return in_place(self.paths, course)
        step = DRIFT_STEP * self.along_of_column
        alongs = course.paths.along + step * np.arange(-DRIFT_STEPS, DRIFT_STEPS + 1)
        driving = [self.paths.driving(along) for along in alongs.tolist()]
        sights = [paths.sight(course.sight.place, course.sight.elevation) for paths in driving]
        # Beside a target, too, the background is what it has where the target is.
        backgrounds, speeds = np.max([one.backgrounds for one in sights], axis=0), np.array([course.speed])
        courses = [
            Course.of(paths, replace(sight, backgrounds=backgrounds), course.row, speeds)
            for paths, sight in zip(driving, sights, strict=True)
        ]
        profile, powers = np.array([one.likelihood for one in courses]), np.array([one.powers for one in courses])
        best = int(np.clip(profile.argmax(), 1, len(alongs) - 2))
        offset, bend = vertex(*profile[best - 1 : best + 2])
        # Not less than dwells differ, by bright pixels beside the target.
        others = (self.paths.seconds != 0) & np.isfinite(backgrounds)
        each = alongs[powers[:, others].argmax(axis=0)] - alongs[best] - step * offset
        weights = powers[best, others] / powers[best, others].sum()
        spread = float(np.sqrt(weights @ each**2))
        sigma = float(np.hypot(np.hypot(step / np.sqrt(bend), DRIFT_ERROR * self.along_of_column), spread))
        likeliest = self.paths.driving(float(alongs[best] + step * offset))
        sight = likeliest.sight(course.sight.place, course.sight.elevation)
        return Placed(Course.of(likeliest, sight, course.row, speeds), sigma, known=True)

    def _described(self, steered: Placed, ratio: float, migrates: bool) -> DwellDetection | None:
        """A target on a course; None: it is at an end of the array, of another row or of another dwell.

        Args:
            steered: course of the target.
            ratio: twice the logarithm of its likelihood ratio.
            migrates: whether it was found by its range migration.
        """
        course, unsure = steered.course, steered.sigma
        if self._belongs_elsewhere(course):
            return None
        row, migration, best = self._refined(course)
        course = replace(course, row=row, speed=migration[0])
        squint = self._squint(course, best)
        if squint is None:
            return None
        # The squint goes with the velocity along the flight.
        paths, sight = course.paths, course.sight
        faster = self.paths.driving(paths.along + unsure)
        if self.paths.unsure:
            faster = self.paths.driving(faster.along, paths.drifts - faster.drifts)
        moved = self._squint(replace(course, paths=faster, sight=faster.sight(sight.place, sight.elevation)), best)
        if moved is None:
            return None
        squint = squint[0], float(np.hypot(squint[1], moved[0] - squint[0]))
        elevation = self._elevation(course, squint[0])
        if elevation is None:
            return None
        power = float(np.abs(paths.on_path(course.moving, course.path[0])[0, best, paths.middle]) ** 2)
        still = sight.squint + paths.ground[0]
        there = sight.still[paths.middle] + row
        # The rows of what stands still at the places of the image are not all its own.
        aperture = paths.dwells[paths.middle].aperture
        ahead = float((sight.place - aperture.position) @ aperture.direction) / paths.reach
        migration = migration[0] + ahead * paths.drift, migration[1]
        return DwellDetection(
            there,
            squint,
            migration,
            (paths.along, unsure),
            steered.known,
            migrates,
            ratio,
            elevation,
            power,
            still,
            sight.place,
        )

    def _squint(self, course: Course, best: int) -> tuple[float, float] | None:
        """Mean and standard deviation of the likely squints in the middle dwell; None: those of another dwell.

        Args:
            course: of the target.
            best: number of about the likeliest.
        """
        paths, near = course.paths, course.paths.lobes.squints[course.paths.lobes.near]
        elevation = self._elevation(course, float(near[best]))
        if elevation is None:
            return None
        fine = np.linspace(near[0], near[-1], FINE_SQUINTS * (len(near) - 1) + 1)
        under = fine[:, None] + paths.lobes.ahead
        matched, gains = paths.matching(course.sight, paths.beams.response(elevation[0] + paths.lobes.higher, under))
        weights, parts = course.path
        logarithms = ratio_in_dwells(np.abs(paths.on_path(matched, weights))[0], gains * parts[0])
        if logarithms.argmax() in (0, len(fine) - 1):
            return None
        weight = np.exp(logarithms - logsumexp(logarithms))
        squint = float(weight @ fine)
        return squint, float(np.sqrt(weight @ (fine - squint) ** 2 + (fine[1] - fine[0]) ** 2 / 12))

    def _brightest(self, sight: Sight, moving: C128) -> float:
        """Row of the target in the middle dwell, over that of what stands still there, in fractions."""
        paths = self.paths
        places: F64 = np.arange(-1.0, 1.0 + FINE_STEP / 2, FINE_STEP)
        numbers, still = sight.numbers[paths.middle], sight.still[paths.middle]
        responses = paths.response(numbers - still - places[:, None])
        energy = np.abs(responses @ moving[:, paths.middle].T) ** 2 / np.sum(responses**2, axis=-1, keepdims=True)
        return float(places[energy.max(axis=-1).argmax()])

    def _refined(self, course: Course) -> tuple[float, tuple[float, float], int]:
        """The row, the walk with its standard deviation, and the number of the squint about some that are likeliest."""
        paths, sight = course.paths, course.sight
        step = FINE_STEP * paths.speed_of_row
        speeds = course.speed + step * np.arange(-6, 7, dtype=np.float64)
        rows = course.row + FINE_STEP * np.arange(-4, 5, dtype=np.float64)
        each = np.array(
            [
                paths.ratios(course.moving, course.gains, paths.path(sight, one, speeds), paths.lobes.near)
                for one in rows
            ]
        )
        profile = each.max(axis=(0, 2))
        best = int(np.clip(profile.argmax(), 1, len(speeds) - 2))
        offset, bend = vertex(*profile[best - 1 : best + 2])
        place = int(each[:, best].max(axis=-1).argmax())
        sigma = float(np.hypot(step / np.sqrt(bend), WALK_ERROR * paths.speed_of_row))
        migration = float(speeds[best] + step * offset), sigma
        return float(rows[place]), migration, int(each[place, best].argmax())

    def _elevation(self, course: Course, squint: float) -> tuple[float, float] | None:
        """The most likely elevation of a target under a squint in the middle dwell, and its standard deviation.

        Args:
            course: of the target.
            squint: rad.

        Returns:
            None: it is that of an outer beam.
        """
        lobes, grid = course.paths.lobes, course.paths.lobes.elevations
        along = np.einsum("nr,nrc->nc", course.path[0][0], course.sight.spectra)
        amplitudes = course.paths.beams.response(grid[:, None] + lobes.higher, squint + lobes.ahead)
        gains = np.sum(np.abs(amplitudes) ** 2, axis=-1)
        used = (gains > LEAST_GAIN * gains.max()) & np.isfinite(course.sight.backgrounds)
        seen = np.abs(np.sum(amplitudes.conj() * along, axis=-1)) ** 2 / np.maximum(gains, 1e-12)
        # Dwells by themselves, as the target fades; one whose gain is low tells little and may be wrong.
        weight = used[int(np.where(used, seen, 0.0).sum(axis=-1).argmax())]
        explained = seen @ weight
        best = int(explained.argmax())
        if not 0 < best < len(grid) - 1:
            return None
        offset, bend = vertex(*explained[best - 1 : best + 2])
        left = float(np.sum(np.abs(along[weight]) ** 2)) - explained[best]
        error = max(left / (weight.sum() * (along.shape[-1] - 1)), MODEL_ERROR * explained[best] / along.shape[-1])
        step = grid[1] - grid[0]
        return float(grid[best] + step * offset), float(np.sqrt(error * step**2 / bend))
