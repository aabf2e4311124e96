"""Movers over spotlight dwells: their place, height and radial velocity, without being told the velocity.

The beam is held on the scene, so that one dwell does not tell in which direction it saw a target. Those before and
after do: their beams are a part of a beamwidth farther along the flight, and what moves lies in another row of their
images.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np
from scipy.ndimage import maximum_filter, median_filter

from sal_height.beams import Beams
from sal_height.imaging import Slc
from sal_height.movers.detection import MARGIN, SIDELOBES
from sal_height.movers.dwell_images import COLUMN_STEPS, DwellImage
from sal_height.movers.dwell_lobes import FARTHEST
from sal_height.movers.dwell_paths import DwellPaths
from sal_height.movers.dwell_search import DwellSearch, Found
from sal_height.movers.mover import Looked, Mover, Sighting, mover_of, without_ambiguities
from sal_height.movers.settings import MoverSettings
from sal_height.numeric import F64, Index, vertex
from sal_height.sensor import Sensor

OVERLAP = 1.6
"""Greatest distance of dwells along the flight that are looked at together, in beamwidths."""

LEAST_DWELLS, MOST_DWELLS = 2, 9
"""That are looked at together; of more, every second or third one."""

STRAY = 0.1
"""Greatest part of the way from a dwell to the next by which that is not where the first one flew to."""

MOST_BYTES = 1_000_000_000
"""Of images that are held: a platform that hovers would fill the memory."""

SAME_ROWS = 3.0
"""Within which two pixels are those of one target: its response in range is as wide."""

AROUND = (17, 5)
"""Rows and columns from which the brightness around a pixel is taken."""

COLUMN_ERROR = 0.1
"""Standard deviation of a target's place in the image along the flight, in columns."""

ALONE = "Dwell {} overlaps with none before or after it, and so tells no movers."
"""What to say of a dwell in which no movers could be looked for."""


@dataclass(frozen=True, eq=False)
class ShownDwell:
    """A dwell in which movers are looked for.

    Attributes:
        image: of it.
        slc: that this was made from.
        beams: of the channels, in one direction.
        sensor: that took it.
    """

    image: DwellImage
    slc: Slc
    beams: Beams
    sensor: Sensor

    def follows(self, earlier: ShownDwell) -> bool:
        """Whether this dwell is of the same flight as an earlier one: as far ahead as it is later."""
        one, other = self.image, earlier.image
        speed = float(np.linalg.norm(other.aperture.velocity))
        seconds = one.seconds - other.seconds
        way = one.aperture.position - other.aperture.position - seconds * other.aperture.velocity
        same = one.pixels.shape == other.pixels.shape and self.sensor.config_hash == earlier.sensor.config_hash
        return same and seconds > 0 and float(np.linalg.norm(way)) < STRAY * speed * seconds

    def apart(self, other: ShownDwell) -> float:
        """How far the beams of two dwells are apart along the flight, in beamwidths."""
        grid = self.image.grid
        reach = float(np.linalg.norm(grid.middle - self.image.aperture.position))
        way = float(np.linalg.norm(self.image.aperture.position - other.image.aperture.position))
        return way / (reach * self.beams.track_beamwidth)


@dataclass(frozen=True, eq=False)
class MoverTrack:
    """A mover, and where other dwells show it.

    Attributes:
        mover: that was found.
        place: of what stands still in its pixel, in map, m, shape (3,).
        rows: by which it walks, 1/s.
        drift: by which its image advances along the flight, m/s.
        seconds: time of its dwell.
    """

    mover: Mover
    place: F64
    rows: float
    drift: float
    seconds: float

    def covers(self, other: MoverTrack, dwells: Sequence[DwellImage]) -> bool:
        """Whether another is less sure, and is this one or in its pixel in one of the dwells."""
        if other.mover.likelihood_ratio >= self.mover.likelihood_ratio:
            return False
        if len(without_ambiguities([self.mover, other.mover])) == 1:
            return True
        return any(self._is_beside(other, dwell) for dwell in dwells)

    def _is_beside(self, other: MoverTrack, dwell: DwellImage) -> bool:
        """Whether the pixels of two tracks in a dwell are those of one target."""
        (row, col), (other_row, other_col) = self._pixel(dwell), other._pixel(dwell)
        cols, beside = dwell.steps // COLUMN_STEPS, abs(col - other_col)
        return abs(row - other_row) <= SAME_ROWS and min(beside, cols - beside) <= MARGIN

    def _pixel(self, dwell: DwellImage) -> tuple[float, float]:
        """Row and column at which a dwell shows it."""
        later = dwell.seconds - self.seconds
        row, step = dwell.shows(self.place + self.drift * later * dwell.aperture.direction)
        return row + self.rows * later, step / COLUMN_STEPS


