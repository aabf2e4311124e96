"""Compiled loops of the errors of positions; the formulas stand in `position_error`.

They take the positions of the antenna, m, shape (n, 3), or (1, 3) for all points; its velocity, m/s, shape (3,); and
the unit vector forward in the body, shape (3,). Positions of scatterers, m, have the shape (n, 3), covariances, m^2,
the shape (n, 3, 3).
"""

from __future__ import annotations

import numpy as np

from sal_height.geometry import EARTH_RADIUS
from sal_height.numeric import F32, F64, Vector, compiled_with_nan, cross, dot, inlined, squared, total, vector


@inlined
def _unit(velocity: F64) -> Vector:
    """Direction of a velocity."""
    flight = vector(velocity)
    return total(1 / np.sqrt(dot(flight, flight)), flight, 0.0, flight)


@inlined
def _upright(position: F64) -> Vector:
    """Unit vector away from the centre of the earth."""
    away = position[0], position[1], position[2] + EARTH_RADIUS
    return total(1 / np.sqrt(dot(away, away)), away, 0.0, away)


@inlined
def _sight(position: F64, antenna: F64) -> Vector:
    """Line of sight s."""
    return position[0] - antenna[0], position[1] - antenna[1], position[2] - antenna[2]


@inlined
def _circle(sight: Vector, direction: Vector, forward: Vector) -> Vector:
    """Derivative c of a position by elevation, m/rad."""
    square, sight_forward, sight_along = dot(sight, sight), dot(sight, forward), dot(sight, direction)
    determinant = sight_forward * sight_along - square * dot(direction, forward)
    turn = cross(sight, direction)
    return total((square - squared(sight_forward)) / determinant, turn, 0.0, turn)


@inlined
def _by_range(sight: Vector, direction: Vector, forward: Vector) -> Vector:
    """Derivative of a position by slant range, m/m."""
    square, sight_forward, sight_along = dot(sight, sight), dot(sight, forward), dot(sight, direction)
    squint = dot(direction, forward)
    share = np.sqrt(square) / (sight_forward * sight_along - square * squint)
    return total(share * sight_along, forward, -share * squint, sight)


@inlined
def _by_along(sight: Vector, direction: Vector, forward: Vector) -> Vector:
    """Derivative of a position by distance along the flight, m/m."""
    square, sight_forward, sight_along = dot(sight, sight), dot(sight, forward), dot(sight, direction)
    share = 1 / (sight_forward * sight_along - square * dot(direction, forward))
    return total(share * sight_forward, sight, -share * square, forward)


@compiled_with_nan
def fill_jacobians(antenna: F64, velocity: F64, forward: F64, positions: F64, jacobians: F64) -> None:
    """Fill the Jacobians of `position_error.position_jacobian`."""
    direction, ahead = _unit(velocity), vector(forward)
    each = 0 if len(antenna) == 1 else 1
    for i in range(len(positions)):
        sight = _sight(positions[i], antenna[i * each])
        columns = (
            _circle(sight, direction, ahead),
            _by_range(sight, direction, ahead),
            _by_along(sight, direction, ahead),
        )
        for row in range(3):
            for col in range(3):
                jacobians[i, row, col] = columns[col][row]


@compiled_with_nan
def fill_covariances(
    antenna: F64, velocity: F64, forward: F64, positions: F64, sigmas: F64, covariances: F64, climb: F64
) -> None:
    """Fill the covariances of `position_error.measured_covariance`.

    Args:
        antenna: its positions.
        velocity: of it.
        forward: in the body.
        positions: of scatterers.
        sigmas: of elevation (rad), slant range and distance along the flight (m), shape (n, 3).
        covariances: to be filled.
        climb: derivative of height by elevation, without its sign, to be filled, m/rad, shape (n,).
    """
    direction, ahead = _unit(velocity), vector(forward)
    each = 0 if len(antenna) == 1 else 1
    for i in range(len(positions)):
        sight = _sight(positions[i], antenna[i * each])
        circle = _circle(sight, direction, ahead)
        one = total(sigmas[i, 0], circle, 0.0, circle)
        two, three = _by_range(sight, direction, ahead), _by_along(sight, direction, ahead)
        two, three = total(sigmas[i, 1], two, 0.0, two), total(sigmas[i, 2], three, 0.0, three)
        for row in range(3):
            for col in range(3):
                covariances[i, row, col] = one[row] * one[col] + two[row] * two[col] + three[row] * three[col]
        climb[i] = abs(dot(circle, _upright(positions[i])))


@compiled_with_nan
def fill_circle_covariances(
    antenna: F64, velocity: F64, forward: F64, positions: F64, height_sigma: F64, covariances: F64
) -> None:
    """Fill the covariances of `position_error.circle_covariance`, for heights with the sigma `height_sigma`, m."""
    direction, ahead = _unit(velocity), vector(forward)
    each = 0 if len(antenna) == 1 else 1
    for i in range(len(positions)):
        circle = _circle(_sight(positions[i], antenna[i * each]), direction, ahead)
        share = height_sigma[i] / dot(circle, _upright(positions[i]))
        moved = total(share, circle, 0.0, circle)
        for row in range(3):
            for col in range(3):
                covariances[i, row, col] = moved[row] * moved[col]


@compiled_with_nan
def fill_pose_covariances(
    pose: F64, antenna: F64, velocity: F64, forward: F64, positions: F64, covariances: F64
) -> None:
    """Fill the covariances of `position_error.pose_covariance` from that of the `pose`, shape (6, 6)."""
    direction, ahead = _unit(velocity), vector(forward)
    each = 0 if len(antenna) == 1 else 1
    for i in range(len(positions)):
        sight = _sight(positions[i], antenna[i * each])
        square, sight_forward = dot(sight, sight), dot(sight, ahead)
        share = 1 / (square - squared(sight_forward))
        turned = total(share * square, ahead, -share * sight_forward, sight)
        circle, variance = _circle(sight, direction, ahead), 0.0
        for axis in range(3):
            variance += turned[axis] * dot(vector(pose[3 + axis, 3:]), turned)
        for row in range(3):
            half = dot(vector(pose[row, 3:]), turned) + variance / 2 * circle[row]
            for col in range(3):
                other = dot(vector(pose[col, 3:]), turned) + variance / 2 * circle[col]
                covariances[i, row, col] = pose[row, col] + half * circle[col] + circle[row] * other


@compiled_with_nan
def fill_height_variances(positions: F64, covariances: F64, variances: F64) -> None:
    """Fill the variances of `position_error.height_variance`, m^2, shape (n,)."""
    for i in range(len(positions)):
        upright = _upright(positions[i])
        variances[i] = 0.0
        for row in range(3):
            variances[i] += upright[row] * dot(vector(covariances[i, row]), upright)


@compiled_with_nan
def fold_covariances(covariances: F64, triangles: F32) -> None:
    """Fill the upper triangles of symmetric matrices, row by row, shape (n, 6)."""
    for i in range(len(covariances)):
        number = 0
        for row in range(3):
            for col in range(row, 3):
                triangles[i, number] = covariances[i, row, col]
                number += 1


@compiled_with_nan
def unfold_covariances(triangles: F32, covariances: F64) -> None:
    """Fill the symmetric matrices of upper triangles, shape (n, 6)."""
    for i in range(len(covariances)):
        number = 0
        for row in range(3):
            for col in range(row, 3):
                covariances[i, row, col] = covariances[i, col, row] = triangles[i, number]
                number += 1
