"""Targets that move by range cells while the beam passes them: found by undoing their range migration.

A target that recedes with v_r is seen under the aspect alpha (squint) at the time -alpha rho / v after it is abeam, rho
being its range and v the speed of the platform. Its image has in the Doppler bin of that aspect the range

    r = r_0 - v_r alpha rho / v

with r_0 that of the image at the aspect 0. The phase of pulses is ambiguous in v_r, by multiples of wavelength * PRF /
2; the migration has no period, but is some thousand times less precise.

For a migration, the samples of each bin are weighted by the response in range about the range there. That is all of a
target that is thin in range, so that its likelihood is that of `likelihood` for this spectrum, and the rest is noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from sal_height.geometry import aperture_at
from sal_height.imaging import Slc
from sal_height.movers.likelihood import MODEL_ERROR
from sal_height.movers.search import Search
from sal_height.movers.spectrum import column_aspects, point_response
from sal_height.numeric import C64, C128, F64, Index, vertex
from sal_height.sensor import Sensor

REACH = 3
"""Margin around a migration for the response of a target, rows."""

FINE_STEP = 0.05
"""Last step of the search in range, and step for targets at rest, rows."""


@dataclass(frozen=True, eq=False)
class Migration:
    """Range migration of a target.

    Attributes:
        speed: radial velocity, positive if it recedes, m/s.
        sigma: standard deviation of that, m/s.
    """

    speed: float
    sigma: float


@dataclass(frozen=True, eq=False)
class Migrations:
    """Search for targets that migrate in an image.

    Attributes:
        search: search for lags in the same image.
        slope: shift of a target per m/s and per radian of the aspect, rows.
        spacing: spacing of rows, range resolutions.
        window: window over the band, a name of `windows.WINDOWS`.
        aspects: aspects of all bins of whole rows, in the order of `numpy.fft.fft`, shape (cols,), rad.
        fastest: largest speed of the search, m/s.
    """

    search: Search
    slope: float
    spacing: float
    window: str
    aspects: F64
    fastest: float

    @classmethod
    def of(cls, search: Search, slc: Slc, sensor: Sensor, fastest: float) -> Self:
        """The search in an image, whose pixels `search` has about the phase of their range (`about_ranges`)."""
        grid = slc.grid
        middle = grid.middle
        aperture = aperture_at(middle, slc.aperture)
        sight = middle - aperture.position
        slant_range, speed = float(np.linalg.norm(sight)), float(np.linalg.norm(aperture.velocity))
        spacing = grid.row_spacing * float(grid.row_direction @ sight) / slant_range
        aspects = column_aspects(slc, sensor, grid.cols)
        slope, cells = slant_range / (speed * spacing), abs(spacing) / sensor.range_resolution
        found = cls(search, slope, cells, slc.range_window, aspects, fastest)
        return replace(found, fastest=min(fastest, 6 * found.speed_of_row))

    @property
    def speed_of_row(self) -> float:
        """Speed of a target that migrates by one row from the first bin to the last, m/s."""
        aspects = self.search.bins.aspects
        return float(1 / abs(self.slope * (aspects[-1] - aspects[0])))

    def response(self, rows: F64) -> F64:
        """Amplitude of a point at distances from it (rows), 1 in the middle."""
        return point_response(self.window, self.spacing, rows)

    def spectra(self, row: float, speed: float) -> C128:
        """Spectra of the middle pixels along the migration of a target, shape (bins, channels).

        Args:
            row: row of the target at the aspect 0, in fractions.
            speed: radial velocity, m/s.
        """
        rows, cols = self.search.images.shape[1:]
        spread = REACH + int(np.ceil(0.5 * abs(speed) / self.speed_of_row))
        numbers = np.arange(max(0, round(row) - spread), min(rows, round(row) + spread + 1))
        spectra = self.search.spectra(numbers, np.full(len(numbers), cols // 2))
        return self._along(spectra, numbers, np.array([row]), np.array([speed]))[0]

    def look(self, row: int, col: int) -> Migration | None:
        """Range migration of the target at a pixel; None: it is at an end of the array."""
        search = self.search
        numbers = np.arange(max(0, row - REACH), min(search.images.shape[1], row + REACH + 1))
        spectra = search.spectra(numbers, np.full(len(numbers), col))
        coarse = self._along(spectra, numbers, np.array([float(row)]), np.array([0.0]))
        elevations = search.elevations(coarse)
        if not np.isfinite(elevations[0]):
            return None
        power = float(np.mean(np.sum(np.abs(coarse[0]) ** 2, axis=-1)))
        background = max(float(search.backgrounds(np.array([row]), elevations)[0]), MODEL_ERROR * power)
        beam = search.beams.response(elevations[0], search.bins.aspects)
        matched = np.einsum("bc,rbc->rb", beam.conj(), spectra) / np.linalg.norm(beam, axis=-1) / np.sqrt(background)
        return self._measured(_Rows(numbers, spectra, matched, float(elevations[0]), background), row)

    def _measured(self, target: _Rows, row: int) -> Migration:
        """Migration of a target about a row."""
        step = self.speed_of_row / 8
        speeds: F64 = step * np.arange(-11, 12, dtype=np.float64)
        rows: F64 = row + 0.25 * np.arange(-4, 5, dtype=np.float64)
        energy = self._energy(target, rows, speeds)
        fast, place = np.unravel_index(energy.argmax(), energy.shape)
        speeds = speeds[fast] + step * np.arange(-3, 4)
        fine: F64 = rows[place] + FINE_STEP * np.arange(-10, 11, dtype=np.float64)
        energy = self._energy(target, fine, speeds)
        best = int(np.clip(energy.max(axis=1).argmax(), 1, len(speeds) - 2))
        speeds, energy = speeds[best - 1 : best + 2], energy[best - 1 : best + 2]
        places = energy.argmax(axis=1)
        spectra = self._along(target.spectra, target.numbers, fine[places], speeds)
        offset, bend = vertex(*(self._likelihoods(target, spectra).max(axis=1) + energy.max(axis=1)))
        return Migration(float(speeds[1] + step * offset), float(step / np.sqrt(bend)))

    def _likelihoods(self, target: _Rows, spectra: C128) -> F64:
        """Logarithm of the likelihoods of all lags of spectra made of a target's rows, shape (spectra, lags)."""
        count = len(spectra)
        elevations, backgrounds = np.full(count, target.elevation), np.full(count, target.background)
        return self.search.likelihoods(spectra, elevations, backgrounds)[0]

    def _energy(self, target: _Rows, rows: F64, speeds: F64) -> F64:
        """Power along migrations, the sum over bins, shape (speeds, rows)."""
        weights = self.weights(target.numbers, rows, speeds[:, None])
        return np.asarray(np.sum(np.abs(np.einsum("vtrb,rb->vtb", weights, target.matched)) ** 2, axis=-1))

    def _along(self, spectra: C128, numbers: Index, rows: F64, speeds: F64) -> C128:
        """Spectra of migrations, shape (speeds, bins, channels), from those of rows, shape (rows, bins, channels)."""
        return np.asarray(np.einsum("trb,rbc->tbc", self.weights(numbers, rows, speeds), spectra))

    def weights(self, numbers: Index, rows: F64, speeds: F64, aspects: F64 | None = None) -> F64:
        """Weights of numbered rows in the spectra of migrations, sum of squares 1, shape (..., rows, bins).

        The rows of the targets at the aspect 0 and the speeds broadcast.
        """
        rows, speeds = np.broadcast_arrays(np.asarray(rows, np.float64), speeds)
        squints = self.search.bins.aspects if aspects is None else aspects
        there = rows[..., None] - self.slope * speeds[..., None] * squints
        responses = self.response(numbers[:, None] - there[..., None, :])
        return np.asarray(responses / np.linalg.norm(responses, axis=-2, keepdims=True))


@dataclass(frozen=True, eq=False)
class _Rows:
    """Spectra of rows around a target.

    Attributes:
        numbers: numbers of the rows.
        spectra: spectra of the channels, shape (rows, bins, channels).
        matched: spectra of the beam at the elevation, background 1, shape (rows, bins).
        elevation: elevation of the target, rad.
        background: power of noise and ground.
    """

    numbers: Index
    spectra: C128
    matched: C128
    elevation: float
    background: float


def about_ranges(images: C64 | C128, slc: Slc, sensor: Sensor) -> C128:
    """Images without the phase of the range of their rows, 4 pi / wavelength per metre."""
    grid = slc.grid
    points = grid.points(np.arange(grid.rows), (grid.cols - 1) / 2)
    abeam = aperture_at(points[grid.rows // 2], slc.aperture).position
    ranges = np.linalg.norm(points - abeam, axis=-1)
    turns = 2 * (ranges - ranges[grid.rows // 2]) / sensor.wavelength
    return np.asarray(images * np.exp(-2j * np.pi * turns)[:, None])
