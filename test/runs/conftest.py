"""Runs to look at, made once."""

from __future__ import annotations

import dataclasses
import fcntl
import os
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


Once = Callable[[str, Callable[[Path], object]], Path]


@pytest.fixture(scope="session")
def once(tmp_path_factory: pytest.TempPathFactory) -> Once:
    """A folder by its name, which the first of all workers makes, and which all of them read."""
    root = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        root = root.parent

    def made(name: str, make: Callable[[Path], object]) -> Path:
        parent = root / f"once_{name}"
        parent.mkdir(exist_ok=True)
        with (parent / "lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)  # until the file is closed
            if not (parent / "is_made").exists():
                make(parent / name)
                (parent / "is_made").touch()
        return parent / name

    return made


@pytest.fixture(scope="session")
def recorded(two_dwells: Preset, once: Once) -> Path:
    """Output folder of a run of two dwells, without pictures."""
    return once("recorded", lambda out: fly(two_dwells, SEED, out, {}))


@pytest.fixture(scope="session")
def with_images(recorded: Path, once: Once) -> Path:
    """Bag of a replay of `recorded` through nodes, with the images of all channels: two dwells of 8 channels."""
    made = once("images", lambda out: bag_replay.replay(recorded / "bag", out, {}, Execution(record=["slc"])))
    return made / "bag"


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
