"""Loops over points of the terrain, compiled; a test compares each with its formula in NumPy. NaN: no terrain."""

from __future__ import annotations

import math

from sal_height.geometry import EARTH_RADIUS
from sal_height.numeric import F64, I32, I64, Bool, between_nodes, compiled_with_nan, inlined, node_before, squared

SMALL_ANGLE = 0.02
"""Angle at the centre of the earth, rad, up to which series replace sine and cosine: off by less than 1e-17."""


@compiled_with_nan
def rise_in_canopy(
    rows: F64,
    cols: F64,
    ground: F64,
    top: F64,
    base: float,
    ceiling: float,
    points: F64,
    slope: F64,
    steps: int,
    result: F64,
) -> None:
    """Height that straight paths upwards rise inside a canopy, m, followed in equal steps in height up to its ceiling.

    Args:
        rows: arc distances north of the nodes, m, increasing.
        cols: arc distances east of the nodes, m, increasing.
        ground: height of the terrain on the nodes, m, shape (rows, cols).
        top: of the canopy above the terrain, m, same shape; there is no canopy outside of the nodes.
        base: height above the terrain at which the canopy begins, m.
        ceiling: height above which there is no canopy, m.
        points: where the paths begin: arc distances east and north, and height, m, shape (3, paths).
        slope: way eastwards and northwards per metre of height, shape (2, paths).
        steps: number of steps.
        result: shape (paths,).
    """
    i, j = 0, 0
    for k in range(result.size):
        step = max(ceiling - points[2, k], 0.0) / steps
        inside = 0.0
        for number in range(steps):
            climb = (number + 0.5) * step
            y, x = points[1, k] + slope[1, k] * climb, points[0, k] + slope[0, k] * climb
            if not (step > 0 and rows[0] <= y <= rows[-1] and cols[0] <= x <= cols[-1]):
                continue
            i, j = node_before(rows, y, i), node_before(cols, x, j)
            height = points[2, k] + climb - between_nodes(rows, cols, ground, i, j, y, x)
            highest, lowest = height + 0.5 * step, height - 0.5 * step
            inside += max(0.0, min(highest, between_nodes(rows, cols, top, i, j, y, x)) - max(lowest, base))
        result[k] = inside


@compiled_with_nan
def see(
    east: F64, north: F64, height: F64, antenna: F64, glide: F64, rotation: F64, side: int, positions: F64, seen: F64
) -> None:
    """Positions of points on the earth, and slant range, elevation and squint under which an aperture sees them.

    Formulas of `earth.sphere_point`, `frames.aperture_at` and `frames.angles_of`.

    Args:
        east: arc distance, m, shape (n,).
        north: arc distance, m, shape (n,).
        height: above the sphere, m, shape (n,).
        antenna: position, m, shape (3,).
        glide: how far a sliding aperture moves per m of way forward, shape (3,); 0 if it does not slide.
        rotation: body into map axes, shape (3, 3).
        side: +1 looking right, -1 left.
        positions: result, m, shape (3, n).
        seen: result, shape (3, n).
    """
    xs, ys, zs = positions[0], positions[1], positions[2]
    for i in range(east.size):
        square = (east[i] * east[i] + north[i] * north[i]) / squared(EARTH_RADIUS)
        if square <= squared(SMALL_ANGLE):
            sinc = 1 - square / 6 * (1 - square / 20 * (1 - square / 42))
            fall = square / 2 * (1 - square / 12 * (1 - square / 30 * (1 - square / 56)))  # 1 - cos
        else:
            angle = math.sqrt(square)
            sinc = math.sin(angle) / angle
            fall = 2 * squared(math.sin(angle / 2))
        scale = (1 + height[i] / EARTH_RADIUS) * sinc
        xs[i], ys[i], zs[i] = scale * east[i], scale * north[i], height[i] * (1 - fall) - EARTH_RADIUS * fall
    distance, elevation, squint = seen[0], seen[1], seen[2]
    for i in range(east.size):  # a loop of its own, which is vectorised
        x, y, z = xs[i] - antenna[0], ys[i] - antenna[1], zs[i] - antenna[2]
        way = x * rotation[0, 0] + y * rotation[1, 0] + z * rotation[2, 0]
        x, y, z = x - way * glide[0], y - way * glide[1], z - way * glide[2]
        ahead = x * rotation[0, 0] + y * rotation[1, 0] + z * rotation[2, 0]
        left = x * rotation[0, 1] + y * rotation[1, 1] + z * rotation[2, 1]
        up = x * rotation[0, 2] + y * rotation[1, 2] + z * rotation[2, 2]
        across = left * left + up * up
        distance[i] = math.sqrt(ahead * ahead + across)
        elevation[i] = angle_of(-side * left, -up)
        squint[i] = angle_of(ahead, math.sqrt(across))


