"""A pool of workers: whatever ends, every job has an outcome, and the results are those of one process."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

PROGRAM = Path(__file__).with_name("pooled_jobs.py")

SCENARIOS = (
    "plenty",
    "scarce",
    "lost_worker",
    "series",
    "rehearsal",
    "order",
    "one_after_the_other",
    "without_keeper",
    "hiccup",
)


@pytest.fixture(scope="module")
def outcomes() -> dict[str, Any]:
    """What became of the jobs of each scenario."""
    done = subprocess.run(  # noqa: S603 (our own program)
        [sys.executable, str(PROGRAM), *SCENARIOS], capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    return dict(json.loads(done.stdout))


@pytest.mark.parametrize(("scenario", "memory"), [("plenty", 100_000_000), ("scarce", 1_000_000)])
def test_results_are_those_of_one_process_and_all_memory_is_given_back(
    outcomes: dict[str, Any], scenario: str, memory: int
) -> None:
    """What finds no room in the shared memory is sent as other objects are."""
    assert outcomes[scenario] == {"equal": 24, "processes": 2, "free": memory // 64 * 64}


def test_a_worker_that_ends_costs_its_jobs_and_is_replaced_at_once(outcomes: dict[str, Any]) -> None:
    seen = outcomes["lost_worker"]
    assert seen["lost"] == {"0": "worker ended"}
    assert seen["made"] == [*range(1, 9)]
    assert seen["back_s"] < 3  # the next worker is forked, and has nothing to load


def test_jobs_of_a_series_go_to_one_worker_in_their_order_also_after_it_ends(outcomes: dict[str, Any]) -> None:
    """Jobs of no series, between them, do not overtake them."""
    seen = outcomes["series"]
    assert (seen["processes"], seen["after"], seen["moved"], seen["in_order"]) == (1, 1, True, True)
    assert seen["lost"] == {"12": "worker ended"}  # what the strip had so far is lost: its next block says so
    assert seen["accounted"] == 12 + 12 + 4


def test_every_worker_rehearses_and_one_rehearsal_is_concluded(outcomes: dict[str, Any]) -> None:
    assert outcomes["rehearsal"] == {"concluded": ["only"], "made": 1}


def test_dwells_that_were_begun_are_finished_first(outcomes: dict[str, Any]) -> None:
    assert outcomes["order"]["log"] == ["first", *["later"] * 3, *["first"] * 3]


def test_jobs_are_finished_in_the_order_in_which_they_were_given(outcomes: dict[str, Any]) -> None:
    """As the tracker needs it: what another worker has made sooner waits, also for what is lost."""
    seen = outcomes["one_after_the_other"]
    assert seen == {"order": [0, 1, 2, 3, 4], "processes": 2, "after": [6, 7], "lost": {"5": "worker ended"}}


def test_a_pool_that_gets_no_more_workers_says_so(outcomes: dict[str, Any]) -> None:
    assert outcomes["without_keeper"] == {"before": "", "said": True}


def test_a_single_dwell_that_took_long_does_not_make_others_late(outcomes: dict[str, Any]) -> None:
    assert outcomes["hiccup"] == {"expected_s": 0.1}
