"""Body and map axes, mounting and state of the sensor, and the directions of elevation and squint.

Map axes are those of `earth`; body axes are FLU (REP-103). Elevation is the angle from nadir (-z) towards the look
side, squint the angle towards the direction of flight; all angles in rad.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from sal_height.errors import UserError
from sal_height.geometry.accuracy import is_finite_covariance
from sal_height.numeric import F64, ShortRepr


@dataclass(frozen=True, eq=False)
class ApertureState(ShortRepr):
    """State of the sensor in the middle of a synthetic aperture; "body" axes are those of the sensor frame.

    Attributes:
        position: position of the antenna in map, shape (3,), m; after `aperture_at`, one for each point, (..., 3).
        velocity: velocity of the antenna in map axes, shape (3,), m/s.
        rotation: matrix that turns body into map axes, shape (3, 3).
        length: length of the synthetic aperture, m.
        covariance: covariance of position (m^2) and of rotation about x, y, z of map (rad^2), shape (6, 6); zeros:
            unknown.
        sliding: True in stripmap, where the aperture slides along the flight with the columns of the image; `position`
            then belongs to the middle column.
    """

    position: F64
    velocity: F64
    rotation: F64
    length: float
    covariance: F64
    sliding: bool = False

    @cached_property
    def direction(self) -> F64:
        """Unit vector of flight in map axes."""
        return self.velocity / np.linalg.norm(self.velocity)

    @property
    def forward(self) -> F64:
        """Unit vector of the body's x axis in map axes; the beams lie in the plane perpendicular to it."""
        return self.rotation[:, 0]


def shift_along(aperture: ApertureState, sight: F64) -> F64:
    """Displacement of a surface if it is assumed to be one metre farther along the flight, shape (3,).

    Its slant range and its elevation, which is measured about the body's forward axis f, are constant: with the unit
    vectors s to the surface and v of the flight it moves by f - s (s f), over the component of that along v, as in
    `relief.position_jacobian`. In an image that slides, the aperture moves with it.

    Args:
        aperture: aperture of the image.
        sight: unit vector to the surface in map axes, shape (3,).
    """
    if aperture.sliding:
        return aperture.direction
    across = aperture.forward - (sight @ aperture.forward) * sight
    return np.asarray(across / (across @ aperture.direction))


def look_direction(elevation: npt.ArrayLike, squint: npt.ArrayLike, look_side: int) -> F64:
    """Return the unit vector in body axes towards `elevation` and `squint` (rad), shape (..., 3)."""
    elevation, squint = np.broadcast_arrays(elevation, squint)
    level = np.cos(squint)
    return np.stack([np.sin(squint), -look_side * level * np.sin(elevation), -level * np.cos(elevation)], axis=-1)


def angles_of(points: F64, aperture: ApertureState, look_side: int) -> tuple[F64, F64, F64]:
    """Return slant range (m), elevation and squint (rad) of `points` of shape (..., 3) from an aperture."""
    body = (points - aperture.position) @ aperture.rotation
    slant_range = np.linalg.norm(body, axis=-1)
    return slant_range, np.arctan2(-look_side * body[..., 1], -body[..., 2]), np.arcsin(body[..., 0] / slant_range)


def aperture_at(points: F64, aperture: ApertureState) -> ApertureState:
    """Return the aperture from which an image shows `points` of shape (..., 3).

    If `aperture` does not slide, that is `aperture` itself. A sliding one is moved along its velocity until each
    point is abeam of the body (squint 0); the result has one position per point and does not slide.
    """
    if not aperture.sliding:
        return aperture
    seconds = (points - aperture.position) @ aperture.forward / (aperture.velocity @ aperture.forward)
    return replace(aperture, position=aperture.position + seconds[..., None] * aperture.velocity, sliding=False)


