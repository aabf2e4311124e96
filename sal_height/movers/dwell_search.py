"""Position and motion of the target in a bright pixel of a dwell, by the dwells before and after.

A target at rest has one position, one row and the squint of its position in all images. A mover has any squint within
the beam; it migrates through rows, and its image along the flight (`dwell_paths`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import logsumexp

from sal_height.movers.dwell_images import COLUMN_STEPS
from sal_height.movers.dwell_paths import Course, DwellPaths, Sight
from sal_height.movers.dwell_places import Placed, deep, glinting, in_place, several, standing_instead
from sal_height.movers.likelihood import HYPOTHESES, MODEL_ERROR, ratio_in_dwells
from sal_height.movers.migration import FINE_STEP
from sal_height.movers.mover import MIGRATING
from sal_height.numeric import C128, F64, Index, vertex

MIGRATION_STEP = 0.25
"""Step of the migration from dwell to dwell in the search, rows."""

COLUMN_ERROR = 0.1
"""Standard deviation of a position along the flight that the response leaves, columns."""


@dataclass(frozen=True)
class Pair:
    """Motion of a target that two dwells show as bright pixels in different columns.

    Attributes:
        along: velocity along the flight, m/s.
        migration: velocity of the migration through rows, m/s.
    """

    along: float
    migration: float


@dataclass(frozen=True, eq=False)
class DwellDetection:
    """The best migration of a target, and its likelihood ratio against a target at rest.

    Attributes:
        row: row in the middle dwell, in fractions.
        squint: squint in the middle dwell, and its standard deviation, rad.
        migration: velocity of its migration, and its standard deviation, m/s.
        along: velocity along the flight, and its standard deviation, m/s.
        along_known: True if that is known well enough to be published.
        migrates: True if it was found by these, and else by its squint.
        ratio: twice the logarithm of the likelihood ratio against no migration, or against a target at rest.
        elevation: elevation, and its standard deviation, rad.
        cnr: power over the background in the middle dwell.
        still_squint: squint of a target at rest in the same pixel, rad.
        place: position of that in map, shape (3,), m.
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
        """True if its migration or its velocity along the flight is significant."""
        return max(abs(value) / sigma for value, sigma in (self.migration, self.along)) > MIGRATING


