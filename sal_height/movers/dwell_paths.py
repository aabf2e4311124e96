"""What dwells that follow each other show along the path of a target, and how likely it is by that.

Dwell n, at the time t_n after the one in whose image the target is bright, has it in the row r + w t_n, if it recedes
with the velocity w over that of its image, and under the squint s + s_n, in which what stands still in the image has
the squint of its place there.

Where a target drives along the flight with the velocity u, and the antenna flies on with v, the place of its image,
which is where its Doppler frequency puts it, advances by u (2 - u / v) t_n, and its squint by u t_n over the range R:
the target is x = x_0 + (u - v) t_n ahead of the antenna, and its image (1 - u / v) x - v_r R / v.

Where the image of a dwell lies farther along the flight than it is thought to, so do the target and the beam in it.
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
from sal_height.movers.dwell_lobes import Lobes
from sal_height.movers.ground import ground_lag
from sal_height.movers.likelihood import MODEL_ERROR, POWERS_IN_DWELLS, ratio_in_dwells
from sal_height.movers.migration import LEAST_PART, REACH
from sal_height.movers.response import point_response
from sal_height.numeric import C64, C128, F64, Bool, Index
from sal_height.sensor import Sensor

LEAST_ERROR = 0.05
"""Columns by which images must be unsure along the flight for that to count."""

MOST_OFF = 1.6
"""By how much what stands still may be seen ahead of its place in the image, in beamwidths."""

POINTING_ERRORS = 3.0
"""Standard deviations of the place of the beam by which what stands still may seem to lag."""

BACKGROUND = (8, 2)
"""Rows and columns to each side of a target from which its background is taken."""

LEAST_BACKGROUND = 10**-3.5
"""Power of the background over that of the brightest pixel around: sidelobes of the image."""


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
class DwellPaths:
    """Dwells, and the paths of targets through them.

    Attributes:
        dwells: that follow each other.
        middle: number of the one in whose image targets are bright.
        beams: of the channels.
        lobes: the same in the directions that are looked at.
        seconds: of the dwells after the middle one, shape (dwells,).
        depth: slant range from a row to the next, m.
        spacing: the same in range resolutions.
        window: over the band, a name of `windows.WINDOWS`.
        window_along: over the pulses, likewise.
        reach: slant range of the middle, m.
        fastest: greatest velocity that is looked for, m/s.
        ground: by how much what stands still is seen ahead of its place in the image, rad, and its standard deviation.
        along: velocity of targets along the flight, m/s.
        offsets: by which images of dwells lie farther along the flight than that of the middle one, m, shape (dwells,).
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
        lags = lobes.squints[np.abs(lobes.squints) <= MOST_OFF * beams.track_beamwidth]

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
        """The paths of what drives along the flight with this velocity, m/s, in images that lie farther, m."""
        lobes = self.lobes.turned((along * self.seconds + offsets) / self.reach)
        return replace(self, along=along, offsets=offsets, lobes=lobes)

    @cached_property
    def errors(self) -> F64:
        """Standard deviations of the places of the images along the flight, each by itself, m, shape (dwells,)."""
        return np.array([one.error for one in self.dwells])

    @property
    def unsure(self) -> bool:
        """Whether these count."""
        return bool(self.errors.max() > LEAST_ERROR * self.dwells[self.middle].grid.col_spacing)

    @cached_property
    def flight_speed(self) -> float:
        """Of the antenna, m/s."""
        return float(np.linalg.norm(self.dwells[self.middle].aperture.velocity))

    @property
    def drift(self) -> float:
        """Velocity along the flight of the place of the image, m/s."""
        return self.along * (2 - self.along / self.flight_speed)

    @property
    def drifts(self) -> F64:
        """How far that has advanced in the image of each dwell, m, shape (dwells,)."""
        return self.drift * self.seconds + self.offsets

    def along_of(self, drift: float) -> float:
        """Velocity along the flight (m/s) of what has an image that advances by `drift` (m/s); NaN: of none."""
        share = 1 - drift / self.flight_speed
        return self.flight_speed * (1 - float(np.sqrt(share))) if share >= 0 else float("nan")

    def places(self, place: F64) -> F64:
        """Places of the image in each dwell, m, shape (dwells, 3), of what has it at a place in the middle one."""
        return place + self.drifts[:, None] * self.dwells[self.middle].aperture.direction

    @cached_property
    def speed_of_row(self) -> float:
        """Velocity of what walks by a row from the middle dwell to the next one, m/s."""
        return abs(self.depth) / float(np.min(np.abs(self.seconds[self.seconds != 0])))

    def place_of(self, row: int, step: int) -> tuple[F64, int] | None:
        """Where what is bright in the middle dwell would stand still, m, and the number of its elevation.

        None: it is at an end of the array or of the rows.
        """
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
        return place, number

    def sight(self, place: F64, elevation: int) -> Sight:
        """Pixels around the image of what has it at a place (m) in the middle dwell, by the number of its elevation."""
        lobes = self.lobes
        spread = int(np.ceil(self.fastest * np.abs(self.seconds).max() / abs(self.depth))) + REACH
        beam = lobes.amplitudes[len(lobes.squints) // 2, self.middle, elevation]
        beam = beam / np.linalg.norm(beam)
        numbers, inside, still, spectra, backgrounds = [], [], [], [], []
        for one, there in zip(self.dwells, self.places(place), strict=True):
            at, column = one.shows(there)
            rows = round(at) + np.arange(-spread, spread + 1)
            pixels, within = one.column(rows, column)
            around = np.abs(beam.conj() @ one.around(round(at), column, BACKGROUND)) ** 2
            level = float(np.median(around)) / np.log(2) if around.size else np.inf
            brightest = float(max(np.max(np.abs(pixels @ beam.conj()) ** 2), np.max(around, initial=0.0)))
            numbers.append(rows)
            inside.append(within)
            still.append(at)
            spectra.append(pixels)
            backgrounds.append(max(level, LEAST_BACKGROUND * brightest, 1e-300))
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
        """Numbers of the squints that what stands still in the image may have, there and at its azimuth ambiguities."""
        there = self.dwells[self.middle]
        reach = float(np.linalg.norm(there.grid.points(sight.still[self.middle], 0) - there.aperture.position))
        turns = np.arange(-2, 3) * (there.period / reach)
        step = self.lobes.squints[1] - self.lobes.squints[0]
        unsure = int(np.ceil(POINTING_ERRORS * self.ground[1] / step)) + 1
        about = step * np.arange(-unsure, unsure + 1, dtype=np.float64)
        return np.unique(self.lobes.nearest(np.add.outer(sight.squint + self.ground[0] + turns, about).ravel()))

    def matched(self, sight: Sight, squints: Index) -> tuple[C128, F64]:
        """Amplitudes that match targets under numbered squints, and gains of the beam, over the background's.

        Returns:
            Shapes (squints, dwells, rows) and (squints, dwells).
        """
        return self.matching(sight, self.lobes.amplitudes[squints, :, sight.elevation])

    def matched_each(
        self, sight: Sight, squints: Index, dwell: int | None = None, row: float = 0.0
    ) -> tuple[C128, F64]:
        """The same, each squint with the elevation that explains the bright pixel best.

        In a sidelobe that is another one than in the main lobe. The pixel is that of a dwell, the middle one if it is
        None, in a row over that of what stands still.
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
        """The same for beams of the shape (squints, dwells, channels); what is not known of them is in their gains."""
        gains = np.linalg.norm(amplitudes, axis=-1)
        level = np.sqrt(sight.backgrounds)
        found = np.einsum("snc,nrc->snr", amplitudes.conj(), sight.spectra)
        found = found / (np.maximum(gains, 1e-12) * level)[..., None]
        greatest = np.linalg.norm(self.lobes.amplitudes[len(self.lobes.squints) // 2, self.middle, sight.elevation])
        return np.asarray(found), np.hypot(gains, np.sqrt(MODEL_ERROR) * greatest) / level

    def response(self, rows: F64) -> F64:
        """Amplitude of a target so many rows away."""
        return point_response(self.window, self.spacing, rows)

    def response_along(self, columns: F64) -> F64:
        """Amplitude of a target so many columns away, of which there is one for each Doppler frequency."""
        return point_response(self.window_along, 1.0, columns)

    def path(self, sight: Sight, row: float | F64, speeds: F64) -> tuple[F64, F64]:
        """Weights of the rows of each dwell along walks from a row over that of what stands still.

        Returns:
            Weights, sum of squares 1, shape (walks, dwells, rows); the part of the response's amplitude that is in the
            image, shape (walks, dwells).
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
        """Amplitudes along walks, shape (walks, squints, dwells)."""
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
        """Logarithm of the likelihoods of walks and numbered squints, shape (walks, squints).

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
