"""Movers in the images of a strip: position, height and radial velocity, without knowing the velocity before.

Only the direction in which it was seen separates a mover from targets at rest. For each bright pixel elevation and lag
(`likelihood`) are estimated together. The test statistic is twice the logarithm of the likelihood of the best lag over
that of the ground. For a target at rest, each other lag has a ratio beyond t in less than exp(-t / 2) of all cases
(Markov's inequality, if power and width were known), and the best of HYPOTHESES separate lags in that many times more.

A target that migrates by rows while the beam passes it is brightest once that migration is undone (`migration`). Its
likelihood ratio is that against targets without migration, whatever their lag, and the number of hypotheses is greater
by the number of velocities whose migration is undone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, Self

import numpy as np
from scipy.ndimage import maximum_filter

from sal_height.beams import Beams
from sal_height.errors import Rejected, UserError
from sal_height.geometry import aperture_at
from sal_height.imaging import Slc
from sal_height.movers.likelihood import HYPOTHESES
from sal_height.movers.migration import Migration, Migrations, about_ranges
from sal_height.movers.mover import MIGRATING, Looked, Mover, MoverMeasurement, mover_of, peak_of, without_ambiguities
from sal_height.movers.search import Search, Seen, ground_lag, spectra_of_image
from sal_height.movers.spectrum import Bins
from sal_height.numeric import C64, C128, F64, Bool, Index, vertex
from sal_height.sensor import MAX_SHARE, Sensor
from sal_height.settings import Settings, setting

MARGIN = 4
"""Margin at the edge of an image without candidates, pixels: the response is cut off there."""


class MoverSettings(Settings):
    """Candidates of the search, and the likelihood that a mover must have."""

    prominence_db: float = setting(
        10.0,
        "power of a pixel over the median of its row, in spotlight of what is around it, from which it is looked at",
        unit="dB",
        minimum=3.0,
        maximum=60.0,
    )
    false_alarm_rate: float = setting(
        1e-3,
        "greatest fraction of candidates at rest that may be taken for movers",
        minimum=1e-9,
        maximum=0.1,
    )
    fastest_mps: float = setting(
        20.0,
        "greatest radial velocity whose range migration is looked for, in spotlight along the flight, too; in "
        "stripmap no more than 6 rows while the beam passes; 0: none",
        unit="m/s",
        minimum=0.0,
        maximum=1000.0,
    )
    chip_pixels: int = setting(
        32,
        "pixels along the flight of a strip from which the spectrum of a bright pixel is taken",
        minimum=16,
        maximum=256,
    )
    max_saturated_fraction: float = setting(
        MAX_SHARE,
        "highest fraction of clipped samples in a channel; above it, an image is left out",
        minimum=0.0,
        maximum=1.0,
    )


@dataclass(frozen=True, eq=False)
class Drive:
    """Velocity of a target along the flight, and its image in focus.

    Attributes:
        along: velocity along the flight, and its standard deviation; None: the whole image may be out of focus, m/s.
        smear: smear that has been removed, over n (see above).
        speed: speed of the platform, m/s.
        col: column of its image in focus.
        row: pixels of its row, or along its migration, in focus, shape (channels, cols).
    """

    along: tuple[float, float] | None
    smear: float
    speed: float
    col: int
    row: C128

    @property
    def share(self) -> float:
        """Speed with which the target passes the beam, over that of the platform: 1 - u / v."""
        return 1 - self.along[0] / self.speed if self.along else 1.0

    def slowed(self, velocity: tuple[float, float]) -> tuple[float, float]:
        """Radial velocity by migration, and its standard deviation, corrected for the rate of the Doppler, m/s."""
        unsure = 2 * self.share * self.along[1] / self.speed if self.along else self.smear
        return self.share**2 * velocity[0], float(np.hypot(self.share**2 * velocity[1], unsure * velocity[0]))


@dataclass(frozen=True, eq=False)
class Drives:
    """Search for velocities along the flight in an image.

    Attributes:
        search: search with spectra of whole rows.
        cells: number n of cells, see above.
        speed: speed of the platform, m/s.
        blur: standard deviation of the smear of targets at rest, cells.
    """

    search: Search
    cells: float
    speed: float
    blur: float

    @classmethod
    def of(cls, search: Search, slc: Slc, sensor: Sensor) -> Self:
        """The search in an image, whose whole rows `search` has."""
        grid = slc.grid
        middle = grid.middle
        slant_range = float(np.linalg.norm(middle - aperture_at(middle, slc.aperture).position))
        cells = 2 * search.bins.angle**2 * slant_range / sensor.wavelength
        speed = float(np.linalg.norm(slc.aperture.velocity))
        place = slc.placement.beams_error * slant_range / speed
        # Each half of the aperture is in another block.
        return cls(search, cells, speed, 2 * np.sqrt(2) * place / (search.bins.cell * grid.col_spacing))

    def blurred(self, velocity: tuple[float, float]) -> tuple[float, float]:
        """A velocity by migration, and its standard deviation with the error of the Doppler rate by defocus, m/s."""
        return velocity[0], float(np.hypot(velocity[1], self.blur / self.cells * velocity[0]))

    def look(self, spectra: C128, elevation: float) -> Drive | None:
        """Velocity of a target along the flight; None: no smear is found.

        The image in focus must have half a dB more power than that out of focus, and 0.7 of that of a point: those of
        24 to 34 dB over the cells of a street reach 0.85.

        Args:
            spectra: spectra of the channels in its row, or along its migration, shape (bins, channels).
            elevation: elevation, rad.
        """
        bins = self.search.bins
        line = _line(self.search, spectra, elevation)
        most = len(line) // 2
        smear_step = 1.0  # step of the smears of the search for the sharpest image, cells
        smears = np.arange(-most, most + smear_step / 2, smear_step)
        places, waves = _places(bins)
        focused = line * np.exp(-1j * np.pi * smears[:, None] * bins.frequencies**2)
        power = np.abs(focused @ waves) ** 2
        brightest = power.max(axis=1)
        best = int(np.clip(brightest.argmax(), 1, len(smears) - 2))
        sharper = brightest[best] / brightest[len(smears) // 2]
        share = brightest[best] / np.sum(np.abs(line)) ** 2  # 1: a point in focus
        if sharper < 10**0.05 or share < 0.7:
            return None
        smear = float(smears[best] + smear_step * vertex(*brightest[best - 1 : best + 2])[0])
        place = float(places[power[best].argmax()])
        rate = 1 + smear / self.cells
        if rate <= 0:
            return None
        along, per_cell = self.speed * (1 - rate**-0.5), self.speed * rate**-1.5 / (2 * self.cells)
        published = None if self.blur else (along, per_cell)  # other targets change the smear by a cell
        col = bins.pixels // 2 + round(place * bins.cell)
        in_focus = spectra.T * np.exp(-1j * np.pi * smear * bins.frequencies**2)
        return Drive(published, smear / self.cells, self.speed, col, bins.image(in_focus))


def is_in_focus(search: Search, spectra: C128, elevation: float) -> bool:
    """True if the pixels around a target are about the image of a point: half of that power, at least.

    Otherwise it moves along the flight faster than is searched, and has Doppler frequencies beyond these pixels.
    Of 29 movers in strips of exact odometry the correct ones had 0.59 and more once their smear was removed; seven that
    were faster along the flight, or close to brighter ones, had 0.37 at most, and positions up to half a metre off.

    Args:
        search: search of these spectra.
        spectra: spectra of the channels, shape (bins, channels).
        elevation: elevation, rad.
    """
    line = _line(search, spectra, elevation)
    _, waves = _places(search.bins)
    return bool(np.max(np.abs(line @ waves)) ** 2 >= 0.5 * np.sum(np.abs(line)) ** 2)


def _line(search: Search, spectra: C128, elevation: float) -> C128:
    """Spectrum of the channels together, with a window, shape (bins,)."""
    beam = search.beams.response(elevation, search.bins.aspects)
    return np.asarray(np.sum(beam.conj() * spectra, axis=-1) / np.linalg.norm(beam, axis=-1) * np.hanning(len(spectra)))


def _places(bins: Bins) -> tuple[F64, C128]:
    """Positions in an image, a quarter of a cell apart, cells, and the waves of the bins, shape (bins, positions)."""
    places = np.arange(-len(bins.frequencies) / 2, len(bins.frequencies) / 2, 0.25)
    return places, np.exp(2j * np.pi * bins.frequencies[:, None] * places)


def check_sensor(sensor: Sensor) -> None:
    """Check that movers can be estimated with a sensor.

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
        images: images of channels of independent noise of one power, shape (channels, rows, cols).
        beams: beams of these channels, in one direction.
        slc: image from which these channels were combined.
        sensor: sensor of the image.
        settings: settings of the search.

    Raises:
        Rejected: the image has too few columns.
    """
    least = 16  # columns of the shortest spectrum, the minimum of chip_pixels
    if images.shape[-1] < least:
        raise Rejected(
            "few columns",
            f"An image of a strip has {images.shape[-1]} columns; {least} are needed to find movers (parameter "
            "cols of sar_compression).",
        )
    images = about_ranges(np.where(np.isfinite(images), images, 0), slc, sensor)
    bins = Bins.of(slc, sensor, min(settings.chip_pixels, images.shape[-1] // 2 * 2))
    coarse_step = 0.08  # step between the lags of the first search, beamwidths
    search, coarse = Search(images, beams, bins), Search(images, beams, bins, coarse_step)
    whole = Bins.of(slc, sensor, images.shape[-1])
    ground = ground_lag(slc, sensor, search.lags, lambda: spectra_of_image(images, beams, whole, search.lags))
    migrations = Migrations.of(coarse, slc, sensor, settings.fastest_mps, ground[0])
    of_rows = Migrations.of(Search(images, beams, whole, coarse_step), slc, sensor, settings.fastest_mps, ground[0])
    drives = Drives.of(of_rows.search, slc, sensor)
    looking = _Looking(search, migrations, of_rows, drives, ground, slc, sensor)
    migrating, looked_at = looking.for_migration(settings)
    lagging, candidates = looking.for_lags(settings)
    apart = [one for one in lagging if not any(_in_image_of(one, other, migrations) for other in migrating)]
    fastest = min(settings.fastest_mps, float(migrations.speeds[-1]))
    return Looked(without_ambiguities([*migrating, *apart]), looked_at + candidates, ground, fastest)


def bright_pixels(power: F64, background: F64, prominence_db: float, mode: Literal["reflect", "wrap"]) -> Bool:
    """Pixels brighter than all around them, than their background, and than sidelobes of brighter ones.

    Args:
        power: power of the image, shape (rows, cols).
        background: power of the ground; broadcasts to that shape.
        prominence_db: least power over the background, dB.
        mode: continuation of the image beyond its edges, as of `scipy.ndimage.maximum_filter`.
    """
    bright = power == maximum_filter(power, size=(3, 2 * MARGIN + 1), mode=mode)
    bright &= power > 10 ** (prominence_db / 10) * background
    columns = maximum_filter(power.max(axis=0), size=2 * MARGIN + 1, mode=mode)
    rows = maximum_filter(power.max(axis=1), size=3)
    # A sidelobe has up to -25 dB of the brightest pixel in the same rows or columns.
    bright &= power > 10**-2.5 * np.maximum(columns, rows[:, None])
    return np.asarray(bright)


def _candidates(power: F64, prominence_db: float) -> Index:
    """Rows and columns of bright pixels of a strip over the median of their row, shape (pixels, 2)."""
    bright = bright_pixels(power, np.median(power, axis=1, keepdims=True), prominence_db, "reflect")
    bright[:, :MARGIN] = bright[:, power.shape[1] - MARGIN :] = False
    return np.argwhere(bright)


@dataclass(frozen=True, eq=False)
class _Looking:
    """The search in an image; `of_rows` has spectra of whole rows, from which `drives` estimates smears."""

    search: Search
    migrations: Migrations
    of_rows: Migrations
    drives: Drives
    ground: tuple[float, float]
    slc: Slc
    sensor: Sensor

    def for_lags(self, settings: MoverSettings) -> tuple[list[Mover], int]:
        """Movers that the beam sees under another aspect than the ground, and the number of candidate pixels."""
        candidates = _candidates(np.sum(np.abs(self.search.images) ** 2, axis=0), settings.prominence_db)
        threshold = 2 * np.log(HYPOTHESES / settings.false_alarm_rate)
        found = []
        for seen in self.search.at(self._screened(candidates, threshold)):
            ratio = _ratio(seen, self.search.lags, self.ground[0])
            if ratio < threshold or not self._is_inside(seen.likelihoods):
                continue
            row, col = round(seen.row), round(seen.col)
            migration = self.migrations.look(row, col, len(self.migrations.speeds) // 2)
            if migration is None:
                continue
            if abs(migration.speed) < MIGRATING * migration.sigma:
                found += self._mover(seen, ratio, migration)
                continue
            # A single row contains it in a part of the bins only, and so with another lag.
            for along in self.search.of(migration.spectra[None], np.array([row]), np.array([col])):
                ratio = _ratio(along, self.search.lags, self.ground[0])
                if ratio > threshold and self._is_inside(along.likelihoods):
                    found += self._mover(along, ratio, migration, migrates=True)
        return found, len(candidates)

    def _screened(self, pixels: Index, threshold: float) -> Index:
        """The pixels whose ratio may exceed the threshold, by a few lags."""
        coarse = self.migrations.search
        # A lag half way between two has up to 7 more, if its standard deviation is the least that MODEL_ERROR leaves,
        # 0.015 beamwidths.
        lost = 8.0
        maybe = [
            seen.pixel for seen in coarse.at(pixels) if _ratio(seen, coarse.lags, self.ground[0]) > threshold - lost
        ]
        return np.array(maybe, np.intp).reshape(-1, 2)

    def for_migration(self, settings: MoverSettings) -> tuple[list[Mover], int]:
        """Movers that migrate through rows while the beam passes them, and the number of candidate pixels."""
        if settings.fastest_mps == 0:
            return [], 0
        powers = np.array(list(self.migrations.powers()))
        candidates = _candidates(powers.max(axis=0), settings.prominence_db)
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
        """The mover of a pixel; empty: it is at an end of the array, or out of focus."""
        elevation = self.search.elevation(seen.spectra, float(self.search.lags[seen.likelihoods.argmax()]))
        if elevation is None:
            return []
        row, velocity = migration.row if migrates else seen.row, (migration.speed, migration.sigma)
        search, along = self.search, None
        drive = self.drives.look(self.of_rows.spectra(row, migration.speed if migrates else 0.0), elevation[0])
        if drive:
            # A Doppler frequency is that of a greater aspect, and of a later time, than for a target at rest.
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
        """Standard deviation of a lag by what autofocus leaves, rad; 0: it has not located the image.

        Of 56 movers in strips with the errors of `sal_strips` the lag was wrong by 0.15 beamwidths (rms) and in the
        median by 0.04.
        """
        return 0.1 * self.search.beams.track_beamwidth if self.slc.placement.beams_error else 0.0

    def _in_focus(self, search: Search, seen: Seen, drive: Drive) -> tuple[Seen, tuple[float, float]] | None:
        """The pixel and its elevation by its image in focus; None: it is at an end of the array or of the lags."""
        cols = np.array([drive.col])
        chip = drive.row[:, search.first(cols)[0] + np.arange(search.bins.pixels)]
        for one in search.of(search.bins.spectra(chip).T[None], np.array([seen.pixel[0]]), cols):
            elevation = search.elevation(one.spectra, float(search.lags[one.likelihoods.argmax()]))
            if elevation and self._is_inside(one.likelihoods):
                return one, elevation
        return None

    def _is_inside(self, likelihoods: F64) -> bool:
        """True if the best lag is not an outermost one."""
        return bool(0 < likelihoods.argmax() < len(likelihoods) - 1)


def _ratio(seen: Seen, lags: F64, ground: float) -> float:
    """Twice the logarithm of the likelihood ratio of the best lag against that of the ground (rad)."""
    return float(2 * (seen.likelihoods.max() - _at(ground, lags, seen.likelihoods)))


def _at(lag: float, lags: F64, likelihoods: F64) -> float:
    """Logarithm of the likelihood of a lag between those of the search, by the parabola through three."""
    best = int(np.clip(np.rint((lag - lags[0]) / (lags[1] - lags[0])), 1, len(lags) - 2))
    before, there, after = likelihoods[best - 1 : best + 2].tolist()
    off = float(np.clip((lag - lags[best]) / (lags[1] - lags[0]), -1, 1))
    return float(there + off * (after - before) / 2 + off**2 * (after + before - 2 * there) / 2)


def _in_image_of(one: Mover, other: Mover, migrations: Migrations) -> bool:
    """True if a mover without migration may be part of the image of one that migrates, two rows around its path."""
    rows = abs(other.walk_velocity) / migrations.speed_of_row / 2 + 2.0
    return abs(one.row - other.row) <= rows and abs(one.col - other.col) <= 2 * MARGIN
