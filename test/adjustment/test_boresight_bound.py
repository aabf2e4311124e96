"""The boresight that errors of the attitude leave, by the formula of docs/adjustment.md, against least squares."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.adjusting import attitude_bounds, of_boresight
from sal_height.simulation import Preset, load_preset


def with_passes(count: int) -> Preset:
    preset = load_preset("sal_passes")
    return replace(preset, flight=replace(preset.flight, passes=replace(preset.flight.passes, count=count)))


@pytest.mark.parametrize("count", [2, 8, 30])
def test_the_formula_is_the_best_linear_estimate_of_alternating_signs(count: int) -> None:
    """Passes to and fro 120 s apart turn the boresight about horizontal axes; the attitude errs by 40 urad."""
    preset, numbers = with_passes(count), np.arange(count)
    inverse = np.linalg.inv(4e-5**2 * np.exp(-120 / 100 * np.abs(numbers[:, None] - numbers)))
    signs, ones = (-1.0) ** numbers, np.ones(count)
    level, heading = 1 / (signs @ inverse @ signs), 1 / (ones @ inverse @ ones)
    look = preset.flight.look_angle_rad
    along = level * np.cos(look) ** 2 + heading * np.sin(look) ** 2
    expected = [1 / np.sqrt(1 / 2e-5**2 + 1 / variance) for variance in (level, along)]
    np.testing.assert_allclose(attitude_bounds(preset), expected, rtol=1e-9)


def test_rows_are_about_the_flight_and_along_it() -> None:
    """Of pitch and yaw only their sum along the flight counts."""
    preset, look = with_passes(20), load_preset("sal_passes").flight.look_angle_rad
    errors = 1e-6 * np.array([[3.0, np.sin(look), np.cos(look)], [-4.0, -np.cos(look), np.sin(look)]])
    covariances = 1e-12 * np.diag([4.0, 1.0, 1.0]) * np.ones((2, 1, 1))
    rows = {row.name: row.value for row in of_boresight(preset, errors, covariances, "made up")}
    bounds = 1e6 * np.array(attitude_bounds(preset))
    expected = [np.sqrt(12.5), np.sqrt(12.5) / 2, 2 / bounds[0], np.sqrt(0.5), np.sqrt(0.5), 1 / bounds[1]]
    np.testing.assert_allclose(list(rows.values()), expected, rtol=1e-9)
