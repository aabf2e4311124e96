"""Elevation becomes height: where on the ground the scatterer of each pixel lies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sal_height.beams import Beams
from sal_height.estimate import ElevationEstimate, Validity
from sal_height.geometry import (
    EARTH_RADIUS,
    Aperture,
    Grid,
    aperture_at,
    height_of,
    locate,
    look_direction,
    squint_on_cone,
)
from sal_height.looks import Looks

Array = npt.NDArray[np.float64]

SLOPE_STEP = 1e-6
"""Half step in rad of the central difference that gives the slope of height over elevation."""


@dataclass(frozen=True)
class HeightField:
    """Heights of one dwell; arrays of shape (rows, cols) of the height image.

    Attributes:
        grid: pixels of the height image.
        height: above the sphere, m; NaN where not valid.
        sigma: standard deviation of height, m, with that of the platform's pose; NaN where not valid.
        cnr_db: carrier-to-noise ratio of one look, dB; NaN where there is no signal.
        validity: `Validity` of each pixel, uint8.
        positions: of the scatterers in map, m, shape (rows, cols, 3); NaN where not valid.
    """

    grid: Grid
    height: Array
    sigma: Array
    cnr_db: Array
    validity: npt.NDArray[np.uint8]
    positions: Array


def look_grid(grid: Grid, range_looks: int, azimuth_looks: int) -> Grid:
    """Grid whose pixels are the blocks of looks of `grid`."""
    return Grid(
        origin=grid.points((range_looks - 1) / 2, (azimuth_looks - 1) / 2),
        row_direction=grid.row_direction,
        col_direction=grid.col_direction,
        row_spacing=grid.row_spacing * range_looks,
        col_spacing=grid.col_spacing * azimuth_looks,
        rows=grid.rows // range_looks,
        cols=grid.cols // azimuth_looks,
    )


def column_squint(grid: Grid, aperture: Aperture, beams: Beams, look_side: int) -> Array:
    """Squint (rad) under which each column of `grid` is seen at the middle row and the middle of the beams, (cols,)."""
    points = grid.points((grid.rows - 1) / 2, np.arange(grid.cols))
    sight = points - aperture_at(points, aperture).position
    cone = sight @ aperture.direction / np.linalg.norm(sight, axis=-1)
    return squint_on_cone(np.mean(beams.span), cone, aperture, look_side)


def height_field(
    estimate: ElevationEstimate,
    looks: Looks,
    slc_grid: Grid,
    grid: Grid,
    aperture: Aperture,
    look_side: int,
    radial_velocity: float = 0.0,
) -> HeightField:
    """Height, its uncertainty and the ground position of every pixel.

    Range and Doppler are those of the looks' power-weighted centre; the elevation picks the point on the circle they
    leave. Sigma is that of elevation times |d height / d elevation|, and that of range times |d height / d range|:
    within its cell the range of the speckle's centre is not known, which limits the height at high CNR. What the
    platform's pose leaves open comes on top (`pose_variance`): an error that all pixels of the dwell share.

    Args:
        estimate: elevations.
        looks: where in the SLC each pixel's power lies.
        slc_grid: pixels of the SLC.
        grid: pixels of the height image (`look_grid`).
        aperture: state of the platform.
        look_side: +1 right, -1 left.
        radial_velocity: of the targets, m/s, receding positive: v_r moves them back in the image by range v_r / speed
            (SAL paper, section 4), which is made good.
    """
    points = slc_grid.points(looks.row, looks.col)
    aperture = aperture_at(points, aperture)
    sight = points - aperture.position
    slant_range = np.linalg.norm(sight, axis=-1)
    along = sight @ aperture.direction + slant_range * radial_velocity / np.linalg.norm(aperture.velocity)
    below, positions, above = (
        locate(estimate.elevation + shift, slant_range, along, aperture, look_side)
        for shift in (-SLOPE_STEP, 0.0, SLOPE_STEP)
    )
    slope = (height_of(above) - height_of(below)) / (2 * SLOPE_STEP)
    farther = locate(estimate.elevation, slant_range + slc_grid.row_spacing, along, aperture, look_side)
    depth = (height_of(farther) - height_of(positions)) / slc_grid.row_spacing
    range_cell = slc_grid.row_spacing * np.abs(sight @ slc_grid.row_direction) / slant_range
    variance = (estimate.sigma * slope) ** 2 + (range_cell * depth) ** 2 / (12 * looks.count)
    variance += pose_variance(estimate.elevation, slope, positions, aperture, look_side)
    located = np.isfinite(positions).all(axis=-1)
    validity = np.where(located | (estimate.validity != Validity.OK), estimate.validity, Validity.OUTSIDE_ARRAY)
    valid = validity == Validity.OK
    with np.errstate(divide="ignore", invalid="ignore"):
        cnr_db = 10 * np.log10(np.where(estimate.cnr > 0, estimate.cnr, np.nan))
    return HeightField(
        grid=grid,
        height=np.where(valid, height_of(positions), np.nan),
        sigma=np.sqrt(np.where(valid, variance, np.nan)),
        cnr_db=cnr_db,
        validity=validity.astype(np.uint8),
        positions=np.where(valid[..., None], positions, np.nan),
    )


def pose_variance(elevation: Array, slope: Array, positions: Array, aperture: Aperture, look_side: int) -> Array:
    """Variance of height (m^2) by the covariance of the platform's pose, shape (rows, cols).

    Where the platform moves, the scatterer moves along. Where the body turns by a small angle about an axis, the plane
    of its elevation turns, and the scatterer stays on the circle that range and Doppler leave: to first order, as if
    the elevation changed by the turn about the body's x axis (but for the squint). Range and Doppler are measured, and
    stay. A covariance that is 0 or not finite is not known and adds nothing.

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
    return np.asarray(np.maximum(np.sum(gradient @ aperture.covariance * gradient, axis=-1), 0.0))
