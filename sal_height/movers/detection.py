"""Movers in the images of a strip: their place, height and radial velocity, without being told the velocity.

Nothing but the direction in which it was seen tells a mover from what stands still. For each bright pixel elevation and
lag (`likelihood`) are estimated together. Twice the logarithm of the likelihood of the best lag over that of the ground
is what tells that it moves. With what stands still, each other lag has a ratio beyond t in less than exp(-t / 2) of all
cases (Markov's inequality, if power and width were known), and the best of the lags that can be told apart in about as
many times more: HYPOTHESES, measured with pairs of points in one cell, the worst of what was tried.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.ndimage import maximum_filter
from scipy.optimize import nnls
from scipy.special import logsumexp

from sal_height.beams import Beams
from sal_height.errors import Rejected, UserError
from sal_height.geometry import aperture_at, locate_at_elevation
from sal_height.imaging import NavigationPrior, Slc, line_of_sight
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

GAIN_DIGITS = 3
"""Decimals of a gain over the greatest: what differs by less has the same likelihood."""

LEAST_COLUMNS = 16
"""Of an image, along the flight."""

PARTS = 5
"""Of the bins, whose elevations are compared."""

SIDELOBES = 10**-2.5
"""Power, over that of the brightest in the same rows or columns, up to which a pixel may be its sidelobe."""

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


def check_sensor(sensor: Sensor) -> None:
    """Movers can be told with a sensor.

    Raises:
        UserError: it is in spotlight, where the beam follows a target whatever its velocity, or channels are blanked.
    """
    if sensor.mode != "stripmap":
        raise UserError(
            f"Sensor {sensor.name} is of mode {sensor.mode}; movers are found in stripmap only, where the beam passes "
            "them and so tells their direction."
        )
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
            f"An image of a strip has {images.shape[-1]} columns; {LEAST_COLUMNS} are needed to tell movers (parameter "
            "cols of sar_compression).",
        )
    images = np.where(np.isfinite(images), images, 0)
    bins = Bins.of(slc, sensor, min(settings.chip_pixels, images.shape[-1] // 2 * 2))
    steps = round(FARTHEST / STEP)
    lags: F64 = sensor.beams.track_beamwidth * STEP * np.arange(-steps, steps + 1, dtype=np.float64)
    whole = Bins.of(slc, sensor, images.shape[-1])
    ground = _ground_lag(images, beams, whole, lags, _lag_by_odometry(slc, sensor))
    candidates = _bright(images, settings.prominence_db)
    threshold = 2 * np.log(HYPOTHESES / settings.false_alarm_rate)
    search = _Search(images, beams, bins, lags)
    found = []
    for row, col in np.argwhere(candidates):
        seen = search.at(int(row), int(col))
        if seen is None:
            continue
        ratio = 2 * (seen.told.max() - float(np.interp(ground[0], lags, seen.told)))
        if ratio > threshold and 0 < seen.told.argmax() < len(lags) - 1:
            found.append(_mover(seen, ratio, lags, ground, slc, sensor))
    return Looked(_without_ambiguities(found), int(candidates.sum()), ground)


def _bright(images: C64 | C128, prominence_db: float) -> Bool:
    """Pixels that are brighter than all around, than most of their row, and than sidelobes of what is brighter."""
    power = np.sum(np.abs(images) ** 2, axis=0)
    around = maximum_filter(power, size=(3, 2 * MARGIN + 1))
    bright = (power == around) & (power > 10 ** (prominence_db / 10) * np.median(power, axis=1, keepdims=True))
    beside = np.maximum(
        maximum_filter(power, size=(2 * len(power) + 1, 2 * MARGIN + 1)),
        maximum_filter(power, size=(3, 2 * power.shape[1] + 1)),
    )
    bright &= power > SIDELOBES * beside
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
    _likelihoods: dict[bytes, LagLikelihood] = field(default_factory=dict)

    def at(self, row: int, col: int) -> _Seen | None:
        """Elevation and likelihoods of the lags of the target at a pixel; None: it is at an end of the array."""
        first = int(np.clip(col - self.bins.pixels // 2, 0, self.images.shape[-1] - self.bins.pixels))
        spectra = self.bins.spectra(self.images[:, row, first : first + self.bins.pixels]).T
        power = float(np.sum(np.abs(spectra) ** 2)) / len(spectra)
        # The elevation of what stands still; where beams do not separate, a lag changes it a little.
        found = self._elevation(spectra, 0.0)
        if found is None:
            return None
        background = self._background(row, found[0])
        told, centre = self._told(spectra, found[0], max(background, MODEL_ERROR * power))
        found = self._elevation(spectra, float(self.lags[told.argmax()]))
        if found is None:
            return None
        middle = first + self.bins.pixels // 2 + centre * self.bins.pixels / len(self.bins.numbers)
        return _Seen(self._row(row, col), middle, *found, told, power / background)

    def _told(self, spectra: C128, elevation: float, background: float) -> tuple[F64, float]:
        """Likelihoods of the lags of a target at an elevation, and how many cells it lies off the middle."""
        amplitudes = self.bins.amplitudes(self.beams, elevation, self.lags)
        gains = np.linalg.norm(amplitudes, axis=-1)
        matched = np.sum(amplitudes.conj() * spectra, axis=-1) / np.maximum(gains, 1e-12) / np.sqrt(background)
        peak, centre = _centres(matched[len(self.lags) // 2], self.bins.frequencies)
        turned = [matched * np.exp(2j * np.pi * self.bins.frequencies * place) for place in (peak, centre)]
        # Beyond its main lobe the antenna may have the sidelobes of its pattern, or none.
        likelihoods = [self._likelihood(gains), self._likelihood(np.where(self._known, gains, 0.0))]
        return np.max([one.of(spectrum) for one in likelihoods for spectrum in turned], axis=0), centre

    def _likelihood(self, gains: F64) -> LagLikelihood:
        """That of these gains, whatever their scale: where beams separate, the same for all pixels."""
        shape = np.round(gains / gains.max(), GAIN_DIGITS)
        return self._likelihoods.setdefault(shape.tobytes(), LagLikelihood(self.bins.frequencies, shape, self._known))

    @cached_property
    def _known(self) -> Bool:
        """Whether the antenna saw a target with each of the lags in its main lobe in each bin."""
        lobe = max(pattern.main_lobe for pattern in self.beams.patterns) * self.beams.track_beamwidth
        return np.asarray(np.abs(self.bins.aspects + self.lags[:, None]) < lobe)

    def _row(self, row: int, col: int) -> float:
        """Where in range the power has its peak, by the rows beside the brightest, in fractions of a row."""
        if not 0 < row < self.images.shape[1] - 1:
            return float(row)
        power = np.sum(np.abs(self.images[:, row - 1 : row + 2, col]) ** 2, axis=0)
        return row + 0.5 * float(np.clip(2 * _vertex(np.log(power + 1e-300))[0], -1, 1))

    def _elevation(self, spectra: C128, lag: float) -> tuple[float, float] | None:
        """The most likely elevation of a target with a lag, and its standard deviation; None: that of an outer beam.

        Errors are those of the power that the target does not explain, and not less than parts of the bins differ:
        another surface in the same cell turns against the target from bin to bin.
        """
        low, high = self.beams.span
        step = ELEVATION_STEP * self.beams.beamwidth
        grid = np.arange(low, high, step)
        amplitudes = self.beams.response(grid[:, None], self.bins.aspects + lag)
        in_bins = np.abs(np.sum(amplitudes.conj() * spectra, axis=-1)) ** 2
        gains = np.mean(np.sum(np.abs(amplitudes) ** 2, axis=-1), axis=-1)
        explained = np.sum(in_bins, axis=-1) / gains
        best = int(explained.argmax())
        if not 0 < best < len(grid) - 1:
            return None
        offset, bend = _vertex(explained[best - 1 : best + 2])
        left = (np.sum(np.abs(spectra) ** 2) - explained[best]) / (len(spectra) * (spectra.shape[1] - 1))
        variance = max(left, MODEL_ERROR * explained[best] / len(spectra)) * step**2 / bend
        parts = np.add.reduceat(in_bins, np.arange(PARTS) * len(spectra) // PARTS, axis=-1)
        shares = parts[best] / parts[best].sum()
        spread = np.sum((shares * (grid[parts.argmax(axis=0)] - grid[best])) ** 2)
        return float(grid[best] + step * offset), float(np.sqrt(max(variance, spread)))

    def _background(self, row: int, elevation: float) -> float:
        """Power of noise and ground that a target at an elevation has in its row and those beside it."""
        beam = self.beams.response(elevation, float(np.mean(self.bins.aspects)))
        rows = self.images[:, max(0, row - 2) : row + 3]
        power = np.abs(np.tensordot(beam.conj(), rows, 1)) ** 2 / np.sum(np.abs(beam) ** 2)
        return max(float(np.median(power)) / np.log(2), 1e-300)


def _vertex(values: F64) -> tuple[float, float]:
    """Of the parabola through three values: how many steps it lies off the middle one, at most 1, and its bend."""
    before, there, after = values.tolist()
    bend = max(2 * there - before - after, 1e-12 * (1 + abs(there)))
    return float(np.clip((after - before) / (2 * bend), -1, 1)), bend


def _centres(spectrum: C128, frequencies: F64) -> tuple[float, float]:
    """Where a target lies off the middle, in cells: its brightest place, and the centre of the power around it."""
    step = 0.125
    places = np.arange(-len(frequencies) / 2, len(frequencies) / 2, step)
    power = np.abs(np.exp(2j * np.pi * places[:, None] * frequencies) @ (spectrum * np.hanning(len(frequencies)))) ** 2
    best = int(np.clip(power.argmax(), 1, len(places) - 2))
    peak = places[best] + step * _vertex(power[best - 1 : best + 2])[0]
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
    power = power[np.all(power > 0, axis=-1)]
    if not len(power):
        return 0.0, prior
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


def _lag_by_odometry(slc: Slc, sensor: Sensor) -> float:
    """Standard deviation of the lag of what stands still, rad, by the covariance of the pose; 0: it is exact.

    An error of the velocity is in that of the position along the flight (`Placement.seen_from`).
    """
    grid, aperture = slc.grid, slc.aperture
    middle = grid.points((grid.rows - 1) / 2, (grid.cols - 1) / 2)
    slant_range = float(np.linalg.norm(middle - aperture_at(middle, aperture).position))
    pointing = NavigationPrior.of(aperture, np.zeros((3, 3)), line_of_sight(sensor, aperture)).pointing
    along = aperture.direction @ aperture.covariance[:3, :3] @ aperture.direction
    return float(np.hypot(pointing, np.sqrt(along) / slant_range)) if along >= 0 else pointing


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
    (offset, bend), step = _vertex(told[best - 1 : best + 2]), lags[1] - lags[0]
    return float(lags[best] + step * offset), float(step / np.sqrt(bend))


def _without_ambiguities(found: list[Mover]) -> tuple[Mover, ...]:
    """The surest first, without those that are at the place of a surer one: its azimuth ambiguities and sidelobes."""
    kept: list[Mover] = []
    for one in sorted(found, key=lambda mover: -mover.likelihood_ratio):
        apart = [np.linalg.norm(one.position - other.position) for other in kept]
        errors = [np.sqrt(np.trace(one.covariance + other.covariance)) for other in kept]
        if all(distance > 3 * error for distance, error in zip(apart, errors, strict=True)):
            kept.append(one)
    return tuple(kept)
