"""Held odometry: in order, bounded, and not to be wiped by one wrong stamp."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest

from sal_height.geometry import PlatformState
from sal_height.nodes import odometry
from sal_height.nodes.odometry import Arrival, OdometryHistory

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


def test_covariances_are_held_of_each_sample() -> None:
    """Equal ones once: in 100 s of odometry they would take more memory than all else."""
    history = OdometryHistory(10.0)
    given = [replace(state(k), velocity_covariance=(k // 2 + 1) * np.eye(3)) for k in range(4)]
    for one in given:
        history.add(one)
    held = history.around(given[0].stamp_ns, given[3].stamp_ns)
    assert [one.velocity_covariance[0, 0] for one in held] == [1.0, 1.0, 2.0, 2.0]
    assert held[0].velocity_covariance is held[1].velocity_covariance
    assert held[0].velocity_covariance is not held[2].velocity_covariance


def test_a_sample_that_was_overtaken_takes_its_place() -> None:
    history = history_of(0.0, 0.1, 0.3)
    assert history.add(state(0.2)) is Arrival.REORDERED
    assert history.add(state(0.4)) is Arrival.IN_ORDER
    assert around(history, 0.0, 0.4) == [0.0, 0.1, 0.2, 0.3, 0.4]


def test_a_sample_that_comes_twice_is_held_once() -> None:
    history = history_of(0.0, 0.1, 0.2)
    assert history.add(state(0.1)) is Arrival.REPEATED
    assert len(history) == 3


@pytest.mark.parametrize("wrong", [-EPOCH_S, -50.0, 1e9], ids=["zero", "past", "future"])
def test_one_wrong_stamp_costs_nothing_else(wrong: float) -> None:
    history = history_of(0.0, 0.1)
    assert history.add(state(wrong)) is Arrival.SET_ASIDE
    assert history.add(state(0.2)) is Arrival.IN_ORDER
    assert around(history, 0.0, 0.2) == [0.0, 0.1, 0.2]


def test_two_unset_stamps_are_no_clock_that_starts_anew() -> None:
    history = history_of(0.0, 0.1)
    assert [history.add(state(-EPOCH_S)) for _ in range(3)] == [Arrival.SET_ASIDE] * 3
    assert len(history) == 2


def test_a_clock_that_starts_anew_is_believed_at_the_second_sample() -> None:
    history = history_of(0.0, 50.0, 50.1)
    assert history.add(state(10.0)) is Arrival.SET_ASIDE
    assert history.add(state(10.1)) is Arrival.RESTARTED
    assert history.add(state(10.2)) is Arrival.IN_ORDER
    assert around(history, 0.0, 10.2) == [0.0, 10.0, 10.1, 10.2]  # what was earlier than the new start stays


def test_a_clock_that_jumps_ahead_is_believed_at_the_second_sample() -> None:
    history = history_of(0.0, 0.1)
    assert [history.add(state(t)) for t in (1000.0, 1000.1)] == [Arrival.SET_ASIDE, Arrival.RESTARTED]
    assert around(history, 1000.0, 1000.1) == [1000.0, 1000.1]


def test_samples_are_held_by_time() -> None:
    history = history_of(*np.arange(0.0, 50.0, 0.1), held_s=10.0)
    assert around(history, 40.0, 49.9)[0] == 40.0
    assert len(history) <= 2 * 100 + 1


def test_samples_of_one_moment_do_not_pile_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(odometry, "MOST_STATES", 1000)
    history = history_of(*np.arange(5000) * 1e-6)
    assert len(history) <= 1000


def test_taking_a_sample_in_costs_the_same_however_many_are_held() -> None:
    """Copying 100 000 samples for each new one, as a list that is made anew would, takes some 0.4 ms."""
    history = history_of(*np.arange(0.0, 100.0, 0.001), held_s=100.0)
    more = [state(100.0 + step * 0.001) for step in range(2000)]
    began = time.process_time()
    for sample in more:
        history.add(sample)
    assert (time.process_time() - began) / len(more) < 50e-6
