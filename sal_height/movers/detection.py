"""Movers in the images of a strip: their place, height and radial velocity, without being told the velocity.

Nothing but the direction in which it was seen tells a mover from what stands still. For each bright pixel elevation and
lag (`likelihood`) are estimated together. Twice the logarithm of the likelihood of the best lag over that of the ground
is what tells that it moves. With what stands still, each other lag has a ratio beyond t in less than exp(-t / 2) of all
cases (Markov's inequality, if power and width were known), and the best of the lags that can be told apart in about as
many times more: HYPOTHESES, measured with pairs of points in one cell, the worst of what was tried.

What moves by rows while the beam passes it is brightest with that walk undone (`walk`). Its likelihood ratio is that
against what does not walk, whatever its lag, and there are as many times more hypotheses as walks that are undone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import maximum_filter

from sal_height.beams import Beams
from sal_height.errors import Rejected, UserError
from sal_height.imaging import Slc
from sal_height.movers.drive import Drive, Drives, is_in_focus
from sal_height.movers.ground import ground_lag, spectra_of_image
from sal_height.movers.likelihood import HYPOTHESES
from sal_height.movers.migration import Migration, Migrations, about_ranges
from sal_height.movers.mover import Looked, Mover, MoverMeasurement, mover_of, peak_of, without_ambiguities
from sal_height.movers.search import Search, Seen
from sal_height.movers.settings import MoverSettings
from sal_height.movers.spectrum import Bins
from sal_height.numeric import C64, C128, F64, Bool, Index
from sal_height.sensor import Sensor

LEAST_COLUMNS = 16
"""Of an image, along the flight."""

SIDELOBES = 10**-2.5
"""Power, over that of the brightest in the same rows or columns, up to which a pixel may be its sidelobe."""

COARSE_STEP = 0.08
"""Between the lags of a first search, in beamwidths."""

BETWEEN_LAGS = 8.0
"""Likelihood ratio that a lag between two of these may have over theirs.

A target whose lag has the standard deviation of 0.015 beamwidths, the least that MODEL_ERROR leaves, loses 7."""

MIGRATING = 5.0
"""Standard deviations of the walk's velocity from which what moves is taken to walk."""

WALK_ROWS = 2.0
"""Beside the walk, within which the image of a target that walks lies."""

MARGIN = 4
"""Pixels from the edge of an image within which nothing is looked at: its response is cut off."""

LAG_OF_BLOCKS = 0.1
"""Standard deviation of the lag by what autofocus leaves within the blocks that it places, beamwidths.

Of 56 movers in strips with the errors of `sal_strips` the lag was off by 0.15 beamwidths (rms) and in the median by
0.04."""


def check_sensor(sensor: Sensor) -> None:
    """Movers can be told with a sensor.

    Raises:
        UserError: channels are blanked.
    """
    if sensor.blanked_ranges:
        raise UserError(
            f"Sensor {sensor.name} has channels that do not receive over some ranges (channels.blanked_ranges); movers "
            "are found only where all channels receive."
        )


