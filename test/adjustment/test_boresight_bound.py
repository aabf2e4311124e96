"""The least errors of the boresight, by the formulas of docs/adjustment.md, against least squares."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from benchmarks.boresight import attitude_bounds, bound_about_flight, of_boresight, with_drawn_mounting
from sal_height.adjustment.drift import STATE, Drift, Stated
from sal_height.adjustment.equations import Equation, Form, System
from sal_height.simulation import Preset, load_preset
from sal_height.simulation.odometry_errors import OdometryErrors

PRIOR_RAD, ARM_M, EDGES_M = 2e-5, 0.01, 0.03


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
    expected = [1 / np.sqrt(1 / PRIOR_RAD**2 + 1 / variance) for variance in (level, along)]
    np.testing.assert_allclose(attitude_bounds(preset), expected, rtol=1e-9)


@pytest.mark.parametrize("count", [2, 20, 30])
def test_the_bound_about_the_flight_is_that_of_the_adjustment_s_own_model_of_drift(count: int) -> None:
    """Each pass is a knot of the navigation; differences between passes that follow each other are exact."""
    preset = with_passes(count)
    flight, odometry = preset.flight, preset.impairments.odometry
    errors, drift = odometry.drawn(np.random.default_rng(0)), Drift(odometry.correlation_s)
    common = np.arange(2)  # boresight about the flight; lever arm across and edges
    shared = np.diag([PRIOR_RAD**-2, 1 / (ARM_M**2 + EDGES_M**2)])
    equations, views = [Equation(common, np.eye(2), np.zeros(2), shared)], []
    for number in range(count):
        seconds, side = flight.passes.interval_s * number, (-1.0) ** number
        columns = 2 + STATE * number + np.arange(STATE)
        stated = Stated(seconds, errors.covariance(seconds), odometry.velocity_mps**2 * np.eye(3))
        equations += drift.add_knot(stated, columns)
        across, up = flight.slant_range_m * np.array([np.cos(flight.look_angle_rad), np.sin(flight.look_angle_rad)])
        values = np.array([[1, 0, across, side * across, side], [0, 1, side * up, up, 0]])
        views.append(Form(np.append(columns[[1, 2, 6]], common), values, np.zeros(2)))
    for one, after in pairwise(views):
        equations.append(after.minus([(1.0, one)]).equals(np.zeros(2), 1e8 * np.eye(2)))
    solution = System(equations).solved(np.ones(len(equations)))
    (variance,) = solution.covariance([Form(common[:1], np.eye(1), np.zeros(1))])
    assert bound_about_flight(preset, EDGES_M) == pytest.approx(float(np.sqrt(variance[0, 0])), rel=2e-3)


def test_positions_that_do_not_drift_leave_what_the_attitude_does() -> None:
    """And edges that lie where they are, and an exact lever arm."""
    preset = with_passes(20)
    known = {"sar_compression": {**preset.processing["sar_compression"], "lever_arm_sigma_m": 0.0}}
    still = replace(preset.impairments.odometry, velocity_mps=1e-9)
    preset = replace(preset, processing=known, impairments=replace(preset.impairments, odometry=still))
    assert bound_about_flight(preset, 0.0) == pytest.approx(attitude_bounds(preset)[0], rel=1e-6)


def test_rows_are_about_the_flight_and_along_it() -> None:
    """Of pitch and yaw only their sum along the flight counts."""
    preset, look = with_passes(20), load_preset("sal_passes").flight.look_angle_rad
    errors = 1e-6 * np.array([[3.0, np.sin(look), np.cos(look)], [-4.0, -np.cos(look), np.sin(look)]])
    covariances = 1e-12 * np.diag([4.0, 1.0, 1.0]) * np.ones((2, 1, 1))
    rows = {row.name: row.value for row in of_boresight(preset, errors, covariances, EDGES_M, "made up")}
    bounds = 1e6 * np.array([bound_about_flight(preset, EDGES_M), attitude_bounds(preset)[1]])
    expected = [np.sqrt(12.5), np.sqrt(12.5) / 2, 2 / bounds[0], np.sqrt(0.5), np.sqrt(0.5), 1 / bounds[1]]
    np.testing.assert_allclose(list(rows.values()), expected, rtol=1e-9)


def test_errors_of_the_mounting_are_spread_as_is_stated_of_them() -> None:
    """The boresight, the lever arm and the delay of the odometry of each flight are other ones."""
    preset = load_preset("sal_passes")

    def drawn(seed: int) -> OdometryErrors:
        return with_drawn_mounting(preset, seed).impairments.odometry

    flights = [drawn(seed) for seed in range(400)]
    for name, sigma in (
        ("undescribed_boresight_rad", PRIOR_RAD),
        ("undescribed_lever_arm_m", ARM_M),
        ("delay_s", 1e-5),
    ):
        values = np.array([getattr(flight, name) for flight in flights])
        np.testing.assert_allclose(np.sqrt(np.mean(values**2, axis=0)), sigma, rtol=0.15)
    assert drawn(3) == drawn(3) != drawn(4)
    assert drawn(3).attitude_rad == preset.impairments.odometry.attitude_rad
