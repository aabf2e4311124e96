"""Measuring focused images of known responses."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import circular

from sal_height.geometry import Grid
from sal_height.impulse_response import OVERSAMPLING, measure_brightest

ROWS, COLS = 90, 120
HALF_POWER = 0.88589  # width of a sinc in resolution cells


def grid_of(rows: int = ROWS, cols: int = COLS) -> Grid:
    return Grid(np.array([3.0, -2.0, 1.0]), np.array([0.0, -1.0, 0.0]), np.array([1.0, 0.0, 0.0]), 0.5, 0.2, rows, cols)


def response(
    row: float, col: float, cells: tuple[float, float] = (1.7, 2.3), carrier: tuple[float, float] = (0.0, 0.0)
) -> np.ndarray:
    """A point's image: resolution cells of `cells` pixels, band centred on `carrier` (cycles per pixel)."""
    down, across = np.arange(ROWS) - row, np.arange(COLS) - col
    return np.outer(
        np.sinc(down / cells[0]) * np.exp(2j * np.pi * carrier[0] * down),
        np.sinc(across / cells[1]) * np.exp(2j * np.pi * carrier[1] * across),
    )


@pytest.mark.parametrize("place", [(40.0, 60.0), (44.37, 71.81), (20.5, 33.3)])
@pytest.mark.parametrize("carrier", [(0.0, 0.0), (0.31, -0.44)], ids=["baseband", "shifted band"])
def test_position_and_widths_of_a_point(place: tuple[float, float], carrier: tuple[float, float]) -> None:
    grid = grid_of()
    measured = measure_brightest(response(*place, carrier=carrier), grid)
    # The position is a sample of the interpolated cut, half a step off at most; truncation of the cut adds as much.
    error = measured.position - grid.points(*place)
    assert abs(error[1]) < 1 / OVERSAMPLING * grid.row_spacing
    assert abs(error[0]) < 1 / OVERSAMPLING * grid.col_spacing
    assert error[2] == 0
    assert measured.row_width == pytest.approx(1.7 * HALF_POWER * grid.row_spacing, rel=0.01)
    assert measured.col_width == pytest.approx(2.3 * HALF_POWER * grid.col_spacing, rel=0.01)


@pytest.mark.parametrize("place", [(3.0, 60.0), (40.0, 116.0), (87.0, 2.0)], ids=["top", "right", "bottom left"])
def test_point_near_the_edge_of_the_image(place: tuple[float, float]) -> None:
    grid = grid_of()
    measured = measure_brightest(response(*place), grid)
    np.testing.assert_allclose(measured.position, grid.points(*place), atol=0.1 * grid.row_spacing)
    # The response is cut off beside the peak: the interpolation rings.
    assert measured.row_width == pytest.approx(1.7 * HALF_POWER * grid.row_spacing, rel=0.1)
    assert measured.col_width == pytest.approx(2.3 * HALF_POWER * grid.col_spacing, rel=0.1)


def test_the_brightest_of_several_points_is_measured() -> None:
    grid = grid_of()
    image = response(30.0, 40.0) + 1.5 * response(60.0, 80.0, cells=(1.7, 3.1))
    measured = measure_brightest(image, grid)
    np.testing.assert_allclose(measured.position, grid.points(60, 80), atol=0.02)
    assert measured.col_width == pytest.approx(3.1 * HALF_POWER * grid.col_spacing, rel=0.02)


def test_image_smaller_than_the_chip() -> None:
    image = response(15.0, 12.0)[:30, :25]
    measured = measure_brightest(image, grid_of(30, 25))
    np.testing.assert_allclose(measured.position, grid_of().points(15, 12), atol=0.02)
    assert measured.row_width == pytest.approx(1.7 * HALF_POWER * 0.5, rel=0.03)


def test_pixels_that_are_nan_do_not_count() -> None:
    image = response(45.0, 60.0)
    image[:5] = np.nan
    measured = measure_brightest(image, grid_of())
    np.testing.assert_allclose(measured.position, grid_of().points(45, 60), atol=0.02)
    assert np.isfinite([measured.row_width, measured.col_width, measured.peak_over_median_db]).all()


def test_peak_over_median_in_decibels() -> None:
    """The median of exponential power is ln 2 of its mean."""
    noise = circular(np.random.default_rng(31), (ROWS, COLS)) * 1e-2
    noise[45, 60] = 30.0
    measured = measure_brightest(noise, grid_of())
    expected = 10 * np.log10(30.0**2 / (1e-4 * np.log(2)))
    standard_error = 10 / np.log(10) / (np.log(2) * np.sqrt(ROWS * COLS))  # dB: of the median, 1 / sqrt(n) of the mean
    assert measured.peak_over_median_db == pytest.approx(expected, abs=3.5 * standard_error)
