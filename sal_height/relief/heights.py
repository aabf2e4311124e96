"""Heights from elevations: the position on the ground of the scatterer in each pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from sal_height.elevation import SCATTERERS, ElevationEstimate, Looks, Scatterer, Validity
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
        spread: standard deviation of the surface's own heights within the pixel, m; 0: a single point.
        own_covariance: of the position without the error of the platform's pose, m^2, shape (rows, cols, 3, 3).
        common_covariance: what the pose adds, an error that all pixels of a dwell share; None: not known.
    """

    height: F64
    sigma: F64
    cnr_db: F64
    positions: F64
    spread: F64
    own_covariance: F64
    common_covariance: F64 | None = None

    @classmethod
    def at(cls, positions: F64, height: F64, sigma: F64, cnr_db: F64) -> Self:
        """A surface of single points, whose covariance is not known."""
        return cls(height, sigma, cnr_db, positions, np.zeros_like(height), np.full((*height.shape, 3, 3), np.nan))

    @property
    def is_determined(self) -> Bool:
        """Where place and height are finite, and sigma is so in single precision, which messages have: (rows, cols)."""
        with np.errstate(over="ignore"):
            sigma = self.sigma.astype(np.float32)
        return np.isfinite(self.positions).all(axis=-1) & np.isfinite(sigma) & (sigma > 0)

    def where(self, there: Bool) -> Surface:
        """The surface only `there`, and NaN elsewhere; the CNR stays."""
        common, matrices = self.common_covariance, there[..., None, None]
        return Surface(
            height=np.where(there, self.height, np.nan),
            sigma=np.where(there, self.sigma, np.nan),
            cnr_db=self.cnr_db,
            positions=np.where(there[..., None], self.positions, np.nan),
            spread=np.where(there, self.spread, np.nan),
            own_covariance=np.where(matrices, self.own_covariance, np.nan),
            common_covariance=None if common is None else np.where(matrices, common, np.nan),
        )


@dataclass(frozen=True)
class HeightField:
    """Heights of one dwell.

    Attributes:
        grid: pixels of the height image.
        validity: `Validity` of each pixel, uint8, shape (rows, cols).
        surfaces: the strongest scatterer of the pixels that have a height, with the `cnr_db` of all pixels that have a
            signal; then as many weaker ones as were looked for.
        order_probability: as in `ElevationEstimate`; None: not estimated.
    """

    grid: Grid
    validity: U8
    surfaces: tuple[Surface, ...]
    order_probability: F64 | None = None

    @property
    def first(self) -> Surface:
        """The surface of the strongest scatterers."""
        return self.surfaces[0]


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

    def surface(scatterer: Scatterer) -> Surface:
        """Height and position of scatterers; NaN where there is no such direction."""
        elevation, cnr = scatterer.elevation, scatterer.cnr
        positions = locate_at_elevation(elevation, slant_range, along, aperture, look_side)
        height = height_of(positions)
        farther = locate_at_elevation(elevation, slant_range + range_step, along, aperture, look_side)
        depth = (height_of(farther) - height) / range_step
        slope = _height_slope(elevation, slant_range, along, aperture, look_side)
        variance = (scatterer.sigma * slope) ** 2 + (range_sigma * depth) ** 2
        variance += pose_variance(elevation, slope, positions, aperture, look_side)
        with np.errstate(divide="ignore", invalid="ignore"):
            cnr_db = 10 * np.log10(np.where(cnr > 0, cnr, np.nan))
        placed = Surface.at(positions, height, np.sqrt(variance), cnr_db)
        return replace(placed, spread=np.abs(scatterer.spread * slope))

    surfaces = [surface(scatterer) for scatterer in estimate.scatterers]
    validity = _checked_validity(estimate.validity, surfaces)
    held = scatterer_count(validity)
    first, *others = (one.where(held > number) for number, one in enumerate(surfaces))
    others = [replace(one, cnr_db=np.where(np.isfinite(one.height), one.cnr_db, np.nan)) for one in others]
    return HeightField(grid, validity, (first, *others), estimate.order_probability)


def scatterer_count(validity: U8) -> U8:
    """Number of scatterers with a height in each pixel, by its `Validity`; same shape."""
    table = np.zeros(256, np.uint8)
    table[list(SCATTERERS)] = list(SCATTERERS.values())
    return table[validity]


def _height_slope(elevation: F64, slant_range: F64, along: F64, aperture: ApertureState, look_side: int) -> F64:
    """Derivative of height by elevation on the circles of range and Doppler, m/rad, by central differences."""
    below, above = (
        height_of(locate_at_elevation(elevation + step, slant_range, along, aperture, look_side))
        for step in (-SLOPE_STEP, SLOPE_STEP)
    )
    return (above - below) / (2 * SLOPE_STEP)


def _checked_validity(validity: U8, surfaces: Sequence[Surface]) -> U8:
    """The validity with a reason where measurements could be used, but a height or its sigma is not determined.

    OUTSIDE_ARRAY: no place on the ground has that range, Doppler and elevation. LOW_CNR: sigma is infinite, as without
    a signal. NOT_ONE_SCATTERER: one or more of several scatterers are not determined.
    """
    held = scatterer_count(validity)
    determined = sum(one.is_determined & (held > number) for number, one in enumerate(surfaces))
    placed = np.isfinite(surfaces[0].positions).all(axis=-1)
    reason = np.select([held > 1, placed], [Validity.NOT_ONE_SCATTERER, Validity.LOW_CNR], Validity.OUTSIDE_ARRAY)
    return np.where(determined < held, reason, validity).astype(np.uint8)


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
