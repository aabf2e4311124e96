"""Compiled loops over points: positions from range, Doppler and elevation or height, and on the sphere."""

from __future__ import annotations

import numpy as np

from sal_height.numeric import F64, Vector, compiled_with_nan, cross, dot, inlined, squared, total, vector


@inlined
def height_above(point: Vector, earth: float) -> float:
    """Height (m) above the sphere of the radius `earth` (m), as `earth.height_of`."""
    x, y, z = point
    square = x * x + y * y
    return (square + z * z + 2 * earth * z) / (np.sqrt(square + squared(z + earth)) + earth)


@compiled_with_nan
def fill_heights(points: F64, earth: float, heights: F64) -> None:
    """Fill the heights (m) of `earth.height_of`, shape (n,), of points, m, shape (n, 3)."""
    for i in range(len(points)):
        heights[i] = height_above(vector(points[i]), earth)


@compiled_with_nan
def locate_at_elevations(
    elevation: F64,
    slant_range: F64,
    along: F64,
    position: F64,
    velocity: F64,
    rotation: F64,
    look_side: int,
    positions: F64,
) -> None:
    """Fill the positions of `trajectory.locate_at_elevation`.

    The direction fulfils A sin(squint) + B cos(squint) = cone, as in `frames.squint_on_cone`, which gives

        sin(squint) = (A cone - B root) / (A^2 + B^2),    cos(squint) = (B cone + A root) / (A^2 + B^2)

    with the root of A^2 + B^2 - cone^2.

    Args:
        elevation: elevations, shape (n,), rad.
        slant_range: slant ranges, shape (n,), m.
        along: components of the ranges along the flight, shape (n,), m.
        position: positions of the antenna, shape (n, 3), or (1, 3) for all points, m.
        velocity: velocity of the antenna, shape (3,), m/s.
        rotation: matrix from body to map axes, shape (3, 3).
        look_side: +1 right, -1 left.
        positions: array to fill, shape (n, 3), m.
    """
    flight = vector(velocity)
    speed = np.sqrt(dot(flight, flight))
    forward = dot(flight, vector(rotation[:, 0])) / speed
    left, up = dot(flight, vector(rotation[:, 1])) / speed, dot(flight, vector(rotation[:, 2])) / speed
    each = 0 if len(position) == 1 else 1
    for i in range(len(elevation)):
        sine, cosine = np.sin(elevation[i]), np.cos(elevation[i])
        cone, down = along[i] / slant_range[i], -look_side * left * sine - up * cosine
        square = squared(forward) + squared(down)
        root = np.sqrt(square - squared(cone))
        ahead, level = (forward * cone - down * root) / square, (down * cone + forward * root) / square
        body = ahead, -look_side * level * sine, -level * cosine
        for axis in range(3):
            positions[i, axis] = position[i * each, axis] + slant_range[i] * dot(vector(rotation[axis]), body)


@compiled_with_nan
def locate_at_heights(
    height: F64,
    slant_range: F64,
    along: F64,
    position: F64,
    velocity: F64,
    look_side: int,
    earth: float,
    positions: F64,
) -> None:
    """Fill the positions of `trajectory.locate_at_height`.

    Arguments as in `locate_at_elevations`, with heights and the radius of the `earth` in m.
    """
    flight = vector(velocity)
    speed = np.sqrt(dot(flight, flight))
    direction = total(1 / speed, flight, 0.0, flight)
    each = 0 if len(position) == 1 else 1
    for i in range(len(height)):
        antenna = vector(position[i * each])
        platform = height_above(antenna, earth)
        centre = antenna[0], antenna[1], antenna[2] + earth
        ahead = dot(centre, direction)
        upright = total(1.0, centre, -ahead, direction)
        distance = np.sqrt(dot(upright, upright))
        upward = total(1 / distance, upright, 0.0, upright)
        aside = cross(direction, upward)
        # (e + s)^2 - e^2 = 2 e s + s^2, with the difference of the squares taken analytically.
        growth = (height[i] - platform) * (2 * earth + height[i] + platform)
        up = ((growth - squared(slant_range[i])) / 2 - along[i] * ahead) / distance
        across = look_side * np.sqrt(squared(slant_range[i]) - squared(along[i]) - squared(up))
        for axis in range(3):
            sight = along[i] * direction[axis] + up * upward[axis] + across * aside[axis]
            positions[i, axis] = antenna[axis] + sight


@compiled_with_nan
def fill_sphere_coordinates(points: F64, earth: float, coordinates: F64) -> None:
    """Fill the arc distances east and north and the height of `earth.sphere_coordinates`.

    Args:
        points: positions in map, shape (n, 3), m.
        earth: radius, m.
        coordinates: array to fill, shape (3, n), m.
    """
    for i in range(len(points)):
        x, y, z = vector(points[i])
        level = np.sqrt(x * x + y * y)
        scale = earth * np.arctan2(level, z + earth) / level if level > 0 else 1.0
        coordinates[0, i], coordinates[1, i] = scale * x, scale * y
        coordinates[2, i] = height_above((x, y, z), earth)
