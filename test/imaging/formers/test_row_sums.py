"""Sums over rows against backprojection: on any track, as long as the pixels of a row are at one range."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from former_scenes import chosen, db, difference_db, dwell
from helpers import refused

from sal_height.errors import UserError
from sal_height.geometry.frames import ApertureState
from sal_height.imaging.formers.choice import ALLOWED_ERROR
from sal_height.imaging.formers.row_sums import PHASES_OF_THREAD, expected_error, focus_rows
from sal_height.imaging.pixels import Processing, ground_plane_grid


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"gust": 10.0},
        {"jitter": 1e-3},
        {"processing": Processing("rectangular", "rectangular")},
        {"rows": 1},
        {"cols": 1},
        {"rows": 90},
        {"rows": 100, "cols": 11, "pulse_count": 49, "sample_count": 255},
        {"shift": (3.3, -4.1), "spread": (0.7, 1.3)},
    ],
    ids=str,
)
def test_image_of_a_lidar_is_that_of_backprojection(changes: dict) -> None:
    """Also with pixels beyond the range window, which are NaN in both."""
    case = dwell(np.random.default_rng(141), **changes)
    image, reference = case.image(focus_rows), case.image()
    assert image.dtype == np.complex64
    np.testing.assert_array_equal(np.isnan(image), np.isnan(reference))
    assert np.isnan(image).any() == (changes.get("rows") == 90)
    assert difference_db(image, reference) < -70


def test_image_in_the_ground_plane_is_that_of_backprojection() -> None:
    case = dwell(np.random.default_rng(142))
    aperture = ApertureState(case.antenna.mean(axis=0), np.array([50.0, 0, 0]), np.eye(3), 0.08, np.zeros((6, 6)))
    case = replace(case, grid=ground_plane_grid(case.sensor, aperture, 5000.0, 30, 20, 0.03))
    assert difference_db(case.image(focus_rows), case.image()) < -70


def test_more_rows_than_one_thread_takes_are_those_of_few() -> None:
    case = dwell(np.random.default_rng(143), rows=500, sample_count=512)
    assert case.grid.rows * case.grid.cols * len(case.antenna) > PHASES_OF_THREAD
    few = replace(case, grid=replace(case.grid, origin=case.grid.points(490, 0), rows=10))
    np.testing.assert_allclose(few.image(focus_rows), case.image(focus_rows)[:, 490:], atol=1e-6)


@pytest.mark.parametrize("cols", [40, 160, 500])
def test_expected_error_is_the_measured_one_within_3_db(cols: int) -> None:
    """In the worst columns, at the ends of the rows, of an image whose rows bow by a part of a cell."""
    case = dwell(
        np.random.default_rng(144), cols=cols, bandwidth=2e10, reach=500.0, processing=Processing("rectangular")
    )
    expected = expected_error(case.antenna, case.sensor, case.grid)
    image, reference = (made[..., [0, 1, 2, -3, -2, -1]] for made in (case.image(focus_rows), case.image()))
    assert abs(difference_db(image, reference) - db(expected)) < 3


def test_rows_that_bow_are_refused_in_a_sentence() -> None:
    case = dwell(np.random.default_rng(145), cols=500, bandwidth=2e10, reach=500.0)
    assert expected_error(case.antenna, case.sensor, case.grid) > ALLOWED_ERROR
    with refused(UserError, "row_sums", "backprojection"):
        chosen(case, "row_sums")
