"""Position of a target from its range, its Doppler and either its elevation or its height."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sal_height.geometry.earth import EARTH_RADIUS, height_of
from sal_height.geometry.frames import ApertureState, look_direction, squint_on_cone
from sal_height.numeric import F64


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
    squint = squint_on_cone(elevation, np.asarray(along) / slant_range, aperture, look_side)
    direction = look_direction(elevation, squint, look_side) @ aperture.rotation.T
    return aperture.position + np.asarray(slant_range)[..., None] * direction


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
    height, slant_range, along = (np.asarray(value, dtype=np.float64) for value in (height, slant_range, along))
    platform = height_of(aperture.position)
    centre = aperture.position + np.array([0.0, 0.0, EARTH_RADIUS])
    ahead = centre @ aperture.direction
    upright = centre - ahead[..., None] * aperture.direction
    distance = np.linalg.norm(upright, axis=-1)
    upward = upright / distance[..., None]
    aside = look_side * np.cross(aperture.direction, upward)
    # (e + s)^2 - e^2 = 2 e s + s^2, with the difference of the squares taken analytically.
    growth = (height - platform) * (2 * EARTH_RADIUS + height + platform)
    up = ((growth - slant_range**2) / 2 - along * ahead) / distance
    with np.errstate(invalid="ignore"):
        across = np.sqrt(slant_range**2 - along**2 - up**2)
    parts = (along, aperture.direction), (up, upward), (across, aside)
    return aperture.position + sum(np.asarray(length)[..., None] * axis for length, axis in parts)