@dataclass(frozen=True, eq=False)
class _Found:
    """What was found in a dwell, and where others show it; None: no other overlaps with it."""

    looked: Looked | None
    tracks: Sequence[MoverTrack]


Of = TypeVar("Of")


class DwellMovers(Generic[Of]):
    """Movers in dwells that follow each other, as they come; each is told with what it was handed over with.

    A dwell is searched when all have come whose beams overlap with its own, and told when all that it may have seen
    through sidelobes has been searched in the dwells that see it better.
    """

    def __init__(self, settings: MoverSettings) -> None:
        """Look for movers with these settings."""
        self._settings = settings
        self._begin()

    def _begin(self) -> None:
        self._held: list[ShownDwell] = []
        self._found: list[_Found] = []
        self._told = 0
        self._of: deque[Of] = deque()

    @property
    def untold(self) -> int:
        """Number of dwells that have not been told yet."""
        return len(self._of)

    def add(self, dwell: ShownDwell, of: Of) -> list[tuple[Of, Looked | None]]:
        """Take in a dwell, and whatever it is of; what was found in those that are done, in their order.

        None: it overlaps with no dwell before or after it, and so tells no movers. Where those that are held have more
        than MOST_BYTES, the next begins anew, as does one of another flight.
        """
        held = sum(one.image.pixels.nbytes for one in self._held)
        goes_on = not self._held or (held <= MOST_BYTES and dwell.follows(self._held[-1]))
        done = [] if goes_on else self.end()
        self._held.append(dwell)
        self._of.append(of)
        while self._held[len(self._found)].apart(dwell) > OVERLAP:
            self._found.append(self._search(len(self._found)))
        while self._told < len(self._found) and self._apart(self._told, len(self._found) - 1) > FARTHEST:
            done.append(self._tell())
        while self._told and self._apart(0, self._told) > FARTHEST + OVERLAP:
            del self._held[0], self._found[0]
            self._told -= 1
        return done

    def end(self) -> list[tuple[Of, Looked | None]]:
        """No more dwells follow these: what was found in those that are left, in their order."""
        self._found += [self._search(number) for number in range(len(self._found), len(self._held))]
        done = [self._tell() for _ in range(self._told, len(self._held))]
        self._begin()
        return done

    def _apart(self, one: int, other: int) -> float:
        """How far two of the dwells that are held are apart, in beamwidths."""
        return self._held[one].apart(self._held[other])

    def _search(self, number: int) -> _Found:
        """Look for movers that one of the dwells sees best."""
        group = [other for other in range(len(self._held)) if self._apart(number, other) <= OVERLAP]
        thin = -(-len(group) // MOST_DWELLS)
        group = [other for other in group if (other - number) % thin == 0]
        if len(group) < LEAST_DWELLS:
            return _Found(None, [])
        shown, images = self._held[number], [self._held[other].image for other in group]
        return find_over_dwells(images, group.index(number), shown, self._settings)

    def _is_covered(self, track: MoverTrack, number: int) -> bool:
        """Whether what was found in another dwell covers a track of this one."""
        for other, each in enumerate(self._found):
            between = [held.image for held in self._held[min(other, number) : max(other, number) + 1]]
            if other != number and any(rival.covers(track, between) for rival in each.tracks):
                return True
        return False

    def _tell(self) -> tuple[Of, Looked | None]:
        """What was found in the next dwell, without what others show better, or have told."""
        number, found = self._told, self._found[self._told]
        kept = [one for one in found.tracks if not self._is_covered(one, number)]
        self._found[number] = replace(found, tracks=kept)
        self._told += 1
        looked = replace(found.looked, movers=tuple(one.mover for one in kept)) if found.looked else None
        return self._of.popleft(), looked


def find_over_dwells(dwells: Sequence[DwellImage], middle: int, shown: ShownDwell, settings: MoverSettings) -> _Found:
    """Find what moves and is seen best in one of some dwells.

    Args:
        dwells: that follow each other, whose beams overlap.
        middle: number of the one that movers are seen best in.
        shown: the same.
        settings: of the search.
    """
    slc, sensor, dwell = shown.slc, shown.sensor, dwells[middle]
    paths = DwellPaths.of(dwells, middle, shown.beams, slc, sensor, settings.fastest_mps)
    search, candidates = DwellSearch(paths), _bright(dwell, settings.prominence_db)
    beside = [n for n in (middle - 1, middle + 1) if 0 <= n < len(dwells)]
    bright = {n: _bright(dwells[n], settings.prominence_db) for n in beside}
    tracks = []
    for row, col in candidates.tolist():
        step, off = _brightest(dwell, row, col)
        seen = search.look(row, step, bright, settings.false_alarm_rate)
        if seen:
            sighting = _sighting(seen, (step + off) / COLUMN_STEPS, off, paths)
            walk = seen.walk[0] if seen.walks else 0.0
            drift = paths.driving(seen.along[0]).drift
            tracks.append(
                MoverTrack(mover_of(sighting, slc, sensor), seen.place, walk / paths.depth, drift, dwell.seconds)
            )
    surest = without_ambiguities(one.mover for one in tracks)
    looked = Looked(surest, len(candidates), paths.ground, float(search.speeds[-1]))
    return _Found(looked, [one for one in tracks if any(one.mover is mover for mover in surest)])


def _brightest(dwell: DwellImage, row: int, col: int) -> tuple[int, float]:
    """The step of a row at which a target about a column is brightest, and what it is off that, in steps."""
    steps = COLUMN_STEPS * col + np.arange(-COLUMN_STEPS // 2 - 1, COLUMN_STEPS // 2 + 2)
    power = np.sum(np.abs(dwell.pixels[:, row, steps % dwell.steps]) ** 2, axis=0)
    best = int(np.clip(power.argmax(), 1, len(steps) - 2))
    return int(steps[best] % dwell.steps), float(vertex(*power[best - 1 : best + 2])[0])


def _sighting(seen: Found, col: float, off: float, paths: DwellPaths) -> Sighting:
    """What was seen of a mover in the middle dwell.

    Args:
        seen: of it.
        col: of its pixel, in fractions.
        off: by which that is off the step that was looked at, in steps.
        paths: of the dwells.
    """
    grid, aperture = paths.dwells[paths.middle].grid, paths.dwells[paths.middle].aperture
    column = grid.col_spacing / float(np.linalg.norm(grid.points(seen.row, col) - aperture.position))
    lag = seen.squint[0] - seen.still_squint - off / COLUMN_STEPS * column
    sigma = float(np.linalg.norm([seen.squint[1], COLUMN_ERROR * column, paths.ground[1]]))
    # Rows are those of what stands still at the place in the image: its range rate comes on top of the walk.
    speed = float(np.linalg.norm(aperture.velocity))
    walk = seen.walk[0] + lag * speed, float(np.hypot(seen.walk[1], sigma * speed))
    found = seen.row, col, seen.cnr, seen.elevation, (lag, sigma), walk, seen.walks, seen.ratio, seen.along
    return Sighting(*found, tells_along=seen.tells_along)


def _bright(dwell: DwellImage, prominence_db: float) -> Index:
    """Pixels that are brighter than all around, than most beside them, and than sidelobes of what is brighter.

    Their rows and columns, shape (pixels, 2).
    """
    power = dwell.power
    bright = power == maximum_filter(power, size=(3, 2 * MARGIN + 1), mode="wrap")
    bright &= power > 10 ** (prominence_db / 10) * median_filter(power, AROUND, mode="wrap")
    columns = maximum_filter(power.max(axis=0), size=2 * MARGIN + 1, mode="wrap")
    rows = maximum_filter(power.max(axis=1), size=3)
    bright &= power > SIDELOBES * np.maximum(columns, rows[:, None])
    return np.argwhere(bright)
