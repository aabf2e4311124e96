"""What a bright pixel of a dwell is, by what the dwells before and after show: where it was, and how it walked.

Dwell n, at the time t_n after the one in whose image it is bright, has a target that recedes with the velocity w over
that of its image in the row r + w t_n, at the same place along the flight: that is where its Doppler frequency puts it.
The beam sees it under the squint s + s_n. What stands still lies in the row r of all dwells and has the squint of its
place in the image; a mover has any squint s within the beam.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from scipy.special import logsumexp

from sal_height.beams import Beams, column_squint
from sal_height.geometry import locate_at_elevation
from sal_height.imaging import Slc
from sal_height.movers.dwell_images import DwellImage
from sal_height.movers.dwell_likelihood import POWERS, told, told_of_cloud
from sal_height.movers.dwell_lobes import Lobes
from sal_height.movers.ground import lag_by_odometry, lag_of_spectra
from sal_height.movers.response import point_response
from sal_height.movers.search import MODEL_ERROR
from sal_height.movers.walk import DEPTHS, FINE_STEP, LEAST_PART, NEIGHBOURS, REACH
from sal_height.numeric import C64, C128, F64, Bool, Index, vertex
from sal_height.sensor import Sensor

FINE_SQUINTS = 5
"""Steps of the squint of what is found, in one of these."""

WALK_STEP = 0.25
"""Of the walk from dwell to dwell in the search, in rows."""

WALK_ERROR = 0.01
"""Standard deviation of the walk from dwell to dwell that the response leaves, in rows."""

MOST_OFF = 1.6
"""By how much what stands still may be seen ahead of its place in the image, in beamwidths."""

POINTING_ERRORS = 3.0
"""Standard deviations of the place of the beam by which what stands still may seem to lag."""

LEAST_GAIN = 0.1
"""Of the beam over the greatest, as a power, with which a dwell counts in the elevation."""

BACKGROUND = (8, 2)
"""Rows and columns to each side of a target from which its background is taken."""

ROUNDING = 1e-6
"""By how much two logarithms of one likelihood may differ."""

LEAST_BACKGROUND = 10**-3.5
"""Power of the background over that of the brightest row: sidelobes of the image."""


@dataclass(frozen=True, eq=False)
class Sight:
    """Pixels around the place of a bright one, in all dwells.

    Attributes:
        numbers: of the rows, shape (dwells, rows).
        inside: whether they are in the image, same shape.
        still: row at which each dwell has what stands still at that place, shape (dwells,).
        spectra: pixels, shape (dwells, rows, channels).
        backgrounds: power of noise and ground, shape (dwells,); infinite: the dwell does not have these rows.
        elevation: number of the elevation.
        squint: of what stands still in the middle dwell, rad.
        place: of what stands still, in map, m, shape (3,).
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
class Found:
    """The best walk of a target, and how much likelier it is than what stands still.

    Attributes:
        row: in the middle dwell, in fractions.
        squint: under which that saw it, and its standard deviation, rad.
        walk: velocity of its walk, and its standard deviation, m/s.
        walks: whether it was found by that, and else by its squint.
        ratio: twice the logarithm of the likelihood ratio against what does not walk, or against what stands still.
        elevation: and its standard deviation, rad.
        cnr: power over the background in the middle dwell.
        still_squint: of what stands still in the same pixel, rad.
        place: of that, in map, m, shape (3,).
    """

    row: float
    squint: tuple[float, float]
    walk: tuple[float, float]
    walks: bool
    ratio: float
    elevation: tuple[float, float]
    cnr: float
    still_squint: float
    place: F64


