"""Movers over spotlight dwells: position, height and radial velocity, without knowing the velocity before.

The beam is steered to the scene, so that the direction of a target cannot be estimated from one dwell. It can be with
those before and after: their beams are a part of a beamwidth farther along the flight, and a mover is in another row of
their images.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np
from scipy.ndimage import median_filter

from sal_height.beams import Beams
from sal_height.imaging import Slc
from sal_height.movers.detection import MARGIN, MoverSettings, bright_pixels
from sal_height.movers.dwell_images import COLUMN_STEPS, DwellImage
from sal_height.movers.dwell_paths import FARTHEST, DwellPaths
from sal_height.movers.dwell_search import COLUMN_ERROR, DwellDetection, DwellSearch
from sal_height.movers.mover import Looked, Mover, MoverMeasurement, mover_of, without_ambiguities
from sal_height.numeric import F64, Index, ShortRepr, vertex
from sal_height.sensor import Sensor

OVERLAP = 1.6
"""Largest distance along the flight of dwells that are searched together, beamwidths."""

MOST_BYTES = 1_000_000_000
"""Limit of the size of cached images, as those of a platform that hovers all overlap, bytes."""

ALONE = "Dwell {} overlaps with none before or after it, so that no movers are found in it."
"""Warning about a dwell in which no movers could be searched."""


@dataclass(frozen=True, eq=False)
class ShownDwell(ShortRepr):
    """A dwell in which movers are searched.

    Attributes:
        image: image of the dwell.
        slc: image from which this was made.
        beams: beams of the channels, in one direction.
        sensor: sensor of the dwell.
    """

    image: DwellImage
    slc: Slc
    beams: Beams
    sensor: Sensor

    def follows(self, earlier: ShownDwell) -> bool:
        """True if this dwell is of the same flight as an earlier one: as far ahead as it is later, to a tenth."""
        one, other = self.image, earlier.image
        speed = float(np.linalg.norm(other.aperture.velocity))
        seconds = one.seconds - other.seconds
        way = one.aperture.position - other.aperture.position - seconds * other.aperture.velocity
        same = one.pixels.shape == other.pixels.shape and self.sensor.config_hash == earlier.sensor.config_hash
        return same and seconds > 0 and float(np.linalg.norm(way)) < 0.1 * speed * seconds

    def apart(self, other: ShownDwell) -> float:
        """Distance of the beams of two dwells along the flight, beamwidths."""
        grid = self.image.grid
        reach = float(np.linalg.norm(grid.middle - self.image.aperture.position))
        way = float(np.linalg.norm(self.image.aperture.position - other.image.aperture.position))
        return way / (reach * self.beams.track_beamwidth)


@dataclass(frozen=True, eq=False)
class MoverTrack:
    """A mover, and where other dwells show it.

    Attributes:
        mover: mover.
        place: position of a target at rest in its pixel, in map, shape (3,), m.
        rows: rate of its range migration, rows per s.
        drift: velocity of its image along the flight, m/s.
        seconds: time of its dwell, s.
    """

    mover: Mover
    place: F64
    rows: float
    drift: float
    seconds: float

    def covers(self, other: MoverTrack, dwells: Sequence[DwellImage]) -> bool:
        """True if another is less sure, and is this one or in its pixel in one of the dwells."""
        if other.mover.likelihood_ratio >= self.mover.likelihood_ratio:
            return False
        if len(without_ambiguities([self.mover, other.mover])) == 1:
            return True
        return any(self._shares_pixel(other, dwell) for dwell in dwells)

    def _shares_pixel(self, other: MoverTrack, dwell: DwellImage) -> bool:
        """True if the pixels of two tracks in a dwell are those of one target."""
        (row, col), (other_row, other_col) = self._pixel(dwell), other._pixel(dwell)
        cols, adjacent = dwell.steps // COLUMN_STEPS, abs(col - other_col)
        return abs(row - other_row) <= 3 and min(adjacent, cols - adjacent) <= MARGIN

    def _pixel(self, dwell: DwellImage) -> tuple[float, float]:
        """Row and column of the mover in a dwell."""
        later = dwell.seconds - self.seconds
        row, step = dwell.shows(self.place + self.drift * later * dwell.aperture.direction)
        return row + self.rows * later, step / COLUMN_STEPS


@dataclass(frozen=True, eq=False)
class _Searched:
    """Result of the search in a dwell, and tracks of its movers; None: no other dwell overlaps with it."""

    looked: Looked | None
    tracks: Sequence[MoverTrack]


Of = TypeVar("Of")


class DwellMovers(Generic[Of]):
    """Movers in successive dwells, in the order of arrival.

    A dwell is searched once all dwells with overlapping beams have arrived, and published once all targets that it may
    show through sidelobes have been searched in the dwells that see them better.
    """

    def __init__(self, settings: MoverSettings) -> None:
        """Search for movers with these settings."""
        self._settings = settings
        self._begin()

    def _begin(self) -> None:
        self._dwells: list[ShownDwell] = []
        self._found: list[_Searched] = []
        self._published = 0
        self._of: deque[Of] = deque()

    @property
    def unpublished(self) -> int:
        """Number of dwells that have not been published yet."""
        return len(self._of)

    def add(self, dwell: ShownDwell, of: Of) -> list[tuple[Of, Looked | None]]:
        """Accept a dwell.

        Once cached images have more than MOST_BYTES, the next dwell starts a new search, as does one of another flight.

        Args:
            dwell: dwell, later than those before.
            of: object that is returned with its result.

        Returns:
            Results of the dwells that are done, in their order; None: no dwell before or after overlaps with it.
        """
        cached = sum(one.image.pixels.nbytes for one in self._dwells)
        goes_on = not self._dwells or (cached <= MOST_BYTES and dwell.follows(self._dwells[-1]))
        done = [] if goes_on else self.end()
        self._dwells.append(dwell)
        self._of.append(of)
        while self._dwells[len(self._found)].apart(dwell) > OVERLAP:
            self._found.append(self._search(len(self._found)))
        while self._published < len(self._found) and self._distance(self._published, len(self._found) - 1) > FARTHEST:
            done.append(self._publish())
        while self._published and self._distance(0, self._published) > FARTHEST + OVERLAP:
            del self._dwells[0], self._found[0]
            self._published -= 1
        return done

    def end(self) -> list[tuple[Of, Looked | None]]:
        """Results of the remaining dwells in their order, after which no more follow."""
        self._found += [self._search(number) for number in range(len(self._found), len(self._dwells))]
        done = [self._publish() for _ in range(self._published, len(self._dwells))]
        self._begin()
        return done

    def _distance(self, one: int, other: int) -> float:
        """Distance of two of the cached dwells, beamwidths."""
        return self._dwells[one].apart(self._dwells[other])

    def _search(self, number: int) -> _Searched:
        """Search for movers that one of the dwells sees best.

        At most nine dwells are searched together: of more, every second or third one.
        """
        group = [other for other in range(len(self._dwells)) if self._distance(number, other) <= OVERLAP]
        thin = -(-len(group) // 9)
        group = [other for other in group if (other - number) % thin == 0]
        if len(group) < 2:
            return _Searched(None, [])
        shown, images = self._dwells[number], [self._dwells[other].image for other in group]
        return find_over_dwells(images, group.index(number), shown, self._settings)

    def _is_covered(self, track: MoverTrack, number: int) -> bool:
        """True if a track found in another dwell covers a track of this one."""
        for other, each in enumerate(self._found):
            between = [cached.image for cached in self._dwells[min(other, number) : max(other, number) + 1]]
            if other != number and any(rival.covers(track, between) for rival in each.tracks):
                return True
        return False

    def _publish(self) -> tuple[Of, Looked | None]:
        """Result of the next dwell, without movers that others show better, or that have been published."""
        number, found = self._published, self._found[self._published]
        kept = [one for one in found.tracks if not self._is_covered(one, number)]
        self._found[number] = replace(found, tracks=kept)
        self._published += 1
        looked = replace(found.looked, movers=tuple(one.mover for one in kept)) if found.looked else None
        return self._of.popleft(), looked


def find_over_dwells(
    dwells: Sequence[DwellImage], middle: int, shown: ShownDwell, settings: MoverSettings
) -> _Searched:
    """Find the movers that one of several dwells sees best.

    Args:
        dwells: successive dwells, whose beams overlap.
        middle: number of the dwell that sees the movers best.
        shown: images, sensor and beams of that dwell.
        settings: settings of the search.
    """
    slc, sensor, dwell = shown.slc, shown.sensor, dwells[middle]
    paths = DwellPaths.of(dwells, middle, shown.beams, slc, sensor, settings.fastest_mps)
    search, candidates = DwellSearch(paths), _bright(dwell, settings.prominence_db)
    adjacent = [n for n in (middle - 1, middle + 1) if 0 <= n < len(dwells)]
    bright = {n: _bright(dwells[n], settings.prominence_db) for n in adjacent}
    tracks = []
    for row, col in candidates.tolist():
        step, off = _brightest(dwell, row, col)
        seen = search.look(row, step, bright, settings.false_alarm_rate)
        if seen:
            sighting = _sighting(seen, (step + off) / COLUMN_STEPS, off, paths)
            migration = seen.migration[0] if seen.migrates else 0.0
            drift = paths.driving(seen.along[0]).drift
            tracks.append(
                MoverTrack(mover_of(sighting, slc, sensor), seen.place, migration / paths.depth, drift, dwell.seconds)
            )
    surest = without_ambiguities(one.mover for one in tracks)
    looked = Looked(surest, len(candidates), paths.ground, float(search.speeds[-1]))
    return _Searched(looked, [one for one in tracks if any(one.mover is mover for mover in surest)])


def _brightest(dwell: DwellImage, row: int, col: int) -> tuple[int, float]:
    """The step of a row at which a target about a column is brightest, and its distance from that, steps."""
    steps = COLUMN_STEPS * col + np.arange(-COLUMN_STEPS // 2 - 1, COLUMN_STEPS // 2 + 2)
    power = np.sum(np.abs(dwell.pixels[:, row, steps % dwell.steps]) ** 2, axis=0)
    best = int(np.clip(power.argmax(), 1, len(steps) - 2))
    return int(steps[best] % dwell.steps), float(vertex(*power[best - 1 : best + 2])[0])


def _sighting(seen: DwellDetection, col: float, off: float, paths: DwellPaths) -> MoverMeasurement:
    """Measurements of a mover in the middle dwell.

    Args:
        seen: detection.
        col: column of its pixel, in fractions.
        off: distance of that from the step of the search, steps.
        paths: paths through the dwells.
    """
    grid, aperture = paths.dwells[paths.middle].grid, paths.dwells[paths.middle].aperture
    column = grid.col_spacing / float(np.linalg.norm(grid.points(seen.row, col) - aperture.position))
    lag = seen.squint[0] - seen.still_squint - off / COLUMN_STEPS * column
    sigma = float(np.linalg.norm([seen.squint[1], COLUMN_ERROR * column, paths.ground[1]]))
    # Rows are those of a target at rest at the position in the image, whose range rate adds to the migration.
    speed = float(np.linalg.norm(aperture.velocity))
    migration = seen.migration[0] + lag * speed, float(np.hypot(seen.migration[1], sigma * speed))
    found = seen.row, col, seen.cnr, seen.elevation, (lag, sigma), migration, seen.migrates, seen.ratio, seen.along
    return MoverMeasurement(*found, along_known=seen.along_known)


def _bright(dwell: DwellImage, prominence_db: float) -> Index:
    """Rows and columns of bright pixels over the median of 17 by 5 pixels, shape (pixels, 2)."""
    power = dwell.power
    return np.argwhere(bright_pixels(power, median_filter(power, (17, 5), mode="wrap"), prominence_db, "wrap"))
