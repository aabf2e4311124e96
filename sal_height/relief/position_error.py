"""Covariance of a scatterer's position, and the resulting error of height at a fixed position.

A pixel measures the slant range R, the component L of the line of sight s along the flight v (from Doppler), and the
elevation: s lies in a plane through the body's forward axis f with the normal m = f x s. Moved along with each other,

    s ds / |s| = dR,    v ds = dL,    m ds = |m|^2 (d elevation) + (s x m) d rotation,

and the solution for ds is the Jacobian of the position, exact to first order. With D = (s f)(s v) - s^2 (v f) it is

    c = (s x v) |m|^2 / D by elevation,    |s| (f (s v) - s (v f)) / D by R,    (s (s f) - f s^2) / D by L.

On their circle of range and Doppler positions move along c, outwards when up, so that an error of elevation does not
only raise a point but shifts it. A rotation e of the body moves them by c (w e), w = (s x m) / |m|^2.

At a fixed position (east, north) on ground of slope g = (d height / d east, d height / d north), a point with the error
e is too high by e_up - g e_horizontal. That is the error that a map of heights has.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from sal_height.geometry import EARTH_RADIUS, ApertureState, Grid, antennas_of, aperture_at, locate_at_elevation
from sal_height.numeric import F32, F64, in_parallel
from sal_height.relief import _error_kernels as kernels
from sal_height.relief._kernels import variances_across

STEEPEST = 1.0
"""Steepest slope (height over distance) of ground whose slope is not known: 45 degrees, about the repose of rubble."""

LEAST_POINTS = 2**14
"""Points that are worth a thread."""


def position_jacobian(positions: F64, aperture: ApertureState) -> F64:
    """Derivative of positions by elevation (m/rad), by slant range and by along-track distance (m/m).

    The sign of elevation is that of a right-handed rotation about the body's forward axis.

    Args:
        positions: positions of scatterers in map, m, shape (..., 3).
        aperture: aperture from which they were seen.

    Returns:
        Matrices whose columns are the three derivatives, shape (..., 3, 3).
    """
    jacobians = np.empty((*positions.shape, 3))
    _fill(kernels.fill_jacobians, aperture, positions, jacobians)
    return jacobians


def turn_jacobian(positions: F64, aperture: ApertureState) -> F64:
    """Derivative of positions by a small turn of the body about the axes of map, m/rad: c w^T.

    Args:
        positions: positions of scatterers in map, m, shape (..., 3).
        aperture: aperture from which they were seen.

    Returns:
        Matrices of shape (..., 3, 3).
    """
    sight = positions - aperture_at(positions, aperture).position
    normal = np.cross(aperture.forward, sight)
    turn = np.cross(sight, normal) / np.sum(normal**2, axis=-1, keepdims=True)
    return np.asarray(position_jacobian(positions, aperture)[..., :, :1] * turn[..., None, :])


def level_turn(elevation: float, grid: Grid, aperture: ApertureState, look_side: int) -> float:
    """Elevation (rad) that level ground gains from row to row of an image, in its middle.

    Args:
        elevation: elevation under which the ground is seen, rad.
        grid: pixels of the image in the slant plane.
        aperture: aperture from which the image was seen.
        look_side: look side, +1 right, -1 left.
    """
    point = grid.middle
    aperture = aperture_at(point, aperture)
    sight = point - aperture.position
    slant_range = np.linalg.norm(sight)
    position = locate_at_elevation(elevation, slant_range, sight @ aperture.direction, aperture, look_side)
    by_elevation, by_range, _ = vertical(position) @ position_jacobian(position, aperture)
    depth = grid.row_spacing * (grid.row_direction @ sight) / slant_range
    return float(abs(depth * by_range / by_elevation))


def measured_covariance(
    positions: F64, aperture: ApertureState, sigma: F64, range_sigma: F64 | float, along_sigma: F64 | float
) -> tuple[F64, F64]:
    """Covariance (m^2) of positions from the independent errors of the measured quantities.

    Args:
        positions: positions of scatterers in map, m, shape (..., 3).
        aperture: aperture from which they were seen.
        sigma: standard deviation of elevation, rad, shape (...) or one that broadcasts to it.
        range_sigma: standard deviation of the slant range, m, same shapes.
        along_sigma: standard deviation of the along-track distance, m, same shapes.

    Returns:
        The covariance in map axes, shape (..., 3, 3), not finite where a sigma is not; and the derivative of height by
        elevation, without its sign, m/rad, shape (...).
    """
    sigmas, covariance = np.empty(positions.shape), np.empty((*positions.shape, 3))
    climb = np.empty(positions.shape[:-1])
    sigmas[..., 0], sigmas[..., 1], sigmas[..., 2] = sigma, range_sigma, along_sigma
    _fill(kernels.fill_covariances, aperture, positions, sigmas, covariance, climb)
    return covariance, climb


def circle_covariance(height_sigma: F64, positions: F64, aperture: ApertureState) -> F64:
    """Covariance (m^2) of positions with errors only along their circles of range and Doppler.

    Args:
        height_sigma: standard deviation of their heights, m, shape (...).
        positions: positions in map, m, shape (..., 3).
        aperture: aperture from which they were seen.

    Returns:
        In map axes, shape (..., 3, 3).
    """
    covariance = np.empty((*positions.shape, 3))
    _fill(kernels.fill_circle_covariances, aperture, positions, height_sigma, covariance)
    return covariance


def covariances_from_sigma(height_sigma: F64, positions: F64, aperture: ApertureState) -> tuple[F64, F64 | None]:
    """Own and common covariance (m^2) of positions of which only the standard deviation of height is known.

    The common part is that of the pose; the rest of the variance of height, at least 0.01 of it as sigma may have been
    rounded to float32, is assumed to be caused by errors of elevation. Arguments as of `circle_covariance`, results as
    of it and of `pose_covariance`.
    """
    with np.errstate(invalid="ignore", over="ignore"):  # values that are not finite stay so
        common = pose_covariance(positions, aperture)
        variance = height_sigma**2
        own = variance if common is None else variance - height_variance(common, positions)
        return circle_covariance(np.sqrt(np.maximum(own, 0.01 * variance)), positions, aperture), common


def pose_covariance(positions: F64, aperture: ApertureState) -> F64 | None:
    """Covariance (m^2) of positions from that of the platform's pose, which all pixels of a dwell share.

    An error of the platform's position p displaces the scatterer by as much. A small error e of the body's rotation,
    about the axes of map, turns the plane of its elevation: it moves on its circle of range and Doppler, which are
    measured, by c (w e). With a = C_pe w + (w C_ee w) c / 2,

        C = C_pp + a c^T + c a^T.

    Args:
        positions: positions of scatterers in map, m, shape (..., 3).
        aperture: aperture from which they were seen; its covariance is of position and of rotation about the axes of
            map, as in nav_msgs/Odometry.

    Returns:
        In map axes, shape (..., 3, 3); NaN where a position is NaN. None: the covariance of the pose is 0 or not
        finite, that is, not known.
    """
    if not (np.all(np.isfinite(aperture.covariance)) and np.any(aperture.covariance)):
        return None
    covariance = np.empty((*positions.shape, 3))
    pose = np.ascontiguousarray(aperture.covariance, dtype=np.float64)
    _fill(partial(kernels.fill_pose_covariances, pose), aperture, positions, covariance)
    return covariance


def pitch_covariance(positions: F64, aperture: ApertureState, offset: F64, sigma: float) -> F64:
    """Covariance (m^2) of positions from an error of the angles between the beams, which all dwells share.

    Beams that are farther apart than described, by the fraction e, make an elevation wrong by e times its offset from
    the middle of the array.

    Args:
        positions: positions of scatterers in map, m, shape (..., 3).
        aperture: aperture from which they were seen.
        offset: their elevations from the middle of the array, rad, shape (...).
        sigma: standard deviation of e.

    Returns:
        In map axes, shape (..., 3, 3).
    """
    return measured_covariance(positions, aperture, sigma * np.abs(offset), 0.0, 0.0)[0]


def height_variance(covariance: F64, positions: F64) -> F64:
    """Variance of height (m^2) of points with these covariances of position: that along their vertical.

    Args:
        covariance: covariances of the positions in map axes, m^2, shape (..., 3, 3).
        positions: positions in map, m, shape (..., 3).
    """
    variance = np.empty(positions.shape[:-1])
    flat = (
        np.ascontiguousarray(positions.reshape(-1, 3)),
        np.ascontiguousarray(covariance.reshape(-1, 3, 3)),
        variance.reshape(-1),
    )
    in_parallel(
        lambda part: kernels.fill_height_variances(*(array[part] for array in flat)), len(flat[2]), LEAST_POINTS
    )
    return variance


def folded(covariances: F64) -> F32:
    """Upper triangles of symmetric matrices, shape (..., 3, 3), row by row in single precision, shape (..., 6)."""
    triangles = np.empty((*covariances.shape[:-2], 6), np.float32)
    kernels.fold_covariances(np.ascontiguousarray(covariances.reshape(-1, 3, 3)), triangles.reshape(-1, 6))
    return triangles


def unfolded(triangles: F32) -> F64:
    """The symmetric matrices, shape (..., 3, 3), of upper triangles as of `folded`, shape (..., 6)."""
    covariances = np.empty((*triangles.shape[:-1], 3, 3))
    kernels.unfold_covariances(np.ascontiguousarray(triangles.reshape(-1, 6)), covariances.reshape(-1, 3, 3))
    return covariances


def vertical(positions: F64) -> F64:
    """Unit vector away from the centre of the earth at positions in map (m), shape (..., 3)."""
    upright = positions + np.array([0.0, 0.0, EARTH_RADIUS])
    return np.asarray(upright / np.linalg.norm(upright, axis=-1, keepdims=True))


def variance_at_place(covariance: F64, slope: F64) -> F64:
    """Variance (m^2) of the height of points at their positions (east, north): that across the ground.

    With the normal n = (-g, 1) of the ground it is n C n.

    Args:
        covariance: covariance of the points, m^2, axes east, north, up, shape (..., 3, 3).
        slope: slope of the ground towards east and north, m/m, shape (..., 2); NaN: not known. Then the result bounds
            the variance on all ground up to STEEPEST: (sigma of height + STEEPEST x greatest horizontal sigma)^2.
    """
    shape = np.broadcast_shapes(covariance.shape[:-2], slope.shape[:-1])
    matrices, slopes = np.broadcast_to(covariance, (*shape, 3, 3)), np.broadcast_to(slope, (*shape, 2))
    variance = np.empty(shape)
    flat = matrices.reshape(-1, 3, 3), slopes.reshape(-1, 2), variance.reshape(-1)
    in_parallel(
        lambda part: variances_across(flat[0][part], flat[1][part], STEEPEST, flat[2][part]), len(flat[2]), LEAST_POINTS
    )
    return variance


def _fill(loop: Callable[..., None], aperture: ApertureState, positions: F64, *arrays: F64) -> None:
    """Run a compiled loop over points that were seen from an aperture; it fills some of the arrays.

    Args:
        loop: loop of `_error_kernels`.
        aperture: aperture from which they were seen.
        positions: positions of the points in map, m, shape (..., 3).
        arrays: arguments of the loop after the positions, shapes (...) with any further axes.
    """
    shape = positions.shape[:-1]
    antenna = antennas_of(aperture_at(positions, aperture), shape)
    flat = [np.ascontiguousarray(array.reshape(-1, *array.shape[len(shape) :])) for array in (positions, *arrays)]
    velocity, forward = np.ascontiguousarray(aperture.velocity), np.ascontiguousarray(aperture.forward)

    def fill(part: slice) -> None:
        loop(antenna[part] if len(antenna) > 1 else antenna, velocity, forward, *(array[part] for array in flat))

    in_parallel(fill, len(flat[0]), LEAST_POINTS)
