"""Slope of the ground from neighbouring pixels: its error, and where it cannot be told."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from sal_height.relief.slope import KNOWN, SLOPE_ERROR, ground_slope

Array = npt.NDArray[np.float64]

SPACING = 0.1


def ground(slope: tuple[float, float], sigma: float, shape: tuple[int, int] = (60, 40)) -> tuple[Array, Array]:
    """Points of a plane, off by errors of `sigma` (m) along a circle at 45 degrees; and their covariance."""
    rng = np.random.default_rng(1)
    north, east = (SPACING * index for index in np.indices(shape))
    plane = np.stack([east, north, 5.0 + slope[0] * east + slope[1] * north], axis=-1)
    circle = np.array([0.0, -1.0, 1.0]) * sigma
    errors = rng.standard_normal((*shape, 1)) * circle
    return plane + errors, np.broadcast_to(np.outer(circle, circle), (*shape, 3, 3))


def planes(points: Array) -> Array:
    """Points of shape (rows, cols, 3) as `ground_slope` takes them."""
    return np.moveaxis(points, -1, 0)


@pytest.mark.parametrize("slope", [(0.0, 0.0), (0.3, 0.84), (-0.2, -0.84), (0.0, 0.5)])
@pytest.mark.parametrize("sigma", [1e-4, 0.01, 0.05, 0.3])
def test_slopes_are_as_good_as_they_are_meant_to_be(slope: tuple[float, float], sigma: float) -> None:
    """Precise heights or poor ones: windows widen with the errors, and slopes have no bias.

    On ground that falls away errors are nearly twice as great as on level ground.
    """
    points, covariance = ground(slope, sigma, (200, 160))
    found, stated = ground_slope(planes(points), covariance, SPACING)
    known = np.isfinite(found).all(axis=-1)
    inner = known[30:-30, 30:-30]
    assert inner.mean() > 0.95
    error = (found - slope)[30:-30, 30:-30][inner]
    assert np.sqrt(np.mean(error**2)) < 1.5 * SLOPE_ERROR
    assert np.sqrt(np.mean(np.sum(error**2, axis=-1))) < 1.1 * np.median(stated[30:-30, 30:-30][inner])
    assert np.abs(np.mean(error, axis=0)).max() < SLOPE_ERROR / 2


def test_beside_a_step_and_a_false_height_the_slope_is_not_known() -> None:
    points, covariance = ground((0.0, 0.1), 0.005)
    points[:, 20:, 2] += 0.5
    points[10, 5, 2] += 1.0
    known = np.isfinite(ground_slope(planes(points), covariance, SPACING)[1])
    assert not known[:, 19:21].any()
    assert not known[9:12, 4:7].any()
    assert known[1:-1, np.r_[1:4, 7:18, 22:39]].mean() > 0.98


def test_pixels_without_height_or_neighbours_have_no_slope() -> None:
    points, covariance = ground((0.2, 0.1), 0.005)
    points[20:, :] = np.nan
    points[30, 30] = (3.0, 3.0, 5.0)
    points[5, 5] = np.nan
    slope, _ = ground_slope(planes(points), covariance, SPACING)
    assert np.isnan(slope[5, 5]).all()
    assert np.isnan(slope[20:]).all()
    np.testing.assert_allclose(np.nanmedian(slope[:20], axis=(0, 1)), [0.2, 0.1], atol=0.01)
    nothing, _ = ground_slope(planes(np.full_like(points, np.nan)), covariance, SPACING)
    assert np.isnan(nothing).all()


def test_what_is_too_poor_or_too_small_has_no_slope() -> None:
    """Heights of 30 m at pixels of 10 cm; and an image of one column, which no plane is fixed by."""
    points, covariance = ground((0.0, 0.0), 30.0)
    poor, _ = ground_slope(planes(points), covariance, SPACING)
    assert np.isnan(poor).mean() > 0.95
    column, covariance = ground((0.0, 0.0), 0.001, shape=(40, 1))
    assert np.isnan(ground_slope(planes(column), covariance, SPACING)[0]).all()
    assert KNOWN > SLOPE_ERROR