@dataclass(frozen=True, eq=False)
class DwellSearch:
    """The search about a dwell.

    Attributes:
        paths: paths of targets that do not move along the flight.
    """

    paths: DwellPaths

    @cached_property
    def speeds(self) -> F64:
        """Velocities of the migrations of the search: 0 is in their middle, m/s."""
        step = MIGRATION_STEP * self.paths.speed_of_row
        count = int(np.ceil(self.paths.fastest / step))
        return step * np.arange(-count, count + 1, dtype=np.float64)

    @cached_property
    def along_of_column(self) -> float:
        """Velocity along the flight of a target whose image is a column farther in the next dwell, m/s."""
        paths = self.paths
        column = paths.dwells[paths.middle].grid.col_spacing
        return column / 2 / float(np.min(np.abs(paths.seconds[paths.seconds != 0])))

    @property
    def drifts(self) -> int:
        """Number of velocities along the flight that can be separated."""
        return 1 + 2 * int(np.ceil(self.paths.fastest / self.along_of_column))

    def look(self, row: int, step: int, bright: Mapping[int, Index], rate: float) -> DwellDetection | None:
        """The mover that is bright in a row and at a step of the middle dwell.

        Args:
            row: row of the pixel.
            step: step along the row.
            bright: rows and columns of bright pixels in other dwells, by the number of the dwell.
            rate: rate of false alarms.

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
        # Without migration: under any squint, and under that of a target at rest.
        at_rest = paths.path(sight, fine, np.zeros(1))
        lagging = float(paths.ratios(*matched, at_rest, near).max())
        ground = max(
            float(paths.ratios(standing, ground_gains, at_rest, still).max()), glinting(paths, sight, at_rest, still)
        )
        migrating = Course.matched_by(paths, sight, matched, fine, self.speeds)
        # A target that moves along the flight, against one at rest at each position where it would be.
        driving = self._driving(place, fine, bright)
        if driving and driving.likelihood > migrating.likelihood:
            steered = self._steered(driving)
            needed = 2 * (np.log(HYPOTHESES * len(self.speeds) * self.drifts / rate) + steered.tried)
            if (ratio := self._ratio_of_driving(steered.course, place, lagging)) >= needed:
                return self._moving(steered, ratio, rate)
            if 2 * (steered.course.likelihood - lagging) > needed:
                return None  # it may be one or the other
        # The best of the migrations, against all without migration.
        needed = 2 * np.log(HYPOTHESES * len(self.speeds) / rate)
        ratio = 2 * (migrating.likelihood - max(lagging, ground))
        if ratio > needed:
            rows = several(paths, sight, standing, ground_gains, still, fine, migrating.speed)
            cloud = deep(sight, standing, ground_gains, fine)
            ratio = 2 * (migrating.likelihood - max(lagging, ground, rows, cloud))
        if ratio >= needed:
            return self._moving(self._steered(migrating), ratio, rate)
        # A lag only.
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
        """A target found by its migration; where images are so uncertain that it may have none, one that lags."""
        found = self._described(steered, ratio, migrates=True)
        if found is None or found.goes:
            return found
        if not self.paths.unsure:
            return None
        return self._lagging(self._steered(replace(steered.course, speed=0.0)), rate)

    def _lagging(self, steered: Placed, rate: float) -> DwellDetection | None:
        """A target that only lags, against one at rest in images that are where they show it."""
        course, paths, sight = steered.course, steered.course.paths, steered.course.sight
        still = paths.ambiguous(sight)
        standing, gains = paths.matched_each(sight, still)
        ground = float(paths.ratios(standing, gains, course.path, still).max())
        ratio = 2 * (course.likelihood - max(ground, glinting(paths, sight, course.path, still)))
        # Positions count twice, as a target that fades by chance has bright ground next to it.
        if ratio < 2 * (np.log(HYPOTHESES / rate) + 2 * steered.tried):
            return None
        return self._described(steered, ratio, migrates=False)

    def _ratio_of_driving(self, driving: Course, place: tuple[F64, int], lagging: float) -> float:
        """Twice the logarithm of the likelihood ratio of motion along the flight against targets at rest.

        Args:
            driving: course along the flight.
            place: position of a target at rest, m, and number of its elevation.
            lagging: logarithm of the likelihood of a target that only lags.

        Returns:
            0: others may be bright where it would be (responses of bright targets are known to 0.9 of their
            likelihood), or more than 0.9 of it is in other dwells, which see it better.
        """
        here, *elsewhere = standing_instead(self.paths, driving.paths, place, driving.row, driving.speed)
        own = driving.likelihood - driving.likelihood_of_others
        if driving.likelihood - lagging <= 0.9 * sum(elsewhere) or own <= 0.1 * driving.likelihood:
            return 0.0
        return 2 * (driving.likelihood - here - sum(elsewhere))

    def _driving(self, place: tuple[F64, int], row: float, bright: Mapping[int, Index]) -> Course | None:
        """The likeliest course along the flight from a position and a row; None: no pair of pixels suggests one.

        Args:
            place: position, m, and number of the elevation (`DwellPaths.place_of`).
            row: row over that of a target at rest there.
            bright: rows and columns of bright pixels in other dwells, by the number of the dwell.
        """
        courses = []
        for pair in self._pairs(place[0], bright):
            driving = self.paths.driving(pair.along)
            courses.append(Course.of(driving, driving.sight(*place), row, pair.migration + self._velocities_nearby))
        return max(courses, key=lambda one: one.likelihood, default=None)

    @cached_property
    def _velocities_nearby(self) -> F64:
        """Velocities around the migration of a pair, a row to each side, m/s."""
        return MIGRATION_STEP * self.paths.speed_of_row * np.arange(-4, 5, dtype=np.float64)

    def _pairs(self, place: F64, bright: Mapping[int, Index]) -> list[Pair]:
        """Motions of a target at a position (m) if it is a bright pixel of another dwell, over a column away."""
        paths, pairs = self.paths, []
        for number, pixels in bright.items():
            dwell, seconds = paths.dwells[number], float(paths.seconds[number])
            still, there = dwell.shows(place)
            half = dwell.steps // 2
            columns = ((COLUMN_STEPS * pixels[:, 1] - there + half) % dwell.steps - half) / COLUMN_STEPS
            migrates = (pixels[:, 0] - still) * paths.depth / seconds
            for column, migration in zip(columns.tolist(), migrates.tolist(), strict=True):
                along = paths.along_of(column * dwell.grid.col_spacing / seconds)
                if abs(column) > 1 and abs(migration) <= paths.fastest and abs(along) <= paths.fastest:
                    pairs.append(Pair(along, migration))
        return pairs

    def _belongs_elsewhere(self, course: Course) -> bool:
        """True if another dwell's part of a migration is likelier with another row of the middle one, or squint.

        A bright pixel at rest would otherwise be tied to a mover that the next dwell shows next to it, and a mover be
        published for each dwell that sees it through a sidelobe.
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
        return bool(rivals.max() > own.max() + 1e-6)  # rounding of two logarithms of one likelihood

    def _steered(self, course: Course) -> Placed:
        """The course with the likeliest velocity along the flight about that of another one."""
        if self.paths.unsure:
            return in_place(self.paths, course)
        step = 0.25 * self.along_of_column
        alongs = course.paths.along + step * np.arange(-6, 7)
        driving = [self.paths.driving(along) for along in alongs.tolist()]
        sights = [paths.sight(course.sight.place, course.sight.elevation) for paths in driving]
        # Next to a target, too, the background is that at the target.
        backgrounds, speeds = np.max([one.backgrounds for one in sights], axis=0), np.array([course.speed])
        courses = [
            Course.of(paths, replace(sight, backgrounds=backgrounds), course.row, speeds)
            for paths, sight in zip(driving, sights, strict=True)
        ]
        profile, powers = np.array([one.likelihood for one in courses]), np.array([one.powers for one in courses])
        best = int(np.clip(profile.argmax(), 1, len(alongs) - 2))
        offset, bend = vertex(*profile[best - 1 : best + 2])
        # Not less than dwells differ, by bright pixels next to the target.
        others = (self.paths.seconds != 0) & np.isfinite(backgrounds)
        each = alongs[powers[:, others].argmax(axis=0)] - alongs[best] - step * offset
        weights = powers[best, others] / powers[best, others].sum()
        spread = float(np.sqrt(weights @ each**2))
        sigma = float(np.hypot(np.hypot(step / np.sqrt(bend), COLUMN_ERROR * self.along_of_column), spread))
        likeliest = self.paths.driving(float(alongs[best] + step * offset))
        sight = likeliest.sight(course.sight.place, course.sight.elevation)
        return Placed(Course.of(likeliest, sight, course.row, speeds), sigma, known=True)

    def _described(self, steered: Placed, ratio: float, migrates: bool) -> DwellDetection | None:
        """A target on a course; None: it is at an end of the array, of another row or of another dwell.

        Args:
            steered: course of the target.
            ratio: twice the logarithm of its likelihood ratio.
            migrates: True if it was found by its migration.
        """
        course, unsure = steered.course, steered.sigma
        if self._belongs_elsewhere(course):
            return None
        row, migration, best = self._refined(course)
        course = replace(course, row=row, speed=migration[0])
        squint = self._squint(course, best)
        if squint is None:
            return None
        # The squint depends on the velocity along the flight.
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
        # Rows of targets at rest at the positions of its image are not all its own.
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
            course: course of the target.
            best: number of about the likeliest squint.
        """
        paths, near = course.paths, course.paths.lobes.squints[course.paths.lobes.near]
        elevation = self._elevation(course, float(near[best]))
        if elevation is None:
            return None
        fine = np.linspace(near[0], near[-1], 5 * (len(near) - 1) + 1)
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
        """Row of the target in the middle dwell over that of a target at rest there, in fractions."""
        paths = self.paths
        places: F64 = np.arange(-1.0, 1.0 + FINE_STEP / 2, FINE_STEP)
        numbers, still = sight.numbers[paths.middle], sight.still[paths.middle]
        responses = paths.response(numbers - still - places[:, None])
        energy = np.abs(responses @ moving[:, paths.middle].T) ** 2 / np.sum(responses**2, axis=-1, keepdims=True)
        return float(places[energy.max(axis=-1).argmax()])

    def _refined(self, course: Course) -> tuple[float, tuple[float, float], int]:
        """The likeliest row, migration with its standard deviation (m/s), and number of the squint about a course."""
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
        # The response leaves an error of a hundredth of a row.
        sigma = float(np.hypot(step / np.sqrt(bend), 0.01 * paths.speed_of_row))
        migration = float(speeds[best] + step * offset), sigma
        return float(rows[place]), migration, int(each[place, best].argmax())

    def _elevation(self, course: Course, squint: float) -> tuple[float, float] | None:
        """The most likely elevation of a target under a squint in the middle dwell, and its standard deviation.

        Args:
            course: course of the target.
            squint: squint, rad.

        Returns:
            None: it is that of an outer beam.
        """
        lobes, grid = course.paths.lobes, course.paths.lobes.elevations
        along = np.einsum("nr,nrc->nc", course.path[0][0], course.sight.spectra)
        amplitudes = course.paths.beams.response(grid[:, None] + lobes.higher, squint + lobes.ahead)
        gains = np.sum(np.abs(amplitudes) ** 2, axis=-1)
        used = (gains > 0.1 * gains.max()) & np.isfinite(course.sight.backgrounds)
        seen = np.abs(np.sum(amplitudes.conj() * along, axis=-1)) ** 2 / np.maximum(gains, 1e-12)
        # Dwells by themselves, as the target fades; one of low gain contributes little and may be wrong.
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
