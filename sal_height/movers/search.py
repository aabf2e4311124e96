"""Elevations of bright pixels in a strip, and likelihoods of their lags (`likelihood`), for all pixels at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import nnls
from scipy.special import logsumexp

from sal_height.beams import Beams
from sal_height.geometry import aperture_at
from sal_height.imaging import NavigationPrior, Slc, line_of_sight
from sal_height.movers.likelihood import MODEL_ERROR, LagLikelihood
from sal_height.movers.spectrum import Bins
from sal_height.numeric import C64, C128, F64, MEDIAN_ERROR, Bool, Index, vertex
from sal_height.sensor import Sensor

ELEVATION_STEP = 0.05
"""Step of the elevations of the search, beamwidths."""

STEP = 0.02
"""Step of the lags of the search, beamwidths along the flight."""


def ground_lag(slc: Slc, sensor: Sensor, lags: F64, spectra: Callable[[], tuple[F64, F64]]) -> tuple[float, float]:
    """Lag of the ground, and its standard deviation, rad.

    Where autofocus has estimated the middle of the beams, the image is there, with the error that autofocus states.
    Otherwise it is estimated from spectra and odometry, unless odometry is exact.

    Args:
        slc: image.
        sensor: sensor of the image.
        lags: lags of the search, shape (lags,), rad.
        spectra: function for the power of rows in Doppler bins, shape (rows, bins), and the gains of the beam there,
            shape (lags, bins).
    """
    if slc.placement.beams_error:
        return 0.0, slc.placement.beams_error / float(np.linalg.norm(slc.aperture.velocity))
    prior = lag_by_odometry(slc, sensor)
    return lag_of_spectra(*spectra(), lags, prior) if prior else (0.0, 0.0)


def spectra_of_image(images: C64 | C128, beams: Beams, bins: Bins, lags: F64) -> tuple[F64, F64]:
    """Power of the rows of a strip's image, and gains of the beam, for `ground_lag`."""
    power = np.sum(np.abs(bins.spectra(images * np.hanning(images.shape[-1]))) ** 2, axis=0)
    gains = np.sum(np.abs(bins.amplitudes(beams, float(np.mean(beams.span)), lags)) ** 2, axis=-1)
    return power, gains


def lag_of_spectra(power: F64, gains: F64, lags: F64, prior: float) -> tuple[float, float]:
    """Mean and standard deviation of the lag by spectra and odometry, rad.

    The spectra are the median over rows, each over its own mean, so that no target counts for much; they have the
    beam's power over that of noise, which is unknown. Arguments as for `ground_lag`, and the standard deviation of the
    lag by odometry, rad.
    """
    power = power[np.all(power > 0, axis=-1)]
    if not len(power):
        return 0.0, prior
    power = power / np.mean(power, axis=-1, keepdims=True)
    level, error = np.median(power, axis=0), MEDIAN_ERROR * np.std(power) / np.sqrt(len(power))
    misfits = []
    for gain in gains:
        columns = np.stack([gain, np.ones_like(gain)], axis=-1)
        share, _ = nnls(columns, level)
        misfits.append(np.sum((columns @ share - level) ** 2) / error**2)
    misfit = np.array(misfits)
    excess = max(1.0, misfit.min() / max(1, len(level) - 3))
    logarithm = -misfit / (2 * excess) - (lags / prior) ** 2 / 2
    weight = np.exp(logarithm - logsumexp(logarithm))
    lag = float(weight @ lags)
    return lag, float(np.sqrt(weight @ (lags - lag) ** 2))


def lag_by_odometry(slc: Slc, sensor: Sensor) -> float:
    """Standard deviation of the lag of the ground by the covariance of the pose, rad; 0: it is exact.

    An error of the velocity is in that of the position along the flight (`Placement.seen_from`).
    """
    grid, aperture = slc.grid, slc.aperture
    middle = grid.middle
    slant_range = float(np.linalg.norm(middle - aperture_at(middle, aperture).position))
    pointing = NavigationPrior.of(aperture, np.zeros((3, 3)), line_of_sight(sensor, aperture)).pointing
    along = aperture.direction @ aperture.covariance[:3, :3] @ aperture.direction
    return float(np.hypot(pointing, np.sqrt(along) / slant_range)) if along >= 0 else pointing


