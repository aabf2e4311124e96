"""Fixtures for all tests: a ROS graph that meets no other, and real data from beside the repository."""

from __future__ import annotations

import gc
import logging
import os
import signal
import warnings
from collections.abc import Callable, Generator, Iterator
from contextlib import suppress
from pathlib import Path

# Read when a context starts: nodes of other machines stay out of the tests.
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"

# A command's help keeps the width that the terminal had when this process first printed it.
os.environ["COLUMNS"] = "80"

with warnings.catch_warnings():
    # The parser in the ROS wheels imports modules that Python has deprecated; messages load it at their first use.
    warnings.simplefilter("ignore", DeprecationWarning)
    import rosidl_generator_py  # noqa: F401

import pytest
from blank_pictures import blank_pictures as pictures_that_are_blank

from sal_height.nodes.transport.domain import free_domain
from sal_height.nodes.transport.graph import Graph

# A first start tells that it compiles; tests look at what else is told.
logging.getLogger("sal_height.numeric.jit").setLevel(logging.ERROR)


LONGEST_FIRST = (
    *("test_soak.py", "runs/test_run.py", "runs/live/test_live_host_products.py", "movers/test_detection.py"),
    *(
        "runs/test_offline.py",
        "figures/test_figures.py",
        "test_golden.py",
        "nodes/test_hosts.py",
        "movers/test_dwells.py",
    ),
    *("runs/test_supervisor.py", "passes/test_heights.py", "runs/replay/test_replay.py", "test_tutorials.py"),
    *("runs/campaign/test_batch.py", "commands/test_program.py", "runs/products/test_adjust.py"),
    *("adjustment/test_adjust.py", "pipeline/test_groups.py", "engine/test_every_stage.py", "runs/live/test_live.py"),
    *("messages/test_codec.py", "nodes/test_height_adjuster.py", "test_layering.py", "runs/test_psf_images.py"),
    *("imaging/formers/test_range_doppler.py", "numeric/test_jit.py", "passes/test_chance.py", "imports/test_slc.py"),
    *("runs/live/test_live_host.py", "runs/replay/test_same_bytes.py"),
    *("nodes/test_hostile.py", "engine/test_imports.py", "imaging/test_strip.py", "runs/test_ensemble.py"),
)
"""Files that take 8 s of processor time or more, or wait for programs, the longest first."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Long files come first: workers take whole files in this order, and none is left alone with one at the end."""
    ranks = {Path(__file__).parent / name: rank for rank, name in enumerate(LONGEST_FIRST)}
    items.sort(key=lambda item: ranks.get(item.path, len(ranks)))


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """What modules make stays: a collector of garbage would look at all of it again and again for nothing."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


def pytest_collection_finish() -> None:
    """What all modules have made stays to the end: the collector looks at it no more, nor do forked processes."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def signals_end_programs() -> Iterator[None]:
    """Programs leave signals ignored that are so: SIGHUP where the tests are run under nohup, SIGINT in background."""
    handlers = {signal.SIGHUP: signal.SIG_DFL, signal.SIGINT: signal.default_int_handler}
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def living_participants() -> int:
    """DDS participants of this process (Linux): each has a thread for its events, named dds.ev.NUMBER."""
    names = []
    for file in Path("/proc/self/task").glob("*/comm"):
        with suppress(OSError):  # the thread has ended meanwhile
            names.append(file.read_text())
    return sum(name.startswith("dds.ev.") for name in names)


@pytest.fixture(scope="module", autouse=True)
def no_participant_is_left() -> Iterator[None]:
    """Tests of a module end all nodes that they make; each that is left takes seven threads and several ports."""
    before = living_participants()
    yield
    assert living_participants() <= before, "tests of this module leave DDS participants"


@pytest.fixture
def domain_id() -> Iterator[int]:
    """A DDS domain that no other test uses at the moment, in this process or another."""
    with free_domain() as domain:
        yield domain


@pytest.fixture
def graph(domain_id: int) -> Iterator[Graph]:
    """Context and executor in a DDS domain of their own."""
    with Graph(domain_id) as graph:
        yield graph


@pytest.fixture
def blank_pictures() -> Iterator[None]:
    """Pictures of runs are white while a test runs."""
    with pictures_that_are_blank():
        yield


@pytest.fixture(scope="session")
def shared_data() -> Callable[[str], Path]:
    """Path of a folder with real data; the test is skipped where it is absent."""

    def find(name: str) -> Path:
        path = Path(__file__).parents[2] / "shared" / "data" / name
        if not path.is_dir():
            pytest.skip(f"real data '{name}' is not in {path.parent}")
        return path

    return find
