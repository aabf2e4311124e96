"""Fixtures for all tests: a ROS graph that meets no other, and real data from beside the repository."""

from __future__ import annotations

import fcntl
import itertools
import os
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import IO

# Read when a context starts: nodes of other machines stay out of the tests.
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"

with warnings.catch_warnings():
    # The parser in the ROS wheels imports modules that Python has deprecated; messages load it at their first use.
    warnings.simplefilter("ignore", DeprecationWarning)
    import rosidl_generator_py  # noqa: F401

import pytest

from sal_height.nodes.graph import Graph

DOMAIN_IDS = range(1, 101)  # higher ones have their ports in the range the kernel hands out

_next_domain = itertools.count(os.getpid())


@contextmanager
def _free_domain() -> Iterator[int]:
    with _locked_domain() as lock:
        yield int(lock.name.rpartition("_")[2])


@pytest.fixture(scope="session")
def free_domain() -> Callable[[], AbstractContextManager[int]]:
    """Context manager that gives a DDS domain nobody else uses meanwhile, for fixtures of a wider scope."""
    return _free_domain


@pytest.fixture
def domain_id() -> Iterator[int]:
    """A DDS domain that no other test uses at the moment, in this process or another."""
    with _free_domain() as domain:
        yield domain


@pytest.fixture
def graph(domain_id: int) -> Iterator[Graph]:
    """Context and executor in a DDS domain of their own."""
    with Graph(domain_id) as graph:
        yield graph


@pytest.fixture(scope="session")
def shared_data() -> Callable[[str], Path]:
    """Path of a folder with real data; the test is skipped where it is absent."""

    def find(name: str) -> Path:
        path = Path(__file__).parents[2] / "shared" / "data" / name
        if not path.is_dir():
            pytest.skip(f"real data '{name}' is not in {path.parent}")
        return path

    return find


def _locked_domain() -> IO[str]:
    """Open file that holds the lock of a free domain until it is closed; its name ends in the domain's number."""
    for _ in DOMAIN_IDS:
        domain = DOMAIN_IDS[next(_next_domain) % len(DOMAIN_IDS)]
        path = Path(tempfile.gettempdir(), f"sal_height_test_domain_{domain}")
        lock = path.open("w", encoding="utf-8")  # the caller closes it, and so gives the domain back
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lock.close()
        else:
            return lock
    pytest.fail(f"all DDS domains from {DOMAIN_IDS[0]} to {DOMAIN_IDS[-1]} are in use by tests")
