"""Movers in the images of a strip: their place, height and radial velocity, without being told the velocity.

Nothing but the direction in which it was seen tells a mover from what stands still. For each bright pixel elevation and
lag (`likelihood`) are estimated together. Twice the logarithm of the likelihood of the best lag over that of the ground
is what tells that it moves; with what stands still, it exceeds t in less than HYPOTHESES exp(-t / 2) of all cases: each
of the lags that can be told apart does so in less than exp(-t / 2) (Markov's inequality of likelihood ratios).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import maximum_filter
from scipy.optimize import nnls
from scipy.special import logsumexp

from sal_height.beams import Beams
from sal_height.geometry import aperture_at, locate_at_elevation
from sal_height.imaging import Slc
from sal_height.movers.likelihood import LagLikelihood
from sal_height.movers.settings import MoverSettings
from sal_height.movers.spectrum import Bins
from sal_height.numeric import C64, C128, F64, Bool
from sal_height.relief import Surface, measured_covariance
from sal_height.sensor import Sensor

HYPOTHESES = 10.0
"""Lags that can be told apart."""

FARTHEST, STEP = 1.1, 0.02
"""Greatest lag that is looked for and the step from one to the next, in beamwidths along the flight.

What has a greater one, or the greatest itself, is seen through sidelobes only, and not told."""

MODEL_ERROR = 0.01
"""Power by which spectra differ from what the beams let expect, over their own."""

ELEVATION_STEP = 0.05
"""Of the search, in beamwidths."""

MEDIAN_ERROR = 1.25
"""Standard error of a median over that of a mean."""

ROW_ERROR = 0.15
"""Standard deviation of a target's place in range, in rows: neighbours shift the peak of its power."""

SAME_ELEVATION = 0.01
"""Change of an elevation, in beamwidths, that changes nothing of a lag."""

PARTS = 5
"""Of the bins, whose elevations are compared."""

MARGIN = 4
"""Pixels from the edge of an image within which nothing is looked at: its response is cut off."""


@dataclass(frozen=True, eq=False)
class Mover:
    """Something that moves.

    Attributes:
        position: in map when it was abeam, m, shape (3,).
        covariance: of that, with what the pose adds, m^2, shape (3, 3).
        height: above the sphere, m.
        sigma: of the height, m.
        radial_velocity: m/s, positive if it recedes; known but for multiples of `ambiguity`.
        velocity_sigma: its standard deviation, m/s.
        ambiguity: radial velocity that pulses cannot tell from none, m/s.
        likelihood_ratio: twice its logarithm, against the ground's.
        cnr_db: power of its brightest pixel over noise and ground around it.
        row: of that pixel.
        col: of that pixel.
    """

    position: F64
    covariance: F64
    height: float
    sigma: float
    radial_velocity: float
    velocity_sigma: float
    ambiguity: float
    likelihood_ratio: float
    cnr_db: float
    row: int
    col: int


@dataclass(frozen=True, eq=False)
class Looked:
    """What was found in an image.

    Attributes:
        movers: that were found, the surest first.
        candidates: number of pixels that were looked at.
        ground_lag: of what stands still, rad, and its standard deviation.
    """

    movers: tuple[Mover, ...]
    candidates: int
    ground_lag: tuple[float, float]