@inlined
def angle_of(y: float, x: float) -> float:
    """Angle of the point (x, y), atan2(y, x), within 3e-16; without branches, so that loops are vectorised.

    It is taken off 0, 45 or 90 degrees, whichever lies within 22.5 of it; NaN at x = y = 0.
    """
    a, b = abs(x), abs(y)
    steep, flat = b > 2.414213562373095 * a, b <= 0.41421356237309503 * a
    rise, run = (-a if steep else (b if flat else b - a)), (b if steep else (a if flat else b + a))
    t = rise / run
    q = t * t
    high = 0.07690633498721493 - q * (
        0.06646135792330424 - q * (0.05719186455520228 - q * (0.04436956155129065 - q * 0.02222139626242128))
    )
    series = 0.1111110825562648 - q * (0.09090821352646508 - q * high)
    series = 1 - q * (0.3333333333333126 - q * (0.1999999999947823 - q * (0.1428571423180624 - q * series)))
    angle = t * series + (0.5 * math.pi if steep else (0.0 if flat else 0.25 * math.pi))
    angle = math.pi - angle if x < 0 else angle
    return -angle if y < 0 else angle


@compiled_with_nan
def divide_cuts(pieces: I64, cuts: F64, points: F64, strip_of: I32, node_of: I32) -> None:
    """Divide what lies between two nodes of a cut into equal pieces, and interpolate linearly in their middles.

    Args:
        pieces: number of them, shape (strips, nodes - 1).
        cuts: values on the nodes, shape (values, strips, nodes).
        points: result, strip after strip, shape (values, points).
        strip_of: result, the strip of each point.
        node_of: result, the node before it.
    """
    k = 0
    for strip in range(pieces.shape[0]):
        for node in range(pieces.shape[1]):
            for number in range(pieces[strip, node]):
                fraction = (number + 0.5) / pieces[strip, node]
                for value in range(cuts.shape[0]):
                    start, end = cuts[value, strip, node], cuts[value, strip, node + 1]
                    points[value, k] = start + (end - start) * fraction
                strip_of[k], node_of[k] = strip, node
                k += 1


@compiled_with_nan
def mark_lit(elevation: F64, strip_of: I32, node_of: I32, horizon: F64, lit: Bool) -> None:
    """Mark the points of each strip, ordered outwards, that are seen over all points before them, and over a horizon.

    Args:
        elevation: of the points, rad, shape (points,).
        strip_of: of each point.
        node_of: the node before it.
        horizon: elevation over which a point after that node must be seen, rad, shape (strips, nodes - 1).
        lit: result, shape (points,).
    """
    highest, strip = -math.pi, -1
    for i in range(elevation.size):
        if strip_of[i] != strip:
            highest, strip = -math.pi, strip_of[i]
        highest = max(highest, horizon[strip_of[i], node_of[i]])
        lit[i] = elevation[i] >= highest
        highest = elevation[i] if lit[i] else highest  # NaN is not lit
