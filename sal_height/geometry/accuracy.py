"""Accuracy of odometry: what its covariances state, and what is assumed where they state nothing.

A covariance has blocks: position and attitude of the pose, and the velocity. A block is unknown if it is no covariance
(a negative variance, NaN), if a variance is zero, which by the conventions of ROS means unknown, or if all axes have
one and the same number that drivers write in place of a measurement, such as 1e-9 or 99999.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np

from sal_height.numeric import F64

NOT_STATED = -1.0
"""Stands for a standard deviation that nobody states."""


@dataclass(frozen=True)
class OdometryAccuracy:
    """Standard deviations of odometry in blocks whose covariances are unknown; 0: exact, NOT_STATED: not known.

    Attributes:
        position_m: of each component of the position, m.
        velocity_mps: of each component of the velocity, m/s.
        attitude_rad: of roll and pitch, rad.
        heading_rad: of the heading, rad.
    """

    position_m: float = NOT_STATED
    velocity_mps: float = NOT_STATED
    attitude_rad: float = NOT_STATED
    heading_rad: float = NOT_STATED

    @property
    def stated(self) -> F64:
        """Standard deviations about all AXES that are stated; 0: exact, or not known."""
        return np.maximum(self._of_axes, 0.0)

    @property
    def assumed(self) -> F64:
        """Standard deviations about all AXES that are assumed because nobody states them; 0: stated."""
        return np.where(self._of_axes < 0, ASSUMED._of_axes, 0.0)

    @property
    def with_assumed(self) -> OdometryAccuracy:
        """The accuracy that counts what is assumed as stated."""
        pairs = zip(astuple(self), astuple(ASSUMED), strict=True)
        return OdometryAccuracy(*(assumed if stated < 0 else stated for stated, assumed in pairs))

    @property
    def _of_axes(self) -> F64:
        turns = self.attitude_rad, self.attitude_rad, self.heading_rad
        return np.array([*[self.position_m] * 3, *turns, *[self.velocity_mps] * 3], np.float64)


AXES = 9
"""Number of axes: x, y, z of the position and of the attitude in map, and of the velocity."""

ASSUMED = OdometryAccuracy(position_m=2.0, velocity_mps=0.05, attitude_rad=2e-3, heading_rad=1e-2)
"""Accuracy of a navigation by satellites without corrections and a small inertial sensor."""

EXACT = OdometryAccuracy(0.0, 0.0, 0.0, 0.0)
"""Accuracy of odometry whose covariances of zeros say that it is exact, as of a simulated flight."""


@dataclass(frozen=True)
class _Block:
    """A block of three axes.

    Attributes:
        least: standard deviation below which one that all axes have is no measurement.
        huge: standard deviation from which one that all axes have is no measurement.
        greatest: standard deviation of an unknown pose or velocity.
    """

    least: float
    huge: float
    greatest: float


POSITION, ATTITUDE, VELOCITY = _Block(1e-3, 100.0, 1e5), _Block(2e-6, 1.0, np.pi), _Block(1e-4, 100.0, 1e3)


def is_finite_covariance(matrix: F64) -> bool:
    """True if a matrix is finite and has no negative variance in any direction, except for rounding."""
    if not np.all(np.isfinite(matrix)):
        return False
    return bool(np.linalg.eigvalsh(matrix / 2 + matrix.T / 2)[0] >= -1e-5 * np.abs(matrix).max())


def known_pose(stated: F64) -> F64:
    """Valid part of the covariance that is stated of a pose, shape (6, 6), with standard deviations that are possible.

    Blocks that are no covariance, or huge placeholders, become zeros.
    """
    return _known(stated, (POSITION, ATTITUDE))


def known_velocity(stated: F64) -> F64:
    """Valid part of the covariance that is stated of a velocity, shape (3, 3); as `known_pose`."""
    return _known(stated, (VELOCITY,))


def position_variances(stated: F64) -> F64:
    """Variances of each of N positions, m^2, shape (N, 3); 0 where they are not finite, or huge placeholders.

    Args:
        stated: covariances of the positions, shape (N, 3, 3).
    """
    variances = stated.diagonal(axis1=1, axis2=2)
    is_huge = np.all(variances == variances[:, :1], axis=1) & (variances[:, 0] >= POSITION.huge**2)
    is_known = np.isfinite(variances).all(axis=1) & ~is_huge
    return np.where(is_known[:, None], np.maximum(variances, 0.0), 0.0)


def shortfall(pose: F64, velocity: F64, sigmas: F64) -> F64:
    """Variances by which the unknown blocks of covariances are less than they ought to be, shape (AXES,).

    Args:
        pose: covariance that is stated of the pose, shape (6, 6).
        velocity: covariance that is stated of the velocity, shape (3, 3).
        sigmas: standard deviations of unknown blocks about all axes, shape (AXES,).
    """
    parts = pose[:3, :3], pose[3:, 3:], velocity
    unknown = np.repeat([_is_unknown(*one) for one in zip(parts, (POSITION, ATTITUDE, VELOCITY), strict=True)], 3)
    known = np.concatenate([known_pose(pose).diagonal(), known_velocity(velocity).diagonal()])
    return np.where(unknown, np.maximum(sigmas**2 - known, 0.0), 0.0)


def is_unknown_position(covariance: F64) -> bool:
    """True if the covariance of a position, shape (3, 3), states nothing."""
    return _is_unknown(covariance, POSITION)


def _is_unknown(part: F64, block: _Block) -> bool:
    """True if a block of shape (3, 3) states nothing."""
    variances = part.diagonal()
    if not (is_finite_covariance(part) and np.all(variances > 0)):
        return True
    return _is_huge(part, block) or (_is_one_number(variances) and bool(variances[0] < block.least**2))


def _is_huge(part: F64, block: _Block) -> bool:
    """True if all axes of a block have one and the same huge variance."""
    variances = part.diagonal()
    return _is_one_number(variances) and bool(variances[0] >= block.huge**2)


def _is_one_number(variances: F64) -> bool:
    return bool(np.all(variances == variances[0]))


def _known(stated: F64, blocks: Sequence[_Block]) -> F64:
    known = stated
    places = [(slice(3 * number, 3 * number + 3), block) for number, block in enumerate(blocks)]
    if not is_finite_covariance(stated) or any(_is_huge(stated[place, place], block) for place, block in places):
        known = np.zeros_like(stated)
        for place, block in places:
            part = stated[place, place]
            if is_finite_covariance(part) and not _is_huge(part, block):
                known[place, place] = part
    greatest = np.repeat([block.greatest for block in blocks], 3)
    sigmas = np.sqrt(np.maximum(known.diagonal(), 0.0))
    if np.all(sigmas <= greatest):
        return known
    scale = greatest / np.maximum(sigmas, greatest)
    return np.asarray(scale[:, None] * known * scale)
