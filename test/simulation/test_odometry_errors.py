"""Odometry that errs: as much as is asked for and stated, and corrected if it is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from sal_height.elevation import ESTIMATORS, MlSettings, Validity
from sal_height.errors import UserError
from sal_height.geometry import AT_BASE_LINK
from sal_height.imaging import ImageSettings, Slc
from sal_height.pipeline import Compressor, heights
from sal_height.simulation import SimulatedFlight, flight_of, load_preset, parse_preset
from sal_height.simulation.odometry_errors import OdometryErrors
from sal_height.simulation.preset import SHIPPED

SEEDS = 400
TRUE = load_preset("small")


def flight_with(**errors: object) -> SimulatedFlight:
    impairments = replace(TRUE.impairments, odometry=OdometryErrors(**errors))  # type: ignore[arg-type]
    return flight_of(replace(TRUE, impairments=impairments), seed=2)


def compressed(flight: SimulatedFlight, **settings: object) -> Slc:
    slc = Compressor().add(
        flight.phase_history(0), flight.track(0), flight.sensor, ImageSettings(air="none", rows=30, cols=8, **settings)
    )
    assert slc is not None
    return slc


def median_height(flight: SimulatedFlight, **settings: object) -> float:
    field = heights(compressed(flight, **settings), flight.sensor, ESTIMATORS["ml"], MlSettings())
    return float(np.median(field.first.height[field.validity == Validity.OK]))


def test_errors_are_as_large_as_they_are_stated_at_any_time() -> None:
    """Over 400 flights, each with three axes: rms within 3.5 of its standard errors, 7 %."""
    errors = OdometryErrors(position_m=0.05, velocity_mps=0.01, attitude_rad=1e-4, correlation_s=20.0)
    drawn = [errors.drawn(np.random.default_rng(seed)) for seed in range(SEEDS)]
    for seconds in (0.0, 10.0, 60.0):
        stated = np.sqrt(np.diag(drawn[0].covariance(seconds)))
        position = np.sqrt(np.mean([one.position(seconds) ** 2 for one in drawn]))
        turn = np.sqrt(np.mean([one.rotation(seconds).as_rotvec() ** 2 for one in drawn]))
        velocity = np.sqrt(np.mean([one.velocity(seconds) ** 2 for one in drawn]))
        assert position == pytest.approx(stated[0], rel=0.075)
        assert turn == pytest.approx(stated[3], rel=0.075)
        assert velocity == pytest.approx(0.01, rel=0.075)


SHEET = {"tactical": (0.01, 0.013, 0.035), "navigation": (0.005, 0.005, 0.008), "survey": (0.005, 0.0025, 0.005)}
"""Rms of velocity (m/s), of roll and pitch, and of heading (degrees) that the maker states of each grade."""


@pytest.mark.parametrize("grade", SHEET)
def test_a_grade_errs_as_its_maker_states_and_says_so(grade: str) -> None:
    """Over 400 flights: rms within 3.5 of its standard errors, 1 / sqrt(2 n) of n numbers."""
    velocity, attitude, heading = SHEET[grade][0], *np.radians(SHEET[grade][1:])
    true = flight_of(TRUE, seed=2).platform_states(0)[0]
    errors, seconds, t = OdometryErrors(grade=grade), 60.0, 100.0  # type: ignore[arg-type]
    states = [errors.drawn(np.random.default_rng(seed)).added_to(true, seconds) for seed in range(SEEDS)]
    back = Rotation.from_quat(true.orientation).inv()
    turns = np.array([(Rotation.from_quat(state.orientation) * back).as_rotvec() for state in states])
    moved = 2 * (velocity * t) ** 2 * (seconds / t - 1 + np.exp(-seconds / t))
    stated = np.sqrt(0.1**2 + moved), velocity, attitude, heading
    drawn = (
        np.array([state.position - true.position for state in states]),
        np.array([state.velocity - true.velocity for state in states]),
        turns[:, :2],
        turns[:, 2],
    )
    for told, found in zip(stated, drawn, strict=True):
        assert np.sqrt(np.mean(found**2)) == pytest.approx(told, rel=3.5 / np.sqrt(2 * found.size))
    np.testing.assert_allclose(np.sqrt(np.diag(states[0].covariance)), [stated[0]] * 3 + [attitude, attitude, heading])
    np.testing.assert_allclose(states[0].velocity_covariance, velocity**2 * np.eye(3))


def test_numbers_beside_a_grade_override_it_and_others_stay() -> None:
    errors = OdometryErrors(grade="survey", velocity_mps=0.0, attitude_rad=1e-3)
    assert (errors.velocity_mps, errors.attitude_rad) == (0.0, 1e-3)
    assert (errors.position_m, errors.heading_rad) == pytest.approx((0.1, np.radians(0.005)))
    assert OdometryErrors(attitude_rad=1e-4).heading_rad == 1e-4
    assert not OdometryErrors().is_wrong


def test_a_preset_names_a_grade_and_another_name_is_refused() -> None:
    content = yaml.safe_load((SHIPPED / "small.yaml").read_text(encoding="utf-8"))
    content["impairments"] = {"odometry": {"grade": "navigation", "position_m": 0.3}}
    errors = parse_preset(content, "mine").impairments.odometry
    assert errors == OdometryErrors(grade="navigation", position_m=0.3)
    content["impairments"] = {"odometry": {"grade": "marine"}}
    with pytest.raises(UserError, match=r"grade is 'marine'; it must be 'tactical', 'navigation' or 'survey'"):
        parse_preset(content, "mine")


def test_velocity_is_the_change_of_position_and_forgets_in_its_correlation_time() -> None:
    errors = OdometryErrors(velocity_mps=0.01, correlation_s=5.0)
    drawn = [errors.drawn(np.random.default_rng(seed)) for seed in range(SEEDS)]
    step = 1e-3
    slope = (drawn[0].position(3 + step) - drawn[0].position(3 - step)) / (2 * step)
    np.testing.assert_allclose(slope, drawn[0].velocity(3.0), rtol=1e-4, atol=1e-9)
    product = np.mean([one.velocity(1.0) * one.velocity(6.0) for one in drawn]) / 0.01**2
    assert product == pytest.approx(np.exp(-1), abs=3.5 / np.sqrt(3 * SEEDS) + 0.02)


def test_odometry_without_errors_is_exact_and_states_nothing() -> None:
    flight = flight_of(TRUE, seed=2)
    for state in flight.platform_states(0):
        np.testing.assert_array_equal(state.position, flight.position(state.stamp_ns * 1e-9))
        assert not state.covariance.any()


def test_stated_errors_reach_sigma() -> None:
    field = heights(compressed(flight_with(position_m=0.05)), TRUE.make_sensor(), ESTIMATORS["ml"], MlSettings())
    assert np.nanmin(field.first.sigma) > 0.05


def test_late_odometry_is_corrected_exactly() -> None:
    plain, late = compressed(flight_of(TRUE, seed=2)), compressed(flight_with(delay_s=0.005), odometry_delay_s=0.005)
    np.testing.assert_allclose(late.aperture.position, plain.aperture.position, rtol=0, atol=1e-9)
    np.testing.assert_allclose(late.images, plain.images, rtol=0, atol=1e-5 * np.abs(plain.images).max())


def test_a_roll_that_nobody_describes_raises_heights_until_it_is_corrected() -> None:
    """By R sin(look) for each radian, on the right."""
    roll = 2e-5
    plain, rolled = median_height(flight_of(TRUE, seed=2)), flight_with(undescribed_boresight_rad=(roll, 0.0, 0.0))
    reach = TRUE.flight.slant_range_m * np.sin(TRUE.flight.look_angle_rad)
    assert median_height(rolled) - plain == pytest.approx(roll * reach, rel=0.03)
    assert median_height(rolled, elevation_offset_rad=roll) == pytest.approx(plain, abs=1e-3)


def test_an_antenna_that_is_higher_than_described_sees_the_ground_lower() -> None:
    """Odometry is that of base_link: what is above it by more than is said is taken to be lower than it is."""
    plain = median_height(flight_of(TRUE, seed=2))
    assert median_height(flight_with(undescribed_lever_arm_m=(0.0, 0.0, 0.05))) - plain == pytest.approx(
        -0.05, abs=2e-3
    )


def test_the_mounting_that_is_built_is_the_described_one_turned_about_its_own_axes() -> None:
    turned = OdometryErrors(undescribed_boresight_rad=(0.0, 0.0, np.pi / 2)).built(AT_BASE_LINK)
    np.testing.assert_allclose(turned.axes.apply([1.0, 0.0, 0.0]), [0.0, 1.0, 0.0], atol=1e-12)
    assert OdometryErrors().built(AT_BASE_LINK) is AT_BASE_LINK
    twice = OdometryErrors(undescribed_boresight_rad=(0.0, 0.0, np.pi / 2)).built(turned)
    assert (twice.axes * Rotation.from_euler("z", np.pi)).magnitude() == pytest.approx(0, abs=1e-9)


def test_errors_beyond_their_limits_are_refused() -> None:
    content = yaml.safe_load((SHIPPED / "small.yaml").read_text(encoding="utf-8"))
    content["impairments"] = {"odometry": {"velocity_mps": -1.0}}
    with pytest.raises(UserError, match="velocity_mps"):
        parse_preset(content, "mine")
