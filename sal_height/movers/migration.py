"""Targets that move by range cells while the beam passes them: found by undoing their range migration.

A target that recedes with v_r is seen under the aspect alpha (squint) at the time -alpha rho / v after it is abeam, rho
being its range and v the speed of the platform. Its image has in the Doppler bin of that aspect the range

    r = r_0 - v_r alpha rho / v

with r_0 that of the image at the aspect 0. The phase of pulses is ambiguous in v_r, by multiples of wavelength * PRF /
2; the migration has no period, but is some thousand times less precise.

For a migration, the samples of each bin are weighted by the response in range about the range there. That is all of a
target that is thin in range, so that its likelihood is that of `likelihood` for this spectrum, and the rest is noise. A
target at rest, or nearly so, may be a cloud that is spread over range as well: for the same samples, bins of several
rows, the covariance is that of `likelihood` times that of the rows. The ratio of these two is the test for migration.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
import scipy.fft

from sal_height.geometry import aperture_at
from sal_height.imaging import Slc
from sal_height.movers.likelihood import MODEL_ERROR
from sal_height.movers.search import Search, centres_of
from sal_height.movers.spectrum import column_aspects, point_response
from sal_height.numeric import C64, C128, F64, Index, fast_length, vertex
from sal_height.sensor import Sensor

REACH = 3
"""Margin around a migration for the response of a target, rows."""

FINE_STEP = 0.05
"""Last step of the search in range, and step for targets at rest, rows."""

NEIGHBOURS = 3
"""Number of targets at rest in the same rows that may together look like one that migrates."""

LEAST_PART = 0.5
"""Least fraction of the amplitude of a target's response within the image, and without that of the targets before."""

DEPTHS = (0.35, 0.7, 1.4, 2.8)
"""Rms widths in range of clouds at rest, in addition to thin ones, rows."""


