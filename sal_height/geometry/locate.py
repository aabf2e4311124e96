"""Position of a target from its range, its Doppler and either its elevation or its height."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from sal_height.geometry import _kernels as kernels
from sal_height.geometry.earth import EARTH_RADIUS
from sal_height.geometry.frames import ApertureState, antennas_of
from sal_height.numeric import F64, in_parallel


def locate_at_elevation(
    elevation: npt.ArrayLike, slant_range: npt.ArrayLike, along: npt.ArrayLike, aperture: ApertureState, look_side: int
) -> F64:
    """Return the map position (m) of the target at `elevation` (rad) with a pixel's range and Doppler.

    Args:
        elevation: elevation in body axes, rad.
        slant_range: distance from the middle of the aperture, m.
        along: component of that distance along the flight, m.
        aperture: state of the platform, not sliding (`aperture_at`).
        look_side: +1 right, -1 left.

    Returns:
        Positions of the broadcast shape (..., 3); NaN where no such direction exists.
    """
    velocity, rotation = np.ascontiguousarray(aperture.velocity), np.ascontiguousarray(aperture.rotation)

    def fill(numbers: F64, antennas: F64, positions: F64) -> None:
        angles, ranges, ahead = numbers
        kernels.locate_at_elevations(angles, ranges, ahead, antennas, velocity, rotation, look_side, positions)

    return _located(fill, (elevation, slant_range, along), aperture)


def locate_at_height(
    height: npt.ArrayLike, slant_range: npt.ArrayLike, along: npt.ArrayLike, aperture: ApertureState, look_side: int
) -> F64:
    """Return the map position (m) of the target at `height` (m) above the sphere with a pixel's range and Doppler.

    The line of sight s has the length `slant_range` and the component `along` in the direction of flight. With the
    platform at e from the earth's centre, |e + s| = EARTH_RADIUS + height fixes a second component, along the part of e
    perpendicular to the flight. Of the two points that remain, one lies on the look side.

    Arguments and result are those of `locate_at_elevation`, with the height instead of the elevation; NaN where no
    point has that range, Doppler and height.
    """
    velocity = np.ascontiguousarray(aperture.velocity)

    def fill(numbers: F64, antennas: F64, positions: F64) -> None:
        heights, ranges, ahead = numbers
        kernels.locate_at_heights(heights, ranges, ahead, antennas, velocity, look_side, EARTH_RADIUS, positions)

    return _located(fill, (height, slant_range, along), aperture)


def _located(
    fill: Callable[[F64, F64, F64], None],
    each: tuple[npt.ArrayLike, npt.ArrayLike, npt.ArrayLike],
    aperture: ApertureState,
) -> F64:
    """Positions of pixels, of the shape (..., 3) to which their numbers and the aperture's positions broadcast.

    Args:
        fill: function that fills the positions (n, 3) of pixels from their numbers (3, n) and `antennas_of`.
        each: three numbers of each pixel.
        aperture: aperture of the image.
    """
    arrays = [np.asarray(numbers) for numbers in each]
    shape = np.broadcast_shapes(*(array.shape for array in arrays), aperture.position.shape[:-1])
    numbers, positions, antennas = np.empty((3, *shape)), np.empty((*shape, 3)), antennas_of(aperture, shape)
    for number, array in enumerate(arrays):
        numbers[number] = array
    rows, found = numbers.reshape(3, -1), positions.reshape(-1, 3)

    def fill_part(part: slice) -> None:
        fill(rows[:, part], antennas[part] if len(antennas) > 1 else antennas, found[part])

    in_parallel(fill_part, len(found), 2**14)  # points for which another thread pays
    return positions