def find_movers(images: C64 | C128, beams: Beams, slc: Slc, sensor: Sensor, settings: MoverSettings) -> Looked:
    """Find what moves in an image of a strip.

    Args:
        images: of channels of independent noise of one power, shape (channels, rows, cols).
        beams: of these channels, in one direction.
        slc: that the images are of.
        sensor: that took them.
        settings: of the search.

    Raises:
        Rejected: the image has too few columns.
    """
    if images.shape[-1] < LEAST_COLUMNS:
        raise Rejected(
            "few columns",
            f"An image of a strip has {images.shape[-1]} columns; {LEAST_COLUMNS} are needed to detect movers "
            f"(parameter "
            "cols of sar_compression).",
        )
    images = about_ranges(np.where(np.isfinite(images), images, 0), slc, sensor)
    bins = Bins.of(slc, sensor, min(settings.chip_pixels, images.shape[-1] // 2 * 2))
    search, coarse = Search(images, beams, bins), Search(images, beams, bins, COARSE_STEP)
    whole = Bins.of(slc, sensor, images.shape[-1])
    ground = ground_lag(slc, sensor, search.lags, lambda: spectra_of_image(images, beams, whole, search.lags))
    migrations = Migrations.of(coarse, slc, sensor, settings.fastest_mps, ground[0])
    of_rows = Migrations.of(Search(images, beams, whole, COARSE_STEP), slc, sensor, settings.fastest_mps, ground[0])
    drives = Drives.of(of_rows.search, slc, sensor)
    looking = _Looking(search, migrations, of_rows, drives, ground, slc, sensor)
    migrating, looked_at = looking.for_migration(settings)
    lagging, candidates = looking.for_lags(settings)
    apart = [one for one in lagging if not any(_in_image_of(one, other, migrations) for other in migrating)]
    fastest = min(settings.fastest_mps, float(migrations.speeds[-1]))
    return Looked(without_ambiguities([*migrating, *apart]), looked_at + candidates, ground, fastest)


def _bright(power: F64, prominence_db: float) -> Bool:
    """Pixels that are brighter than all around, than most of their row, and than sidelobes of what is brighter."""
    around = maximum_filter(power, size=(3, 2 * MARGIN + 1))
    bright = (power == around) & (power > 10 ** (prominence_db / 10) * np.median(power, axis=1, keepdims=True))
    beside = np.maximum(
        maximum_filter(power.max(axis=0), size=2 * MARGIN + 1), maximum_filter(power.max(axis=1), size=3)[:, None]
    )
    bright &= power > SIDELOBES * beside
    bright[:, :MARGIN] = bright[:, power.shape[1] - MARGIN :] = False
    return np.asarray(bright)


@dataclass(frozen=True, eq=False)
class _Looking:
    """The search in an image; `of_rows` has walks through it as spectra of whole rows, from which `drives` tells."""

    search: Search
    migrations: Migrations
    of_rows: Migrations
    drives: Drives
    ground: tuple[float, float]
    slc: Slc
    sensor: Sensor

    def for_lags(self, settings: MoverSettings) -> tuple[list[Mover], int]:
        """What is seen in another part of the beam than the ground, and the number of pixels that were looked at."""
        candidates = np.argwhere(_bright(np.sum(np.abs(self.search.images) ** 2, axis=0), settings.prominence_db))
        threshold = 2 * np.log(HYPOTHESES / settings.false_alarm_rate)
        found = []
        for seen in self.search.at(self._screened(candidates, threshold)):
            ratio = self._ratio(seen)
            if ratio < threshold or not self._is_inside(seen.likelihoods):
                continue
            row, col = round(seen.row), round(seen.col)
            migration = self.migrations.look(row, col, len(self.migrations.speeds) // 2)
            if migration is None:
                continue
            if abs(migration.speed) < MIGRATING * migration.sigma:
                found += self._mover(seen, ratio, migration)
                continue
            # One row has it in a part of the bins, and so another lag.
            for along in self.search.of(migration.spectra[None], np.array([row]), np.array([col])):
                if (ratio := self._ratio(along)) > threshold and self._is_inside(along.likelihoods):
                    found += self._mover(along, ratio, migration, migrates=True)
        return found, len(candidates)

    def _screened(self, pixels: Index, threshold: float) -> Index:
        """The pixels whose ratio may exceed the threshold, by a few lags."""
        coarse = self.migrations.search
        maybe = [
            seen.pixel
            for seen in coarse.at(pixels)
            if 2 * (seen.likelihoods.max() - _at(self.ground[0], coarse.lags, seen.likelihoods))
            > threshold - BETWEEN_LAGS
        ]
        return np.array(maybe, np.intp).reshape(-1, 2)

    def _ratio(self, seen: Seen) -> float:
        """Twice the logarithm of the likelihood ratio of the best lag against that of the ground."""
        return float(2 * (seen.likelihoods.max() - _at(self.ground[0], self.search.lags, seen.likelihoods)))

    def for_migration(self, settings: MoverSettings) -> tuple[list[Mover], int]:
        """What walks through rows while the beam passes it, and the number of pixels that were looked at."""
        if settings.fastest_mps == 0:
            return [], 0
        powers = np.array(list(self.migrations.powers()))
        candidates = np.argwhere(_bright(powers.max(axis=0), settings.prominence_db))
        threshold = 2 * np.log(HYPOTHESES * len(powers) / settings.false_alarm_rate)
        found = []
        for row, col in candidates.tolist():
            migration = self.migrations.look(row, col, int(powers[:, row, col].argmax()), threshold)
            if migration is None or abs(migration.speed) < MIGRATING * migration.sigma:
                continue
            for seen in self.search.of(migration.spectra[None], np.array([row]), np.array([col])):
                if self._is_inside(seen.likelihoods):
                    found += self._mover(seen, migration.likelihood_ratio, migration, migrates=True)
        return found, len(candidates)

    def _mover(self, seen: Seen, ratio: float, migration: Migration, migrates: bool = False) -> list[Mover]:
        """What was seen, as a mover; none: it is at an end of the array, or out of focus."""
        elevation = self.search.elevation(seen.spectra, float(self.search.lags[seen.likelihoods.argmax()]))
        if elevation is None:
            return []
        row, velocity = migration.row if migrates else seen.row, (migration.speed, migration.sigma)
        search, along = self.search, None
        drive = self.drives.look(self.of_rows.spectra(row, migration.speed if migrates else 0.0), elevation[0])
        if drive:
            # A Doppler frequency is that of a greater aspect, and of a time that is later, than of what stands still.
            search = replace(search, bins=search.bins.slowed(drive.share))
            focused = self._in_focus(search, seen, drive)
            if focused is None:
                return []
            (seen, elevation), along = focused, drive.along
        if not is_in_focus(search, seen.spectra, elevation[0]):
            return []
        velocity = self.drives.blurred(drive.slowed(velocity) if drive else velocity)
        lag, sigma = peak_of(seen.likelihoods, search.lags)
        own = lag - self.ground[0], math.hypot(sigma, self.ground[1], self._left_in_blocks)
        sighting = MoverMeasurement(row, seen.col, seen.cnr, elevation, own, velocity, migrates, ratio, along)
        return [mover_of(sighting, self.slc, self.sensor)]

    @property
    def _left_in_blocks(self) -> float:
        """Standard deviation of a lag by what autofocus leaves, rad; 0: it has not placed the image."""
        return LAG_OF_BLOCKS * self.search.beams.track_beamwidth if self.slc.placement.beams_error else 0.0

    def _in_focus(self, search: Search, seen: Seen, drive: Drive) -> tuple[Seen, tuple[float, float]] | None:
        """The same and its elevation by its image in focus; None: it is at an end of the array or of the lags."""
        cols = np.array([drive.col])
        chip = drive.row[:, search.first(cols)[0] + np.arange(search.bins.pixels)]
        for one in search.of(search.bins.spectra(chip).T[None], np.array([seen.pixel[0]]), cols):
            elevation = search.elevation(one.spectra, float(search.lags[one.likelihoods.argmax()]))
            if elevation and self._is_inside(one.likelihoods):
                return one, elevation
        return None

    def _is_inside(self, likelihoods: F64) -> bool:
        """Whether the best lag is none of the outermost."""
        return bool(0 < likelihoods.argmax() < len(likelihoods) - 1)


def _at(lag: float, lags: F64, likelihoods: F64) -> float:
    """Logarithm of the likelihood of a lag between those that were looked for, by the parabola through three."""
    best = int(np.clip(np.rint((lag - lags[0]) / (lags[1] - lags[0])), 1, len(lags) - 2))
    before, there, after = likelihoods[best - 1 : best + 2].tolist()
    off = float(np.clip((lag - lags[best]) / (lags[1] - lags[0]), -1, 1))
    return float(there + off * (after - before) / 2 + off**2 * (after + before - 2 * there) / 2)


def _in_image_of(one: Mover, other: Mover, migrations: Migrations) -> bool:
    """Whether what was seen without its walk may be part of the image of what walks."""
    rows = abs(other.walk_velocity) / migrations.speed_of_row / 2 + WALK_ROWS
    return abs(one.row - other.row) <= rows and abs(one.col - other.col) <= 2 * MARGIN
