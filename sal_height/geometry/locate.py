"""Position of a target from its range, its Doppler and either its elevation or its height."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sal_height.geometry import _kernels as kernels
from sal_height.geometry.earth import EARTH_RADIUS
from sal_height.geometry.frames import ApertureState, antennas_of
from sal_height.numeric import F64, in_parallel

LEAST_POINTS = 2**14
"""Points that are worth a thread."""


def locate_at_elevation(
    elevation: npt.ArrayLike, slant_range: npt.ArrayLike, along: npt.ArrayLike, aperture: ApertureState, look_side: int
) -> F64:
    """Return the map position (m) of the target at `elevation` (rad) with a pixel's range and Doppler.

    Args:
        elevation: in body axes, rad.
        slant_range: distance from the middle of the aperture, m.
        along: component of that distance along the flight, m.
        aperture: state of the platform, not sliding (`aperture_at`).
        look_side: +1 right, -1 left.

    Returns:
        Positions of the broadcast shape (..., 3); NaN where no such direction exists.
    """
    shape, numbers = _pixels(elevation, slant_range, along, aperture)
    antennas, places = antennas_of(aperture, shape), np.empty((*shape, 3))
    velocity, rotation = np.ascontiguousarray(aperture.velocity), np.ascontiguousarray(aperture.rotation)
    found = places.reshape(-1, 3)

    def fill(part: slice) -> None:
        of_part = antennas[part] if len(antennas) > 1 else antennas
        angles, ranges, ahead = numbers[:, part]
        kernels.place_at_elevations(angles, ranges, ahead, of_part, velocity, rotation, look_side, found[part])

    in_parallel(fill, len(found), LEAST_POINTS)
    return places


def locate_at_height(
    height: npt.ArrayLike, slant_range: npt.ArrayLike, along: npt.ArrayLike, aperture: ApertureState, look_side: int
) -> F64:
    """Return the map position (m) of the target at `height` (m) above the sphere with a pixel's range and Doppler.

    The line of sight s has the length `slant_range` and the component `along` in the direction of flight. With the
    platform at e from the earth's centre, |e + s| = EARTH_RADIUS + height fixes a second component, along the part of e
    perpendicular to the flight. Of the two points that remain, one lies on the look side.

    Arguments and result are those of `locate_at_elevation`, with the height in place of the elevation; NaN where no
    point has that range, Doppler and height.
    """
    shape, numbers = _pixels(height, slant_range, along, aperture)
    antennas, places = antennas_of(aperture, shape), np.empty((*shape, 3))
    velocity, found = np.ascontiguousarray(aperture.velocity), places.reshape(-1, 3)

    def fill(part: slice) -> None:
        of_part = antennas[part] if len(antennas) > 1 else antennas
        heights, ranges, ahead = numbers[:, part]
        kernels.place_at_heights(heights, ranges, ahead, of_part, velocity, look_side, EARTH_RADIUS, found[part])

    in_parallel(fill, len(found), LEAST_POINTS)
    return places


def _pixels(
    first: npt.ArrayLike, second: npt.ArrayLike, third: npt.ArrayLike, aperture: ApertureState
) -> tuple[tuple[int, ...], F64]:
    """The shape to which numbers of pixels and the aperture's positions broadcast, and the numbers, shape (3, n)."""
    arrays = np.asarray(first), np.asarray(second), np.asarray(third)
    shape = np.broadcast_shapes(*(array.shape for array in arrays), aperture.position.shape[:-1])
    numbers = np.empty((3, *shape))
    for number, array in enumerate(arrays):
        numbers[number] = array
    return shape, numbers.reshape(3, -1)
