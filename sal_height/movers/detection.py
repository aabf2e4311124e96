"""Movers in the images of a strip: their place, height and radial velocity, without being told the velocity.

Nothing but the direction in which it was seen tells a mover from what stands still. For each bright pixel elevation and
lag (`likelihood`) are estimated together. Twice the logarithm of the likelihood of the best lag over that of the ground
is what tells that it moves. With what stands still, each other lag has a ratio beyond t in less than exp(-t / 2) of all
cases (Markov's inequality, if power and width were known), and the best of the lags that can be told apart in about as
many times more: HYPOTHESES, measured with pairs of points in one cell, the worst of what was tried.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter

from sal_height.beams import Beams
from sal_height.errors import Rejected, UserError
from sal_height.geometry import aperture_at, locate_at_elevation
from sal_height.imaging import Slc
from sal_height.movers.ground import ground_lag, lag_by_odometry
from sal_height.movers.search import Search, Seen, vertex
from sal_height.movers.settings import MoverSettings
from sal_height.movers.spectrum import Bins
from sal_height.numeric import C64, C128, F64, Bool
from sal_height.relief import Surface, measured_covariance
from sal_height.sensor import Sensor

HYPOTHESES = 10.0
"""Lags that can be told apart."""

ROW_ERROR = 0.15
"""Standard deviation of a target's place in range, in rows: neighbours shift the peak of its power."""

LEAST_COLUMNS = 16
"""Of an image, along the flight."""

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
    search = Search(images, beams, Bins.of(slc, sensor, min(settings.chip_pixels, images.shape[-1] // 2 * 2)))
    whole = Bins.of(slc, sensor, images.shape[-1])
    ground = ground_lag(images, beams, whole, search.lags, lag_by_odometry(slc, sensor))
    candidates = _bright(images, settings.prominence_db)
    threshold = 2 * np.log(HYPOTHESES / settings.false_alarm_rate)
    found = []
    for seen in search.at(np.argwhere(candidates)):
        ratio = 2 * (seen.told.max() - _at(ground[0], search.lags, seen.told))
        if ratio > threshold and 0 < seen.told.argmax() < len(search.lags) - 1:
            found += _mover(seen, ratio, search, ground, slc, sensor)
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


def _mover(
    seen: Seen, ratio: float, search: Search, ground: tuple[float, float], slc: Slc, sensor: Sensor
) -> list[Mover]:
    """What was seen at a pixel, as a mover; none: it is at an end of the array."""
    found = search.elevation(seen.spectra, float(search.lags[seen.told.argmax()]))
    if found is None:
        return []
    elevation, elevation_sigma = found
    lag, sigma = _peak(seen.told, search.lags)
    lag, sigma = lag - ground[0], float(np.hypot(sigma, ground[1]))
    point = slc.grid.points(seen.row, seen.col)
    aperture = aperture_at(point, slc.aperture)
    sight = point - aperture.position
    slant_range, speed = float(np.linalg.norm(sight)), float(np.linalg.norm(aperture.velocity))
    along = float(sight @ aperture.direction) + slant_range * lag
    position = locate_at_elevation(elevation, slant_range, along, aperture, sensor.look_side)
    depth = ROW_ERROR * slc.grid.row_spacing
    own, _ = measured_covariance(position, aperture, np.array(elevation_sigma), depth, slant_range * sigma)
    surface = Surface.seen_from(aperture, position[None, None], own[None, None], np.zeros((1, 1)))
    mover = Mover(
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
    return [mover]


def _at(lag: float, lags: F64, told: F64) -> float:
    """Logarithm of the likelihood of a lag between those that were looked for, by the parabola through three."""
    best = int(np.clip(np.rint((lag - lags[0]) / (lags[1] - lags[0])), 1, len(lags) - 2))
    before, there, after = told[best - 1 : best + 2].tolist()
    off = float(np.clip((lag - lags[best]) / (lags[1] - lags[0]), -1, 1))
    return float(there + off * (after - before) / 2 + off**2 * (after + before - 2 * there) / 2)


def _peak(told: F64, lags: F64) -> tuple[float, float]:
    """The most likely lag, and its standard deviation by the bend of the likelihood there."""
    best = int(np.clip(told.argmax(), 1, len(lags) - 2))
    (offset, bend), step = vertex(told[best - 1 : best + 2]), lags[1] - lags[0]
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