@dataclass(frozen=True, eq=False)
class DwellSearch:
    """The search about a dwell.

    Attributes:
        dwells: that follow each other.
        middle: number of the one whose bright pixels are looked at.
        beams: of the channels.
        lobes: the same in the directions that are looked at.
        seconds: of the dwells after the middle one, shape (dwells,).
        depth: slant range from a row to the next, m.
        spacing: the same in range resolutions.
        window: over the band, a name of `windows.WINDOWS`.
        fastest: greatest velocity that is looked for, m/s.
        ground: by how much what stands still is seen ahead of its place in the image, rad, and its standard deviation.
    """

    dwells: Sequence[DwellImage]
    middle: int
    beams: Beams
    lobes: Lobes
    seconds: F64
    depth: float
    spacing: float
    window: str
    fastest: float
    ground: tuple[float, float]

    @classmethod
    def of(
        cls, dwells: Sequence[DwellImage], middle: int, beams: Beams, slc: Slc, sensor: Sensor, fastest: float
    ) -> Self:
        """The search about the `middle` one of some dwells, which was made from `slc`, up to a velocity (m/s)."""
        there = dwells[middle]
        grid = there.grid
        place = grid.points((grid.rows - 1) / 2, (grid.cols - 1) / 2)
        sight = place - there.aperture.position
        angles = np.array([one.angles(place) for one in dwells])
        higher, ahead = (angles - angles[middle]).T
        lobes = Lobes.of(beams, ahead, higher)
        depth = grid.row_spacing * float(grid.row_direction @ sight) / float(np.linalg.norm(sight))
        seconds = np.array([one.seconds - there.seconds for one in dwells])
        cells = abs(depth) / sensor.range_resolution
        prior = lag_by_odometry(slc, sensor)
        ground = 0.0, 0.0
        if prior:
            aspects = column_squint(grid, there.aperture, beams, sensor.look_side)
            lags = lobes.squints[np.abs(lobes.squints) <= MOST_OFF * beams.track_beamwidth]
            gains = beams.power(float(np.mean(beams.span)), aspects + lags[:, None])
            ground = lag_of_spectra(there.power, gains, lags, prior)
        return cls(dwells, middle, beams, lobes, seconds, depth, cells, slc.range_window, fastest, ground)

    @cached_property
    def speed_of_row(self) -> float:
        """Velocity of what walks by a row from the middle dwell to the next one, m/s."""
        return abs(self.depth) / float(np.min(np.abs(self.seconds[self.seconds != 0])))

    @cached_property
    def speeds(self) -> F64:
        """Velocities of the walks that are looked for, m/s: 0 is in their middle."""
        step = WALK_STEP * self.speed_of_row
        count = int(np.ceil(self.fastest / step))
        return step * np.arange(-count, count + 1, dtype=np.float64)

    def look(self, row: int, step: int, thresholds: tuple[float, float]) -> Found | None:
        """What is bright in a row and at a step of the middle dwell.

        Args:
            row: of the pixel.
            step: along the row.
            thresholds: that the likelihood ratios of what walks and of what only lags must exceed.

        Returns:
            None: it does not move, or is at an end of the array or of the rows.
        """
        sight = self._sight(row, step)
        if sight is None:
            return None
        moving, gains = self._matched(sight, self.lobes.near)
        still = self._ambiguous(sight)
        standing, ground_gains = self._matched_each(sight, still)
        fine = self._brightest(sight, moving)
        # Without a walk: under any squint, and under that of what stands still.
        near, at_rest = self.lobes.near, self._along(sight, fine, np.zeros(1))
        lagging = float(self._told(moving, gains, at_rest, near).max())
        ground = max(
            float(self._told(standing, ground_gains, at_rest, still).max()), self._glinting(sight, at_rest, still)
        )
        # With the best of the walks, which a few squints and powers tell, against all that does not walk.
        walks = self._along(sight, fine, self.speeds)
        each = self._told(moving[1::2], gains[1::2], walks, near[1::2], POWERS[::2], points=False)
        speed = float(self.speeds[each.max(axis=-1).argmax()])
        path = self._along(sight, fine, np.array([speed]))
        walking = float(self._told(moving, gains, path, near, points=False).max())
        ratio = 2 * (walking - max(lagging, ground))
        if ratio > thresholds[0]:
            several = self._several(sight, standing, ground_gains, still, fine, speed)
            deep = self._deep(sight, standing, ground_gains, fine)
            ratio = 2 * (walking - max(lagging, ground, several, deep))
        is_walk = bool(ratio >= thresholds[0])
        if not is_walk:
            lagging = float(self._told(moving, gains, at_rest, near, points=False).max())
            ratio, speed = 2 * (lagging - ground), 0.0
            if ratio < thresholds[1]:
                return None
        if self._belongs_elsewhere(sight, fine, speed):
            return None
        return self._described(sight, moving, gains, fine, speed, ratio, is_walk)

    def _belongs_elsewhere(self, sight: Sight, fine: float, speed: float) -> bool:
        """Whether what another dwell shows of a walk is likelier with another row of the middle one, or another squint.

        A bright pixel that stands still would otherwise be tied to a mover that the next dwell shows beside it, and a
        mover be told in each dwell that sees it through a sidelobe.
        """
        near, everywhere = self.lobes.near, np.arange(len(self.lobes.squints))
        matched, gains = self._matched_each(sight, everywhere)
        matched[near], gains[near] = self._matched(sight, near)
        path = self._along(sight, fine, np.array([speed]))
        own = self._told(matched[near], gains[near], path, near)[0]
        powers = np.abs(self._on_path(matched[near], path[0])[0, int(own.argmax())]) ** 2 * (self.seconds != 0)
        tied = self.seconds[int(powers.argmax())]
        speeds = np.append(self.speeds, speed)
        rows: F64 = fine + (speed - speeds) * tied / self.depth
        rivals = self._told(matched, gains, self._along(sight, rows, speeds), everywhere)
        return bool(rivals.max() > own.max() + ROUNDING)

    def _described(
        self, sight: Sight, moving: C128, gains: F64, fine: float, speed: float, ratio: float, walks: bool
    ) -> Found | None:
        """A target that walks with about a speed; None: it is at an end of the array, or of another dwell."""
        row, walk, best = self._refined(sight, moving, gains, fine, speed)
        path = self._along(sight, row - sight.still[self.middle], np.array([walk[0]]))
        along = np.einsum("nr,nrc->nc", path[0][0], sight.spectra)
        first = self._elevation(sight, along, float(self.lobes.squints[self.lobes.near[best]]))
        squint = self._squint(sight, path, first[0]) if first else None
        elevation = self._elevation(sight, along, squint[0]) if squint else None
        if squint is None or elevation is None:
            return None
        power = float(np.abs(self._on_path(moving, path[0])[0, best, self.middle]) ** 2)
        return Found(row, squint, walk, walks, ratio, elevation, power, sight.squint + self.ground[0], sight.place)

    def _squint(self, sight: Sight, path: tuple[F64, F64], elevation: float) -> tuple[float, float] | None:
        """Mean and standard deviation of the likely squints in the middle dwell; None: those of another dwell."""
        near = self.lobes.squints[self.lobes.near]
        fine = np.linspace(near[0], near[-1], FINE_SQUINTS * (len(near) - 1) + 1)
        under = fine[:, None] + self.lobes.ahead
        matched, gains = self._matching(sight, self.beams.response(elevation + self.lobes.higher, under))
        weights, parts = path
        logarithms = told(np.abs(self._on_path(matched, weights))[0], gains * parts[0])
        if logarithms.argmax() in (0, len(fine) - 1):
            return None
        weight = np.exp(logarithms - logsumexp(logarithms))
        squint = float(weight @ fine)
        return squint, float(np.sqrt(weight @ (fine - squint) ** 2 + (fine[1] - fine[0]) ** 2 / 12))

    def _sight(self, row: int, step: int) -> Sight | None:
        """Pixels around the place of a bright one; None: it is at an end of the array or of the rows."""
        there = self.dwells[self.middle]
        if not REACH <= row < there.grid.rows - REACH:
            return None
        lobes = self.lobes
        # Elevation of what is in the main lobe.
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
        spread = int(np.ceil(self.fastest * np.abs(self.seconds).max() / abs(self.depth))) + REACH
        numbers, inside, still, spectra, backgrounds = [], [], [], [], []
        for one in self.dwells:
            at, column = one.shows(place)
            rows = round(at) + np.arange(-spread, spread + 1)
            pixels, within = one.column(rows, column)
            beam = lobes.amplitudes[len(lobes.squints) // 2, self.middle, number]
            beam = beam / np.linalg.norm(beam)
            around = np.abs(beam.conj() @ one.around(round(at), column, BACKGROUND)) ** 2
            level = float(np.median(around)) / np.log(2) if around.size else np.inf
            brightest = float(np.max(np.abs(pixels @ beam.conj()) ** 2))
            numbers.append(rows)
            inside.append(within)
            still.append(at)
            spectra.append(pixels)
            backgrounds.append(max(level, LEAST_BACKGROUND * brightest, 1e-300))
        _, squint = there.angles(place)
        return Sight(
            numbers=np.array(numbers),
            inside=np.array(inside),
            still=np.array(still),
            spectra=np.array(spectra),
            backgrounds=np.array(backgrounds),
            elevation=number,
            squint=squint,
            place=place,
        )

    def _ambiguous(self, sight: Sight) -> Index:
        """Numbers of the squints that what stands still in the image may have, there and at its azimuth ambiguities."""
        there = self.dwells[self.middle]
        reach = float(np.linalg.norm(there.grid.points(sight.still[self.middle], 0) - there.aperture.position))
        turns = np.arange(-2, 3) * (there.period / reach)
        step = self.lobes.squints[1] - self.lobes.squints[0]
        unsure = int(np.ceil(POINTING_ERRORS * self.ground[1] / step)) + 1
        about = step * np.arange(-unsure, unsure + 1, dtype=np.float64)
        return np.unique(self.lobes.nearest(np.add.outer(sight.squint + self.ground[0] + turns, about).ravel()))

    def _matched(self, sight: Sight, squints: Index) -> tuple[C128, F64]:
        """Amplitudes that match targets under numbered squints, and gains of the beam, over the background's.

        Returns:
            Shapes (squints, dwells, rows) and (squints, dwells).
        """
        return self._matching(sight, self.lobes.amplitudes[squints, :, sight.elevation])

    def _matched_each(self, sight: Sight, squints: Index) -> tuple[C128, F64]:
        """The same, each squint with the elevation that explains the bright pixel best.

        In a sidelobe that is another one than in the main lobe.
        """
        amplitudes = self.lobes.amplitudes[squints, self.middle]
        gains = np.sum(np.abs(amplitudes) ** 2, axis=-1)
        there = sight.spectra[self.middle, sight.spectra.shape[1] // 2]
        seen = np.abs(amplitudes.conj() @ there) ** 2 / (gains + MODEL_ERROR * gains.max())
        elevations = seen.argmax(axis=-1)
        chosen = np.moveaxis(self.lobes.amplitudes[squints], 2, 1)[np.arange(len(squints)), elevations]
        return self._matching(sight, chosen)

    def _matching(self, sight: Sight, amplitudes: F64 | C128) -> tuple[C128, F64]:
        """The same for beams of the shape (squints, dwells, channels); what is not known of them is in their gains."""
        gains = np.linalg.norm(amplitudes, axis=-1)
        level = np.sqrt(sight.backgrounds)
        found = np.einsum("snc,nrc->snr", amplitudes.conj(), sight.spectra)
        found = found / (np.maximum(gains, 1e-12) * level)[..., None]
        greatest = np.linalg.norm(self.lobes.amplitudes[len(self.lobes.squints) // 2, self.middle, sight.elevation])
        return np.asarray(found), np.hypot(gains, np.sqrt(MODEL_ERROR) * greatest) / level

    def _brightest(self, sight: Sight, moving: C128) -> float:
        """Row of the target in the middle dwell, over that of what stands still there, in fractions."""
        places: F64 = np.arange(-1.0, 1.0 + FINE_STEP / 2, FINE_STEP)
        numbers, still = sight.numbers[self.middle], sight.still[self.middle]
        responses = self._response(numbers - still - places[:, None])
        energy = np.abs(responses @ moving[:, self.middle].T) ** 2 / np.sum(responses**2, axis=-1, keepdims=True)
        return float(places[energy.max(axis=-1).argmax()])

    def _response(self, rows: F64) -> F64:
        return point_response(self.window, self.spacing, rows)

    def _along(self, sight: Sight, row: float | F64, speeds: F64) -> tuple[F64, F64]:
        """Weights of the rows of each dwell along walks from a row over that of what stands still.

        Returns:
            Weights, sum of squares 1, shape (walks, dwells, rows); the part of the response's amplitude that is in the
            image, shape (walks, dwells).
        """
        there = sight.still + np.asarray(row)[..., None] + speeds[:, None] * self.seconds / self.depth
        responses = self._response(sight.numbers - there[..., None])
        whole = np.linalg.norm(responses, axis=-1)
        responses = responses * sight.inside
        norms = np.linalg.norm(responses, axis=-1)
        weights = responses / np.maximum(norms, 1e-12)[..., None]
        parts = norms / np.maximum(whole, 1e-12)
        parts = np.where(parts > LEAST_PART, parts, 0.0)
        return weights * (parts[..., None] > 0), parts

    def _on_path(self, matched: C128, weights: F64) -> C128:
        """Amplitudes along walks, shape (walks, squints, dwells)."""
        return np.asarray(np.einsum("wnr,snr->wsn", weights, matched))

    def _told(
        self,
        matched: C128,
        gains: F64,
        path: tuple[F64, F64],
        squints: Index,
        powers: F64 = POWERS,
        points: bool = True,
    ) -> F64:
        """Logarithm of the likelihoods of walks and numbered squints, shape (walks, squints).

        Beyond its main lobe the antenna may see nothing.
        """
        weights, parts = path
        along = np.abs(self._on_path(matched, weights))
        strength = gains * parts[:, None]
        known = self.lobes.known[squints]
        both = told(along, strength, powers, points)
        if np.all(known):
            return both
        return np.maximum(both, told(along, np.where(known, strength, 0.0), powers, points))

    def _refined(
        self, sight: Sight, moving: C128, gains: F64, row: float, speed: float
    ) -> tuple[float, tuple[float, float], int]:
        """The row, the walk with its standard deviation, and the number of the squint about some that are likeliest."""
        step = FINE_STEP * self.speed_of_row
        speeds = speed + step * np.arange(-6, 7, dtype=np.float64)
        rows = row + FINE_STEP * np.arange(-4, 5, dtype=np.float64)
        each = np.array([self._told(moving, gains, self._along(sight, one, speeds), self.lobes.near) for one in rows])
        profile = each.max(axis=(0, 2))
        best = int(np.clip(profile.argmax(), 1, len(speeds) - 2))
        offset, bend = vertex(*profile[best - 1 : best + 2])
        place = int(each[:, best].max(axis=-1).argmax())
        sigma = float(np.hypot(step / np.sqrt(bend), WALK_ERROR * self.speed_of_row))
        walk = float(speeds[best] + step * offset), sigma
        return sight.still[self.middle] + float(rows[place]), walk, int(each[place, best].argmax())

    def _several(self, sight: Sight, standing: C128, gains: F64, still: Index, row: float, speed: float) -> float:
        """Logarithm of the likelihood of targets that stand still in different rows of the walk."""
        beside = abs(speed) * float(np.abs(self.seconds).max()) / abs(self.depth) + 1.0
        places: F64 = row + np.arange(-beside, beside + FINE_STEP / 2, 2 * FINE_STEP, dtype=np.float64)
        return max(
            self._greedy(sight, standing[[one]], gains[[one]], still[[one]], places) for one in range(len(still))
        )

    def _greedy(self, sight: Sight, standing: C128, gains: F64, still: Index, places: F64) -> float:
        """The same for one squint: the brightest first, each without what those before it have."""
        weights, parts = self._along(sight, places, np.zeros(1))
        found = np.zeros((len(self.dwells), 0, weights.shape[-1]))
        total = best = 0.0
        for _ in range(NEIGHBOURS):
            left = weights - np.einsum("wnk,nkr->wnr", np.einsum("wnr,nkr->wnk", weights, found), found)
            norms = np.linalg.norm(left, axis=-1)
            left = np.where((norms > LEAST_PART)[..., None], left / np.maximum(norms, 1e-12)[..., None], 0.0)
            energy = np.sum(np.abs(self._on_path(standing, left)[:, 0]) ** 2, axis=-1)
            one = int(energy.argmax())
            if not energy[one] > 0:
                break
            shown = parts * np.where(norms > LEAST_PART, norms, 0.0)
            total += float(self._told(standing, gains, (left[[one]], shown[[one]]), still)[0, 0])
            best = max(best, total)
            found = np.concatenate([found, left[one][:, None]], axis=1)
        return best

    def _glinting(self, sight: Sight, path: tuple[F64, F64], still: Index) -> float:
        """Logarithm of the likelihood of what stands still and has its centre at another elevation in each dwell.

        That is what several scatterers in one cell do, as speckle.
        """
        along = np.einsum("nr,nrc->nc", path[0][0], sight.spectra)
        amplitudes = self.lobes.amplitudes[still]
        squares = np.sum(np.abs(amplitudes) ** 2, axis=-1)
        floor = MODEL_ERROR * squares.max()
        seen = np.abs(np.sum(amplitudes.conj() * along[:, None], axis=-1)) ** 2 / (squares + floor)
        best = seen.argmax(axis=-1)[..., None]
        matched, gains = (np.take_along_axis(one, best, -1)[..., 0] for one in (seen, squares + floor))
        return float(told(np.sqrt(matched / sight.backgrounds), path[1][0] * np.sqrt(gains / sight.backgrounds)).max())

    def _deep(self, sight: Sight, standing: C128, gains: F64, row: float) -> float:
        """Logarithm of the likelihood of a cloud that stands still and is spread over range."""
        there = sight.numbers - (sight.still + row)[:, None]
        shares = np.exp(-(there**2) / (2 * np.square(DEPTHS)[:, None, None])) * sight.inside
        shares = shares / np.maximum(shares.sum(axis=-1, keepdims=True), 1e-12)
        return max(told_of_cloud(np.abs(one), gain, shares) for one, gain in zip(standing, gains, strict=True))

    def _elevation(self, sight: Sight, along: C128, squint: float) -> tuple[float, float] | None:
        """The most likely elevation of a target under a squint in the middle dwell, and its standard deviation.

        Args:
            sight: of the target.
            along: pixels along its walk, shape (dwells, channels).
            squint: rad.

        Returns:
            None: it is that of an outer beam.
        """
        lobes, grid = self.lobes, self.lobes.elevations
        amplitudes = self.beams.response(grid[:, None] + lobes.higher, squint + lobes.ahead)
        gains = np.sum(np.abs(amplitudes) ** 2, axis=-1)
        used = (gains > LEAST_GAIN * gains.max()) & np.isfinite(sight.backgrounds)
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
