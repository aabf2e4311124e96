"""The corrected trajectory puts antenna and beams where they were, corrected heights where an exact flight has them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import make_sensor
from scipy.spatial.transform import Rotation
from test_observed import ERRORS, LAYOUT, imaged, observed

from sal_height.adjustment import (
    Adjustment,
    AdjustmentSettings,
    PoseError,
    corrected_aperture,
    corrected_heights,
    corrected_mounting,
    corrected_states,
)
from sal_height.adjustment.drift import STATE, Stated
from sal_height.adjustment.equations import Equation, System
from sal_height.adjustment.observed import (
    BORESIGHT,
    COMMON,
    DELAY,
    LEVER_ARM,
    POSE,
    STRETCH,
    Unknowns,
    pose,
    pose_jacobian,
)
from sal_height.elevation import BEAM_PITCH
from sal_height.geometry import Mounting, PlatformState, Trajectory, angles_of, height_of, sphere_coordinates
from sal_height.numeric import F64
from sal_height.relief import pitch_covariance, pose_covariance
from sal_height.sensor import NOTHING_STATED, SensorUncertainty

MOUNTING = Mounting("sensor", (1.2, -0.7, -0.5), tuple(Rotation.from_rotvec([0.1, 0.02, -0.3]).as_quat().tolist()))
KNOTS = np.array([0.0, 10.0])
SETTINGS = AdjustmentSettings(jitter_rad=2e-6)
TIMES = np.arange(-0.1, 0.1, 0.005)


def true_states() -> list[PlatformState]:
    """A platform that flies at 50 m/s and turns slowly."""
    turns = Rotation.from_rotvec(np.array([0.0, 0.02, 0.5]) + TIMES[:, None] * np.array([0.01, -0.02, 0.03]))
    return [
        PlatformState(
            stamp_ns=round(1e9 * (time + 1)),
            position=np.array([50.0 * time, 20.0, 3500.0]),
            orientation=turn.as_quat(),
            velocity=np.array([50.0, 0.0, 0.0]),
            covariance=np.eye(6),
        )
        for time, turn in zip(TIMES.tolist(), turns, strict=True)
    ]


def adjustment_with(knots: F64, common: F64) -> Adjustment:
    """An adjustment that has found these errors, and knows each to within 1."""
    layout = Unknowns(100.0)
    for number, seconds in enumerate(KNOTS.tolist()):
        layout.add(number, Stated(seconds, np.eye(6), np.eye(3)))
    unknowns = np.concatenate([common, knots.ravel()])
    columns = np.concatenate([layout.common, *(knot.columns for knot in layout.drift.knots)])
    told = Equation(columns, np.eye(len(columns)), unknowns, np.eye(len(columns)))
    return Adjustment(layout, System([told]).solved(np.ones(1)), [], [])


def sensor_of(states: list[PlatformState], mounting: Mounting) -> tuple[np.ndarray, np.ndarray]:
    """Positions of the antenna, m, and rotations of the sensor."""
    attitude = Rotation.from_quat([state.orientation for state in states])
    positions = np.array([state.position for state in states]) + attitude.apply(mounting.lever_arm)
    return positions, (attitude * mounting.axes).as_matrix()


def test_errors_that_were_found_are_taken_out() -> None:
    """To second order in the errors: of 1e-4 rad and 10 cm 10 um and 1e-8 rad are left."""
    truth = true_states()
    knots, common = np.zeros((2, STATE)), np.zeros(COMMON)
    knots[0] = [0.3, -0.2, 0.1, 0.01, -0.02, 0.005, 1e-4, -5e-5, 2e-4]
    knots[1] = knots[0]
    knots[1, :3] += 10.0 * knots[0, 3:6]
    common[BORESIGHT], common[LEVER_ARM], common[DELAY] = [1e-4, 2e-4, -1e-4], [0.05, -0.02, 0.03], 1e-3
    # The true mounting is without the errors of the described one.
    adjustment = adjustment_with(knots, common)
    true_mounting = corrected_mounting(MOUNTING, adjustment)
    stated = []
    for state, time in zip(truth, TIMES.tolist(), strict=True):
        turned = Rotation.from_rotvec(knots[0, 6:9]) * Rotation.from_quat(state.orientation)
        moved = state.position + knots[0, :3] + time * knots[0, 3:6] - common[DELAY] * state.velocity
        stated.append(
            replace(state, position=moved, orientation=turned.as_quat(), velocity=state.velocity + knots[0, 3:6])
        )

    found = corrected_states(stated, TIMES.tolist(), adjustment, MOUNTING, SETTINGS)

    positions, rotations = sensor_of(found, MOUNTING)
    true_positions, true_rotations = sensor_of(truth, true_mounting)
    np.testing.assert_allclose(positions, true_positions, atol=5e-5)
    np.testing.assert_allclose(rotations, true_rotations, atol=2e-7)
    np.testing.assert_allclose([s.velocity for s in found], [s.velocity for s in truth], atol=1e-9)
    Trajectory(found).mounted(MOUNTING)


def test_mounting_is_told_without_the_errors() -> None:
    common = np.zeros(COMMON)
    common[BORESIGHT], common[LEVER_ARM] = [0.0, 0.0, 0.01], [0.1, 0.0, 0.0]
    better = corrected_mounting(MOUNTING, adjustment_with(np.zeros((2, STATE)), common))
    np.testing.assert_allclose(better.lever_arm, [1.1, -0.7, -0.5])
    turn = (MOUNTING.axes.inv() * better.axes).as_rotvec()
    np.testing.assert_allclose(turn, [0.0, 0.0, -0.01], atol=1e-12)


def test_covariance_is_that_of_pose_and_mounting_together_near_dwells_and_the_stated_one_elsewhere() -> None:
    adjustment = adjustment_with(np.zeros((2, STATE)), np.zeros(COMMON))
    states = true_states()
    near, far = corrected_states([states[0], states[1]], [0.0, 5.0], adjustment, MOUNTING, SETTINGS)
    np.testing.assert_array_equal(far.covariance, states[1].covariance)
    # Each of position, lever arm and delay adds 1, 1 and V^2; the boresight its turn of the arm.
    speed, arm = states[0].velocity, np.array(MOUNTING.lever_arm)
    expected = 2 * np.eye(3) + np.outer(speed, speed)
    turned = Rotation.from_quat(states[0].orientation).apply(arm)
    expected += turned @ turned * np.eye(3) - np.outer(turned, turned)
    np.testing.assert_allclose(near.covariance[:3, :3], expected, atol=1e-9)
    np.testing.assert_allclose(near.covariance[3:, 3:], (2 + 4e-12) * np.eye(3), atol=1e-12)
    np.testing.assert_allclose(near.velocity_covariance, np.eye(3), atol=1e-12)


def test_jitter_that_odometry_does_not_contain_is_in_the_attitude() -> None:
    adjustment, states = adjustment_with(np.zeros((2, STATE)), np.zeros(COMMON)), true_states()[:1]
    calm, shaken = (
        corrected_states(states, [0.0], adjustment, MOUNTING, AdjustmentSettings(jitter_rad=jitter))[0].covariance
        for jitter in (1e-9, 0.1)
    )
    np.testing.assert_allclose(shaken - calm, 0.01 * np.diag([0, 0, 0, 1, 1, 1]), atol=1e-9)


def test_beyond_the_knots_velocity_stays() -> None:
    knots = np.zeros((2, STATE))
    knots[:, 0], knots[:, 3] = [1.0, 1.2], 0.02
    states = true_states()[:2]
    before, after = corrected_states(states, [-1.0, 12.0], adjustment_with(knots, np.zeros(COMMON)), MOUNTING, SETTINGS)
    assert before.position[0] - states[0].position[0] == pytest.approx(-0.98)
    assert after.position[0] - states[1].position[0] == pytest.approx(-1.24)


EXACT = 1e-12 * np.eye(POSE)


def pose_error(name: str) -> F64:
    """The POSE numbers of an error of the eastward dwell."""
    slc, field, sensor = imaged(0, ERRORS[name])
    form = pose(0, observed(0, slc, field), LAYOUT, sensor.mounting)
    values = np.zeros(form.values.shape[1])
    for number, size in ERRORS[name].unknowns:
        values[number] = size
    return form.values @ values + form.constant


def test_the_error_of_the_angles_between_beams_that_is_left_replaces_the_one_that_heights_had() -> None:
    slc, field, _ = imaged(0, None)
    dwell, first = observed(0, slc, field), field.first
    _, elevation, _ = angles_of(first.positions, slc.aperture, dwell.look_side)
    offset = np.asarray(elevation) - dwell.axis_middle
    by_pitch = pitch_covariance(first.positions, slc.aperture, offset, 0.01)
    known, left = (
        (np.zeros_like(by_pitch) if first.common_covariance is None else first.common_covariance),
        EXACT.copy(),
    )
    left[STRETCH, STRETCH] = 0.004**2
    stated = replace(field, surfaces=(replace(first, common_covariance=known + by_pitch),))
    exact, better, kept = (
        corrected_heights(stated, dwell, PoseError(np.zeros(POSE), covariance), sigma).first.common_covariance
        for covariance, sigma in ((EXACT, 0.01), (left, 0.01), (EXACT, 0.0))
    )
    assert exact is not None
    assert better is not None
    assert kept is not None
    np.testing.assert_allclose(kept - exact, by_pitch, rtol=1e-3, atol=1e-9)
    np.testing.assert_allclose(better - exact, 0.16 * by_pitch, rtol=1e-3, atol=1e-9)
    assert np.nanmax(by_pitch[..., 2, 2]) > 1e-4


def test_angles_between_beams_are_known_as_described() -> None:
    settings, nothing = AdjustmentSettings(), make_sensor(uncertainty=NOTHING_STATED)
    assert settings.described(nothing).pitch_sigma == BEAM_PITCH == 0.01
    assert settings.described(make_sensor(uncertainty=SensorUncertainty(beam_pitch=0.002))).pitch_sigma == 0.002
    assert settings.described(make_sensor()).pitch_sigma == 0.0
    assert settings.changed(pitch_sigma=0.0).described(nothing).pitch_sigma == 0.0


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