@dataclass(frozen=True, eq=False)
class Seen:
    """A bright pixel.

    Attributes:
        pixel: row and column of the candidate.
        row, col: row and column of the target, in fractions.
        elevation: elevation of a target at rest, rad.
        likelihoods: logarithm of the likelihood of each lag, shape (lags,).
        cnr: power over the background.
        spectra: spectra of the channels, shape (bins, channels).
    """

    pixel: tuple[int, int]
    row: float
    col: float
    elevation: float
    likelihoods: F64
    cnr: float
    spectra: C128


@dataclass(frozen=True, eq=False)
class Search:
    """Search for the lags of pixels of an image.

    Attributes:
        images: images of channels of independent noise of one power, shape (channels, rows, cols).
        beams: beams of these channels, in one direction.
        bins: bins of the spectra.
        step: step from one lag to the next, beamwidths along the flight.
        widest: greatest lag. A target with that or more is seen through sidelobes only, and not published.
    """

    images: C64 | C128
    beams: Beams
    bins: Bins
    step: float = STEP
    widest: float = 1.1

    @cached_property
    def lags(self) -> F64:
        """Lags of the search, chosen so that aspect plus lag are the same angles for all images, rad."""
        return self._lags - self.bins.aspects[self.bins.middle]

    def at(self, pixels: Index) -> Iterator[Seen]:
        """The targets at pixels (row and column), shape (targets, 2), without those at an end of the array."""
        rows, cols = pixels.T
        yield from self.of(self.spectra(rows, cols), rows, cols)

    def of(self, spectra: C128, rows: Index, cols: Index) -> Iterator[Seen]:
        """The targets at pixels that have spectra of the shape (targets, bins, channels)."""
        # The elevation of a target at rest; where beams do not separate, a lag changes it a little.
        elevations = self.elevations(spectra)
        inside = np.flatnonzero(np.isfinite(elevations))
        spectra, elevations = spectra[inside], elevations[inside]
        backgrounds = self.backgrounds(rows[inside], elevations)
        powers = np.mean(np.sum(np.abs(spectra) ** 2, axis=-1), axis=-1)
        likelihoods, centres = self.likelihoods(spectra, elevations, np.maximum(backgrounds, MODEL_ERROR * powers))
        first = self.first(cols[inside])
        middles = first + self.bins.pixels // 2 + centres * self.bins.pixels / len(self.bins.numbers)
        for number, pixel in enumerate(inside):
            yield Seen(
                (int(rows[pixel]), int(cols[pixel])),
                self._row(int(rows[pixel]), int(cols[pixel])),
                float(middles[number]),
                float(elevations[number]),
                likelihoods[number],
                float(powers[number] / backgrounds[number]),
                spectra[number],
            )

    def in_focus(self, spectra: C128, row: int, middle: float, elevation: float) -> Seen:
        """A target of known elevation (rad), by spectra of the pixels in focus, shape (bins, channels).

        Args:
            spectra: spectra of the pixels.
            row: row of the target.
            middle: column about which the spectra are taken, in fractions.
            elevation: elevation, rad.
        """
        known, power = np.array([elevation]), float(np.mean(np.sum(np.abs(spectra) ** 2, axis=-1)))
        background = float(self.backgrounds(np.array([row]), known)[0])
        noise = np.array([max(background, MODEL_ERROR * power)])
        likelihoods, centres = self.likelihoods(spectra[None], known, noise)
        col = middle + float(centres[0]) * self.bins.pixels / len(self.bins.numbers)
        return Seen((row, round(middle)), float(row), col, elevation, likelihoods[0], power / background, spectra)

    def spectra(self, rows: Index, cols: Index) -> C128:
        """Spectra of the pixels along the flight around some, shape (targets, bins, channels)."""
        chips = self.images[:, rows[:, None], self.first(cols)[:, None] + np.arange(self.bins.pixels)]
        return np.moveaxis(self.bins.spectra(chips), 0, -1)

    def first(self, cols: Index) -> Index:
        """The first of the pixels around some."""
        return np.clip(cols - self.bins.pixels // 2, 0, self.images.shape[-1] - self.bins.pixels)

    def likelihoods(self, spectra: C128, elevations: F64, backgrounds: F64) -> tuple[F64, F64]:
        """Likelihoods of the lags of targets, shape (targets, lags), and their distances from the middle, cells.

        The centre of a cloud may be its brightest position or the centre of its power; the likelier one counts.
        """
        likelihoods, centres = np.empty((len(spectra), len(self.lags))), np.empty(len(spectra))
        frequencies = self.bins.frequencies
        amplitudes = self.bins.amplitudes(self.beams, elevations[:, None, None], self.lags)
        gains = np.linalg.norm(amplitudes, axis=-1)
        matched = np.einsum("tlbc,tbc->tlb", amplitudes.conj(), spectra)
        matched /= np.maximum(gains, 1e-12) * np.sqrt(backgrounds)[:, None, None]
        for likelihood, targets in self._alike(elevations, gains):
            peaks, middles = centres_of(matched[targets, len(self.lags) // 2], frequencies)
            turned = np.exp(2j * np.pi * frequencies * np.concatenate([peaks, middles])[:, None])
            both = likelihood.of(np.concatenate([matched[targets]] * 2) * turned[:, None])
            likelihoods[targets] = np.maximum(*np.split(both, 2))
            centres[targets] = middles
        return likelihoods, centres

    def _alike(self, elevations: F64, gains: F64) -> Iterator[tuple[LagLikelihood, Index]]:
        """Likelihoods, and the numbers of the targets that have them.

        Where beams separate, to 0.005 of the greatest gain, gains along the flight are those in the middle of the
        array. Elsewhere they are those of the nearest of elevations a quarter of a beamwidth apart.
        """
        step = 0.25 * self.beams.beamwidth
        middle = float(np.mean(self.beams.span))
        common = self._shape(middle)
        apart = np.max(np.abs(gains / gains.max(axis=(1, 2), keepdims=True) - common), axis=(1, 2)) > 0.005
        steps = np.where(apart, np.rint((elevations - middle) / step), 0)
        for number in np.unique(steps):
            shape = self._shape(middle + number * step) if number else common
            yield LagLikelihood.cached(self._nominal.frequencies, shape, self._known), np.flatnonzero(steps == number)

    def _shape(self, elevation: float) -> F64:
        """Gains for each lag at an elevation, over the greatest."""
        amplitudes = self._nominal.amplitudes(self.beams, elevation, self._lags)
        gains = np.linalg.norm(amplitudes, axis=-1)
        return np.asarray(gains / gains.max())

    @cached_property
    def _nominal(self) -> Bins:
        """The bins, as for most images of a flight: likelihoods are computed for these once."""
        return self.bins.nominal()

    @cached_property
    def _lags(self) -> F64:
        """Lags of the nominal bins, rad."""
        steps = round(self.widest / self.step)
        return self.beams.track_beamwidth * self.step * np.arange(-steps, steps + 1, dtype=np.float64)

    @cached_property
    def _known(self) -> Bool:
        """True where a target with each of the lags is in the main lobe in each bin, shape (lags, bins)."""
        lobe = max(pattern.main_lobe for pattern in self.beams.patterns) * self.beams.track_beamwidth
        return np.asarray(np.abs(self._nominal.aspects + self._lags[:, None]) < lobe)

    def _row(self, row: int, col: int) -> float:
        """Position in range of the peak of the power, by the rows adjacent to the brightest, in fractions of a row."""
        if not 0 < row < self.images.shape[1] - 1:
            return float(row)
        power = np.sum(np.abs(self.images[:, row - 1 : row + 2, col]) ** 2, axis=0)
        return row + 0.5 * float(np.clip(2 * vertex(*np.log(power + 1e-300))[0], -1, 1))

    @cached_property
    def elevation_grid(self) -> F64:
        """Elevations of the search, rad."""
        low, high = self.beams.domain(0.0)
        return np.arange(low, high, ELEVATION_STEP * self.beams.beamwidth)

    @cached_property
    def _elevation_beams(self) -> F64 | C128:
        """Beams for a target at rest at each of the elevations, shape (elevations, bins, channels)."""
        return self.beams.response(self.elevation_grid[:, None], self.bins.aspects)

    def elevations(self, spectra: C128) -> F64:
        """The most likely elevations of targets at rest, shape (targets,); NaN: that of an outer beam."""
        grid, amplitudes = self.elevation_grid, self._elevation_beams
        gains = np.mean(np.sum(np.abs(amplitudes) ** 2, axis=-1), axis=-1)
        in_bins = np.einsum("ebc,tbc->etb", amplitudes.conj(), spectra, optimize=True)
        explained = np.sum(np.abs(in_bins) ** 2, axis=-1) / gains[:, None]
        found = np.full(len(spectra), np.nan)
        for target, (values, best) in enumerate(zip(explained.T, explained.argmax(axis=0), strict=True)):
            if 0 < best < len(grid) - 1:
                found[target] = grid[best] + (grid[1] - grid[0]) * vertex(*values[best - 1 : best + 2])[0]
        return found

    def elevation(self, spectra: C128, lag: float, about: float = np.nan) -> tuple[float, float] | None:
        """The most likely elevation of a target with a lag, and its standard deviation; None: that of an outer beam.

        If it is about a known one (rad), others, such as that of the ground, do not count. Errors are those of the
        power that the target does not explain, and not less than parts of the bins differ: another surface in the same
        cell turns against the target from bin to bin.
        """
        grid = self.elevation_grid
        step = ELEVATION_STEP * self.beams.beamwidth
        if np.isfinite(about):
            grid = grid[np.abs(grid - about) < 0.5 * self.beams.beamwidth]
        amplitudes = self.beams.response(grid[:, None], self.bins.aspects + lag)
        in_bins = np.abs(np.sum(amplitudes.conj() * spectra, axis=-1)) ** 2
        gains = np.mean(np.sum(np.abs(amplitudes) ** 2, axis=-1), axis=-1)
        explained = np.sum(in_bins, axis=-1) / gains
        best = int(explained.argmax())
        if not 0 < best < len(grid) - 1:
            return None
        offset, bend = vertex(*explained[best - 1 : best + 2])
        left = (np.sum(np.abs(spectra) ** 2) - explained[best]) / (len(spectra) * (spectra.shape[1] - 1))
        variance = max(left, MODEL_ERROR * explained[best] / len(spectra)) * step**2 / bend
        # Five parts of the bins, each with its own elevation.
        parts = np.add.reduceat(in_bins, np.arange(5) * len(spectra) // 5, axis=-1)
        shares = parts[best] / parts[best].sum()
        spread = np.sum((shares * (grid[parts.argmax(axis=0)] - grid[best])) ** 2)
        return float(grid[best] + step * offset), float(np.sqrt(max(variance, spread)))

    def backgrounds(self, rows: Index, elevations: F64) -> F64:
        """Power of noise and ground at the elevations of targets, in their rows and the adjacent ones."""
        beams = self.beams.response(elevations, float(np.mean(self.bins.aspects)))
        found = np.empty(len(rows))
        for target, (row, beam) in enumerate(zip(rows.tolist(), beams, strict=True)):
            around = self.images[:, max(0, row - 2) : row + 3]
            power = np.abs(np.tensordot(beam.conj(), around, 1)) ** 2 / np.sum(np.abs(beam) ** 2)
            found[target] = max(float(np.median(power)) / np.log(2), 1e-300)
        return found


def centres_of(spectra: C128, frequencies: F64) -> tuple[F64, F64]:
    """Distances of targets from the middle, cells: brightest positions, and centres of the power 4 cells around."""
    step = 0.125
    places = np.arange(-len(frequencies) / 2, len(frequencies) / 2, step)
    image = (spectra * np.hanning(len(frequencies))) @ np.exp(2j * np.pi * frequencies[:, None] * places)
    power = np.abs(image) ** 2
    peaks, middles = np.empty((2, len(spectra)))
    for target, values in enumerate(power):
        best = int(np.clip(values.argmax(), 1, len(places) - 2))
        peaks[target] = places[best] + step * vertex(*values[best - 1 : best + 2])[0]
        near = np.abs(places - peaks[target]) < 4
        middles[target] = np.sum(places[near] * values[near]) / np.sum(values[near])
    return peaks, middles
