"""Movers, and what follows from their elevation, lag and range migration."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from sal_height.geometry import aperture_at, locate_at_elevation
from sal_height.imaging import Slc
from sal_height.numeric import F64, ShortRepr, vertex
from sal_height.relief import Surface, measured_covariance
from sal_height.sensor import Sensor

MIGRATING = 5.0
"""Least velocity of a range migration, or along the flight, that is significant, standard deviations."""


@dataclass(frozen=True, eq=False)
class Mover(ShortRepr):
    """A moving target.

    Attributes:
        position: position in map when it was abeam, m, shape (3,).
        covariance: covariance of that, with the error of the pose, m^2, shape (3, 3).
        height: height above the sphere, m.
        sigma: standard deviation of the height, m.
        radial_velocity: radial velocity, positive if it recedes, known but for multiples of `ambiguity` unless it is
            `resolved`, m/s.
        velocity_sigma: standard deviation of that, m/s.
        ambiguity: radial velocity whose phase from pulse to pulse is a whole turn, m/s.
        walk_velocity: radial velocity by the range migration, without ambiguity, m/s.
        walk_sigma: standard deviation of that, m/s.
        along_velocity: velocity along the flight; NaN: it is not known, or assumed to be 0, m/s.
        along_sigma: standard deviation of that; NaN likewise, m/s.
        walks: True if it was found by its migration, through rows or along the flight; else by its lag.
        likelihood_ratio: twice the logarithm of the ratio against targets without migration, or against the ground.
        cnr_db: power of its brightest pixel over noise and ground around it, dB.
        row: row of that pixel.
        col: column of that pixel.
    """

    position: F64
    covariance: F64
    height: float
    sigma: float
    radial_velocity: float
    velocity_sigma: float
    ambiguity: float
    walk_velocity: float
    walk_sigma: float
    along_velocity: float
    along_sigma: float
    walks: bool
    likelihood_ratio: float
    cnr_db: float
    row: int
    col: int

    @property
    def resolved(self) -> bool:
        """True if the range migration resolves the ambiguity: other velocities are beyond 5 of its sigmas."""
        return 10 * self.walk_sigma < self.ambiguity

    def without_ambiguity(self) -> Mover:
        """The mover with the one of its ambiguous radial velocities that is nearest to that by the migration."""
        periods = round((self.walk_velocity - self.radial_velocity) / self.ambiguity)
        return replace(self, radial_velocity=self.radial_velocity + periods * self.ambiguity)


@dataclass(frozen=True, eq=False)
class StripMover:
    """A mover in a strip, and its image.

    Attributes:
        mover: mover.
        along: position of its image in focus along the flight, m.
        length: length of its image out of focus, m.
        rows: number of rows through which it migrates.
        ambiguity: distance of the images of its azimuth ambiguities along the flight, m.
    """

    mover: Mover
    along: float
    length: float
    rows: float
    ambiguity: float

    def is_trace_of(self, other: StripMover) -> bool:
        """True if it may be a part of the image of another that is likelier, or an azimuth ambiguity of that."""
        if self.mover.likelihood_ratio >= other.mover.likelihood_ratio:
            return False
        apart, near = abs(self.along - other.along), other.length + 0.05 * other.ambiguity
        beside = abs(self.mover.row - other.mover.row) <= other.rows / 2 + 3
        dim = self.mover.likelihood_ratio < 0.3 * other.mover.likelihood_ratio
        return beside and (apart < near or (dim and apart < 1.3 * other.ambiguity))


@dataclass(frozen=True, eq=False)
class Looked(ShortRepr):
    """Result of the search in an image.

    Attributes:
        movers: movers, the most likely first.
        candidates: number of candidate pixels, for a lag or for a migration.
        ground_lag: lag of the ground, and its standard deviation, rad.
        fastest: largest radial velocity whose migration was searched, m/s.
        blind: fraction of radial velocities that the lag does not show, for movers of some brightness (`Blind`).
    """

    movers: tuple[Mover, ...]
    candidates: int
    ground_lag: tuple[float, float]
    fastest: float
    blind: tuple[Blind, ...] = ()


@dataclass(frozen=True)
class Blind:
    """Fraction of radial velocities that are blind: those whose remainder cannot be separated from the ground's.

    Pulses show a radial velocity modulo its ambiguity. Where the remainder is within its standard deviation of that of
    the ground, the lag does not show that a target moves; its range migration or its smear along the flight may.

    Attributes:
        cnr_db: power of a point over the background, dB.
        sigma: standard deviation of the remainder, m/s.
        fraction: fraction of velocities whose remainder is less than that.
    """

    cnr_db: float
    sigma: float
    fraction: float


@dataclass(frozen=True)
class MoverMeasurement:
    """Measurements of a mover in an image.

    Attributes:
        row, col: row and column of its brightest pixel, in fractions.
        cnr: power over the background.
        elevation: elevation, and its standard deviation, rad.
        lag: angle along the flight from its image to the mover, over that of the ground, and its standard deviation,
            rad.
        migration: radial velocity by its range migration, and its standard deviation, m/s.
        migrates: True if it was found by that.
        ratio: twice the logarithm of the likelihood ratio.
        along: velocity along the flight, and its standard deviation; None: it is not estimated, m/s.
        along_known: True if that is known well enough to be published.
    """

    row: float
    col: float
    cnr: float
    elevation: tuple[float, float]
    lag: tuple[float, float]
    migration: tuple[float, float]
    migrates: bool
    ratio: float
    along: tuple[float, float] | None = None
    along_known: bool = True


def mover_of(seen: MoverMeasurement, slc: Slc, sensor: Sensor) -> Mover:
    """The mover of measurements in an image by a sensor."""
    point = slc.grid.points(seen.row, seen.col)
    aperture = aperture_at(point, slc.aperture)
    sight = point - aperture.position
    slant_range, speed = float(np.linalg.norm(sight)), float(np.linalg.norm(aperture.velocity))
    along = float(sight @ aperture.direction) + slant_range * seen.lag[0]
    driving, driving_sigma = seen.along or (0.0, 0.0)
    # The row of a strip is that at the aspect 0 of the image, that of a dwell in its middle. In a strip the target is
    # abeam at the aspect minus the lag.
    later = (slant_range * seen.lag[0] if slc.aperture.sliding else along) / (speed - driving)
    migration, walk_sigma = seen.migration
    farther, unsure = (migration, walk_sigma) if seen.migrates else (0.0, float(np.hypot(migration, walk_sigma)))
    moved = along + driving * later
    reach = float(np.sqrt((slant_range + farther * later) ** 2 - along**2 + moved**2))
    published = (driving, driving_sigma) if seen.along and seen.along_known else (np.nan, np.nan)
    position = locate_at_elevation(seen.elevation[0], reach, moved, aperture, sensor.look_side)
    # Neighbours shift the peak of its power in range: 0.15 rows.
    depth = np.hypot(0.15 * slc.grid.row_spacing, unsure * later)
    along_sigma = float(np.hypot(slant_range * seen.lag[1], driving_sigma * later))
    own, _ = measured_covariance(position, aperture, np.array(seen.elevation[1]), float(depth), along_sigma)
    # At the position where it is abeam, its velocity along the flight is not radial.
    ahead = along / slant_range
    placed = float(aperture.direction @ aperture.covariance[:3, :3] @ aperture.direction)
    unsure_ahead = np.sqrt(max(0.0, placed)) / slant_range
    not_radial = float(np.hypot(driving_sigma * ahead, np.hypot(driving, driving_sigma) * unsure_ahead))
    surface = Surface.seen_from(aperture, position[None, None], own[None, None], np.zeros((1, 1)))
    mover = Mover(
        position=position,
        covariance=surface.covariance[0, 0],
        height=float(surface.height[0, 0]),
        sigma=float(surface.sigma[0, 0]),
        radial_velocity=seen.lag[0] * speed - driving * ahead,
        velocity_sigma=float(np.hypot(seen.lag[1] * speed, not_radial)),
        ambiguity=sensor.wavelength * sensor.pulse_repetition_frequency / 2,
        walk_velocity=migration - driving * ahead,
        walk_sigma=walk_sigma,
        along_velocity=published[0],
        along_sigma=published[1],
        walks=seen.migrates,
        likelihood_ratio=float(seen.ratio),
        cnr_db=float(10 * np.log10(seen.cnr)),
        row=round(seen.row),
        col=round(seen.col),
    )
    return mover.without_ambiguity() if mover.resolved else mover


def without_ambiguities(found: Iterable[Mover]) -> tuple[Mover, ...]:
    """The movers by likelihood, without those at the position of a likelier one: its ambiguities and sidelobes."""
    kept: list[Mover] = []
    for one in sorted(found, key=lambda mover: -mover.likelihood_ratio):
        apart = [np.linalg.norm(one.position - other.position) for other in kept]
        errors = [np.sqrt(np.trace(one.covariance + other.covariance)) for other in kept]
        if all(distance > 3 * error for distance, error in zip(apart, errors, strict=True)):
            kept.append(one)
    return tuple(kept)


def peak_of(published: F64, lags: F64) -> tuple[float, float]:
    """The most likely lag, and its standard deviation by the bend of the likelihood there."""
    best = int(np.clip(published.argmax(), 1, len(lags) - 2))
    (offset, bend), step = vertex(*published[best - 1 : best + 2]), lags[1] - lags[0]
    return float(lags[best] + step * offset), float(step / np.sqrt(bend))
