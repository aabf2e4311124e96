"""Covariance of a scatterer's position, and the error of height at a place that follows from it.

A pixel measures the slant range R, the component L of the line of sight s along the flight v (from Doppler), and the
elevation: s lies in a plane through the body's forward axis f with the normal m = f x s. Moved along with each other,

    s ds / |s| = dR,    v ds = dL,    m ds = |m|^2 (d elevation) + (s x m) d rotation,

and the solution for ds is the Jacobian of the position, exact to first order. With D = (s f)(s v) - s^2 (v f) it is

    c = (s x v) |m|^2 / D by elevation,    |s| (f (s v) - s (v f)) / D by R,    (s (s f) - f s^2) / D by L.

On their circle of range and Doppler positions move along c, outwards when up, so that an error of elevation does not
only raise a point but shifts it. A rotation e of the body moves them by c (w e), w = (s x m) / |m|^2.

At a fixed place (east, north) on ground of slope g = (d height / d east, d height / d north), a point that is off by e
is too high by e_up - g e_horizontal. That is the error that a map of heights has.
"""

from __future__ import annotations

import numpy as np

from sal_height.geometry import EARTH_RADIUS, ApertureState, Grid, aperture_at, locate_at_elevation
from sal_height.numeric import F64, Bool, in_parallel
from sal_height.relief._kernels import add_squares, find_semidefinite, variances_across

STEEPEST = 1.0
"""Steepest slope (height over distance) of ground whose slope is not known: 45 degrees, about the repose of rubble."""

LEAST_POINTS = 2**14
"""Points that are worth a thread."""

LEAST_OWN_SHARE = 0.01
"""Least share of a height's variance that is not due to the pose; sigma may have been rounded to float32."""

ROUNDING = 1e-5
"""How far a determinant may be below 0, over that of the variances: float32 rounds each number by up to 1e-7."""


def position_jacobian(positions: F64, aperture: ApertureState) -> F64:
    """Derivative of positions by elevation (m/rad), by slant range and by distance along the flight (m/m).

    The sign of elevation is that of a right-handed rotation about the body's forward axis.

    Args:
        positions: of scatterers in map, m, shape (..., 3).
        aperture: from which they were seen.

    Returns:
        Matrices whose columns are the three derivatives, shape (..., 3, 3).
    """
    forward, along = aperture.forward, aperture.direction
    sight = _sight(positions, aperture)
    square, sight_forward, sight_along = (values[..., None] for values in _products(sight, aperture))
    determinant = sight_forward * sight_along - square * (along @ forward)
    by_range = np.sqrt(square) * (forward * sight_along - sight * (along @ forward)) / determinant
    by_along = (sight * sight_forward - forward * square) / determinant
    return np.stack([_circle(sight, aperture), by_range, by_along], axis=-1)


def level_turn(elevation: float, grid: Grid, aperture: ApertureState, look_side: int) -> float:
    """Elevation (rad) that level ground gains from row to row of an image, in its middle.

    Args:
        elevation: under which the ground is seen, rad.
        grid: pixels of the image in the slant plane.
        aperture: from which it was seen.
        look_side: +1 right, -1 left.
    """
    point = grid.points((grid.rows - 1) / 2, (grid.cols - 1) / 2)
    aperture = aperture_at(point, aperture)
    sight = point - aperture.position
    slant_range = np.linalg.norm(sight)
    position = locate_at_elevation(elevation, slant_range, sight @ aperture.direction, aperture, look_side)
    by_elevation, by_range, _ = vertical(position) @ position_jacobian(position, aperture)
    depth = grid.row_spacing * (grid.row_direction @ sight) / slant_range
    return float(abs(depth * by_range / by_elevation))


def covariance_of(jacobian: F64, sigmas: F64) -> F64:
    """Covariance (m^2) of positions from independent errors.

    Args:
        jacobian: derivatives of the positions, shape (..., 3, 3).
        sigmas: standard deviation of elevation (rad), slant range and distance along the flight (m), shape (..., 3).

    Returns:
        In map axes, shape (..., 3, 3); not finite where a sigma is not.
    """
    covariance = np.empty(jacobian.shape)
    flat = jacobian.reshape(-1, 3, 3), sigmas.reshape(-1, 3), covariance.reshape(-1, 3, 3)
    in_parallel(lambda part: add_squares(flat[0][part], flat[1][part], flat[2][part]), len(flat[2]), LEAST_POINTS)
    return covariance


def circle_covariance(height_sigma: F64, positions: F64, aperture: ApertureState) -> F64:
    """Covariance (m^2) of positions that are off only along their circles of range and Doppler.

    Args:
        height_sigma: standard deviation of their heights, m, shape (...).
        positions: in map, m, shape (..., 3).
        aperture: from which they were seen.

    Returns:
        In map axes, shape (..., 3, 3).
    """
    circle = _circle(_sight(positions, aperture), aperture)
    circle *= (height_sigma / _dot(circle, vertical(positions)))[..., None]
    return _outer(circle, circle)


def covariances_from_sigma(height_sigma: F64, positions: F64, aperture: ApertureState) -> tuple[F64, F64 | None]:
    """Own and common covariance (m^2) of positions of which only the standard deviation of height is known.

    The common part is that of the pose; the rest of the variance of height, at least LEAST_OWN_SHARE of it, is taken to
    come from errors of elevation. Arguments as of `circle_covariance`, results as of it and of `pose_covariance`.
    """
    with np.errstate(invalid="ignore", over="ignore"):  # what is not finite stays so
        common = pose_covariance(positions, aperture)
        variance = height_sigma**2
        own = variance if common is None else variance - height_variance(common, positions)
        return circle_covariance(np.sqrt(np.maximum(own, LEAST_OWN_SHARE * variance)), positions, aperture), common


