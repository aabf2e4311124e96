"""Sentences for users stay short, whatever they quote."""

from __future__ import annotations

import pickle
from dataclasses import replace

import pytest

from sal_height.errors import LONGEST, NotDetermined, Rejected, UserError
from sal_height.simulation import flight_of, load_preset


@pytest.mark.parametrize("make", [UserError, NotDetermined, lambda sentence: Rejected("reason", sentence)])
def test_of_a_long_sentence_begin_and_end_are_left(make: type[UserError]) -> None:
    exact = "x" * LONGEST
    assert str(make(exact)) == exact
    said = str(make(f"Sensor mode is '{'a' * 10**6}'; allowed are spotlight, stripmap."))
    assert len(said) == LONGEST
    assert said.startswith("Sensor mode is 'aaa")
    assert " … aaa" in said
    assert said.endswith("aaa'; allowed are spotlight, stripmap.")


def test_a_hostile_value_is_not_quoted_at_its_length() -> None:
    sensor = flight_of(load_preset("small"), seed=1).sensor
    with pytest.raises(UserError) as refused:
        replace(sensor, mode="a" * 10**6, config_hash="")
    assert len(str(refused.value)) <= LONGEST
    assert str(refused.value).endswith("allowed are spotlight, stripmap.")


def test_a_refusal_reaches_another_process() -> None:
    refusal = pickle.loads(pickle.dumps(Rejected("late", "Dwell 3 was late.")))  # noqa: S301 (our own)
    assert (refusal.reason, str(refusal)) == ("late", "Dwell 3 was late.")
