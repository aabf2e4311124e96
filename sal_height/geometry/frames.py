"""Directions, positions and heights: body and map axes, and a spherical earth.

Map axes are ENU (x east, y north, z up) with the origin on a sphere of radius EARTH_RADIUS; heights are above that
sphere. Body axes are FLU (REP-103). Elevation is the angle from nadir (-z) towards the look side, squint the angle
towards the direction of flight; all angles in rad.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

EARTH_RADIUS = 6_371_008.8
"""Mean earth radius (IUGG), m."""


@dataclass(frozen=True)
class ApertureState:
    """State of the platform in the middle of a synthetic aperture.

    Attributes:
        position: of base_link in map, m, shape (3,); of many points' apertures (`aperture_at`), shape (..., 3).
        velocity: in map axes, m/s, shape (3,).
        rotation: matrix that turns body into map axes, shape (3, 3).
        length: of the synthetic aperture, m.
        covariance: of position (m^2) and of rotation about x, y, z of map (rad^2), shape (6, 6); zeros: unknown.
        sliding: True in stripmap: the aperture slides along the flight with the columns of the image, and `position` is
            that of its middle column.
    """

    position: Array
    velocity: Array
    rotation: Array
    length: float
    covariance: Array
    sliding: bool = False

    @property
    def direction(self) -> Array:
        """Unit vector of flight in map axes."""
        return self.velocity / np.linalg.norm(self.velocity)

    @property
    def forward(self) -> Array:
        """Unit vector of the body's x axis in map axes: the beams lie in the plane square to it."""
        return self.rotation[:, 0]


@dataclass(frozen=True)
class Grid:
    """Pixel centres of an image in a plane of the map frame; the same content as sal_height_msgs/ImageGrid.

    Attributes:
        origin: centre of pixel (0, 0), m, shape (3,).
        row_direction: unit vector of growing row (range), shape (3,).
        col_direction: unit vector of growing col (along the flight), shape (3,).
        row_spacing: m.
        col_spacing: m.
        rows: number of rows.
        cols: number of columns.
    """

    origin: Array
    row_direction: Array
    col_direction: Array
    row_spacing: float
    col_spacing: float
    rows: int
    cols: int

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        return self.rows, self.cols

    def points(self, row: npt.ArrayLike, col: npt.ArrayLike) -> Array:
        """Positions (m) of fractional pixel indices, shape (..., 3)."""
        down = np.asarray(row, dtype=np.float64)[..., None] * (self.row_spacing * self.row_direction)
        along = np.asarray(col, dtype=np.float64)[..., None] * (self.col_spacing * self.col_direction)
        return self.origin + down + along

    def distances(self, position: Array) -> Array:
        """Distances (m) of all pixel centres from `position`, shape (rows, cols), without their coordinates.

        The law of cosines in the two indices: 10 times faster, and as exact, as |pixels - position|.
        """
        sight = self.origin - position
        down, along = (
            np.arange(n) * step for n, step in zip(self.shape, (self.row_spacing, self.col_spacing), strict=True)
        )
        by_row = sight @ sight + down * (down + 2 * float(sight @ self.row_direction))
        by_col = along * (along + 2 * float(sight @ self.col_direction))
        square = by_row[:, None] + by_col
        skew = 2 * float(self.row_direction @ self.col_direction)
        if skew:
            square += np.multiply.outer(skew * down, along)
        return np.asarray(np.sqrt(square, out=square))

    def pixels(self) -> Array:
        """Positions (m) of all pixel centres, shape (rows, cols, 3)."""
        return self.points(np.arange(self.rows)[:, None], np.arange(self.cols)[None, :])


def look_direction(elevation: npt.ArrayLike, squint: npt.ArrayLike, look_side: int) -> Array:
    """Unit vector in body axes towards `elevation` and `squint` (rad), shape (..., 3)."""
    elevation, squint = np.broadcast_arrays(elevation, squint)
    return np.stack(
        [
            np.sin(squint),
            -look_side * np.cos(squint) * np.sin(elevation),
            -np.cos(squint) * np.cos(elevation),
        ],
        axis=-1,
    )


def angles_of(points: Array, aperture: ApertureState, look_side: int) -> tuple[Array, Array, Array]:
    """Slant range (m), elevation and squint (rad) under which an aperture sees `points` of shape (..., 3)."""
    body = (points - aperture.position) @ aperture.rotation
    slant_range = np.linalg.norm(body, axis=-1)
    return slant_range, np.arctan2(-look_side * body[..., 1], -body[..., 2]), np.arcsin(body[..., 0] / slant_range)


