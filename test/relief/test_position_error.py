"""Covariance of positions: derivatives by finite differences, Monte Carlo over poses, and heights at a place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from helpers import make_aperture
from scipy.spatial.transform import Rotation

from sal_height.geometry.earth import height_of
from sal_height.geometry.frames import ApertureState, angles_of, aperture_at, shift_along
from sal_height.geometry.grid import Grid
from sal_height.geometry.trajectory import locate_at_elevation, locate_at_height
from sal_height.relief.position_error import (
    height_variance,
    level_turn,
    measured_covariance,
    pose_covariance,
    position_jacobian,
    turn_jacobian,
    variance_at_place,
)

Array = npt.NDArray[np.float64]

SIDES = pytest.mark.parametrize("side", [1, -1], ids=["right", "left"])
SLIDING = pytest.mark.parametrize("sliding", [False, True], ids=["spotlight", "stripmap"])


def turned_aperture(sliding: bool = False) -> ApertureState:
    """A flight that turns and descends, with the body squinted out of it."""
    return replace(make_aperture(angles=(0.11, -0.2, 0.5), velocity=(38.0, 32.0, -2.0)), sliding=sliding)


def seen_points(aperture: ApertureState, side: int) -> Array:
    """Places that the aperture sees at different elevations, ranges and, in spotlight, Dopplers, shape (3, 4, 3)."""
    elevation, slant_range = np.pi / 4 + np.array([[-0.2], [0.0], [0.3]]), 5000 + np.array([-300.0, 0.0, 200.0, 900.0])
    points = locate_at_elevation(elevation, slant_range, 0.1 * slant_range, replace(aperture, sliding=False), side)
    return points + (200 * aperture.direction if aperture.sliding else 0.0)


def pixel_of(points: Array, aperture: ApertureState, side: int) -> tuple[ApertureState, Array, Array, Array]:
    """What a pixel measures: from where, its elevation (rad), slant range and distance along the flight (m)."""
    here = aperture_at(points, aperture)
    slant_range, elevation, _ = angles_of(points, here, side)
    return here, elevation, slant_range, (points - here.position) @ aperture.direction


@SIDES
@SLIDING
def test_the_jacobian_is_that_of_finite_differences(side: int, sliding: bool) -> None:
    """Steps of 1e-6 rad and 1 cm: central differences are good to 1e-8 of 5000 m over the step."""
    aperture = turned_aperture(sliding)
    points = seen_points(aperture, side)
    here, elevation, slant_range, along = pixel_of(points, aperture, side)
    numbers, steps = np.stack([elevation, slant_range, along]), np.array([1e-6, 1e-2, 1e-2])
    jacobian = position_jacobian(points, aperture)
    assert jacobian.shape == (3, 4, 3, 3)
    for parameter, step in enumerate(steps):
        shift = step * np.eye(3)[parameter][:, None, None]
        after, before = (locate_at_elevation(*(numbers + sign * shift), here, side) for sign in (1, -1))
        expected = (after - before) / (2 * step)
        sign = -side if parameter == 0 else 1  # to the right, elevation grows against the rotation about forward
        found = sign * jacobian[..., parameter]
        np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())


@SIDES
def test_level_flight_abeam_has_the_jacobian_of_a_right_triangle(side: int) -> None:
    """At elevation a and range R, s the side: -s R (0, -s cos a, sin a), (0, -s sin a, -cos a) and (1, 0, 0)."""
    aperture, sine, cosine, slant_range = make_aperture(), np.sin(0.7), np.cos(0.7), 5000.0
    point = aperture.position + slant_range * np.array([0.0, -side * sine, -cosine])
    circle = -side * slant_range * np.array([0.0, -side * cosine, sine])
    expected = np.column_stack([circle, [0.0, -side * sine, -cosine], [1.0, 0.0, 0.0]])
    np.testing.assert_allclose(position_jacobian(point, aperture), expected, atol=1e-9)
    sigmas = np.array([1e-5, 0.03, 0.05])
    covariance, climb = measured_covariance(point, aperture, *sigmas)
    np.testing.assert_allclose(covariance, expected @ np.diag(sigmas**2) @ expected.T, rtol=1e-12, atol=1e-13)
    assert climb == pytest.approx(slant_range * sine, rel=1e-3)  # the vertical leans by the arc to the place


@SIDES
def test_level_ground_turns_as_points_of_one_height_do(side: int) -> None:
    """Two points of one height and Doppler, a row of 5 cm beside the flight apart; curvature matters 1e-5."""
    aperture, elevation, along = replace(turned_aperture(), sliding=False), np.pi / 4 + 0.02, 300.0
    first = locate_at_elevation(elevation, 5000.0, along, aperture, side)
    aside = first - aperture.position - along * aperture.direction
    down = aside / np.linalg.norm(aside)
    grid = Grid(first - 0.05 * down, down, aperture.direction, 0.05, 1.0, 3, 1)
    slant_range = np.hypot(np.linalg.norm(aside) + 0.05, along)
    second = locate_at_height(height_of(first), slant_range, along, aperture, side)
    gained = angles_of(second, aperture, side)[1] - elevation
    assert level_turn(elevation, grid, aperture, side) == pytest.approx(gained, rel=1e-4)


@SIDES
@SLIDING
def test_covariance_by_the_pose_is_that_of_positions_over_perturbed_poses(side: int, sliding: bool) -> None:
    """40 000 poses of a covariance with correlations; the standard error of an entry is that of a Wishart matrix.

    Range and Doppler, which the image fixes, stay those of the pose that it was made with.
    """
    rng, trials = np.random.default_rng([32, side + 1, sliding]), 40_000
    aperture = turned_aperture(sliding)
    root = np.diag([0.1, 0.2, 0.15, 1e-4, 3e-4, 2e-4]) @ (np.eye(6) + 0.3 * rng.standard_normal((6, 6)))
    point = seen_points(aperture, side)[0, 3]
    here, elevation, slant_range, along = pixel_of(point, aperture, side)
    errors = rng.standard_normal((trials, 6)) @ root.T
    turns = Rotation.from_rotvec(errors[:, 3:]).as_matrix() @ here.rotation
    positions = np.array(
        [
            locate_at_elevation(
                elevation, slant_range, along, replace(here, position=here.position + e[:3], rotation=turn), side
            )
            for e, turn in zip(errors, turns, strict=True)
        ]
    )
    sample, expected = np.cov(positions.T), pose_covariance(point, replace(aperture, covariance=root @ root.T))
    assert expected is not None
    standard_error = np.sqrt((expected**2 + np.outer(np.diag(expected), np.diag(expected))) / trials)
    assert np.abs((sample - expected) / standard_error).max() < 4
    assert np.linalg.eigvalsh(expected).min() > 0


@pytest.mark.parametrize("unknown", [0.0, np.nan, np.inf])
def test_pose_of_unknown_covariance_adds_nothing(unknown: float) -> None:
    aperture = replace(make_aperture(), covariance=np.full((6, 6), unknown))
    assert pose_covariance(np.array([[100.0, -3500.0, 0.0], [np.nan, 0.0, 0.0]]), aperture) is None


def test_variance_of_height_is_along_the_vertical_of_the_place() -> None:
    """100 km from the origin the vertical leans by 15.7 mrad."""
    lean = np.arctan2(100e3, 6_371_008.8)
    covariance = np.diag([4.0, 0.0, 1.0])
    expected = 4 * np.sin(lean) ** 2 + np.cos(lean) ** 2
    assert height_variance(covariance, np.array([100e3, 0.0, 0.0])) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("slope", [(0.0, 0.0), (0.8, 0.0), (0.0, -0.8), (0.5, 0.7)])
def test_variance_at_a_place_is_that_of_the_height_over_the_ground(slope: tuple[float, float]) -> None:
    """100 000 points beside a plane, each against the ground beneath: the variance has a standard error of .45 %."""
    rng, count = np.random.default_rng(4), 100_000
    root = np.array([[0.2, 0.0, 0.0], [0.1, 0.5, 0.0], [-0.1, 0.6, 0.3]])
    errors = rng.standard_normal((count, 3)) @ root.T
    over_ground = errors[:, 2] - errors[:, :2] @ np.array(slope)
    variance = variance_at_place(root @ root.T, np.array(slope))
    assert variance == pytest.approx(np.var(over_ground), rel=4 * np.sqrt(2 / count))


def test_where_the_slope_is_not_known_the_variance_at_a_place_is_a_bound() -> None:
    """Of an error in one direction it is reached at the slope of 45 degrees against it."""
    rng = np.random.default_rng(5)
    roots = rng.standard_normal((50, 1, 3, 3))
    covariance = roots @ np.swapaxes(roots, -1, -2)
    angle = np.linspace(0, 2 * np.pi, 721)
    steep = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    bound = variance_at_place(covariance[:, 0], np.full((50, 2), np.nan))
    greatest = variance_at_place(covariance, steep).max(axis=1)
    assert np.all(greatest <= bound * (1 + 1e-9))
    circle = np.array([0.3, -0.6, 0.8])
    across = np.outer(circle, circle)
    bound, greatest = variance_at_place(across, np.full(2, np.nan)), variance_at_place(across, steep).max()
    assert bound == pytest.approx(greatest, rel=1e-4)


@SIDES
def test_positions_move_along_the_flight_as_images_do(side: int) -> None:
    aperture = turned_aperture()
    points = seen_points(aperture, side).reshape(-1, 3)
    sights = (points - aperture.position) / np.linalg.norm(points - aperture.position, axis=-1, keepdims=True)
    along = [shift_along(aperture, sight) for sight in sights]
    np.testing.assert_allclose(position_jacobian(points, aperture)[..., 2], along, rtol=1e-9, atol=1e-12)


@SIDES
@SLIDING
def test_turns_of_the_body_move_positions_as_their_covariance_says(side: int, sliding: bool) -> None:
    """Each component of the attitude by itself, as `pose_covariance` has it, which Monte Carlo confirms above."""
    aperture = turned_aperture(sliding)
    points, covariance = seen_points(aperture, side), np.zeros((6, 6))
    turns = turn_jacobian(points, aperture)
    for axis in range(3):
        covariance[3:, 3:] = 0
        covariance[3 + axis, 3 + axis] = 1e-8
        expected = pose_covariance(points, replace(aperture, covariance=covariance))
        moved = 1e-4 * turns[..., axis]
        np.testing.assert_allclose(moved[..., :, None] * moved[..., None, :], expected, rtol=1e-6, atol=1e-12)