def pose_covariance(positions: F64, aperture: ApertureState) -> F64 | None:
    """Covariance (m^2) of positions from that of the platform's pose, which all pixels of a dwell share.

    An error of the platform's position p displaces the scatterer by as much. A small error e of the body's rotation,
    about the axes of map, turns the plane of its elevation: it moves on its circle of range and Doppler, which are
    measured, by c (w e). With a = C_pe w + (w C_ee w) c / 2,

        C = C_pp + a c^T + c a^T.

    Args:
        positions: of scatterers in map, m, shape (..., 3).
        aperture: from which they were seen; its covariance is of position and of rotation about the axes of map, as in
            nav_msgs/Odometry.

    Returns:
        In map axes, shape (..., 3, 3); NaN where a position is NaN. None: the covariance of the pose is 0 or not
        finite, that is, not known.
    """
    if not (np.all(np.isfinite(aperture.covariance)) and np.any(aperture.covariance)):
        return None
    place, mixed, turn = aperture.covariance[:3, :3], aperture.covariance[:3, 3:], aperture.covariance[3:, 3:]
    sight = _sight(positions, aperture)
    square, sight_forward, _ = (values[..., None] for values in _products(sight, aperture))
    turned = (aperture.forward * square - sight * sight_forward) / (square - sight_forward**2)
    circle = _circle(sight, aperture)
    half = turned @ mixed.T + _dot(turned @ turn, turned)[..., None] / 2 * circle
    product = _outer(half, circle)
    return place + product + np.swapaxes(product, -1, -2)


def height_variance(covariance: F64, positions: F64) -> F64:
    """Variance of height (m^2) of points whose positions have these covariances: that along their vertical.

    Args:
        covariance: m^2, in map axes, shape (..., 3, 3).
        positions: m, in map, shape (..., 3).
    """
    upright = vertical(positions)
    with np.errstate(invalid="ignore"):  # an infinite covariance, of scatterers without a sigma, times 0
        return _dot(np.einsum("...ij,...j", covariance, upright), upright)


def is_covariance(matrices: F64) -> Bool:
    """Where symmetric matrices, shape (..., 3, 3), are finite and positive semidefinite but for rounding in float32.

    All principal minors must be 0 or greater (Sylvester).
    """
    found = np.empty(matrices.shape[:-2], np.bool_)
    flat = matrices.reshape(-1, 3, 3), found.reshape(-1)
    in_parallel(lambda part: find_semidefinite(flat[0][part], ROUNDING, flat[1][part]), len(flat[1]), LEAST_POINTS)
    return found


def vertical(positions: F64) -> F64:
    """Unit vector away from the centre of the earth at positions in map (m), shape (..., 3)."""
    upright = positions + np.array([0.0, 0.0, EARTH_RADIUS])
    return np.asarray(upright / np.sqrt(_dot(upright, upright))[..., None])


def variance_at_place(covariance: F64, slope: F64) -> F64:
    """Variance (m^2) of the height that points state for their places (east, north): that across the ground.

    With the normal n = (-g, 1) of the ground it is n C n.

    Args:
        covariance: of the points, m^2, axes east, north, up, shape (..., 3, 3).
        slope: of the ground, towards east and north, m/m, shape (..., 2); NaN: not known. Then it is a bound of the
            variance on all ground up to STEEPEST: (sigma of height + STEEPEST x greatest horizontal sigma)^2.
    """
    shape = np.broadcast_shapes(covariance.shape[:-2], slope.shape[:-1])
    matrices, slopes = np.broadcast_to(covariance, (*shape, 3, 3)), np.broadcast_to(slope, (*shape, 2))
    variance = np.empty(shape)
    flat = matrices.reshape(-1, 3, 3), slopes.reshape(-1, 2), variance.reshape(-1)
    in_parallel(
        lambda part: variances_across(flat[0][part], flat[1][part], STEEPEST, flat[2][part]), len(flat[2]), LEAST_POINTS
    )
    return variance


def _sight(positions: F64, aperture: ApertureState) -> F64:
    """Line of sight s, m, shape (..., 3)."""
    return np.asarray(positions - aperture_at(positions, aperture).position)


def _circle(sight: F64, aperture: ApertureState) -> F64:
    """Derivative c of positions by elevation, m/rad, shape (..., 3)."""
    square, sight_forward, sight_along = _products(sight, aperture)
    determinant = sight_forward * sight_along - square * (aperture.direction @ aperture.forward)
    x, y, z = aperture.direction
    turn = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])  # sight @ turn is sight x direction
    return np.asarray(sight @ turn) * ((square - sight_forward**2) / determinant)[..., None]


def _products(sight: F64, aperture: ApertureState) -> tuple[F64, F64, F64]:
    """s^2 (m^2), s f and s v (m), each of shape (...)."""
    return _dot(sight, sight), sight @ aperture.forward, sight @ aperture.direction


def _dot(one: F64, other: F64) -> F64:
    return np.einsum("...i,...i", one, other)


def _outer(one: F64, other: F64) -> F64:
    return one[..., :, None] * other[..., None, :]
