"""Provenances that state the same are the same object, also in another process."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace

import numpy as np

from sal_height.engine.provenance import CACHED, Provenance, _first_alike


def stated(**parameters: object) -> Provenance:
    return Provenance("1.0", "f00", "", parameters, np.zeros(0, np.float32))


def sent(one: Provenance) -> Provenance:
    found = pickle.loads(pickle.dumps(one))  # noqa: S301 (our own bytes)
    assert isinstance(found, Provenance)
    return found


def test_what_is_sent_twice_arrives_as_one_object() -> None:
    first = sent(stated(looks=3, window="taylor"))
    assert first == stated(looks=3, window="taylor")
    assert sent(stated(looks=3, window="taylor")) is first
    assert copy.deepcopy(first) is first


def test_what_states_something_else_or_of_another_type_is_another_object() -> None:
    one = sent(stated(value=1))
    others = [stated(value=1.0), stated(value=True), stated(value="1"), stated(value=(1,)), stated(other=1)]
    others += [replace(stated(value=1), calibration_id="ca1"), replace(stated(value=1), code_version="2")]
    others += [replace(stated(value=1), autofocus_phase=np.array(phase, np.float32)) for phase in ([0.0], [-0.0])]
    found = [sent(other) for other in others]
    assert len({id(other) for other in (one, *found)}) == len(others) + 1
    for sent_one, other in zip(found, others, strict=True):
        assert repr(sent_one.parameters) == repr(other.parameters)
        assert sent_one.autofocus_phase.tobytes() == other.autofocus_phase.tobytes()


def test_its_phase_is_not_that_of_memory_that_is_used_again() -> None:
    phase = np.ones(3, np.float32)
    make, values = replace(stated(), autofocus_phase=phase).__reduce__()
    found = make(*values)
    phase[:] = 7
    assert found.autofocus_phase.tolist() == [1, 1, 1]


def test_few_are_kept() -> None:
    for number in range(3 * CACHED):
        sent(stated(number=number))
    assert _first_alike.cache_info().currsize == CACHED


def test_further_values_follow_those_that_are_stated() -> None:
    one = Provenance("1.0", "f00", "ca1", {"tracker.gate": 3.0}, np.ones(2, np.float32))
    more = one.stating("tracker.prior.", {"length": 2.0, "mean": None})
    assert list(more.parameters.items()) == [("tracker.gate", 3.0), ("tracker.prior.length", 2.0)]
    assert replace(more, parameters=one.parameters) == one