def aperture_at(points: Array, aperture: ApertureState) -> ApertureState:
    """The aperture from which an image shows `points` of shape (..., 3).

    That is `aperture`; a sliding one has come, at its velocity, to where each point is abeam of the body (squint 0):
    its position has the shape of the points, and it slides no more.
    """
    if not aperture.sliding:
        return aperture
    seconds = (points - aperture.position) @ aperture.forward / (aperture.velocity @ aperture.forward)
    return replace(aperture, position=aperture.position + seconds[..., None] * aperture.velocity, sliding=False)


def squint_on_cone(elevation: npt.ArrayLike, cone: npt.ArrayLike, aperture: ApertureState, look_side: int) -> Array:
    """Squint (rad) of the direction at `elevation` (rad) whose component along the flight is `cone`.

    A pixel fixes a target's range and Doppler, that is `cone`, the cosine of the angle to the velocity; elevation is
    free. Solves A sin(squint) + B cos(squint) = cone, which with attitude equal to track is arcsin(cone).
    """
    forward, left, up = aperture.direction @ aperture.rotation
    b = -look_side * left * np.sin(elevation) - up * np.cos(elevation)
    return np.asarray(np.arcsin(cone / np.hypot(forward, b)) - np.arctan2(b, forward))


def sphere_point(east: npt.ArrayLike, north: npt.ArrayLike, height: npt.ArrayLike) -> Array:
    """Map position (m) of a point at arc distances `east`, `north` (m) along the sphere and `height` (m) above it.

    Azimuthal equidistant: the great circle from the map's origin leaves in the direction (east, north).
    Shape (..., 3).
    """
    east, north, height = np.broadcast_arrays(east, north, height)
    angle = np.hypot(east, north) / EARTH_RADIUS
    scale = (1 + height / EARTH_RADIUS) * np.sinc(angle / np.pi)
    up = height * np.cos(angle) - 2 * EARTH_RADIUS * np.sin(angle / 2) ** 2
    return np.stack([scale * east, scale * north, up], axis=-1)


def sphere_coordinates(points: Array) -> tuple[Array, Array, Array]:
    """Arc distances east and north (m) and height (m) of map positions of shape (..., 3): undoes `sphere_point`."""
    x, y, z = np.moveaxis(np.asarray(points, dtype=np.float64), -1, 0)
    level = np.hypot(x, y)
    angle = np.arctan2(level, z + EARTH_RADIUS)
    scale = np.where(level > 0, EARTH_RADIUS * angle / np.where(level > 0, level, 1), 1.0)
    return scale * x, scale * y, height_of(points)


def height_of(points: Array) -> Array:
    """Height (m) above the sphere of map positions of shape (..., 3), without cancellation.

    sqrt(x^2 + y^2 + (z + R)^2) - R, with the difference of the two large numbers taken analytically.
    """
    x, y, z = np.moveaxis(np.asarray(points, dtype=np.float64), -1, 0)
    radius = np.sqrt(x**2 + y**2 + (z + EARTH_RADIUS) ** 2)
    return np.asarray((x**2 + y**2 + z**2 + 2 * EARTH_RADIUS * z) / (radius + EARTH_RADIUS))


def above_place(x: npt.ArrayLike, y: npt.ArrayLike, height: npt.ArrayLike) -> Array:
    """Map position (m) of the point at the map coordinates `x`, `y` (m) that is `height` (m) above the sphere.

    z = sqrt((R + h)^2 - x^2 - y^2) - R, without cancellation; shape (..., 3). NaN beyond the sphere's horizon.
    """
    x, y, height = (np.asarray(value, dtype=np.float64) for value in np.broadcast_arrays(x, y, height))
    growth = height * (2 * EARTH_RADIUS + height) - x**2 - y**2
    with np.errstate(invalid="ignore"):
        return np.stack([x, y, growth / (np.sqrt(EARTH_RADIUS**2 + growth) + EARTH_RADIUS)], axis=-1)


def locate(
    elevation: npt.ArrayLike, slant_range: npt.ArrayLike, along: npt.ArrayLike, aperture: ApertureState, look_side: int
) -> Array:
    """Map position (m) of the target at `elevation` (rad) on the circle that a pixel's range and Doppler leave.

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
) -> Array:
    """Map position (m) of the target at `height` (m) above the sphere on the circle that range and Doppler leave.

    The sight s has the length `slant_range`, `along` as its component along the flight and, with the platform at e
    from the earth's centre, |e + s| = EARTH_RADIUS + height. That fixes its component along what of e is square to the
    flight; of the two points left, one lies on the look side of the vertical plane through the flight.

    Arguments and result are those of `locate`, with the height in place of the elevation; NaN where the circle has no
    such point.
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