def find_movers(images: C64 | C128, beams: Beams, slc: Slc, sensor: Sensor, settings: MoverSettings) -> Looked:
    """Find what moves in an image of a strip.

    Args:
        images: of channels of independent noise of one power, shape (channels, rows, cols).
        beams: of these channels, in one direction.
        slc: that the images are of.
        sensor: that took them.
        settings: of the search.
    """
    bins = Bins.of(slc, sensor, min(settings.chip_pixels, images.shape[-1] // 2 * 2))
    steps = round(FARTHEST / STEP)
    lags: F64 = sensor.beams.track_beamwidth * STEP * np.arange(-steps, steps + 1, dtype=np.float64)
    whole = Bins.of(slc, sensor, images.shape[-1])
    ground = _ground_lag(images, beams, whole, lags, _lag_by_odometry(slc))
    candidates = _bright(images, settings.prominence_db)
    threshold = 2 * np.log(HYPOTHESES / settings.false_alarm_rate)
    search = _Search(images, beams, bins, lags)
    found = []
    for row, col in np.argwhere(candidates):
        seen = search.at(int(row), int(col))
        ratio = 2 * (seen.told.max() - float(np.interp(ground[0], lags, seen.told)))
        if ratio > threshold and 0 < seen.told.argmax() < len(lags) - 1:
            found.append(_mover(seen, ratio, lags, ground, slc, sensor))
    return Looked(_without_ambiguities(found), int(candidates.sum()), ground)


def _bright(images: C64 | C128, prominence_db: float) -> Bool:
    """Pixels that are brighter than all around, and than most of their row."""
    power = np.sum(np.abs(images) ** 2, axis=0)
    around = maximum_filter(power, size=(3, 2 * MARGIN + 1))
    bright = (power == around) & (power > 10 ** (prominence_db / 10) * np.median(power, axis=1, keepdims=True))
    bright[:, :MARGIN] = bright[:, power.shape[1] - MARGIN :] = False
    return np.asarray(bright)


@dataclass(frozen=True, eq=False)
class _Seen:
    """A bright pixel.

    Attributes:
        row, col: of the pixel, in fractions.
        elevation: rad.
        elevation_sigma: rad.
        told: logarithm of the likelihood of each lag.
        cnr: power over the background.
    """

    row: float
    col: float
    elevation: float
    elevation_sigma: float
    told: F64
    cnr: float


@dataclass(frozen=True, eq=False)
class _Search:
    """Arguments of `find_movers`, and the lags that are looked for."""

    images: C64 | C128
    beams: Beams
    bins: Bins
    lags: F64

    def at(self, row: int, col: int) -> _Seen:
        """Elevation and likelihoods of the lags of the target at a pixel."""
        first = int(np.clip(col - self.bins.pixels // 2, 0, self.images.shape[-1] - self.bins.pixels))
        spectra = self.bins.spectra(self.images[:, row, first : first + self.bins.pixels]).T
        lag, told, elevation, variance, background, centre = 0.0, np.zeros(0), 0.0, 0.0, 1.0, 0.0
        for _ in range(2):  # elevation for a lag, and the lag for the elevation
            before = elevation
            elevation, variance = self._elevation(spectra, lag)
            if abs(elevation - before) < SAME_ELEVATION * self.beams.beamwidth:
                break  # as with all beams that separate: the lag stays, too
            background = self._background(row, elevation, spectra)
            amplitudes = self.bins.amplitudes(self.beams, elevation, self.lags)
            gains = np.linalg.norm(amplitudes, axis=-1)
            matched = np.sum(amplitudes.conj() * spectra, axis=-1) / np.maximum(gains, 1e-12) / np.sqrt(background)
            # Beyond its main lobe the antenna may have the sidelobes of its pattern, or none.
            likelihoods = [
                LagLikelihood(self.bins.frequencies, g, self._known) for g in (gains, np.where(self._known, gains, 0.0))
            ]
            peak, centre = _centres(matched[len(self.lags) // 2], self.bins.frequencies)
            turned = [matched * np.exp(2j * np.pi * self.bins.frequencies * place) for place in (peak, centre)]
            told = np.max([one.of(spectrum) for one in likelihoods for spectrum in turned], axis=0)
            lag = float(self.lags[told.argmax()])
        cnr = float(np.sum(np.abs(spectra) ** 2) / len(spectra)) / background
        middle = first + self.bins.pixels // 2 + centre * self._pixels_per_cell
        return _Seen(self._row(row, col), middle, elevation, float(np.sqrt(variance)), told, cnr)

    @cached_property
    def _known(self) -> Bool:
        """Whether the antenna saw a target with each of the lags in its main lobe in each bin."""
        lobe = max(pattern.main_lobe for pattern in self.beams.patterns) * self.beams.track_beamwidth
        return np.asarray(np.abs(self.bins.aspects + self.lags[:, None]) < lobe)

    @property
    def _pixels_per_cell(self) -> float:
        """Pixels of the chip over its bins: how far apart cells of resolution are."""
        return self.bins.pixels / len(self.bins.numbers)

    def _row(self, row: int, col: int) -> float:
        """Where in range the power has its peak, by the rows beside the brightest, in fractions of a row."""
        if not 0 < row < self.images.shape[1] - 1:
            return float(row)
        before, there, after = np.log(np.sum(np.abs(self.images[:, row - 1 : row + 2, col]) ** 2, axis=0) + 1e-300)
        return row + float(np.clip((after - before) / max(2 * (2 * there - before - after), 1e-12), -0.5, 0.5))

    def _elevation(self, spectra: C128, lag: float) -> tuple[float, float]:
        """The most likely elevation of a target with a lag, and its variance.

        Errors are those of the power that the target does not explain, and not less than parts of the bins differ:
        another surface in the same cell turns against the target from bin to bin.
        """
        low, high = self.beams.span
        grid = np.arange(low, high, ELEVATION_STEP * self.beams.beamwidth)
        amplitudes = self.beams.response(grid[:, None], self.bins.aspects + lag)
        in_bins = np.abs(np.sum(amplitudes.conj() * spectra, axis=-1)) ** 2
        gains = np.mean(np.sum(np.abs(amplitudes) ** 2, axis=-1), axis=-1)
        explained = np.sum(in_bins, axis=-1) / gains
        best = int(np.clip(explained.argmax(), 1, len(grid) - 2))
        before, there, after = explained[best - 1 : best + 2]
        bend, step = max(2 * there - before - after, 1e-9 * there), grid[1] - grid[0]
        left = (np.sum(np.abs(spectra) ** 2) - there) / (len(spectra) * (spectra.shape[1] - 1))
        variance = max(left, MODEL_ERROR * there / len(spectra)) * step**2 / bend
        elevation = grid[best] + step * np.clip((after - before) / (2 * bend), -1, 1)
        parts = np.add.reduceat(in_bins, np.arange(PARTS) * len(spectra) // PARTS, axis=-1)
        shares = parts[best] / parts[best].sum()
        spread = np.sum((shares * (grid[parts.argmax(axis=0)] - grid[best])) ** 2)
        return float(elevation), float(max(variance, spread))

    def _background(self, row: int, elevation: float, spectra: C128) -> float:
        """Power of noise and ground that a target at an elevation has in its row and those beside it."""
        beam = self.beams.response(elevation, float(np.mean(self.bins.aspects)))
        rows = self.images[:, max(0, row - 2) : row + 3]
        power = np.abs(np.tensordot(beam.conj(), rows, 1)) ** 2 / np.sum(np.abs(beam) ** 2)
        around = float(np.median(power)) / np.log(2)
        return max(around, MODEL_ERROR * float(np.sum(np.abs(spectra) ** 2)) / len(spectra))


def _centres(spectrum: C128, frequencies: F64) -> tuple[float, float]:
    """Where a target lies off the middle, in cells: its brightest place, and the centre of the power around it."""
    step = 0.125
    places = np.arange(-len(frequencies) / 2, len(frequencies) / 2, step)
    power = np.abs(np.exp(2j * np.pi * places[:, None] * frequencies) @ (spectrum * np.hanning(len(frequencies)))) ** 2
    best = int(np.clip(power.argmax(), 1, len(places) - 2))
    before, there, after = power[best - 1 : best + 2]
    peak = places[best] + step * np.clip((after - before) / max(2 * (2 * there - before - after), 1e-12), -1, 1)
    near = np.abs(places - peak) < MARGIN
    return float(peak), float(np.sum(places[near] * power[near]) / np.sum(power[near]))


def _ground_lag(images: C64 | C128, beams: Beams, bins: Bins, lags: F64, prior: float) -> tuple[float, float]:
    """Lag of what stands still, rad, and its standard deviation: the mean over what spectra and odometry leave likely.

    The spectra are the median over rows, each over its own mean, so that no target counts for much; they have the
    beam's power over that of noise, which is unknown.

    Args:
        images: of all channels.
        beams: of the channels.
        bins: of whole rows.
        lags: that are looked for, rad.
        prior: standard deviation of the lag by odometry, rad; 0: odometry is exact.
    """
    if prior == 0:
        return 0.0, 0.0
    power = np.sum(np.abs(bins.spectra(images * np.hanning(images.shape[-1]))) ** 2, axis=0)
    power = power / np.mean(power, axis=-1, keepdims=True)
    level, error = np.median(power, axis=0), MEDIAN_ERROR * np.std(power) / np.sqrt(len(power))
    gains = np.sum(np.abs(bins.amplitudes(beams, float(np.mean(beams.span)), lags)) ** 2, axis=-1)
    misfits = []
    for gain in gains:
        columns = np.stack([gain, np.ones_like(gain)], axis=-1)
        share, _ = nnls(columns, level)
        misfits.append(np.sum((columns @ share - level) ** 2) / error**2)
    misfit = np.array(misfits)
    excess = max(1.0, misfit.min() / max(1, len(level) - 3))
    told = -misfit / (2 * excess) - (lags / prior) ** 2 / 2
    weight = np.exp(told - logsumexp(told))
    lag = float(weight @ lags)
    return lag, float(np.sqrt(weight @ (lags - lag) ** 2))


def _lag_by_odometry(slc: Slc) -> float:
    """Standard deviation of the lag of what stands still, rad, by the covariance of the pose; 0: it is exact."""
    grid, covariance = slc.grid, slc.aperture.covariance
    middle = grid.points((grid.rows - 1) / 2, (grid.cols - 1) / 2)
    aperture = aperture_at(middle, slc.aperture)
    sight, flight = middle - aperture.position, aperture.direction
    slant_range = float(np.linalg.norm(sight))
    turn = np.cross(sight / slant_range, flight)
    variance = flight @ covariance[:3, :3] @ flight / slant_range**2 + turn @ covariance[3:, 3:] @ turn
    return float(np.sqrt(variance)) if np.isfinite(variance) and variance > 0 else 0.0


def _mover(seen: _Seen, ratio: float, lags: F64, ground: tuple[float, float], slc: Slc, sensor: Sensor) -> Mover:
    """What was seen at a pixel, as a mover."""
    lag, sigma = _peak(seen.told, lags)
    lag, sigma = lag - ground[0], float(np.hypot(sigma, ground[1]))
    point = slc.grid.points(seen.row, seen.col)
    aperture = aperture_at(point, slc.aperture)
    sight = point - aperture.position
    slant_range, speed = float(np.linalg.norm(sight)), float(np.linalg.norm(aperture.velocity))
    along = float(sight @ aperture.direction) + slant_range * lag
    position = locate_at_elevation(seen.elevation, slant_range, along, aperture, sensor.look_side)
    depth = ROW_ERROR * slc.grid.row_spacing
    own, _ = measured_covariance(position, aperture, np.array(seen.elevation_sigma), depth, slant_range * sigma)
    surface = Surface.seen_from(aperture, position[None, None], own[None, None], np.zeros((1, 1)))
    return Mover(
        position=position,
        covariance=surface.covariance[0, 0],
        height=float(surface.height[0, 0]),
        sigma=float(surface.sigma[0, 0]),
        radial_velocity=lag * speed,
        velocity_sigma=sigma * speed,
        ambiguity=sensor.wavelength * sensor.pulse_repetition_frequency / 2,
        likelihood_ratio=float(ratio),
        cnr_db=float(10 * np.log10(seen.cnr)),
        row=round(seen.row),
        col=round(seen.col),
    )


def _peak(told: F64, lags: F64) -> tuple[float, float]:
    """The most likely lag, and its standard deviation by the bend of the likelihood there."""
    best = int(np.clip(told.argmax(), 1, len(lags) - 2))
    before, there, after = told[best - 1 : best + 2]
    step, bend = lags[1] - lags[0], max(2 * there - before - after, 1e-6)
    return float(lags[best] + step * np.clip((after - before) / (2 * bend), -1, 1)), float(step / np.sqrt(bend))


def _without_ambiguities(found: list[Mover]) -> tuple[Mover, ...]:
    """The surest first, without those that are at the place of a surer one: its azimuth ambiguities and sidelobes."""
    kept: list[Mover] = []
    for one in sorted(found, key=lambda mover: -mover.likelihood_ratio):
        apart = [np.linalg.norm(one.position - other.position) for other in kept]
        errors = [np.sqrt(np.trace(one.covariance + other.covariance)) for other in kept]
        if all(distance > 3 * error for distance, error in zip(apart, errors, strict=True)):
            kept.append(one)
    return tuple(kept)
