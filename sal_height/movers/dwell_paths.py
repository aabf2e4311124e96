"""Pixels of successive dwells along the path of a target, amplitudes of the beams there, and the likelihood of both.

Dwell n, at the time t_n after the one in whose image the target is bright, has it in the row r + w t_n, if it recedes
with the velocity w over that of its image, and under the squint s + s_n, s_n being the difference for a position at
rest.

Where a target moves along the flight with the velocity u, and the antenna flies on with v, the position of its image,
by its Doppler frequency, advances by u (2 - u / v) t_n, and its squint by u t_n over the range R: the target is
x = x_0 + (u - v) t_n ahead of the antenna, and its image (1 - u / v) x - v_r R / v.

If the image of a dwell is offset along the flight, so are the target and the beam in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from sal_height.beams import Beams, column_squint
from sal_height.geometry import locate_at_elevation
from sal_height.imaging import Slc
from sal_height.movers.dwell_images import DwellImage
from sal_height.movers.likelihood import MODEL_ERROR, POWERS_IN_DWELLS, ratio_in_dwells
from sal_height.movers.migration import REACH
from sal_height.movers.search import ELEVATION_STEP, ground_lag
from sal_height.movers.spectrum import point_response
from sal_height.numeric import C64, C128, F64, Bool, Index
from sal_height.sensor import Sensor

FARTHEST = 3.2
"""Largest squint in the middle dwell, beamwidths along the flight."""


LEAST_PART = 0.5
"""Least fraction of the amplitude of a target's response within the image, and without that of the targets before."""


@dataclass(frozen=True, eq=False)
class Lobes:
    """Amplitudes of the channels in each dwell for targets in all directions.

    Attributes:
        squints: squints in the middle dwell, shape (squints,), rad.
        elevations: elevations in the middle dwell, shape (elevations,), rad.
        amplitudes: amplitudes of the channels, shape (squints, dwells, elevations, channels).
        ahead: squint of a position in each dwell less that in the middle one, shape (dwells,), rad.
        higher: difference of the elevation likewise, rad.
        known: True where the squint in a dwell is in the main lobe, shape (squints, dwells).
        near: numbers of the squints that a mover of the middle dwell may have.
    """

    squints: F64
    elevations: F64
    amplitudes: F64 | C128
    ahead: F64
    higher: F64
    known: Bool
    near: Index

    @classmethod
    def of(cls, beams: Beams, ahead: F64, higher: F64) -> Self:
        """Amplitudes by the differences of squint and elevation of a position between dwells, rad."""
        width = beams.track_beamwidth
        step = 0.05  # beamwidths
        count = round(FARTHEST / step)
        squints = width * step * np.arange(-count, count + 1, dtype=np.float64)
        elevations = np.arange(*beams.domain(0.0), ELEVATION_STEP * beams.beamwidth, dtype=np.float64)
        under = squints[:, None, None] + ahead[:, None]
        amplitudes = beams.response(elevations + higher[:, None], under)
        lobe = max(pattern.main_lobe for pattern in beams.patterns) * width
        others = np.abs(ahead[ahead != 0])
        # Half way to the next dwell, and 0.15 beamwidths more.
        reach = (others.min() / 2 if len(others) else 0.0) + 0.15 * width
        known, near = np.abs(under[..., 0]) < lobe, np.flatnonzero(np.abs(squints) <= reach)
        return cls(squints, elevations, amplitudes, ahead, higher, known, near)

    def turned(self, ahead: F64) -> Self:
        """Amplitudes for targets that each dwell sees farther ahead, by angles of shape (dwells,), rad.

        Angles are rounded to steps; beyond the outermost squints, amplitudes are those of the outermost.
        """
        step, last = self.squints[1] - self.squints[0], len(self.squints) - 1
        numbers = np.arange(len(self.squints))[:, None] + np.rint(ahead / step).astype(np.intp)
        numbers = np.clip(numbers, 0, last)
        dwells = np.arange(len(ahead))
        amplitudes, known = self.amplitudes[numbers, dwells], self.known[numbers, dwells]
        return replace(self, amplitudes=amplitudes, known=known, ahead=self.ahead + ahead)

    def nearest(self, squints: F64) -> Index:
        """Numbers of the squints nearest to some, without those that are beyond all."""
        numbers = np.rint((squints - self.squints[0]) / (self.squints[1] - self.squints[0])).astype(np.intp)
        return numbers[(numbers >= 0) & (numbers < len(self.squints))]


