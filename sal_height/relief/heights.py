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

    def where(self, there: Bool) -> Surface:
        """The surface with heights and positions only `there`, and NaN elsewhere; the CNR stays."""
        height, sigma = (np.where(there, values, np.nan) for values in (self.height, self.sigma))
        return Surface(height, sigma, self.cnr_db, np.where(there[..., None], self.positions, np.nan))


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
    along = sight @ aperture.direction + slant_range * radial_velocity / np.linalg.norm(aperture.velocity)
    range_step = slc_grid.row_spacing
    range_sigma = range_step * np.abs(sight @ slc_grid.row_direction) / slant_range / np.sqrt(12 * looks.count)

    def surface(elevation: F64, sigma: F64, cnr: F64) -> Surface:
        """Height and position of scatterers; NaN where there is no such direction."""
        positions = locate_at_elevation(elevation, slant_range, along, aperture, look_side)
        height = height_of(positions)
        farther = locate_at_elevation(elevation, slant_range + range_step, along, aperture, look_side)
        depth = (height_of(farther) - height) / range_step
        slope = _height_slope(elevation, slant_range, along, aperture, look_side)
        variance = (sigma * slope) ** 2 + (range_sigma * depth) ** 2
        variance += pose_variance(elevation, slope, positions, aperture, look_side)
        with np.errstate(divide="ignore", invalid="ignore"):
            cnr_db = 10 * np.log10(np.where(cnr > 0, cnr, np.nan))
        return Surface(height, np.sqrt(variance), cnr_db, positions)

    first, other = surface(estimate.elevation, estimate.sigma, estimate.cnr), estimate.second
    second = surface(other.elevation, other.sigma, other.cnr) if other else None
    validity = _checked_validity(estimate.validity, first, second)
    usable, two = np.isin(validity, (Validity.OK, Validity.TWO_SCATTERERS)), validity == Validity.TWO_SCATTERERS
    if second:
        second = replace(second.where(two), cnr_db=np.where(two, second.cnr_db, np.nan))
    return HeightField(grid, validity, first.where(usable), second)


def _height_slope(elevation: F64, slant_range: F64, along: F64, aperture: ApertureState, look_side: int) -> F64:
    """Derivative of height by elevation on the circles of range and Doppler, m/rad, by central differences."""
    below, above = (
        height_of(locate_at_elevation(elevation + step, slant_range, along, aperture, look_side))
        for step in (-SLOPE_STEP, SLOPE_STEP)
    )
    return (above - below) / (2 * SLOPE_STEP)


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
    slope = _height_slope(elevation, slant_range, sight @ aperture.direction, aperture, RIGHT)
    return pose_variance(elevation, slope, positions, aperture, RIGHT)
