"""Runs to look at, made once."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from sal_height.graph.plan import Execution
from sal_height.runs.replay import bag_replay
from sal_height.runs.truth.simulate import fly
from sal_height.simulation.preset import Preset, load_preset

SEED = 3


@pytest.fixture(scope="session")
def two_dwells() -> Preset:
    """The small preset, two dwells."""
    return dataclasses.replace(load_preset("small"), dwells=2)


@pytest.fixture(scope="session")
def recorded(two_dwells: Preset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Output folder of a run of two dwells, without pictures."""
    out = tmp_path_factory.mktemp("runs") / "recorded"
    fly(two_dwells, SEED, out, {})
    return out


@pytest.fixture(scope="session")
def with_images(recorded: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Bag of a replay of `recorded` through nodes, with the images of all channels: two dwells of 8 channels."""
    out = tmp_path_factory.mktemp("images") / "out"
    bag_replay.replay(recorded / "bag", out, {}, Execution(record=["slc"]))
    return out / "bag"


@pytest.fixture(params=[pytest.param(None, id="nodes", marks=pytest.mark.thorough), pytest.param(1, id="calls")])
def jobs(request: pytest.FixtureRequest) -> int | None:
    """Jobs of a replay: one, without nodes; in `make thorough` through nodes, too.

    Golden bags hold both against each other, value for value (test_golden).
    """
    return request.param


@pytest.fixture
def replay(jobs: int | None) -> Callable[..., bag_replay.Replay]:
    """`bag_replay.replay` by `jobs`."""
    return partial(bag_replay.replay, jobs=jobs)


@pytest.fixture
def replay_words(jobs: int | None) -> list[str]:
    """Words of a command that replays by `jobs`."""
    return ["replay"] if jobs is None else ["replay", "--jobs", str(jobs)]
