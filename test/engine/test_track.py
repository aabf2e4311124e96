"""Odometry that is kept: in order, bounded, and not to be wiped by one wrong stamp."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
from flown_items import samples_of

from sal_height.engine import track
from sal_height.engine.stage import FOREVER_NS
from sal_height.engine.track import Arrival, OdometryHistory, longest_gap_s
from sal_height.geometry import PlatformState

EPOCH_S = 1_700_000_000.0


def state(seconds: float) -> PlatformState:
    still = np.zeros(3)
    return PlatformState(round((EPOCH_S + seconds) * 1e9), still, np.array([0.0, 0, 0, 1]), still, np.zeros((6, 6)))


def history_of(*seconds: float, held_s: float = 100.0) -> OdometryHistory:
    history = OdometryHistory(held_s)
    for moment in seconds:
        history.add(state(moment))
    return history


def around(history: OdometryHistory, start: float, end: float) -> list[float]:
    states = history.around(round((EPOCH_S + start) * 1e9), round((EPOCH_S + end) * 1e9))
    return [round(one.stamp_ns * 1e-9 - EPOCH_S, 3) for one in states]


def test_states_reach_from_before_the_start_to_after_the_end() -> None:
    history = history_of(0.0, 0.1, 0.2, 0.3, 0.4)
    assert around(history, 0.15, 0.25) == [0.1, 0.2, 0.3]
    assert around(history, 0.1, 0.3) == [0.1, 0.2, 0.3]
    assert around(history, 0.15, 0.45) == []
    assert around(history, -0.1, 0.2) == []
    assert around(OdometryHistory(1.0), 0.0, 0.1) == []


def test_covariances_are_kept_of_each_sample() -> None:
    """Equal ones once: in 100 s of odometry they would take more memory than all else."""
    history = OdometryHistory(10.0)
    given = [replace(state(k), velocity_covariance=(k // 2 + 1) * np.eye(3)) for k in range(4)]
    for one in given:
        history.add(one)
    kept = history.around(given[0].stamp_ns, given[3].stamp_ns)
    assert [one.velocity_covariance[0, 0] for one in kept] == [1.0, 1.0, 2.0, 2.0]
    assert kept[0].velocity_covariance is kept[1].velocity_covariance
    assert kept[0].velocity_covariance is not kept[2].velocity_covariance


def test_a_sample_that_was_overtaken_is_put_in_its_place() -> None:
    history = history_of(0.0, 0.1, 0.3)
    assert history.add(state(0.2)) is Arrival.REORDERED
    assert history.add(state(0.4)) is Arrival.IN_ORDER
    assert around(history, 0.0, 0.4) == [0.0, 0.1, 0.2, 0.3, 0.4]


def test_a_sample_that_arrives_twice_is_kept_once() -> None:
    history = history_of(0.0, 0.1, 0.2)
    assert history.add(state(0.1)) is Arrival.REPEATED
    assert len(history) == 3


@pytest.mark.parametrize("wrong", [-EPOCH_S, -50.0, 1e9], ids=["zero", "past", "future"])
def test_one_wrong_stamp_costs_nothing_else(wrong: float) -> None:
    history = history_of(0.0, 0.1)
    assert history.add(state(wrong)) is Arrival.SET_ASIDE
    assert history.add(state(0.2)) is Arrival.IN_ORDER
    assert around(history, 0.0, 0.2) == [0.0, 0.1, 0.2]


def test_two_unset_stamps_are_no_clock_that_starts_again() -> None:
    history = history_of(0.0, 0.1)
    assert [history.add(state(-EPOCH_S)) for _ in range(3)] == [Arrival.SET_ASIDE] * 3
    assert len(history) == 2


def test_a_clock_that_starts_again_is_believed_at_the_second_sample() -> None:
    history = history_of(0.0, 50.0, 50.1)
    assert history.add(state(10.0)) is Arrival.SET_ASIDE
    assert history.add(state(10.1)) is Arrival.RESTARTED
    assert history.add(state(10.2)) is Arrival.IN_ORDER
    assert around(history, 0.0, 10.2) == [0.0, 10.0, 10.1, 10.2]  # what was earlier than the new start stays


def test_a_clock_that_jumps_ahead_is_believed_at_the_second_sample() -> None:
    history = history_of(0.0, 0.1)
    assert [history.add(state(t)) for t in (1000.0, 1000.1)] == [Arrival.SET_ASIDE, Arrival.RESTARTED]
    assert around(history, 1000.0, 1000.1) == [1000.0, 1000.1]


def test_samples_are_kept_by_time() -> None:
    history = history_of(*np.arange(0.0, 50.0, 0.1), held_s=10.0)
    assert around(history, 40.0, 49.9)[0] == 40.0
    assert len(history) <= 2 * 100 + 1


def test_samples_of_one_moment_do_not_pile_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(track, "MOST_STATES", 1000)
    history = history_of(*np.arange(5000) * 1e-6)
    assert len(history) <= 1000


def test_adding_a_sample_costs_the_same_however_many_are_kept() -> None:
    """Copying 100 000 samples for each new one, as a list that is made again would, takes some 0.4 ms."""
    history = history_of(*np.arange(0.0, 100.0, 0.001), held_s=100.0)
    more = [state(100.0 + step * 0.001) for step in range(2000)]
    began = time.process_time()
    for sample in more:
        history.add(sample)
    assert (time.process_time() - began) / len(more) < 50e-6


@pytest.mark.parametrize("step", [-0.9, -0.3])
def test_known_fault_a_clock_that_steps_back_by_less_than_a_second_mixes_two_tracks(step: float) -> None:
    """Its samples are taken for some that were overtaken, and sorted among those of before the step."""
    history = history_of(0.0, 0.2, 0.4, 0.6, 0.8, 1.0)
    after = [1.0 + step + 0.2 * count for count in range(1, 5)]
    arrivals = [history.add(replace(state(moment), position=np.ones(3))) for moment in after]
    assert Arrival.RESTARTED not in arrivals
    assert Arrival.REORDERED in arrivals
    states = history.around(round(EPOCH_S * 1e9), round((EPOCH_S + 1.0) * 1e9))
    assert {one.position[0] for one in states} == {0.0, 1.0}


def may_cover(history: OdometryHistory, start: float, end: float, none_before: float, gap: float = 0.5) -> bool:
    start_ns, end_ns, none_ns = (round((EPOCH_S + moment) * 1e9) for moment in (start, end, none_before))
    return history.may_cover(start_ns, end_ns, none_ns, gap)


def test_a_time_can_be_covered_until_no_sample_that_is_close_enough_can_arrive() -> None:
    history = history_of(0.0, 0.1)
    assert may_cover(history, 0.05, 0.3, -1.0)
    assert may_cover(history, 0.05, 0.3, 0.2)
    assert may_cover(history, 0.05, 0.3, 0.59)  # a sample at 0.59 would do
    assert not may_cover(history, 0.05, 0.3, 0.61)
    assert may_cover(history, 0.05, 0.3, 1e6, gap=np.inf)
    start_ns, end_ns = (round((EPOCH_S + moment) * 1e9) for moment in (0.05, 0.3))
    assert not history.may_cover(start_ns, end_ns, FOREVER_NS, np.inf)


def test_a_time_before_all_samples_cannot_be_covered_once_those_have_passed_it() -> None:
    history = history_of(1.0, 1.1)
    assert may_cover(history, 0.5, 1.05, 0.4)
    assert not may_cover(history, 0.5, 1.05, 0.6)
    assert not may_cover(OdometryHistory(1.0), 0.5, 1.05, 0.6)
    assert may_cover(OdometryHistory(1.0), 0.5, 1.05, 0.5)


def test_a_gap_that_samples_have_passed_stays() -> None:
    history = history_of(0.0, 0.1, 0.9, 1.0)
    assert may_cover(history, 0.05, 0.95, 0.5)  # a sample at 0.5 would do
    assert not may_cover(history, 0.05, 0.95, 0.91)
    assert not may_cover(history, 0.05, 2.0, 1.01)


def test_the_longest_gap_is_that_between_two_samples() -> None:
    assert longest_gap_s([state(0.0), state(0.5), state(0.7)]) == pytest.approx(0.5)
    assert longest_gap_s([]) == longest_gap_s([state(0.0)]) == np.inf


def test_samples_that_are_appended_together_are_as_those_added_one_by_one() -> None:
    rng = np.random.default_rng(3)
    states = [
        replace(
            state(0.1 * number),
            position=rng.normal(size=3),
            orientation=rng.normal(size=4),
            velocity=rng.normal(size=3),
            covariance=(number // 3) * np.eye(6),
            velocity_covariance=(number // 4) * np.eye(3),
        )
        for number in range(40)
    ]
    one_by_one, together = OdometryHistory(100.0), OdometryHistory(100.0)
    together.add(states[0])
    for one in states:
        one_by_one.add(one)
    for first in (1, 2, 20):
        assert together.extend(samples_of(states[first : {1: 2, 2: 20, 20: 40}[first]]))
    assert len(together) == len(one_by_one) == 40
    span = states[0].stamp_ns, states[-1].stamp_ns
    for found, expected in zip(together.around(*span), one_by_one.around(*span), strict=True):
        assert found.stamp_ns == expected.stamp_ns
        for name in ("position", "orientation", "velocity", "covariance", "velocity_covariance"):
            assert getattr(found, name).tobytes() == getattr(expected, name).tobytes(), name
    assert [state.stamp_ns for state in samples_of(states).states()] == [one.stamp_ns for one in states]
    kept = {id(one.covariance) for one in together.around(*span)}
    assert len(kept) < 30  # equal ones are one


def test_samples_out_of_order_are_not_appended_together() -> None:
    assert not OdometryHistory(10.0).extend(samples_of([state(0.0)]))  # the first one begins the history
    for moments in ((0.2, 0.1), (0.3, 0.3), (0.0, 0.1), (0.1, 20.0), (-20.0, -19.0)):
        history = history_of(0.0, held_s=10.0)
        assert not history.extend(samples_of([state(one) for one in moments]))
        assert len(history) == 1


def test_samples_that_are_appended_together_do_not_outlast_the_others() -> None:
    history = history_of(0.0, held_s=1.0)
    for first in range(1, 1000, 10):
        assert history.extend(samples_of([state(0.05 * number) for number in range(first, first + 10)]))
    assert len(history) < 60
