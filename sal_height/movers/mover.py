"""What a mover is, and what follows from its elevation, lag and walk."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from sal_height.geometry import aperture_at, locate_at_elevation
from sal_height.imaging import Slc
from sal_height.numeric import F64, vertex
from sal_height.relief import Surface, measured_covariance
from sal_height.sensor import Sensor

ROW_ERROR = 0.15
"""Standard deviation of a target's place in range, in rows: neighbours shift the peak of its power."""

RESOLVED = 10.0
"""Standard deviations of the walk's velocity in an ambiguity of the lag's, from which others are beyond 5 of them."""


@dataclass(frozen=True, eq=False)
class Mover:
    """Something that moves.

    Attributes:
        position: in map when it was abeam, m, shape (3,).
        covariance: of that, with what the pose adds, m^2, shape (3, 3).
        height: above the sphere, m.
        sigma: of the height, m.
        radial_velocity: m/s, positive if it recedes; known but for multiples of `ambiguity`, unless it is `resolved`.
        velocity_sigma: its standard deviation, m/s.
        ambiguity: radial velocity that pulses cannot tell from none, m/s.
        walk_velocity: radial velocity by the walk through rows, m/s: it has no ambiguity.
        walk_sigma: its standard deviation, m/s.
        along_velocity: along the flight, m/s; NaN: it is not known, or taken as none.
        along_sigma: its standard deviation, m/s; NaN likewise.
        walks: whether it was found by its walk, through rows or along the flight, and else by its lag.
        likelihood_ratio: twice its logarithm, against that of what does not walk, or against the ground's.
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
        """Whether the walk tells which of the velocities that look the same it is: others are beyond 5 sigma."""
        return RESOLVED * self.walk_sigma < self.ambiguity

    def without_ambiguity(self) -> Mover:
        """The mover with that of the radial velocities that look the same which is nearest to the walk's."""
        periods = round((self.walk_velocity - self.radial_velocity) / self.ambiguity)
        return replace(self, radial_velocity=self.radial_velocity + periods * self.ambiguity)


@dataclass(frozen=True, eq=False)
class Looked:
    """What was found in an image.

    Attributes:
        movers: that were found, the surest first.
        candidates: number of pixels that were looked at, for a lag or for a walk.
        ground_lag: of what stands still, rad, and its standard deviation.
        fastest: radial velocity up to which walks were looked for, m/s.
    """

    movers: tuple[Mover, ...]
    candidates: int
    ground_lag: tuple[float, float]
    fastest: float


@dataclass(frozen=True)
class MoverMeasurement:
    """What was seen of a mover, and in which pixel of an image.

    Attributes:
        row, col: of its brightest pixel, in fractions.
        cnr: power over the background.
        elevation: and its standard deviation, rad.
        lag: angle along the flight by which it lies ahead of its image, over that of the ground, and its standard
            deviation, rad.
        walk: radial velocity by its walk through rows, and its standard deviation, m/s.
        walks: whether it was found by that.
        ratio: twice the logarithm of the likelihood ratio.
        along: velocity along the flight, and its standard deviation, m/s; None: nothing tells it.
        tells_along: whether that is known well enough to be told.
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
    """A mover from what was seen of it in an image, and the sensor that took that."""
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
    depth = np.hypot(ROW_ERROR * slc.grid.row_spacing, unsure * later)
    along_sigma = float(np.hypot(slant_range * seen.lag[1], driving_sigma * later))
    own, _ = measured_covariance(position, aperture, np.array(seen.elevation[1]), float(depth), along_sigma)
    # From where it is abeam, what it drives along the flight is not radial.
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
    """The surest first, without those that are at the place of a surer one: its azimuth ambiguities and sidelobes."""
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
