"""Pixels of images, and their noise."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import make_aperture, make_sensor, refused
from scipy.constants import speed_of_light

from sal_height.errors import UserError
from sal_height.geometry.frames import angles_of
from sal_height.imaging.pixels import (
    Processing,
    aim_point,
    azimuth_resolution,
    ground_plane_grid,
    slant_plane_grid,
    slant_plane_size,
    slc_noise_power,
)
from sal_height.numeric.windows import window

SENSOR = make_sensor()


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("velocity", [(50.0, 0, 0), (-50.0, 0, 0), (0, 50.0, 0)], ids=["east", "west", "north"])
def test_slant_plane_holds_the_flight_and_the_line_of_sight(side: int, velocity: tuple[float, float, float]) -> None:
    sensor = make_sensor(look_side=side)
    yaw = np.arctan2(velocity[1], velocity[0])
    aperture = make_aperture(angles=(0, 0, yaw), velocity=velocity)
    grid = slant_plane_grid(sensor, aperture, 5000.0, 21, 11, 1.2)
    middle = grid.points(10, 5)
    np.testing.assert_allclose(middle, aim_point(sensor, aperture, 5000.0), atol=1e-9)
    slant_range, elevation, squint = angles_of(middle, aperture, side)
    assert slant_range == pytest.approx(5000.0, abs=1e-9)
    assert elevation == pytest.approx(np.pi / 4, abs=1e-12)
    assert squint == pytest.approx(0, abs=1e-12)
    # One row further is one (broadened) resolution further away, one column further is one along the flight.
    assert grid.row_spacing == pytest.approx(1.2 * speed_of_light / (2 * sensor.bandwidth), rel=1e-12)
    assert grid.col_spacing == pytest.approx(1.55e-6 * 5000 / (2 * aperture.length), rel=1e-12)
    assert grid.col_spacing == azimuth_resolution(sensor, aperture, 5000.0)
    np.testing.assert_allclose(grid.row_direction, (middle - aperture.position) / 5000, atol=1e-12)
    np.testing.assert_allclose(grid.col_direction, aperture.direction, atol=1e-15)


@pytest.mark.parametrize("side", [1, -1])
def test_ground_plane_is_horizontal_with_rows_pointing_away(side: int) -> None:
    sensor = make_sensor(look_side=side)
    grid = ground_plane_grid(sensor, make_aperture(), 5000.0, 20, 10, 0.25)
    np.testing.assert_allclose(grid.points(9.5, 4.5), [0, -side * 5000 * np.sqrt(0.5), 0], atol=1e-9)
    np.testing.assert_allclose(grid.row_direction, [0, -side, 0], atol=1e-12)
    np.testing.assert_allclose(grid.col_direction, [1, 0, 0], atol=1e-12)
    assert (grid.row_spacing, grid.col_spacing, grid.shape) == (0.25, 0.25, (20, 10))


def test_full_image_covers_the_range_window_and_a_beamwidth() -> None:
    rows, cols = slant_plane_size(SENSOR, make_aperture(), 5000.0, 1.2)
    grid = slant_plane_grid(SENSOR, make_aperture(), 5000.0, rows, cols, 1.2)
    assert 0 <= SENSOR.range_window - rows * grid.row_spacing < grid.row_spacing
    assert 0 <= SENSOR.beamwidth * 5000 - cols * grid.col_spacing + 1e-9 < grid.col_spacing


def test_noise_of_a_pixel_is_that_of_a_sample_over_their_number_times_the_gain_of_the_window() -> None:
    weights = window("hamming", SENSOR.sample_count)
    sensor = make_sensor(noise_power=(1.0, 4.0, 0.25))
    expected = np.array([1.0, 4.0, 0.25]) * np.mean(weights**2) / (48 * 64)
    np.testing.assert_allclose(slc_noise_power(sensor, Processing("hamming"), 48), expected, rtol=1e-12)


def test_image_too_large_to_process_is_refused() -> None:
    with refused(UserError, "4097 x 4096 pixels", str(4096 * 4096)):
        ground_plane_grid(SENSOR, make_aperture(), 5000.0, 4097, 4096, 1.0)


def test_sensor_that_does_not_look_sideways_is_refused() -> None:
    down = make_sensor(elevation_boresights=(1e-13,), noise_power=(1.0,))
    with refused(UserError, "horizontal line of sight", "must look sideways"):
        ground_plane_grid(down, make_aperture(), 5000.0, 4, 4, 1.0)
    ahead = make_aperture(angles=(0, 0, np.pi / 2), velocity=(0.0, 0.0, -50.0))
    with refused(UserError, "line of sight", "must look sideways"):
        slant_plane_grid(down, ahead, 5000.0, 4, 4, 1.0)


def test_pixels_reach_to_the_null_of_their_windows() -> None:
    """Half a cell without a window; with the Taylor window, in pixels as wide as its response, a whole one."""
    down, across = Processing("taylor", "rectangular").reach((0.05, 0.005), (0.05 * 1.19, 0.005))
    assert down == pytest.approx(0.05 * 1.07, rel=0.02)
    assert across == pytest.approx(0.0025, rel=1e-9)
