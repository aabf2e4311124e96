"""Covariance of a scatterer's position, and the error of height at a place that follows from it.

A pixel measures the slant range R, the component L of the line of sight s along the flight v (from Doppler), and the
elevation: s lies in a plane through the body's forward axis f with the normal m = f x s. Moved along with each other,

    s ds / |s| = dR,    v ds = dL,    m ds = |m|^2 (d elevation) + (s x m) d rotation,

and the solution for ds is the Jacobian of the position, exact to first order. On their circle of range and Doppler
positions move along s x v, outwards when up, so that an error of elevation does not only raise a point but shifts it.

At a fixed place (east, north) on ground of slope g = (d height / d east, d height / d north), a point that is off by e
is too high by e_up - g e_horizontal. That is the error that a map of heights has.
"""

from __future__ import annotations

import numpy as np

from sal_height.geometry import EARTH_RADIUS, ApertureState, aperture_at
from sal_height.numeric import F64

STEEPEST = 1.0
"""Steepest slope (height over distance) of ground whose slope is not known: 45 degrees, about the repose of rubble."""


def position_jacobian(positions: F64, aperture: ApertureState) -> F64:
    """Derivative of positions by elevation (m/rad), by slant range and by distance along the flight (m/m).

    The sign of elevation is that of a right-handed rotation about the body's forward axis.

    Args:
        positions: of scatterers in map, m, shape (..., 3).
        aperture: from which they were seen.

    Returns:
        Matrices whose columns are the three derivatives, shape (..., 3, 3).
    """
    sight, normal = _sight_and_normal(positions, aperture)
    ahead = sight / np.linalg.norm(sight, axis=-1, keepdims=True)
    along = np.broadcast_to(aperture.direction, ahead.shape)
    by_elevation, by_range, by_along = np.cross(ahead, along), np.cross(along, normal), np.cross(normal, ahead)
    determinant = _dot(ahead, by_range)
    by_elevation *= _dot(normal, normal)[..., None]
    return np.stack([by_elevation, by_range, by_along], axis=-1) / determinant[..., None, None]


def covariance_of(jacobian: F64, sigmas: F64) -> F64:
    """Covariance (m^2) of positions from independent errors.

    Args:
        jacobian: derivatives of the positions, shape (..., 3, 3).
        sigmas: standard deviation of elevation (rad), slant range and distance along the flight (m), shape (..., 3).

    Returns:
        In map axes, shape (..., 3, 3).
    """
    scaled = jacobian * sigmas[..., None, :]
    return scaled @ np.swapaxes(scaled, -1, -2)


def pose_covariance(positions: F64, aperture: ApertureState) -> F64:
    """Covariance (m^2) of positions from that of the platform's pose, which all pixels of a dwell share.

    An error of the platform's position p displaces the scatterer by as much. A small error e of the body's rotation,
    about the axes of map, turns the plane of its elevation: it moves on its circle of range and Doppler, which are
    measured, as if the elevation had changed by w e, w = (s x m) / |m|^2. With c the derivative by elevation,

        C = C_pp + (C_pe w) c^T + c (C_pe w)^T + (w C_ee w) c c^T.

    A covariance that is 0 or not finite counts as unknown and adds nothing.

    Args:
        positions: of scatterers in map, m, shape (..., 3).
        aperture: from which they were seen; its covariance is of position and of rotation about the axes of map, as in
            nav_msgs/Odometry.

    Returns:
        In map axes, shape (..., 3, 3); NaN where a position is NaN.
    """
    if not (np.all(np.isfinite(aperture.covariance)) and np.any(aperture.covariance)):
        return np.where(np.isfinite(positions[..., :1, None]), np.zeros((3, 3)), np.nan)
    place, mixed, turn = aperture.covariance[:3, :3], aperture.covariance[:3, 3:], aperture.covariance[3:, 3:]
    sight, normal = _sight_and_normal(positions, aperture)
    turned = np.cross(sight, normal) / _dot(normal, normal)[..., None]
    circle = position_jacobian(positions, aperture)[..., 0]
    shifted = _outer(turned @ mixed.T, circle)
    variance = _dot(turned @ turn, turned)
    return place + shifted + np.swapaxes(shifted, -1, -2) + variance[..., None, None] * _outer(circle, circle)


def height_variance(covariance: F64, positions: F64) -> F64:
    """Variance of height (m^2) of points whose positions have these covariances: that along their vertical.

    Args:
        covariance: m^2, in map axes, shape (..., 3, 3).
        positions: m, in map, shape (..., 3).
    """
    upright = positions + np.array([0.0, 0.0, EARTH_RADIUS])
    upright /= np.linalg.norm(upright, axis=-1, keepdims=True)
    return _dot((covariance @ upright[..., None])[..., 0], upright)


def variance_at_place(covariance: F64, slope: F64) -> F64:
    """Variance (m^2) of the height that points state for their places (east, north): that across the ground.

    With the normal n = (-g, 1) of the ground it is n C n.

    Args:
        covariance: of the points, m^2, axes east, north, up, shape (..., 3, 3).
        slope: of the ground, towards east and north, m/m, shape (..., 2); NaN: not known. Then it is a bound of the
            variance on all ground up to STEEPEST: (sigma of height + STEEPEST x greatest horizontal sigma)^2.
    """
    normal = np.concatenate([-slope, np.ones((*slope.shape[:-1], 1))], axis=-1)
    across = _dot((covariance @ normal[..., None])[..., 0], normal)
    return np.where(np.isfinite(across), across, _variance_on_steep_ground(covariance))


def _variance_on_steep_ground(covariance: F64) -> F64:
    """Bound of the variance at a place on ground up to STEEPEST, m^2."""
    east, north, mixed = covariance[..., 0, 0], covariance[..., 1, 1], covariance[..., 0, 1]
    greatest = (east + north) / 2 + np.hypot((east - north) / 2, mixed)
    return (np.sqrt(covariance[..., 2, 2]) + STEEPEST * np.sqrt(greatest)) ** 2


def _sight_and_normal(positions: F64, aperture: ApertureState) -> tuple[F64, F64]:
    """Line of sight s (m) and normal f x s of the plane of elevation, shape (..., 3)."""
    sight = positions - aperture_at(positions, aperture).position
    return sight, np.cross(aperture.forward, sight)


def _dot(one: F64, other: F64) -> F64:
    return np.einsum("...i,...i", one, other)


def _outer(one: F64, other: F64) -> F64:
    return one[..., :, None] * other[..., None, :]
