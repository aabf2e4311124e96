"""The track between odometry samples, to a small part of an optical wavelength."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import refused
from scipy.spatial.transform import Rotation

from sal_height.errors import UserError
from sal_height.geometry import OdometryAccuracy, PlatformState, Trajectory

EPOCH_NS = 1_700_000_000_123_456_789
COEFFICIENTS = np.array([[3.1, -7.2, 3535.5], [48.0, -2.0, 0.5], [0.7, 3.0, -2.0], [-5.0, 11.0, 7.0]])
ROLL_RATE = 0.8


def position(seconds: np.ndarray) -> np.ndarray:
    """A cubic track."""
    return np.power.outer(seconds, np.arange(4)) @ COEFFICIENTS


def velocity(seconds: float) -> np.ndarray:
    return np.array([0, 1, 2 * seconds, 3 * seconds**2]) @ COEFFICIENTS


def state(offset_ns: int) -> PlatformState:
    seconds = offset_ns * 1e-9
    return PlatformState(
        stamp_ns=EPOCH_NS + offset_ns,
        position=position(np.array(seconds)),
        orientation=Rotation.from_euler("x", ROLL_RATE * seconds).as_quat(),
        velocity=velocity(seconds),
        covariance=np.full((6, 6), seconds),
    )


@pytest.fixture
def track() -> Trajectory:
    return Trajectory([state(offset) for offset in (0, 7_000_001, 10_000_000, 19_999_999, 30_000_000)])


def test_cubic_track_is_interpolated_to_a_picometre(track: Trajectory) -> None:
    """At stamps of 1.7e18 ns, where float64 seconds are 0.2 us apart: 1e-5 m at 50 m/s."""
    start_ns, after = 3_333_333, np.linspace(0, 0.026, 40)
    error = track.positions(EPOCH_NS + start_ns, after) - position(start_ns * 1e-9 + after)
    assert np.abs(error).max() < 2e-12  # four steps of float64 at 3535 m


def test_aperture_is_the_state_in_the_middle_of_the_pulses(track: Trajectory) -> None:
    start_ns, pulses = 4_000_000, np.arange(9) * 1e-3
    aperture = track.aperture(EPOCH_NS + start_ns, pulses)
    middle = 0.008
    np.testing.assert_allclose(aperture.position, position(np.array(middle)), atol=2e-12)
    np.testing.assert_allclose(aperture.velocity, velocity(middle), atol=1e-9)
    np.testing.assert_allclose(aperture.rotation, Rotation.from_euler("x", ROLL_RATE * middle).as_matrix(), atol=1e-12)
    # Each of the nine pulses stands for one pulse interval.
    assert aperture.length == pytest.approx(np.linalg.norm(velocity(middle)) * 9e-3, rel=1e-9)
    assert aperture.covariance[0, 0] == pytest.approx(0.007_000_001)  # of the nearest sample


def test_whole_track_may_be_used(track: Trajectory) -> None:
    ends = track.positions(EPOCH_NS, np.array([0.0, 0.03]))
    np.testing.assert_allclose(ends, position(np.array([0.0, 0.03])), atol=2e-12)


def test_odometry_may_end_with_the_last_pulse() -> None:
    """Stamps are rounded to nanoseconds, pulse times are not."""
    pulse_times = np.arange(25) / 117
    track = Trajectory([state(round(seconds * 1e9)) for seconds in pulse_times])
    np.testing.assert_allclose(track.positions(EPOCH_NS, pulse_times), position(pulse_times), atol=1e-7)


@pytest.mark.parametrize(("start_ns", "duration"), [(-1000, 0.01), (29_000_000, 0.001_001), (10**12, 0.01)])
def test_times_outside_the_track_are_refused(track: Trajectory, start_ns: int, duration: float) -> None:
    for request in (track.positions, track.aperture):
        with refused(UserError, "0.000000 to 0.030000 s", "must cover the whole aperture"):
            request(EPOCH_NS + start_ns, np.array([0.0, duration]))


def test_one_state_is_no_track() -> None:
    with refused(UserError, "1 samples", "2 or more"):
        Trajectory([state(0)])


@pytest.mark.parametrize("offsets", [(0, 0), (0, 2_000_000, 1_000_000)])
def test_times_that_do_not_increase_are_refused(offsets: tuple[int, ...]) -> None:
    with refused(UserError, "do not increase"):
        Trajectory([state(offset) for offset in offsets])


def level_states(velocity: float, sigma: float = 0.0) -> list[PlatformState]:
    """A platform that makes 50 m/s east and states `velocity`, with positions known to `sigma` along each axis."""
    level, covariance = np.array([0.0, 0, 0, 1]), sigma**2 * np.eye(6)
    return [
        PlatformState(
            EPOCH_NS + t * 1_000_000, np.array([0.05 * t, 0, 0]), level, np.array([velocity, 0, 0]), covariance
        )
        for t in (0, 10, 20)
    ]


def test_velocity_that_the_positions_contradict_is_refused() -> None:
    """Up to a tenth is left to them, and three standard deviations of the positions: here 6 sqrt(2) sigma / 10 ms."""
    for states in (level_states(45.1), level_states(54.9), level_states(0.0, sigma=0.054)):
        assert Trajectory(states).epoch_ns == EPOCH_NS
    for states in (level_states(44.9), level_states(55.1), level_states(-50.0), level_states(0.0, sigma=0.052)):
        with refused(UserError, f"{states[0].velocity.tolist()} m/s", "positions [50.0, 0.0, 0.0]"):
            Trajectory(states)


def test_a_height_that_is_not_known_does_not_hide_a_wrong_velocity_along_the_ground() -> None:
    """30 m of standard deviation, as of an altitude above an unknown level, allow any velocity upwards."""
    above_unknown = np.diag([1e-6, 1e-6, 900.0, 0, 0, 0])
    with refused(UserError, "positions [50.0, 0.0, 0.0]"):
        Trajectory([replace(one, covariance=above_unknown) for one in level_states(0.0)])
    climbing = [replace(one, velocity=np.array([50.0, 0, 6.0])) for one in level_states(50.0)]
    with refused(UserError, "positions [50.0, 0.0, 0.0]"):
        Trajectory(climbing)
    assert Trajectory([replace(one, covariance=above_unknown) for one in climbing]).states


def test_platform_that_stands_still_is_refused() -> None:
    still = [
        PlatformState(EPOCH_NS + t, np.zeros(3), np.array([0.0, 0, 0, 1]), np.zeros(3), np.zeros((6, 6)))
        for t in (0, 10_000_000)
    ]
    with refused(UserError, "velocity is 0"):
        Trajectory(still).aperture(EPOCH_NS, np.array([0.0, 0.005]))


def milliseconds(track: Trajectory) -> list[int]:
    """Times of the states after the epoch, ms."""
    return [(one.stamp_ns - EPOCH_NS) // 10**6 for one in track.states]


def every_millisecond(first: int, count: int) -> Trajectory:
    return Trajectory([state((first + number) * 10**6) for number in range(count)])


@pytest.mark.parametrize(
    ("start", "end", "expected"), [(2.5, 4.5, [2, 3, 4, 5]), (2, 4, [2, 3, 4]), (-1, 99, list(range(10)))]
)
def test_a_part_of_a_track_reaches_to_the_samples_around_it(start: float, end: float, expected: list[int]) -> None:
    part = every_millisecond(0, 10).between(EPOCH_NS + round(start * 1e6), EPOCH_NS + round(end * 1e6))
    assert milliseconds(part) == expected


def test_a_later_track_takes_the_place_of_the_end_of_an_earlier_one() -> None:
    earlier, later = every_millisecond(0, 6), every_millisecond(4, 5)
    joined = earlier.followed_by(later)
    assert milliseconds(joined) == list(range(9))
    assert joined.states[4] is later.states[0]
    assert later.followed_by(earlier).states == earlier.states


def test_covariance_of_the_velocity_is_that_of_the_nearest_sample_in_axes_of_map() -> None:
    """States a quarter turn to the left: forward is north."""
    north = Rotation.from_euler("z", 90, degrees=True).as_quat()
    states = [
        replace(state(offset), orientation=north, velocity_covariance=np.diag([factor, 2.0 * factor, 3.0 * factor]))
        for offset, factor in ((0, 1.0), (7_000_001, 10.0), (10_000_000, 100.0))
    ]
    found = Trajectory(states).velocity_covariance(EPOCH_NS, np.array([0.004, 0.009]))
    np.testing.assert_allclose(found, np.diag([20.0, 10.0, 30.0]), atol=1e-12)


def test_an_accuracy_that_is_stated_counts_where_covariances_state_none() -> None:
    """In the axes of map, and at the nearest sample."""
    states = [replace(state(offset), covariance=np.zeros((6, 6))) for offset in (0, 10_000_000)]
    track = Trajectory(states, accuracy=OdometryAccuracy(3.0, 0.2, 0.01, 0.05)).of_states(states)
    times = np.array([0.0, 0.004])
    expected = np.diag([3.0, 3.0, 3.0, 0.01, 0.01, 0.05]) ** 2
    np.testing.assert_array_equal(track.aperture(EPOCH_NS, times).covariance, expected)
    np.testing.assert_allclose(track.velocity_covariance(EPOCH_NS, times), 0.04 * np.eye(3), atol=1e-15)
    assert not track.assumed(EPOCH_NS, times).of_samples.any()


def test_an_accuracy_that_nobody_states_is_assumed_and_is_no_covariance() -> None:
    states = [replace(state(offset), covariance=np.zeros((6, 6))) for offset in (0, 10_000_000)]
    track, times = Trajectory(states), np.array([0.0, 0.004])
    assert not track.aperture(EPOCH_NS, times).covariance.any()
    assert not track.velocity_covariance(EPOCH_NS, times).any()
    np.testing.assert_array_equal(
        np.sqrt(track.assumed(EPOCH_NS, times).of_samples), [2, 2, 2, 2e-3, 2e-3, 1e-2, 0.05, 0.05, 0.05]
    )


@pytest.mark.parametrize("unknown", range(3))
def test_one_sample_around_the_pulses_that_states_nothing_is_enough(unknown: int) -> None:
    """That of the first, of the middle or of the last of the pulses; others of the track do not count."""
    stated = {"covariance": np.diag([1e-4] * 3 + [1e-8] * 3), "velocity_covariance": 1e-4 * np.eye(3)}
    states = [replace(state(number * 1_000_000), **stated) for number in range(5)]
    times = np.array([1e-3, 2e-3, 3e-3])
    assert not Trajectory(states).assumed(EPOCH_NS, times).of_samples.any()
    without = {place: replace(states[place], velocity_covariance=np.zeros((3, 3))) for place in (0, unknown + 1, 4)}
    for place in (0, 4):
        elsewhere = Trajectory([*states[:place], without[place], *states[place + 1 :]])
        assert not elsewhere.assumed(EPOCH_NS, times).of_samples.any()
    states[unknown + 1] = without[unknown + 1]
    assert np.flatnonzero(Trajectory(states).assumed(EPOCH_NS, times).of_samples).tolist() == [6, 7, 8]


@pytest.mark.parametrize("unknown", [np.nan, 1e10])
def test_positions_of_unknown_accuracy_are_compared_with_velocities_all_the_same(unknown: float) -> None:
    states = [replace(one, covariance=unknown * np.eye(6)) for one in level_states(0.0)]
    with refused(UserError, "[0.0, 0.0, 0.0] m/s", "positions [50.0, 0.0, 0.0]"):
        Trajectory(states)
