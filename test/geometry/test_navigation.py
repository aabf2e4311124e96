"""Platform states from positions, velocities and attitudes that come apart."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sal_height.errors import Rejected
from sal_height.geometry import Navigation, Origin, PlatformState, Sample
from sal_height.geometry.geodesy import local_axes

RADIUS, RATE = 400.0, 0.125
"""Of the turn that the platform flies, m and rad/s: it has 50 m/s."""

NO = np.zeros((3, 3))
START_NS = 1_700_000_000_000_000_000
GAP_S = 0.5


def ns(seconds: float) -> int:
    return START_NS + round(seconds * 1e9)


def position(seconds: float) -> np.ndarray:
    angle = RATE * seconds
    return np.array([RADIUS * np.sin(angle), RADIUS * (1 - np.cos(angle)), 300.0])


def velocity(seconds: float) -> np.ndarray:
    angle = RATE * seconds
    return RADIUS * RATE * np.array([np.cos(angle), np.sin(angle), 0.0])


def attitude(seconds: float) -> np.ndarray:
    return Rotation.from_euler("ZYX", [RATE * seconds, 0.02, 0.1 * np.sin(seconds)]).as_quat()


def in_order(navigation: Navigation, events: list[tuple[float, str]]) -> list[PlatformState]:
    """Feed samples (time, kind) in the order of their times, as they are measured; nothing may be declined."""
    states: list[PlatformState] = []
    for seconds, kind in sorted(events):
        feed(navigation, seconds, kind)
        found, declined = navigation.take()
        assert not declined
        states += found
    return states


def feed(navigation: Navigation, seconds: float, kind: str) -> None:
    if kind == "position":
        navigation.add_position(Sample(ns(seconds), position(seconds), NO))
    elif kind == "velocity":
        navigation.add_velocity(Sample(ns(seconds), velocity(seconds), NO), in_body=False)
    elif kind == "body velocity":
        turned = Rotation.from_quat(attitude(seconds)).inv().apply(velocity(seconds))
        navigation.add_velocity(Sample(ns(seconds), turned, NO), in_body=True)
    else:
        navigation.add_attitude(Sample(ns(seconds), attitude(seconds), NO))


def seconds_of(state: PlatformState) -> float:
    return (state.stamp_ns - START_NS) * 1e-9


def at_rate(hz: float, kind: str, begin: float = 0.0, end: float = 4.0) -> list[tuple[float, str]]:
    return [(float(t), kind) for t in np.arange(begin, end, 1 / hz)]


def test_samples_of_the_same_times_are_states_as_they_are() -> None:
    """Pose and twist at once: nothing is interpolated, to the last bit."""
    events = [(t, kind) for t in np.arange(0, 2, 0.02) for kind in ("attitude", "position", "velocity")]
    states = in_order(Navigation(GAP_S, velocity_is_measured=True), events)
    assert len(states) == 100
    for state in states:
        t = seconds_of(state)
        np.testing.assert_allclose(state.position, position(t), rtol=0, atol=1e-6)  # 1 ns of 50 m/s is 50 nm
        np.testing.assert_allclose(state.velocity, velocity(t), rtol=0, atol=1e-6)
        np.testing.assert_allclose(state.orientation, attitude(t), rtol=0, atol=1e-6)


@pytest.mark.parametrize("kind", ["velocity", "body velocity"])
def test_a_velocity_between_two_samples_is_off_by_the_bend_of_its_course(kind: str) -> None:
    """Twists every 40 ms, half way between poses: 1/8 of the second derivative, v RATE^2 h^2 / 8 = 0.16 mm/s.

    In body axes it is the roll of up to 0.1 rad that bends the course of the 1 m/s along the axis that is up.
    """
    events = at_rate(25, kind, 0.02) + at_rate(25, "position", 0.04) + at_rate(25, "attitude", 0.0)
    navigation = Navigation(GAP_S, velocity_is_measured=True)
    errors = []
    for seconds, what in sorted(events, key=lambda event: (event[0], event[1] != "position")):
        feed(navigation, seconds, what)
        states, _ = navigation.take()
        errors += [np.linalg.norm(state.velocity - velocity(seconds_of(state))) for state in states]
    assert len(errors) > 90
    second = {"velocity": 50 * RATE**2, "body velocity": 50 * np.sin(0.02) * 0.1}[kind]
    assert max(errors) == pytest.approx(second * 0.04**2 / 8, rel=0.03)


def test_states_between_fixes_are_off_by_the_remainders_of_parabola_and_cubic() -> None:
    """Fixes every 0.1 s, attitudes every 10 ms, no twist.

    The slope of a parabola through three points of distance h is off by p''' h^2 / 6 = v RATE^2 h^2 / 6 = 1.3 mm/s, and
    so is the velocity at these points. Equal errors e of its slopes move a cubic by h e s (1 - s) (1 - 2 s), 0.096 h e
    at most; its own remainder p'''' h^4 / 384 is 25 nm.
    """
    h = 0.1
    states = in_order(
        Navigation(GAP_S, velocity_is_measured=False), at_rate(1 / h, "position") + at_rate(100, "attitude", 0.2)
    )
    speed = RADIUS * RATE
    slope_error = speed * RATE**2 * h**2 / 6
    worst_velocity = max(np.linalg.norm(s.velocity - velocity(seconds_of(s))) for s in states)
    worst_position = max(np.linalg.norm(s.position - position(seconds_of(s))) for s in states)
    assert len(states) > 350
    assert worst_velocity == pytest.approx(slope_error, rel=0.03)
    assert worst_position == pytest.approx(0.0962 * h * slope_error, rel=0.03)


def test_attitudes_of_an_inertial_unit_are_turned_into_map_axes() -> None:
    """30 km from the origin up differs by 5 mrad, which would be 16 m of height."""
    origin = Origin(0.84, 0.2, 0.0)
    latitude, longitude = 0.8445, 0.2015
    place, still = origin.to_map(latitude, longitude, 3000.0), np.array([50.0, 0.0, 0.0])
    navigation = Navigation(GAP_S, velocity_is_measured=True, local_to=origin)
    navigation.add_attitude(Sample(ns(0.0), attitude(1.0), NO))
    navigation.add_velocity(Sample(ns(0.0), still, NO), in_body=True)
    navigation.add_position(Sample(ns(0.0), place, NO))
    (state,), _ = navigation.take()
    turn = local_axes(0.84, 0.2) @ local_axes(latitude, longitude).T
    expected = turn @ Rotation.from_quat(attitude(1.0)).as_matrix()
    np.testing.assert_allclose(Rotation.from_quat(state.orientation).as_matrix(), expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(state.velocity, expected @ still, rtol=0, atol=1e-7)
    assert np.arccos(turn[2, 2]) == pytest.approx(4.6e-3, rel=0.02)


def test_covariances_stand_in_their_places() -> None:
    navigation = Navigation(GAP_S, velocity_is_measured=True)
    navigation.add_velocity(Sample(ns(0.0), velocity(0.0), NO), in_body=False)
    navigation.add_position(Sample(ns(0.0), position(0.0), np.diag([1.0, 2.0, 3.0])))
    navigation.add_attitude(Sample(ns(0.0), attitude(0.0), np.diag([4.0, 5.0, 6.0])))
    (state,), _ = navigation.take()
    np.testing.assert_array_equal(state.covariance, np.diag([1.0, 2, 3, 4, 5, 6]))


def reasons(declined: list[Rejected]) -> set[str]:
    return {reason.reason for reason in declined}


def test_attitudes_in_a_gap_are_declined_and_those_after_it_are_not() -> None:
    navigation = Navigation(GAP_S, velocity_is_measured=True)
    states: list[PlatformState] = []
    declined: list[Rejected] = []
    without = [event for event in at_rate(10, "position") if not 1.05 < event[0] < 2.25]
    for event in sorted(without + at_rate(10, "velocity") + at_rate(50, "attitude", 0.0)):
        feed(navigation, *event)
        found, refused = navigation.take()
        states, declined = states + found, declined + refused
    times = np.array([seconds_of(state) for state in states])
    assert reasons(declined) == {"position gap", "no position"}
    assert any("longest_gap_s" in str(reason) for reason in declined)
    assert not np.any((times > 1.01) & (times < 2.29))
    assert np.sum(times < 1.01) == 51
    assert times[-1] > 3.85
    assert len(states) + len(declined) >= 200 - 6  # all but those that still wait for the next position


@pytest.mark.parametrize("at", [[0.0, 0.9, 1.0], [0.0, 0.1, 1.0]], ids=["before", "after"])
def test_no_velocity_is_a_difference_of_positions_with_a_gap_between(at: list[float]) -> None:
    navigation = Navigation(GAP_S, velocity_is_measured=False)
    for seconds in at:
        feed(navigation, seconds, "position")
    feed(navigation, at[1], "attitude")
    states, declined = navigation.take()
    assert not states
    assert reasons(declined) == {"position gap"}


@pytest.mark.parametrize("kind", ["position", "velocity"])
def test_attitudes_do_not_wait_for_ever_for_what_does_not_come(kind: str) -> None:
    navigation = Navigation(GAP_S, velocity_is_measured=True)
    others = {"position", "velocity", "attitude"} - {kind}
    declined: list[Rejected] = []
    for event in sorted(event for other in others for event in at_rate(100, other, 0.0, 10.0)):
        feed(navigation, *event)
        found, refused = navigation.take()
        assert not found
        declined += refused
    assert reasons(declined) == {f"no {kind}"}
    assert len(declined) >= 1000 - 101  # those of the last second still wait
    assert len(navigation._attitudes.samples) < 320
    assert all(len(series.samples) < 320 for series in (navigation._positions, navigation._velocities))


def test_without_attitudes_what_is_held_does_not_grow() -> None:
    navigation = Navigation(GAP_S, velocity_is_measured=True)
    for event in sorted(at_rate(100, "position", 0.0, 20.0) + at_rate(100, "velocity", 0.0, 20.0)):
        feed(navigation, *event)
        navigation.take()
    assert [len(series.samples) for series in (navigation._positions, navigation._velocities)] == [401, 401]


def test_what_is_held_does_not_grow() -> None:
    """Twice the longest gap of each kind, and a gap of attitudes that wait."""
    navigation = Navigation(GAP_S, velocity_is_measured=True)
    in_order(navigation, [e for kind in ("attitude", "position", "velocity") for e in at_rate(100, kind, 0.0, 20.0)])
    held = [navigation._positions, navigation._velocities, navigation._attitudes]
    assert [len(series.samples) for series in held] == [101, 101, 101]


@pytest.mark.parametrize("late_s", [0.0, 0.5])
def test_a_late_sample_is_refused(late_s: float) -> None:
    navigation = Navigation(GAP_S, velocity_is_measured=True)
    feed(navigation, 1.0, "position")
    with pytest.raises(Rejected, match="Do two sources publish") as refusal:
        feed(navigation, 1.0 - late_s, "position")
    assert refusal.value.reason == "late position"
    assert navigation.take() == ([], [])


def test_a_clock_that_starts_anew_is_followed() -> None:
    navigation = Navigation(GAP_S, velocity_is_measured=True)
    events = [(t, kind) for t in np.arange(0, 2, 0.02) for kind in ("attitude", "position", "velocity")]
    before = in_order(navigation, [(t + 1000.0, kind) for t, kind in events])
    first, *others = events
    feed(navigation, *first)
    states, declined = navigation.take()
    assert (states, reasons(declined)) == ([], {"clock restarted"})
    after = in_order(navigation, others)
    assert [s.stamp_ns - ns(1000.0) for s in before] == pytest.approx([s.stamp_ns - ns(0.0) for s in after], abs=2)
