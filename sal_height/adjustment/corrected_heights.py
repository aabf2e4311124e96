"""A height image without the estimated error of its dwell, with the residual error in its covariance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from sal_height.adjustment.observed import PLACE, TURN, ObservedDwell, pose_jacobian
from sal_height.adjustment.window import PoseError
from sal_height.geometry import ApertureState, height_of
from sal_height.numeric import F64
from sal_height.relief import HeightField, Surface, height_variance, pose_covariance


def corrected_heights(field: HeightField, dwell: ObservedDwell, off: PoseError) -> HeightField:
    """The surfaces of a dwell at corrected positions, with the covariance of the residual error.

    Args:
        field: heights as published.
        dwell: geometry that they were made with.
        off: error of its pose.
    """
    surfaces = tuple(_corrected(surface, dwell, off) for surface in field.surfaces)
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


def _corrected(surface: Surface, dwell: ObservedDwell, off: PoseError) -> Surface:
    jacobian = pose_jacobian(surface.positions, dwell)
    positions = surface.positions - jacobian @ off.error
    common = jacobian @ off.covariance @ np.swapaxes(jacobian, -1, -2) + _beyond_pose(surface, dwell.aperture)
    variance = height_variance(surface.own_covariance + common, positions)
    return replace(
        surface,
        positions=positions,
        height=height_of(positions),
        sigma=np.sqrt(variance),
        common_covariance=common,
    )


def _beyond_pose(surface: Surface, aperture: ApertureState) -> F64:
    """The part of the common covariance that is due to the beams rather than to the pose, m^2."""
    common, by_pose = surface.common_covariance, pose_covariance(surface.positions, aperture)
    if common is None:
        return np.zeros_like(surface.own_covariance)
    if by_pose is None:
        return common
    beyond = common - by_pose
    size = np.trace(common, axis1=-2, axis2=-1)[..., None, None]
    # Less than this fraction is rounding of single precision.
    return np.where(np.abs(beyond).max(axis=(-2, -1), keepdims=True) > 1e-5 * size, beyond, 0.0)
