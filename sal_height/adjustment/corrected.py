"""The trajectory and the heights without the estimated errors, with the covariance of the residual errors.

Estimated errors of the mounting are part of it: with the mounting as described, the corrected trajectory gives the true
position of the antenna and the true direction of its beams.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation

from sal_height.adjustment.adjustment import Adjustment
from sal_height.adjustment.adjustment_settings import AdjustmentSettings
from sal_height.adjustment.drift import STATE
from sal_height.adjustment.equations import Form
from sal_height.adjustment.observed import (
    BORESIGHT,
    COMMON,
    DELAY,
    LEVER_ARM,
    PLACE,
    STRETCH,
    TURN,
    ObservedDwell,
    pose_jacobian,
)
from sal_height.adjustment.window import PoseError
from sal_height.geometry import ApertureState, Mounting, PlatformState, height_of
from sal_height.numeric import F64
from sal_height.relief import HeightField, Surface, height_variance, pose_covariance

MOTION = slice(6, 9)
"""Errors of the velocity of base_link among the numbers of `_errors`, after PLACE and TURN, those of its pose."""


def corrected_mounting(mounting: Mounting, adjustment: Adjustment) -> Mounting:
    """The mounting without the estimated errors."""
    common, _ = adjustment.common
    arm = np.array(mounting.lever_arm) - common[LEVER_ARM]
    x, y, z, w = (mounting.axes * Rotation.from_rotvec(-common[BORESIGHT])).as_quat().tolist()
    return replace(mounting, lever_arm=tuple(arm.tolist()), rotation=(x, y, z, w))


def mounting_covariance(mounting: Mounting, adjustment: Adjustment) -> F64:
    """Covariance of residual errors of the lever arm (m^2) and of the rotation (rad^2), axes of base_link.

    Args:
        mounting: mounting of the sensor, as described.
        adjustment: adjustment of its dwells.

    Returns:
        Shape (6, 6).
    """
    _, covariance = adjustment.common
    turned = np.zeros((6, COMMON))
    turned[:3, LEVER_ARM], turned[3:, BORESIGHT] = np.eye(3), mounting.axes.as_matrix()
    return turned @ covariance @ turned.T


def corrected_states(
    states: Sequence[PlatformState],
    seconds: Sequence[float],
    adjustment: Adjustment,
    mounting: Mounting,
    settings: AdjustmentSettings,
) -> list[PlatformState]:
    """Odometry without the estimated errors.

    Args:
        states: samples, in any order.
        seconds: times of the samples, from the epoch of the dwells, s.
        adjustment: adjustment of these dwells.
        mounting: mounting of the sensor, as described.
        settings: settings of the adjustment; the jitter of single dwells becomes part of the covariance.
    """
    times, common = np.asarray(seconds), adjustment.solution.of(adjustment.layout.common)
    drift = adjustment.layout.drift
    knots = np.array([knot.seconds for knot in drift.knots])
    motion, turns = _interpolated(knots, adjustment.knots, times)
    found = []
    covariances = _covariances(states, times, adjustment, mounting)
    for state, place, velocity, turn, covariance in zip(states, *motion, turns, covariances, strict=True):
        own = np.concatenate([place, velocity, turn, common])
        errors = _errors(state, mounting) @ own
        attitude = Rotation.from_quat(state.orientation)
        new = Rotation.from_rotvec(-errors[TURN]) * attitude
        arm = np.array(mounting.lever_arm)
        antenna = state.position + attitude.apply(arm) - errors[PLACE] - np.cross(errors[TURN], attitude.apply(arm))
        pose, spread = state.covariance, state.velocity_covariance
        if covariance is not None:
            pose = covariance[:6, :6] + settings.jitter_rad**2 * np.diag([0, 0, 0, 1, 1, 1])
            spread = new.as_matrix().T @ covariance[MOTION, MOTION] @ new.as_matrix()
        found.append(
            replace(
                state,
                position=antenna - new.apply(arm),
                orientation=new.as_quat(),
                velocity=state.velocity - errors[MOTION],
                covariance=pose,
                velocity_covariance=spread,
            )
        )
    return found


def _interpolated(knots: F64, errors: F64, times: F64) -> tuple[tuple[F64, F64], F64]:
    """Interpolates errors of position and velocity, and of attitude, between the knots; beyond them they continue."""
    turns = np.stack([np.interp(times, knots, errors[:, axis]) for axis in range(6, STATE)], axis=-1)
    inside = np.clip(times, knots[0], knots[-1])
    if len(knots) > 1:
        spline = CubicHermiteSpline(knots, errors[:, :3], errors[:, 3:6])
        place, velocity = spline(inside), spline(inside, 1)
    else:
        place, velocity = (np.broadcast_to(errors[0, part], (len(times), 3)) for part in (slice(0, 3), slice(3, 6)))
    return (np.asarray(place + (times - inside)[:, None] * velocity), np.asarray(velocity)), turns


def _errors(state: PlatformState, mounting: Mounting) -> F64:
    """Errors of position, attitude and velocity of base_link by those of a knot and the common ones.

    Errors of the mounting count as if they were the platform's: with the arm a and the rotation b of the sensor, in
    map, p + A l - V d - b x a, e + b and v.
    """
    body = Rotation.from_quat(state.orientation)
    sensor, arm = (body * mounting.axes).as_matrix(), body.apply(mounting.lever_arm)
    matrix = np.zeros((9, STATE + COMMON))
    shared = matrix[:, STATE:]
    matrix[PLACE, :3], matrix[TURN, 6:9], matrix[MOTION, 3:6] = np.eye(3), np.eye(3), np.eye(3)
    shared[PLACE, LEVER_ARM], shared[PLACE, DELAY] = body.as_matrix(), -state.velocity
    shared[TURN, BORESIGHT] = sensor
    shared[PLACE, BORESIGHT] = -np.cross(sensor.T, arm).T
    return matrix


def _covariances(
    states: Sequence[PlatformState], times: F64, adjustment: Adjustment, mounting: Mounting
) -> list[F64 | None]:
    """Covariance of the numbers of `_errors` of each state near a knot; None: no knot is near."""
    drift = adjustment.layout.drift
    near = [drift.nearest_knot(time) for time in times.tolist()]
    known = 0.01 * drift.correlation  # so far from a knot its covariance is valid
    covered = [abs(time - knot.seconds) <= known for knot, time in zip(near, times.tolist(), strict=True)]
    first = {knot: number for number, knot in reversed(list(enumerate(near))) if covered[number]}
    if not first:
        return [None] * len(near)
    forms = []
    for number in first.values():
        columns = np.concatenate([near[number].columns, adjustment.layout.common])
        forms.append(Form(columns, _errors(states[number], mounting), np.zeros(9)))
    of_knot = dict(zip(first, adjustment.solution.covariance(forms), strict=True))
    return [of_knot[knot] if there else None for knot, there in zip(near, covered, strict=True)]


def corrected_heights(
    field: HeightField, dwell: ObservedDwell, off: PoseError, pitch_sigma: float = 0.0
) -> HeightField:
    """The surfaces of a dwell at corrected positions, with the covariance of the residual error.

    Args:
        field: heights as published.
        dwell: geometry that they were made with.
        off: error of its pose.
        pitch_sigma: relative standard deviation of the angles between the beams that the covariances of these heights
            contain; that in the error of the pose replaces it.
    """
    surfaces = tuple(_corrected(surface, dwell, off, pitch_sigma) for surface in field.surfaces)
    grid = replace(field.grid, origin=field.grid.origin - off.error[PLACE])
    return replace(field, grid=grid, surfaces=surfaces)


def corrected_aperture(dwell: ObservedDwell, off: PoseError) -> ApertureState:
    """The aperture from which a dwell was seen, with the covariance of its pose."""
    aperture = dwell.aperture
    pose = np.r_[PLACE, TURN]
    return replace(
        aperture,
        position=aperture.position - off.error[PLACE],
        rotation=Rotation.from_rotvec(-off.error[TURN]).as_matrix() @ aperture.rotation,
        covariance=off.covariance[np.ix_(pose, pose)],
    )


def _corrected(surface: Surface, dwell: ObservedDwell, off: PoseError, pitch_sigma: float) -> Surface:
    jacobian = pose_jacobian(surface.positions, dwell)
    positions = surface.positions - jacobian @ off.error
    beyond = _beyond_pose(surface, dwell.aperture, pitch_sigma * jacobian[..., STRETCH] if pitch_sigma else None)
    common = jacobian @ off.covariance @ np.swapaxes(jacobian, -1, -2) + beyond
    variance = height_variance(surface.own_covariance + common, positions)
    return replace(
        surface,
        positions=positions,
        height=height_of(positions),
        sigma=np.sqrt(variance),
        common_covariance=common,
    )


def _beyond_pose(surface: Surface, aperture: ApertureState, by_pitch: F64 | None) -> F64:
    """The part of the common covariance beyond those by the pose and by the angles between the beams, m^2.

    Args:
        surface: surface as published.
        aperture: aperture that it was published with.
        by_pitch: displacement by one standard deviation of these angles, m, shape (..., 3); None: they were exact.
    """
    common, by_pose = surface.common_covariance, pose_covariance(surface.positions, aperture)
    if common is None:
        return np.zeros_like(surface.own_covariance)
    if by_pose is None and by_pitch is None:
        return common
    beyond = common if by_pose is None else common - by_pose
    if by_pitch is not None:
        beyond = beyond - by_pitch[..., :, None] * by_pitch[..., None, :]
    size = np.trace(common, axis1=-2, axis2=-1)[..., None, None]
    # Less than this fraction is rounding of single precision.
    return np.where(np.abs(beyond).max(axis=(-2, -1), keepdims=True) > 1e-5 * size, beyond, 0.0)