@dataclass(frozen=True, eq=False)
class Migration:
    """Range migration of a target.

    Attributes:
        speed: radial velocity, positive if it recedes, m/s.
        sigma: standard deviation of that, m/s.
        row: row of the target at the aspect 0, in fractions.
        likelihood_ratio: twice the logarithm of the ratio against targets without migration; infinite where it was not
            computed.
        spectra: spectra of the channels along the migration, shape (bins, channels).
    """

    speed: float
    sigma: float
    row: float
    likelihood_ratio: float
    spectra: C128


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
        ground_lag: lag of the ground, rad.
    """

    search: Search
    slope: float
    spacing: float
    window: str
    aspects: F64
    fastest: float
    ground_lag: float

    @classmethod
    def of(cls, search: Search, slc: Slc, sensor: Sensor, fastest: float, ground_lag: float) -> Self:
        """The search in an image, whose pixels `search` has about the phase of their range (`about_ranges`)."""
        grid = slc.grid
        middle = grid.middle
        aperture = aperture_at(middle, slc.aperture)
        sight = middle - aperture.position
        slant_range, speed = float(np.linalg.norm(sight)), float(np.linalg.norm(aperture.velocity))
        spacing = grid.row_spacing * float(grid.row_direction @ sight) / slant_range
        aspects = column_aspects(slc, sensor, grid.cols)
        slope, cells = slant_range / (speed * spacing), abs(spacing) / sensor.range_resolution
        return cls(search, slope, cells, slc.range_window, aspects, fastest, ground_lag)

    @property
    def speed_of_row(self) -> float:
        """Speed of a target that migrates by one row from the first bin to the last, m/s."""
        aspects = self.search.bins.aspects
        return float(1 / abs(self.slope * (aspects[-1] - aspects[0])))

    @cached_property
    def speeds(self) -> F64:
        """Speeds whose migration is undone in the whole image, up to 6 rows: 0 is in their middle, m/s."""
        fastest = min(self.fastest, 6 * self.speed_of_row)
        step = 1.5 * self.speed_of_row  # half of it costs 0.5 dB
        count = int(np.ceil(fastest / step))
        return fastest / max(1, count) * np.arange(-count, count + 1, dtype=np.float64)

    def powers(self) -> Iterator[F64]:
        """Power of the image, summed over channels, with the migration of each speed undone, shape (rows, cols)."""
        images = self.search.images
        rows, cols = images.shape[1:]
        length = fast_length(rows + 2 * int(np.ceil(abs(self.speeds[0]) / self.speed_of_row)) + 2)
        spectrum = scipy.fft.fft2(images.astype(np.complex64), s=(length, cols), axes=(1, 2))
        turns = np.fft.fftfreq(length)[:, None] * (self.slope * self.aspects)
        step = self.speeds[1] - self.speeds[0]
        undoing = np.exp(-2j * np.pi * step * turns).astype(np.complex64)
        spectrum *= np.exp(-2j * np.pi * self.speeds[0] * turns).astype(np.complex64)
        for _ in self.speeds:
            undone = scipy.fft.ifft2(spectrum, axes=(1, 2))[:, :rows]
            yield np.sum(undone.real**2 + undone.imag**2, axis=0)
            spectrum *= undoing

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

    def look(self, row: int, col: int, number: int, threshold: float | None = None) -> Migration | None:
        """Migration of the target that is bright at a pixel with the migration of a speed undone.

        Args:
            row: row of the pixel.
            col: column of the pixel.
            number: number of the speed in `speeds`.
            threshold: likelihood ratio that must be exceeded; None: it is known to move, and the ratio is not computed.

        Returns:
            None: it is at an end of the array, or the ratio is less.
        """
        search, speed = self.search, float(self.speeds[number])
        spread = REACH + int(np.ceil(0.5 * abs(speed) / self.speed_of_row))
        numbers = np.arange(max(0, row - spread), min(search.images.shape[1], row + spread + 1))
        spectra = search.spectra(numbers, np.full(len(numbers), col))
        coarse = self._along(spectra, numbers, np.array([float(row)]), np.array([speed]))
        elevations = search.elevations(coarse)
        if not np.isfinite(elevations[0]):
            return None
        power = float(np.mean(np.sum(np.abs(coarse[0]) ** 2, axis=-1)))
        background = max(float(search.backgrounds(np.array([row]), elevations)[0]), MODEL_ERROR * power)
        beam = search.beams.response(elevations[0], search.bins.aspects)
        matched = np.einsum("bc,rbc->rb", beam.conj(), spectra) / np.linalg.norm(beam, axis=-1) / np.sqrt(background)
        target = _Rows(numbers, spectra, matched, float(elevations[0]), background)
        return self._judged(target, row, speed, threshold)

    def _judged(self, target: _Rows, row: int, about: float, threshold: float | None) -> Migration | None:
        """Migration of a target about a row and a speed; None: its likelihood ratio is less than the threshold."""
        step = self.speed_of_row / 8
        speeds: F64 = about + step * np.arange(-11, 12, dtype=np.float64)
        rows: F64 = row + 0.25 * np.arange(-4, 5, dtype=np.float64)
        energy = self._energy(target, rows, speeds)
        fast, place = np.unravel_index(energy.argmax(), energy.shape)
        still = self._still(target, float(rows[place]), float(speeds[fast]))
        if threshold is not None and 2 * (energy.max() - np.sum(np.abs(still[0] @ target.matched) ** 2)) < threshold:
            return None
        speeds = speeds[fast] + step * np.arange(-3, 4)
        fine: F64 = rows[place] + FINE_STEP * np.arange(-10, 11, dtype=np.float64)
        energy = self._energy(target, fine, speeds)
        best = int(np.clip(energy.max(axis=1).argmax(), 1, len(speeds) - 2))
        speeds, energy = speeds[best - 1 : best + 2], energy[best - 1 : best + 2]
        places = energy.argmax(axis=1)
        spectra = self._along(target.spectra, target.numbers, fine[places], speeds)
        migrating = self._likelihoods(target, spectra).max(axis=1) + energy.max(axis=1)
        ratio = np.inf
        if threshold is not None:
            ratio = float(2 * (migrating[1] - self._at_rest(target, still)))
            if ratio < threshold:
                return None
        offset, bend = vertex(*migrating)
        speed, sigma = float(speeds[1] + step * offset), float(step / np.sqrt(bend))
        return Migration(speed, sigma, float(fine[places[1]]), ratio, spectra[1])

    def _at_rest(self, target: _Rows, still: F64) -> float:
        """Logarithm of the greatest likelihood without migration.

        That is one target of any lag, several at rest in different rows, or one that is spread over range.
        """
        likelihoods = self._likelihoods(target, np.einsum("tr,rbc->tbc", still, target.spectra))
        explained = np.sum(np.abs(still @ target.matched) ** 2, axis=-1)
        one = likelihoods[0].max() + explained[0]
        several = np.cumsum(likelihoods[:, self._ground] + explained).max()
        return max(float(one), float(several), self._deep(target, still[0], int(likelihoods[0].argmax())))

    @cached_property
    def _ground(self) -> int:
        """Number of the lag of the ground."""
        return int(np.abs(self.search.lags - self.ground_lag).argmin())

    def _likelihoods(self, target: _Rows, spectra: C128) -> F64:
        """Logarithm of the likelihoods of all lags of spectra made of a target's rows, shape (spectra, lags)."""
        count = len(spectra)
        elevations, backgrounds = np.full(count, target.elevation), np.full(count, target.background)
        return self.search.likelihoods(spectra, elevations, backgrounds)[0]

    def _still(self, target: _Rows, row: float, speed: float) -> F64:
        """Weights of rows in the spectra of the brightest targets at rest, one after the other.

        They are in the rows through which a target about a row migrates with a speed, and one row around these.

        Returns:
            Shape (targets, rows), each orthogonal to the others: the part of a target that those before do not have.
        """
        numbers = target.numbers
        margin = abs(speed) / self.speed_of_row / 2 + 1.0
        places: F64 = row + np.arange(-margin, margin + FINE_STEP / 2, FINE_STEP, dtype=np.float64)
        responses = self.response(numbers - places[:, None])
        found = np.zeros((0, len(numbers)))
        for _ in range(NEIGHBOURS):
            left = responses - responses @ found.T @ found
            norms = np.linalg.norm(left, axis=1)
            left = left[norms > LEAST_PART] / norms[norms > LEAST_PART, None]
            if not len(left):
                break
            energy = np.sum(np.abs(left @ target.matched) ** 2, axis=-1)
            found = np.concatenate([found, left[energy.argmax()][None]])
        return found

    def _deep(self, target: _Rows, brightest: F64, lag: int) -> float:
        """Logarithm of the likelihood of a cloud about a row that is spread over range, at rest or with a lag."""
        likelihood = self.search.likelihood_at(target.elevation)
        power = np.sum(np.abs(target.matched) ** 2, axis=-1)
        row = float(np.sum(target.numbers * brightest**2))
        near = np.abs(target.numbers - row) < REACH
        centroid = float(np.sum((target.numbers * power)[near]) / np.sum(power[near]))
        covariances = np.concatenate(
            [self._covariances(np.asarray(target.numbers - place, np.float64)) for place in (row, centroid)]
        )
        centres = np.concatenate(centres_of((brightest @ target.matched)[None], self.search.bins.frequencies))
        turned = np.exp(2j * np.pi * self.search.bins.frequencies * centres[:, None])
        lags = {lag, self._ground}
        return max(likelihood.of_rows((target.matched * turn).T, one, covariances) for turn in turned for one in lags)

    def _covariances(self, rows: F64) -> F64:
        """Covariances of the amplitudes of rows about the middle of clouds of power 1, for each of DEPTHS."""
        places = np.linspace(-3, 3, 49)
        weights = np.exp(-(places**2) / 2)
        responses = self.response(rows - np.multiply.outer(DEPTHS, places)[..., None])
        return np.einsum("p,dpr,dps->drs", weights / weights.sum(), responses, responses)

    def _energy(self, target: _Rows, rows: F64, speeds: F64) -> F64:
        """Power along migrations, the sum over bins, shape (speeds, rows)."""
        weights = self._weights(target.numbers, rows, speeds[:, None])
        return np.asarray(np.sum(np.abs(np.einsum("vtrb,rb->vtb", weights, target.matched)) ** 2, axis=-1))

    def _along(self, spectra: C128, numbers: Index, rows: F64, speeds: F64) -> C128:
        """Spectra of migrations, shape (speeds, bins, channels), from those of rows, shape (rows, bins, channels)."""
        return np.asarray(np.einsum("trb,rbc->tbc", self._weights(numbers, rows, speeds), spectra))

    def _weights(self, numbers: Index, rows: F64, speeds: F64) -> F64:
        """Weights of numbered rows in the spectra of migrations, sum of squares 1, shape (..., rows, bins).

        The rows of the targets at the aspect 0 and the speeds broadcast.
        """
        rows, speeds = np.broadcast_arrays(np.asarray(rows, np.float64), speeds)
        there = rows[..., None] - self.slope * speeds[..., None] * self.search.bins.aspects
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