def antennas_of(aperture: ApertureState, shape: tuple[int, ...]) -> F64:
    """Positions (m) of an aperture that does not slide, for compiled loops over points of that shape.

    Returns:
        One for all points, shape (1, 3), or one for each, shape (points, 3).
    """
    position = aperture.position
    if position.ndim > 1:
        position = np.broadcast_to(position, (*shape, 3))
    return np.ascontiguousarray(position.reshape(-1, 3), dtype=np.float64)


def squint_on_cone(elevation: npt.ArrayLike, cone: npt.ArrayLike, aperture: ApertureState, look_side: int) -> F64:
    """Return the squint (rad) of the direction at `elevation` (rad) whose component along the flight is `cone`.

    A pixel fixes a target's range and Doppler, that is `cone`, the cosine of the angle to the velocity; its elevation
    is free. The squint solves A sin(squint) + B cos(squint) = cone; with body x along the track it is arcsin(cone).
    """
    forward, left, up = aperture.direction @ aperture.rotation
    b = -look_side * left * np.sin(elevation) - up * np.cos(elevation)
    return np.arcsin(cone / np.hypot(forward, b)) - np.arctan2(b, forward)


FARTHEST_ARM = 1000.0  # m: no platform is larger, and millimetres given as metres are noticed


@dataclass(frozen=True)
class Mounting:
    """Position and direction of the sensor frame in base_link; the same content as sal_height_msgs/Mounting.

    Attributes:
        frame_id: name of the sensor frame; empty: "base_link".
        lever_arm: position of the antenna's phase centre in base_link axes, m.
        rotation: unit quaternion x, y, z, w that turns the axes of the sensor frame into those of base_link.
        lever_arm_covariance: covariance of the lever arm in base_link axes, m^2, 9 numbers, row-major; None: not known;
            zeros: exact.
        rotation_covariance: covariance of the rotation about the axes of base_link, rad^2; likewise.

    Raises:
        UserError: a value that is not finite, a lever arm beyond FARTHEST_ARM, a quaternion whose norm is not 1, or
            numbers that are no covariance.
    """

    frame_id: str = "sensor"
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    lever_arm_covariance: tuple[float, ...] | None = None
    rotation_covariance: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        for name in ("lever_arm_covariance", "rotation_covariance"):
            values = getattr(self, name)
            if values is not None and not _is_covariance(np.asarray(values)):
                raise UserError(
                    f"The {name} of the mounting is {values}; it must be 9 finite numbers of a symmetric matrix "
                    "without negative eigenvalues, row by row, or empty if it is not known."
                )
        if not np.all(np.abs(self.lever_arm) <= FARTHEST_ARM):
            raise UserError(
                f"The lever arm of the mounting is {self.lever_arm} m; each component must be finite and at most "
                f"{FARTHEST_ARM:g} m long."
            )
        if not 0.99 < math.hypot(*self.rotation) < 1.01:
            raise UserError(
                f"The rotation of the mounting is {self.rotation}; it must be a quaternion (x, y, z, w) of norm 1."
            )

    def known_as(self, other: Mounting) -> Mounting:
        """This mounting with the covariances of another one."""
        covariances = {name: getattr(other, name) for name in ("lever_arm_covariance", "rotation_covariance")}
        return replace(self, **covariances)

    @property
    def is_identity(self) -> bool:
        """True if the sensor frame is base_link itself."""
        return not (any(self.lever_arm) or any(self.rotation[:3]))

    @property
    def axes(self) -> Rotation:
        """The rotation from the sensor frame to base_link."""
        return Rotation.from_quat(self.rotation)


def _is_covariance(values: F64) -> bool:
    """True for 9 finite numbers of a symmetric, positive semidefinite matrix, but for rounding."""
    if values.shape != (9,):
        return False
    matrix = values.reshape(3, 3)
    return bool(np.allclose(matrix, matrix.T, rtol=1e-9, atol=0.0)) and is_finite_covariance(matrix)


AT_BASE_LINK = Mounting()  # the sensor frame is base_link: no lever arm, no rotation
