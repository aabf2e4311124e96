"""Promises that a soak run judges, and a real graph with one fault of each kind; `make thorough` runs minutes of it."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import Counter

import pytest

from benchmarks.soak import AFTERWARDS_S, RECOVERY_S, Fault, Moment, Soak, verdict


def moments(seconds: int, **changes: int) -> list[Moment]:
    """A run of ten dwells a second, with something other in one of its seconds."""
    made = []
    heights = left_out = 0
    for second in range(seconds):
        heights += 0 if second == changes.get("no_heights_at") else 10
        left_out += 8 if second == changes.get("drop_at") else 0
        unbalanced = ["ml_height: 5 in, 4 accounted for"] if second == changes.get("unbalanced_at") else []
        memory = {("ml_height", 1): 100.0 + (0.1 * second if changes.get("grows") else 0.0)}
        made.append(Moment(float(second), {"ml/height": heights}, Counter({"late": left_out}), unbalanced, memory))
    return made


def broken(soak: Soak, different: tuple[str, ...] = ()) -> list[str]:
    return [
        sentence.split(":")[0].split(" in ")[0] for kept, sentence in verdict(soak, 10.0, list(different)) if not kept
    ]


def test_what_is_missing_without_a_fault_is_found() -> None:
    assert broken(Soak(20.0, 0, faults=[Fault(40.0, "kill")], moments=moments(100))) == []
    for change, promise in (
        ({"no_heights_at": 30}, "heights missing"),
        ({"drop_at": 30}, "messages left out"),
        ({"unbalanced_at": 45}, "accounts that were not balanced"),
    ):
        assert broken(Soak(20.0, 0, faults=[Fault(40.0, "kill")], moments=moments(100, **change))) == [promise]
    growth = (100 + 0.1 * 583) / (100 + 0.1 * 349) - 1  # from the middle of the second third to that of the last
    sentences = broken(Soak(20.0, 0, faults=[], moments=moments(700, grows=1)))
    assert sentences == [f"memory of 1 nodes that ran for 600 s grows by {100 * growth:.2f} % at most ml_height"]
    assert broken(Soak(20.0, 0, faults=[], moments=moments(500, grows=1))) == []


def test_what_a_fault_may_cost_is_not_counted_and_what_comes_later_is() -> None:
    fault = [Fault(40.0, "kill ml_height")]
    for change in ({"no_heights_at": 41}, {"drop_at": 41}):
        assert broken(Soak(20.0, 0, faults=fault, moments=moments(100, **change))) == []
    late = round(40 + RECOVERY_S) + 2
    assert broken(Soak(20.0, 0, faults=fault, moments=moments(100, drop_at=late))) == ["messages left out"]
    sentences = [
        sentence for _, sentence in verdict(Soak(20.0, 0, faults=fault, moments=moments(100, drop_at=late)), 10.0, [])
    ]
    assert sentences[1].endswith(f"{{'late': 8}}\n    {late} s ({late - 40} s after kill ml_height): {{'late': 8}}")
    sentences = [s for _, s in verdict(Soak(20.0, 0, faults=fault, moments=moments(100, no_heights_at=late)), 10.0, [])]
    assert sentences[2].endswith(f"ml/height 7 (7 from {round(40 + RECOVERY_S)} s)")


def test_on_a_slow_machine_a_fault_may_cost_more_time() -> None:
    for recovery_s, found in ((12.0, ["messages left out"]), (20.0, [])):
        soak = Soak(30.0, 0, recovery_s=recovery_s, faults=[Fault(40.0, "kill")], moments=moments(100, drop_at=54))
        assert broken(soak) == found


def test_what_a_program_does_counts_as_long_as_it_runs_and_a_while_afterwards() -> None:
    program = subprocess.Popen([sys.executable, "-c", ""])
    program.wait()
    fault = Fault(40.0, "hostile slc", program, ended_s=50.0)
    over = round(50 + AFTERWARDS_S)
    assert broken(Soak(20.0, 0, faults=[fault], moments=moments(100, drop_at=over - 1))) == []
    assert broken(Soak(20.0, 0, faults=[fault], moments=moments(100, drop_at=over + 1))) == ["messages left out"]
    fault.ended_s = float("inf")
    assert broken(Soak(20.0, 0, faults=[fault], moments=moments(100, drop_at=99))) == []


GRAPH = """
import json
from dataclasses import replace
from benchmarks.soak import Soak, perform, verdict
kinds = ("kill", "stop", "hostile slc,other sensors,frames twice,other parameters")
run = Soak(1.0, 0, lasts_s=400.0, kinds=kinds)
promises = perform(run, "small", 0.02, 20.0)
unblamed = verdict(replace(run, faults=[]), 0.0, [])
print(json.dumps({
    "done": [fault.what for fault in run.faults],
    "judged_s": [stretch[-1].at_s - stretch[0].at_s for stretch in run.quiet()],
    "broken": [sentence for kept, sentence in promises if not kept],
    "unblamed": [sentence for kept, sentence in unblamed if not kept],
}))
"""


@pytest.mark.thorough
def test_a_real_graph_keeps_its_promises_after_one_fault_of_each_kind() -> None:
    """Messages that are left out meanwhile would break a promise if no fault were known.

    Without a second source of odometry, which dwells may wait for until 50 s later at this pace.
    """
    command = [sys.executable, "-c", GRAPH]
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=600)  # noqa: S603
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["broken"] == [], done.stderr
    assert len(found["done"]) == 3
    assert found["judged_s"][-1] > 4
    assert any(sentence.startswith("messages left out") for sentence in found["unblamed"])
