"""Odometry whose covariances state nothing: what is assumed of it covers its errors, and decides nothing."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from sal_height.elevation import ESTIMATORS
from sal_height.geometry import EXACT, Mounting, OdometryAccuracy, Trajectory, shift_along
from sal_height.imaging import UNKNOWN_ODOMETRY, Centroid, ImageSettings, Placement, Processing, Slc, line_of_sight
from sal_height.numeric import F64
from sal_height.pipeline import Compressor, heights
from sal_height.runs.truth.comparison import PublishedErrors, compare, joined_errors
from sal_height.runs.truth.surface_report import as_flown, true_surfaces
from sal_height.simulation import SimulatedFlight, flight_of, load_preset
from sal_height.simulation.impairments import Impairments

STATED = np.diag([0.02, 0.03, 0.05, 1e-6, 2e-6, 3e-6]) ** 2
SPEEDS = np.diag([1e-5, 2e-5, 3e-5]) ** 2
ZEROS, NO_SPEEDS = np.zeros((6, 6)), np.zeros((3, 3))
UNKNOWN = OdometryAccuracy()
SIZE = ImageSettings(rows=30, cols=8)


@cache
def small_flight() -> SimulatedFlight:
    return flight_of(load_preset("small"), seed=1)


def compressed(
    flight: SimulatedFlight,
    pose: F64,
    velocity: F64,
    accuracy: OdometryAccuracy = UNKNOWN,
    dwell: int = 0,
    settings: ImageSettings = SIZE,
) -> Slc:
    """Images of a dwell whose odometry states these covariances."""
    states = [replace(one, covariance=pose, velocity_covariance=velocity) for one in flight.track(dwell).states]
    slc = Compressor().add(flight.phase_history(dwell), Trajectory(states, accuracy=accuracy), flight.sensor, settings)
    assert slc is not None
    return slc


def added(pose: F64, velocity: F64, flight: SimulatedFlight | None = None) -> F64:
    """What is assumed of the pose in addition to what is stated."""
    flight = flight or small_flight()
    with_it, without = (compressed(flight, pose, velocity, accuracy) for accuracy in (UNKNOWN, EXACT))
    assert np.array_equal(with_it.images, without.images)
    return with_it.aperture.covariance - without.aperture.covariance


def along_the_flight() -> F64:
    """Covariance of the position, shape (3, 3): pulses of a lidar do not show by what multiple an attitude is off."""
    flight, aperture = small_flight(), compressed(small_flight(), STATED, SPEEDS).aperture
    sight = line_of_sight(flight.sensor, aperture)
    pointing = np.cross(sight, aperture.direction) ** 2 @ [4e-6, 4e-6, 1e-4]
    along = flight.preset.flight.slant_range_m * shift_along(aperture, sight)
    return pointing * np.outer(along, along)


def test_what_is_stated_is_left_as_it_is() -> None:
    for accuracy in (UNKNOWN, EXACT, OdometryAccuracy(1.0, 1.0, 1.0, 1.0)):
        slc = compressed(small_flight(), STATED, SPEEDS, accuracy)
        assert not slc.doubts
        np.testing.assert_array_equal(
            slc.aperture.covariance, compressed(small_flight(), STATED, SPEEDS).aperture.covariance
        )


def test_each_block_adds_what_is_assumed_of_it() -> None:
    position, attitude = STATED.copy(), STATED.copy()
    position[:3], attitude[3:] = 0.0, 0.0
    np.testing.assert_allclose(added(position, SPEEDS), np.diag([4.0] * 3 + [0.0] * 3), atol=1e-12)
    found = added(attitude, SPEEDS)
    np.testing.assert_allclose(found[3:], np.diag([0.0] * 3 + [4e-6, 4e-6, 1e-4])[3:], atol=1e-12)
    np.testing.assert_allclose(found[:3, :3], along_the_flight(), rtol=0.01, atol=1e-3)


def test_an_unknown_velocity_moves_the_image_along_the_flight() -> None:
    """By range over speed times 0.05 m/s."""
    flight, slc = small_flight(), compressed(small_flight(), STATED, NO_SPEEDS)
    aperture = slc.aperture
    reach = flight.preset.flight.slant_range_m / float(np.linalg.norm(aperture.velocity)) * 0.05
    along = reach * shift_along(aperture, line_of_sight(flight.sensor, aperture))
    expected = np.zeros((6, 6))
    expected[:3, :3] = np.outer(along, along)
    np.testing.assert_allclose(added(STATED, NO_SPEEDS), expected, atol=1e-3 * reach**2)
    assert np.sqrt(np.trace(expected)) == pytest.approx(reach, rel=0.1)


def test_an_unknown_attitude_moves_the_antenna_at_the_end_of_its_arm() -> None:
    """Two metres below base_link: roll and pitch of 2 mrad move it by 4 mm."""
    plain = small_flight()
    sensor = replace(plain.sensor, mounting=Mounting(lever_arm=(0.0, 0.0, -2.0)), config_hash="")
    attitude = STATED.copy()
    attitude[3:] = 0.0
    found = added(attitude, SPEEDS, replace(plain, sensor=sensor))
    np.testing.assert_allclose(np.sqrt(found.diagonal()[1:3]), [4e-3, 0.0], atol=2e-4)


@pytest.mark.parametrize(
    ("placement", "expected"),
    [
        (Placement(0.0, 0.0, 0.0), 0.05),
        (Placement(0.0, 0.0, 0.0, by_beams=True), 0.3),
        (Placement(0.0, 1e-4, 0.0, Centroid(0.005, 1e-5)), 0.05),
        (Placement(0.12, 2e-5, 0.0, Centroid(0.121, 1e-5)), 0.13),
    ],
    ids=["navigation", "beams", "all of it pointing", "nearly all of it velocity"],
)
def test_an_image_that_data_have_placed_moves_with_what_they_leave_open(placement: Placement, expected: float) -> None:
    """An offset that counted as velocity may be that of the pointing."""
    assert placement.residual_speed(0.05, 0.3) == pytest.approx(expected)
    assert placement.residual_speed(0.05, 0.0) == (0.0 if placement.by_beams else 0.05)


def test_what_is_assumed_turns_no_autofocus_on_and_what_is_stated_does() -> None:
    flight = flight_of(replace(load_preset("sal_realistic"), impairments=Impairments()), seed=1)
    settings = ImageSettings(rows=184, cols=12)
    assert compressed(flight, ZEROS, NO_SPEEDS, settings=settings).focus is None
    stated = OdometryAccuracy(0.05, 0.005, 4e-5, 4e-5)
    by_parameters = compressed(flight, ZEROS, NO_SPEEDS, stated, settings=settings)
    pose = np.diag([0.05] * 3 + [4e-5] * 3) ** 2
    by_covariances = compressed(flight, pose, 0.005**2 * np.eye(3), settings=settings)
    assert by_parameters.focus is not None
    assert not by_parameters.doubts
    np.testing.assert_array_equal(by_parameters.images, by_covariances.images)
    np.testing.assert_allclose(by_parameters.aperture.covariance, by_covariances.aperture.covariance, rtol=1e-9)


def test_the_doubt_states_what_is_unknown_what_is_assumed_and_what_to_do() -> None:
    (doubt,) = compressed(small_flight(), ZEROS, NO_SPEEDS, OdometryAccuracy(heading_rad=0.0)).doubts
    assert doubt.name == UNKNOWN_ODOMETRY
    assert np.isnan(doubt.size)
    assert "heading" not in doubt.sentence
    for part in (
        "The odometry does not state how well it is known (",
        "position 2 m, roll and pitch 0.002 rad and velocity 0.05 m/s.",
        "odometry_position_sigma_m, odometry_attitude_sigma_rad and odometry_velocity_sigma_mps",
    ):
        assert part in doubt.sentence


def test_images_of_a_strip_are_doubted_and_covered() -> None:
    flight = flight_of(replace(load_preset("sal_stripmap"), dwells=4), seed=1)
    settings, found = ImageSettings(rows=16, cols=128), []
    histories = [flight.phase_history(block) for block in range(4)]
    for accuracy in (UNKNOWN, EXACT):
        compressor = Compressor()
        for block, history in enumerate(histories):
            states = [replace(one, covariance=ZEROS) for one in flight.track(block).states]
            track = Trajectory(states, accuracy=accuracy)
            if slc := compressor.add(history, track, flight.sensor, settings):
                found.append(slc)
    half = len(found) // 2
    assert half
    for unknown, exact in zip(found[:half], found[half:], strict=True):
        assert [doubt.name for doubt in unknown.doubts] == [UNKNOWN_ODOMETRY]
        assert not exact.doubts
        added = unknown.aperture.covariance - exact.aperture.covariance
        speed = float(np.linalg.norm(unknown.aperture.velocity))
        reach = flight.preset.flight.slant_range_m
        turn = np.cross(line_of_sight(flight.sensor, unknown.aperture), unknown.aperture.direction)
        pointing = float(np.sqrt(turn**2 @ [4e-6, 4e-6, 1e-4]))
        along = float(np.linalg.norm([2.0, 0.05 * reach / speed, pointing * reach]))
        assert np.sqrt(np.linalg.eigvalsh(added[:3, :3])[-1]) == pytest.approx(along, rel=0.02)
        np.testing.assert_allclose(added[3:, 3:], np.diag([4e-6, 4e-6, 1e-4]), rtol=1e-9, atol=1e-15)


def errors_of(flight: SimulatedFlight, dwell: int, accuracy: OdometryAccuracy) -> PublishedErrors:
    """Errors of the heights of a dwell whose odometry states zeros."""
    settings = ImageSettings(rows=flight.preset.image.rows, cols=flight.preset.image.cols)
    slc, ml = compressed(flight, ZEROS, NO_SPEEDS, accuracy, dwell, settings), ESTIMATORS["ml"]
    field = heights(slc, flight.sensor, ml, ml.settings(range_looks=2, azimuth_looks=2))
    seen, aperture = as_flown(field, slc.aperture, flight, dwell)
    processing = Processing(settings.range_window, settings.azimuth_window)
    truth = true_surfaces(seen, aperture, processing, (2, 2), flight, flight.surface(dwell))
    return compare(field, truth, flight.sensor.beamwidth).errors


def test_heights_with_odometry_that_states_nothing_are_within_five_sigma() -> None:
    """By the errors of sal_realistic: of three flights at most 0.2 %, and more than 20 % where zeros count as exact."""
    preset = load_preset("sal_realistic")
    preset = replace(preset, impairments=Impairments(odometry=preset.impairments.odometry))
    flights = [flight_of(preset, seed) for seed in range(3)]
    beyond = []
    for accuracy in (UNKNOWN, EXACT):
        errors = joined_errors([errors_of(flight, 5 * seed, accuracy) for seed, flight in enumerate(flights)])
        beyond.append(float(np.mean(np.abs(errors.nearest) > 5 * errors.sigma)))
    assert beyond[0] <= 0.002
    assert beyond[1] > 0.2