@dataclass(frozen=True, eq=False)
class Sight:
    """Pixels around the position of a bright one, in all dwells.

    Attributes:
        numbers: numbers of the rows, shape (dwells, rows).
        inside: True where these are in the image, same shape.
        still: row of a target at rest at that position in each dwell, shape (dwells,).
        spectra: pixels, shape (dwells, rows, channels).
        backgrounds: power of noise and ground, shape (dwells,); infinite: the dwell does not have these rows.
        elevation: number of the elevation.
        squint: squint of a target at rest in the middle dwell, rad.
        place: position of a target at rest, in map, shape (3,), m.
    """

    numbers: Index
    inside: Bool
    still: F64
    spectra: C64
    backgrounds: F64
    elevation: int
    squint: float
    place: F64


@dataclass(frozen=True, eq=False)
class DwellPaths:
    """Dwells, and the paths of targets through them.

    Attributes:
        dwells: successive dwells.
        middle: number of the dwell in whose image targets are bright.
        beams: beams of the channels.
        lobes: amplitudes of these in the directions of the search.
        seconds: times of the dwells after the middle one, shape (dwells,), s.
        depth: slant range from a row to the next, m.
        spacing: slant range from a row to the next, range resolutions.
        window: window over the band, a name of `windows.WINDOWS`.
        window_along: window over the pulses, likewise.
        reach: slant range of the middle, m.
        fastest: largest velocity of the search, m/s.
        ground: lag of the ground from its position in the image, and its standard deviation, rad.
        along: velocity of targets along the flight, m/s.
        offsets: offsets of the images along the flight from that of the middle dwell, shape (dwells,), m.
    """

    dwells: Sequence[DwellImage]
    middle: int
    beams: Beams
    lobes: Lobes
    seconds: F64
    depth: float
    spacing: float
    window: str
    window_along: str
    reach: float
    fastest: float
    ground: tuple[float, float]
    along: float = 0.0
    offsets: F64 | float = 0.0

    @classmethod
    def of(
        cls, dwells: Sequence[DwellImage], middle: int, beams: Beams, slc: Slc, sensor: Sensor, fastest: float
    ) -> Self:
        """Paths through the `middle` one of some dwells, which was made from `slc`, up to a velocity (m/s)."""
        there = dwells[middle]
        grid = there.grid
        place = grid.middle
        sight = place - there.aperture.position
        angles = np.array([one.angles(place) for one in dwells])
        higher, ahead = (angles - angles[middle]).T
        lobes = Lobes.of(beams, ahead, higher)
        reach = float(np.linalg.norm(sight))
        depth = grid.row_spacing * float(grid.row_direction @ sight) / reach
        seconds = np.array([one.seconds - there.seconds for one in dwells])
        cells = abs(depth) / sensor.range_resolution
        lags = lobes.squints[np.abs(lobes.squints) <= 1.6 * beams.track_beamwidth]

        def spectra() -> tuple[F64, F64]:
            aspects = column_squint(grid, there.aperture, beams, sensor.look_side)
            return there.power, beams.power(float(np.mean(beams.span)), aspects + lags[:, None])

        return cls(
            dwells,
            middle,
            beams,
            lobes,
            seconds,
            depth,
            cells,
            slc.range_window,
            slc.azimuth_window,
            reach,
            fastest,
            ground_lag(slc, sensor, lags, spectra),
        )

    def driving(self, along: float, offsets: F64 | float = 0.0) -> Self:
        """Paths of targets with a velocity along the flight (m/s), in images with offsets along the flight (m)."""
        lobes = self.lobes.turned((along * self.seconds + offsets) / self.reach)
        return replace(self, along=along, offsets=offsets, lobes=lobes)

    @cached_property
    def errors(self) -> F64:
        """Standard deviations of the independent offsets of the images along the flight, shape (dwells,), m."""
        return np.array([one.error for one in self.dwells])

    @property
    def unsure(self) -> bool:
        """True if these count: a twentieth of a column or more."""
        return bool(self.errors.max() > 0.05 * self.dwells[self.middle].grid.col_spacing)

    @cached_property
    def flight_speed(self) -> float:
        """Speed of the antenna, m/s."""
        return float(np.linalg.norm(self.dwells[self.middle].aperture.velocity))

    @property
    def drift(self) -> float:
        """Velocity of the position of the image along the flight, m/s."""
        return self.along * (2 - self.along / self.flight_speed)

    @property
    def drifts(self) -> F64:
        """Advance of that in the image of each dwell, shape (dwells,), m."""
        return self.drift * self.seconds + self.offsets

    def along_of(self, drift: float) -> float:
        """Velocity along the flight of a target whose image advances by `drift` (m/s); NaN: no target does, m/s."""
        share = 1 - drift / self.flight_speed
        return self.flight_speed * (1 - float(np.sqrt(share))) if share >= 0 else float("nan")

    def places(self, place: F64) -> F64:
        """Positions of the image in each dwell, shape (dwells, 3), from that in the middle one, m."""
        return place + self.drifts[:, None] * self.dwells[self.middle].aperture.direction

    @cached_property
    def speed_of_row(self) -> float:
        """Velocity of a target that migrates by a row from the middle dwell to the next one, m/s."""
        return abs(self.depth) / float(np.min(np.abs(self.seconds[self.seconds != 0])))

    def place_of(self, row: int, step: int) -> tuple[F64, int] | None:
        """Position (m) and number of the elevation of a target at rest in a pixel of the middle dwell.

        Returns:
            None: it is at an end of the array or of the rows.
        """
        there = self.dwells[self.middle]
        if not REACH <= row < there.grid.rows - REACH:
            return None
        lobes = self.lobes
        # Elevation of a target in the main lobe.
        amplitudes = lobes.amplitudes[lobes.near[:: max(1, len(lobes.near) // 6)], self.middle]
        pixel = there.pixels[:, row, step]
        seen = np.abs(amplitudes.conj() @ pixel) ** 2 / np.sum(np.abs(amplitudes) ** 2, axis=-1)
        number = int(seen.max(axis=0).argmax())
        if not 0 < number < len(lobes.elevations) - 1:
            return None
        point = there.grid.points(row, step / (there.steps / there.grid.cols))
        line = point - there.aperture.position
        along, reach = float(line @ there.aperture.direction), float(np.linalg.norm(line))
        place = locate_at_elevation(lobes.elevations[number], reach, along, there.aperture, there.look_side)
        return place, number

    def sight(self, place: F64, elevation: int) -> Sight:
        """Pixels around the image of a target at a position (m) in the middle dwell, by the number of its elevation.

        The background is taken from 8 rows and 2 columns to each side. It has at least the power of sidelobes of the
        image, -35 dB of the brightest pixel.
        """
        lobes = self.lobes
        spread = int(np.ceil(self.fastest * np.abs(self.seconds).max() / abs(self.depth))) + REACH
        beam = lobes.amplitudes[len(lobes.squints) // 2, self.middle, elevation]
        beam = beam / np.linalg.norm(beam)
        numbers, inside, still, spectra, backgrounds = [], [], [], [], []
        for one, there in zip(self.dwells, self.places(place), strict=True):
            at, column = one.shows(there)
            rows = round(at) + np.arange(-spread, spread + 1)
            pixels, within = one.column(rows, column)
            around = np.abs(beam.conj() @ one.around(round(at), column, (8, 2))) ** 2
            level = float(np.median(around)) / np.log(2) if around.size else np.inf
            brightest = float(max(np.max(np.abs(pixels @ beam.conj()) ** 2), np.max(around, initial=0.0)))
            numbers.append(rows)
            inside.append(within)
            still.append(at)
            spectra.append(pixels)
            backgrounds.append(max(level, 10**-3.5 * brightest, 1e-300))
        _, squint = self.dwells[self.middle].angles(place)
        return Sight(
            numbers=np.array(numbers),
            inside=np.array(inside),
            still=np.array(still),
            spectra=np.array(spectra),
            backgrounds=np.array(backgrounds),
            elevation=elevation,
            squint=squint,
            place=place,
        )

    def ambiguous(self, sight: Sight) -> Index:
        """Numbers of the squints that a target at rest may have, there and at its azimuth ambiguities, to 3 sigma."""
        there = self.dwells[self.middle]
        reach = float(np.linalg.norm(there.grid.points(sight.still[self.middle], 0) - there.aperture.position))
        turns = np.arange(-2, 3) * (there.period / reach)
        step = self.lobes.squints[1] - self.lobes.squints[0]
        unsure = int(np.ceil(3 * self.ground[1] / step)) + 1
        about = step * np.arange(-unsure, unsure + 1, dtype=np.float64)
        return np.unique(self.lobes.nearest(np.add.outer(sight.squint + self.ground[0] + turns, about).ravel()))

    def matched(self, sight: Sight, squints: Index) -> tuple[C128, F64]:
        """Amplitudes matched to targets under numbered squints, and gains of the beam, over the background's.

        Returns:
            Shapes (squints, dwells, rows) and (squints, dwells).
        """
        return self.matching(sight, self.lobes.amplitudes[squints, :, sight.elevation])

    def matched_each(
        self, sight: Sight, squints: Index, dwell: int | None = None, row: float = 0.0
    ) -> tuple[C128, F64]:
        """The same, each squint with the elevation that explains the bright pixel best.

        In a sidelobe that is another one than in the main lobe. The pixel is that of a dwell, the middle one if it is
        None, in a row over that of a target at rest.
        """
        dwell = self.middle if dwell is None else dwell
        amplitudes = self.lobes.amplitudes[squints, dwell]
        gains = np.sum(np.abs(amplitudes) ** 2, axis=-1)
        number = int(np.clip(round(sight.spectra.shape[1] // 2 + row), 0, sight.spectra.shape[1] - 1))
        there = sight.spectra[dwell, number]
        seen = np.abs(amplitudes.conj() @ there) ** 2 / (gains + MODEL_ERROR * gains.max())
        elevations = seen.argmax(axis=-1)
        chosen = np.moveaxis(self.lobes.amplitudes[squints], 2, 1)[np.arange(len(squints)), elevations]
        return self.matching(sight, chosen)

    def matching(self, sight: Sight, amplitudes: F64 | C128) -> tuple[C128, F64]:
        """The same for beams of the shape (squints, dwells, channels); gains contain the error of the beams."""
        gains = np.linalg.norm(amplitudes, axis=-1)
        level = np.sqrt(sight.backgrounds)
        found = np.einsum("snc,nrc->snr", amplitudes.conj(), sight.spectra)
        found = found / (np.maximum(gains, 1e-12) * level)[..., None]
        greatest = np.linalg.norm(self.lobes.amplitudes[len(self.lobes.squints) // 2, self.middle, sight.elevation])
        return np.asarray(found), np.hypot(gains, np.sqrt(MODEL_ERROR) * greatest) / level

    def response(self, rows: F64) -> F64:
        """Amplitude of a target at distances from it, rows."""
        return point_response(self.window, self.spacing, rows)

    def response_along(self, columns: F64) -> F64:
        """Amplitude of a target at distances from it in columns, of which each Doppler frequency has one."""
        return point_response(self.window_along, 1.0, columns)

    def path(self, sight: Sight, row: float | F64, speeds: F64) -> tuple[F64, F64]:
        """Weights of the rows of each dwell along migrations from a row over that of a target at rest.

        Returns:
            Weights, sum of squares 1, shape (speeds, dwells, rows); the part of the response's amplitude that is in the
            image, shape (speeds, dwells).
        """
        there = sight.still + np.asarray(row)[..., None] + speeds[:, None] * self.seconds / self.depth
        responses = self.response(sight.numbers - there[..., None])
        whole = np.linalg.norm(responses, axis=-1)
        responses = responses * sight.inside
        norms = np.linalg.norm(responses, axis=-1)
        weights = responses / np.maximum(norms, 1e-12)[..., None]
        parts = norms / np.maximum(whole, 1e-12)
        parts = np.where(parts > LEAST_PART, parts, 0.0)
        return weights * (parts[..., None] > 0), parts

    def on_path(self, matched: C128, weights: F64) -> C128:
        """Amplitudes along migrations, shape (speeds, squints, dwells)."""
        return np.asarray(np.einsum("wnr,snr->wsn", weights, matched))

    def ratios(
        self,
        matched: C128,
        gains: F64,
        path: tuple[F64, F64],
        squints: Index,
        powers: F64 = POWERS_IN_DWELLS,
        points: bool = True,
    ) -> F64:
        """Logarithm of the likelihood ratios of migrations and numbered squints, shape (speeds, squints).

        Beyond its main lobe the antenna may see nothing.
        """
        weights, parts = path
        along = np.abs(self.on_path(matched, weights))
        strength = gains * parts[:, None]
        known = self.lobes.known[squints]
        both = ratio_in_dwells(along, strength, powers, points)
        if np.all(known):
            return both
        return np.maximum(both, ratio_in_dwells(along, np.where(known, strength, 0.0), powers, points))


@dataclass(frozen=True, eq=False)
class Course:
    """Pixels along the path of a target.

    Attributes:
        paths: paths of targets with the same velocity along the flight.
        sight: pixels around the target.
        moving: amplitudes matched to targets under the near squints (`DwellPaths.matched`).
        gains: gains of the beam (see there).
        row: row in the middle dwell over that of a target at rest.
        speed: velocity of the migration, m/s.
        likelihood: logarithm of the likelihood ratio of speckle, the best of the squints.
    """

    paths: DwellPaths
    sight: Sight
    moving: C128
    gains: F64
    row: float
    speed: float
    likelihood: float

    @classmethod
    def of(cls, paths: DwellPaths, sight: Sight, row: float, speeds: F64) -> Self:
        """The course with the likeliest of several migrations (m/s) from a row."""
        return cls.matched_by(paths, sight, paths.matched(sight, paths.lobes.near), row, speeds)

    @classmethod
    def matched_by(cls, paths: DwellPaths, sight: Sight, matched: tuple[C128, F64], row: float, speeds: F64) -> Self:
        """The same by the amplitudes and gains of the near squints; every second one decides between migrations."""
        near, (moving, gains), speed = paths.lobes.near, matched, float(speeds[0])
        if len(speeds) > 1:
            each_path = paths.path(sight, row, speeds)
            each = paths.ratios(moving[1::2], gains[1::2], each_path, near[1::2], POWERS_IN_DWELLS[::2], points=False)
            speed = float(speeds[each.max(axis=-1).argmax()])
        path = paths.path(sight, row, np.array([speed]))
        likelihood = float(paths.ratios(moving, gains, path, near, points=False).max())
        return cls(paths, sight, moving, gains, row, speed, likelihood)

    @property
    def powers(self) -> F64:
        """Power of the target in each dwell, under the squint that is best there, shape (dwells,)."""
        along = self.paths.on_path(self.moving, self.path[0])[0]
        return np.asarray((np.abs(along) ** 2).max(axis=0) * self.sight.backgrounds)

    @property
    def likelihood_of_others(self) -> float:
        """Logarithm of the likelihood by all dwells but the middle one."""
        weights, parts = self.path
        others = np.arange(len(self.paths.seconds)) != self.paths.middle
        path = weights * others[:, None], parts * others
        return float(self.paths.ratios(self.moving, self.gains, path, self.paths.lobes.near, points=False).max())

    @property
    def path(self) -> tuple[F64, F64]:
        """Weights of the rows, and parts that are in the image (`DwellPaths.path`)."""
        return self.paths.path(self.sight, self.row, np.array([self.speed]))
