"""How errors of navigation develop: as the simulator draws them, and as odometry states them."""

from __future__ import annotations

import numpy as np

from sal_height.adjustment.drift import STATE, Drift, Stated
from sal_height.adjustment.equations import Form, System
from sal_height.simulation.odometry_errors import OdometryErrors

ERRORS = OdometryErrors(position_m=0.05, velocity_mps=0.005, attitude_rad=4e-5, correlation_s=50.0)
TIMES = np.array([0.0, 0.03, 0.1, 20.0, 60.0, 60.1, 300.0])
FLIGHTS = 600


def stated(times: np.ndarray) -> list[Stated]:
    errors = ERRORS.drawn(np.random.default_rng(0))
    return [Stated(time, errors.covariance(time), ERRORS.velocity_mps**2 * np.eye(3)) for time in times.tolist()]


def prior_covariance(correlation: float, told: list[Stated]) -> np.ndarray:
    """Of the numbers of knots at all these times."""
    drift, equations = Drift(correlation), []
    for number, one in enumerate(told):
        equations += drift.add_knot(one, STATE * number + np.arange(STATE))
    count = STATE * len(told)
    whole = Form(np.arange(count), np.eye(count), np.zeros(count))
    return np.asarray(System(equations).solved(np.ones(len(equations))).covariance([whole])[0])


def test_covariance_over_time_is_that_of_drawn_errors() -> None:
    """Of 600 flights: variances within 25 % (their standard error is 6 %), correlations within .15."""
    expected = prior_covariance(ERRORS.correlation_s, stated(TIMES))
    rows = []
    for seed in range(FLIGHTS):
        drawn = ERRORS.drawn(np.random.default_rng(seed))
        rows.append(
            np.column_stack([drawn.position(TIMES), drawn.velocity(TIMES), drawn.turns.velocity(TIMES)]).ravel()
        )
    found = np.cov(np.array(rows).T)
    scale = np.sqrt(np.diag(expected))
    ratio = np.diag(found) / scale**2
    assert np.all((ratio > 0.75) & (ratio < 1.25)), ratio.reshape(-1, STATE).round(2)
    drawn_scale = np.sqrt(np.diag(found))
    np.testing.assert_allclose(found / np.outer(drawn_scale, drawn_scale), expected / np.outer(scale, scale), atol=0.2)


def test_position_is_as_well_known_as_odometry_states() -> None:
    """Also where satellites keep it better than velocity would let it become, and where they are lost."""
    told = stated(TIMES)
    for number, sigma in ((3, 0.02), (4, 0.02), (6, 9.0)):
        told[number].pose[:3, :3] = sigma**2 * np.eye(3)
    covariance = prior_covariance(ERRORS.correlation_s, told)
    sigmas = np.sqrt(np.diag(covariance)).reshape(-1, STATE)
    np.testing.assert_allclose(sigmas[[4, 6], 0], [0.02, 9.0], rtol=0.02)
    assert sigmas[3, 0] < 0.0201
    np.testing.assert_allclose(sigmas[-1, 3:6], 0.005, rtol=0.02)
    np.testing.assert_allclose(sigmas[:, 6:], 4e-5, rtol=0.02)


def test_odometry_that_states_nothing_counts_as_exact() -> None:
    told = [Stated(time, np.zeros((6, 6)), np.zeros((3, 3))) for time in TIMES.tolist()]
    sigmas = np.sqrt(np.diag(prior_covariance(50.0, told))).reshape(-1, STATE)
    assert np.all(sigmas[:, :3] < 1e-3)
    assert np.all(sigmas[:, 6:] < 1e-8)


def test_velocity_that_is_not_stated_moves_the_position_as_far_as_stated() -> None:
    told = [Stated(time, np.diag([0.3**2] * 3 + [1e-10] * 3), np.zeros((3, 3))) for time in TIMES.tolist()]
    covariance = prior_covariance(50.0, told)
    sigmas = np.sqrt(np.diag(covariance)).reshape(-1, STATE)
    assert np.all((sigmas[:, 0] > 0.2) & (sigmas[:, 0] < 0.301))
    late = covariance[0, -STATE] / (sigmas[0, 0] * sigmas[-1, 0])
    assert late < 0.5


def test_knots_are_where_dwells_are() -> None:
    times = [0.0, 0.01, 0.02, 0.2, 60.0, 60.01]
    drift = Drift(100.0)
    for one in stated(np.array(times)):
        if drift.needs_knot(one.seconds):
            drift.add_knot(one, np.arange(STATE))
    assert [knot.seconds for knot in drift.knots] == [0.0, 0.2, 60.0]
    first, second, last = drift.knots
    assert [drift.nearest_knot(time) for time in (-1.0, 0.09, 0.15, 99.0)] == [first, first, second, last]
    assert [drift.knot_before(time) for time in (-1.0, 0.19, 0.2, 99.0)] == [first, first, second, last]
    assert drift.forget_before(last) == [first, second]
    assert drift.knots == [last]
