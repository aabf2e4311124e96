"""Heights from elevations: the position on the ground of the scatterer in each pixel."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sal_height.elevation import ElevationEstimate, Looks, Validity
from sal_height.geometry import (
    EARTH_RADIUS,
    ApertureState,
    Grid,
    angles_of,
    aperture_at,
    height_of,
    locate_at_elevation,
    look_direction,
)
from sal_height.numeric import F64, U8, Bool

RIGHT = 1
"""Look side for which elevations on both sides are computed; those on the left are then negative."""

SLOPE_STEP = 1e-6
"""Half step of the central difference for the derivative of height by elevation, rad."""


@dataclass(frozen=True)
class Surface:
    """One scatterer of each pixel; arrays of the shape (rows, cols) of the height image, NaN where there is none.

    Attributes:
        height: above the sphere, m.
        sigma: standard deviation of height, m, including that from the platform's pose.
        cnr_db: carrier-to-noise ratio of one look, dB.
        positions: in map, m, shape (rows, cols, 3).
    """

    height: F64
    sigma: F64
    cnr_db: F64
    positions: F64

    @property
    def is_determined(self) -> Bool:
        """Where place and height are finite, and sigma is so in single precision, which messages have: (rows, cols)."""
        with np.errstate(over="ignore"):
            sigma = self.sigma.astype(np.float32)
        return np.isfinite(self.positions).all(axis=-1) & np.isfinite(sigma) & (sigma > 0)


@dataclass(frozen=True)
class HeightField:
    """Heights of one dwell.

    Attributes:
        grid: pixels of the height image.
        validity: `Validity` of each pixel, uint8, shape (rows, cols).
        first: the only or the stronger scatterer of the pixels with OK, TWO_SCATTERERS or INTERPOLATED; `cnr_db` of
            all pixels that have a signal.
        second: the weaker one of the pixels with TWO_SCATTERERS; None: not looked for.
    """

    grid: Grid
    validity: U8
    first: Surface
    second: Surface | None


@dataclass(frozen=True)
class _Circles:
    """The circle of each pixel's range and Doppler, on which its scatterer lies.

    Attributes:
        aperture: state of the platform, not sliding (`geometry.aperture_at`).
        look_side: +1 right, -1 left.
        slant_range: m, shape (rows, cols).
        along: along-track distance from the platform to the scatterers, m, shape (rows, cols).
        range_step: slant-range spacing of the rows of the SLC, m.
        range_sigma: standard deviation of range, m.
    """

    aperture: ApertureState
    look_side: int
    slant_range: F64
    along: F64
    range_step: float
    range_sigma: F64

    def surface(self, elevation: F64, sigma: F64, cnr: F64) -> Surface:
        """Height and position of scatterers at `elevation` with `sigma` (rad); NaN where there is no such direction."""
        below, positions, above = (self._at(elevation + shift) for shift in (-SLOPE_STEP, 0.0, SLOPE_STEP))
        height = height_of(positions)
        slope = (height_of(above) - height_of(below)) / (2 * SLOPE_STEP)
        depth = (height_of(self._at(elevation, self.range_step)) - height) / self.range_step
        variance = (sigma * slope) ** 2 + (self.range_sigma * depth) ** 2
        variance += pose_variance(elevation, slope, positions, self.aperture, self.look_side)
        with np.errstate(divide="ignore", invalid="ignore"):
            cnr_db = 10 * np.log10(np.where(cnr > 0, cnr, np.nan))
        return Surface(height, np.sqrt(variance), cnr_db, positions)

    def _at(self, elevation: F64, farther: float = 0.0) -> F64:
        return locate_at_elevation(elevation, self.slant_range + farther, self.along, self.aperture, self.look_side)


def height_field(
    estimate: ElevationEstimate,
    looks: Looks,
    slc_grid: Grid,
    grid: Grid,
    aperture: ApertureState,
    look_side: int,
    radial_velocity: float = 0.0,
) -> HeightField:
    """Compute height, its standard deviation and the ground position of every pixel.

    Range and Doppler are those of the looks' power-weighted centre; the elevation selects the point on their circle.
    The variance of height is the sum of that from elevation, times (d height / d elevation)^2; that from range, times
    (d height / d range)^2, because the centre of the speckle within its range cell is unknown, which limits the height
    at high CNR; and that from the platform's pose (`pose_variance`), which all pixels of the dwell share.

    Args:
        estimate: elevations.
        looks: where in the SLC each pixel's power lies.
        slc_grid: pixels of the SLC.
        grid: pixels of the height image (`look_grid`).
        aperture: state of the platform.
        look_side: +1 right, -1 left.
        radial_velocity: v_r of the targets, m/s, positive if they recede. It displaces them in the image by
            -range v_r / speed along-track (SAL paper, section 4), which is corrected.
    """
    points = slc_grid.points(looks.row, looks.col)
    aperture = aperture_at(points, aperture)
    sight = points - aperture.position
    slant_range = np.linalg.norm(sight, axis=-1)
    range_cell = slc_grid.row_spacing * np.abs(sight @ slc_grid.row_direction) / slant_range
    circles = _Circles(
        aperture,
        look_side,
        slant_range,
        sight @ aperture.direction + slant_range * radial_velocity / np.linalg.norm(aperture.velocity),
        slc_grid.row_spacing,
        range_cell / np.sqrt(12 * looks.count),
    )
    first = circles.surface(estimate.elevation, estimate.sigma, estimate.cnr)
    other = estimate.second
    second = circles.surface(other.elevation, other.sigma, other.cnr) if other else None
    validity = _checked_validity(estimate.validity, first, second)
    usable, two = np.isin(validity, (Validity.OK, Validity.TWO_SCATTERERS)), validity == Validity.TWO_SCATTERERS
    if second:
        second = replace(_only(second, two), cnr_db=np.where(two, second.cnr_db, np.nan))
    return HeightField(grid, validity, _only(first, usable), second)


def _checked_validity(validity: U8, first: Surface, second: Surface | None) -> U8:
    """The validity with a reason in the place of OK and TWO_SCATTERERS where a height or its sigma is not determined.

    OUTSIDE_ARRAY: no place on the ground has that range, Doppler and elevation. LOW_CNR: sigma is infinite, as without
    a signal. NOT_ONE_SCATTERER: of two scatterers one or both are not determined.
    """
    two = validity == Validity.TWO_SCATTERERS
    told_apart = first.is_determined & (second.is_determined if second else np.False_)
    placed = np.isfinite(first.positions).all(axis=-1)
    doubtful = np.where(two, ~told_apart, (validity == Validity.OK) & ~first.is_determined)
    reason = np.select([two, placed], [Validity.NOT_ONE_SCATTERER, Validity.LOW_CNR], Validity.OUTSIDE_ARRAY)
    return np.where(doubtful, reason, validity).astype(np.uint8)


def _only(surface: Surface, there: Bool) -> Surface:
    """The surface with heights and positions only where they can be used."""
    return Surface(
        height=np.where(there, surface.height, np.nan),
        sigma=np.where(there, surface.sigma, np.nan),
        cnr_db=surface.cnr_db,
        positions=np.where(there[..., None], surface.positions, np.nan),
    )


def pose_variance(elevation: F64, slope: F64, positions: F64, aperture: ApertureState, look_side: int) -> F64:
    """Variance of height (m^2) that results from the covariance of the platform's pose, shape (rows, cols).

    An error of the platform's position displaces the scatterer by as much. A small error of the body's rotation turns
    the plane of its elevation, and the scatterer moves on its circle of range and Doppler, which are measured: to first
    order as if the elevation changed by the rotation about the body's x axis (but for the squint). A covariance that
    is 0 or not finite counts as unknown and adds nothing.

    Args:
        elevation: rad, shape (rows, cols).
        slope: of height over elevation, m/rad.
        positions: of the scatterers in map, m, shape (rows, cols, 3).
        aperture: state of the platform, not sliding (`geometry.aperture_at`); its covariance is of position and of
            rotation about the axes of map, as in nav_msgs/Odometry.
        look_side: +1 right, -1 left.
    """
    if not (np.all(np.isfinite(aperture.covariance)) and np.any(aperture.covariance)):
        return np.zeros(elevation.shape)
    sight = positions - aperture.position
    ahead = look_direction(elevation, 0.0, look_side) @ aperture.rotation.T
    across = look_direction(elevation + np.pi / 2, 0.0, look_side) @ aperture.rotation.T
    turned = np.cross(sight, across) / np.sum(sight * ahead, axis=-1, keepdims=True)
    centre = positions + np.array([0.0, 0.0, EARTH_RADIUS])
    up = centre / np.linalg.norm(centre, axis=-1, keepdims=True)
    gradient = np.concatenate([up, slope[..., None] * turned], axis=-1)
    return np.maximum(np.sum(gradient @ aperture.covariance * gradient, axis=-1), 0.0)


def shared_variance(positions: F64, aperture: ApertureState) -> F64:
    """Variance of height (m^2) from the pose, of scatterers at `positions` in map (m, shape (..., 3)).

    It is `pose_variance` on their circles of range and Doppler, an error that all pixels of a dwell share; NaN where a
    position is NaN.
    """
    if not np.any(aperture.covariance):
        return np.zeros(positions.shape[:-1])
    aperture = aperture_at(positions, aperture)
    sight = positions - aperture.position
    slant_range, elevation, _ = angles_of(positions, aperture, RIGHT)
    circles = slant_range, sight @ aperture.direction
    below, above = (
        height_of(locate_at_elevation(elevation + step, *circles, aperture, RIGHT))
        for step in (-SLOPE_STEP, SLOPE_STEP)
    )
    return pose_variance(elevation, (above - below) / (2 * SLOPE_STEP), positions, aperture, RIGHT)
