"""Heights without the error of their dwell lie where those of an exact flight do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_observed import ERRORS, LAYOUT, imaged, observed

from sal_height.adjustment import PoseError, corrected_aperture, corrected_heights
from sal_height.adjustment.observed import POSE, STRETCH, pose, pose_jacobian
from sal_height.geometry import height_of, sphere_coordinates
from sal_height.numeric import F64
from sal_height.relief import pose_covariance

EXACT = 1e-12 * np.eye(POSE)


def pose_error(name: str) -> F64:
    """The POSE numbers of an error of the eastward dwell."""
    slc, field, sensor = imaged(0, ERRORS[name])
    form = pose(0, observed(0, slc, field), LAYOUT, sensor.mounting)
    values = np.zeros(form.values.shape[1])
    for number, size in ERRORS[name].unknowns:
        values[number] = size
    return form.values @ values + form.constant


@pytest.mark.parametrize("name", ["position y", "attitude x", "boresight x", "lever arm z", "delay"])
def test_surfaces_come_back(name: str) -> None:
    """To 4 mm, of 14 cm to 30 cm; and so does the aperture."""
    slc, exact, _ = imaged(0, None)
    wrong_slc, wrong, _ = imaged(0, ERRORS[name])
    dwell, off = observed(0, wrong_slc, wrong), PoseError(pose_error(name), EXACT)
    better = corrected_heights(wrong, dwell, off)
    before, after = (
        np.linalg.norm(np.nanmedian(field.first.positions - exact.first.positions, axis=(0, 1)))
        for field in (wrong, better)
    )
    assert before > 0.1
    assert after < 0.004 + 0.03 * before
    first = better.first
    np.testing.assert_allclose(first.height, height_of(first.positions), atol=1e-9)
    if name.startswith(("position", "lever", "delay")):  # others turn the beams, to which the grid is laid
        np.testing.assert_allclose(better.grid.origin, exact.grid.origin, atol=1e-3)
    aperture = corrected_aperture(dwell, off)
    np.testing.assert_allclose(aperture.position, slc.aperture.position, atol=1e-3)
    np.testing.assert_allclose(aperture.rotation, slc.aperture.rotation, atol=1e-7)


def test_a_stretch_of_the_beams_is_taken_out_about_their_middle() -> None:
    slc, field, _ = imaged(0, None)
    dwell = observed(0, slc, field)
    error = np.zeros(POSE)
    error[STRETCH] = 0.02
    moved = corrected_heights(field, dwell, PoseError(error, EXACT)).first.positions - field.first.positions
    expected = -0.02 * pose_jacobian(field.first.positions, dwell)[..., STRETCH]
    np.testing.assert_allclose(moved, expected, atol=1e-6)
    assert np.nanmin(moved[..., 2]) < -0.005 < 0.005 < np.nanmax(moved[..., 2])


def test_what_is_left_is_in_the_common_covariance_and_in_sigma() -> None:
    """As `pose_covariance` has it of the corrected aperture; the part of the beams stays, rounding does not."""
    slc, field, _ = imaged(0, None)
    dwell = observed(0, slc, field)
    root = np.diag([0.1, 0.2, 0.05, 2e-5, 1e-5, 3e-5, 0.0])
    off = PoseError(np.zeros(POSE), root @ root)
    better = corrected_heights(field, dwell, off).first
    aperture = corrected_aperture(dwell, off)
    expected = pose_covariance(better.positions, aperture)
    assert expected is not None
    np.testing.assert_allclose(better.common_covariance, expected, rtol=1e-6, atol=1e-9)
    up = np.moveaxis(np.stack(sphere_coordinates(better.positions)), 0, -1)[..., 2]
    there = np.isfinite(up)
    variance = (better.own_covariance + expected)[there][:, 2, 2]
    np.testing.assert_allclose(better.sigma[there] ** 2, variance, rtol=1e-3)
    # Half as much again by beams, and as a float32 has it.
    stated = replace(dwell.aperture, covariance=root[:6, :6] ** 2)
    of_pose = pose_covariance(field.first.positions, stated)
    assert of_pose is not None
    for share, rounded in ((1.5, False), (1.0, True)):
        common = share * (of_pose.astype(np.float32) if rounded else of_pose)
        told = replace(field, surfaces=(replace(field.first, common_covariance=common),))
        found = corrected_heights(told, replace(dwell, aperture=stated), PoseError(np.zeros(POSE), 0 * EXACT)).first
        assert found.common_covariance is not None
        np.testing.assert_allclose(found.common_covariance, (share - 1) * of_pose, rtol=1e-6, atol=1e-15)


def test_pixels_without_heights_stay_without() -> None:
    slc, field, _ = imaged(0, None)
    better = corrected_heights(field, observed(0, slc, field), PoseError(np.full(POSE, 1e-5), EXACT))
    np.testing.assert_array_equal(np.isfinite(better.first.height), np.isfinite(field.first.height))
    np.testing.assert_array_equal(better.validity, field.validity)
    np.testing.assert_array_equal(better.first.cnr_db, field.first.cnr_db)
