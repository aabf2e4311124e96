"""Golden bags of this repository, put under test by the plugin, as users do with theirs."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from helpers import AS_VERSION_2, few

from sal_height.bag.compare import CHANGED, EQUAL
from sal_height.bag.tolerance import EXACT
from sal_height.errors import UserError
from sal_height.runs.replay.bag_replay import Against, replay
from sal_height.runs.replay.judge import verdict_of

BAGS = Path(__file__).parents[1] / "bags"
GOLDEN = sorted(
    folder.name
    for folder in BAGS.iterdir()
    if folder.is_dir() and folder.name not in {"version_0", "version_1", "version_2"}
)
LARGEST = 4e6
"""Bytes of a golden bag."""


BY_NODES = ["version_3", "sal_stripmap"]
"""Bags that `make test` replays through nodes, too: one of a spotlight, one of a strip."""

OTHERS = [name for name in GOLDEN if name not in BY_NODES]


@pytest.mark.parametrize("name", OTHERS)
def test_a_replay_by_calls_gives_the_heights_of_a_golden_bag(name: str, tmp_path: Path) -> None:
    """Within what processors differ by."""
    done = replay(BAGS / name, tmp_path / "replay", {}, jobs=2)
    assert verdict_of(done.compared) != CHANGED
    assert sum(one.matched for one in done.compared.values()) > 0


@pytest.mark.parametrize("name", few(len(BY_NODES), [*BY_NODES, *OTHERS]))
def test_a_replay_gives_the_heights_of_a_golden_bag(
    name: str, assert_replay_matches: Callable[..., Any], tmp_path: Path
) -> None:
    """Through nodes within what processors differ by, and by calls, side by side, value for value the same."""
    done = assert_replay_matches(BAGS / name)
    by_nodes = Against(tmp_path / "replay_1" / "bag", EXACT)
    by_calls = replay(BAGS / name, tmp_path / "by_calls", {}, against=by_nodes, jobs=2)
    assert {topic: (one.verdict, one.matched) for topic, one in by_calls.compared.items()} == {
        topic: (EQUAL, one.matched) for topic, one in done.compared.items()
    }
    assert sum(one.matched for one in done.compared.values()) > 0


@pytest.mark.parametrize("name", GOLDEN)
def test_a_golden_bag_is_small(name: str) -> None:
    assert sum(file.stat().st_size for file in (BAGS / name).iterdir()) < LARGEST


def test_a_broken_estimator_is_caught(assert_replay_matches: Callable[..., Any]) -> None:
    broken = {"ml_height": {"objective": "numerator"}}
    with pytest.raises(AssertionError, match=r"version_3 differs.*\n.*\n.*/ml/height +changed"):
        assert_replay_matches(BAGS / "version_3", parameters=broken)


def test_heights_are_compared_with_those_of_another_bag(
    assert_replay_matches: Callable[..., Any], tmp_path: Path
) -> None:
    """Version 1 of the bag holds the same flight, made with other defaults; its heights are beside the test."""
    done = assert_replay_matches(BAGS / "version_3")
    assert (tmp_path / "replay_1" / "report.json").is_file()
    golden = tmp_path / "replay_1" / "bag"
    again = assert_replay_matches(BAGS / "version_1", golden=golden, parameters=AS_VERSION_2)
    assert again.compared.keys() == done.compared.keys()
    assert (tmp_path / "replay_2" / "bag").is_dir()
    assert CHANGED not in {one.verdict for one in again.compared.values()}


def test_what_cannot_be_used_is_refused(assert_replay_matches: Callable[..., Any], tmp_path: Path) -> None:
    with pytest.raises(UserError, match="does not exist"):
        assert_replay_matches(BAGS / "none")
    with pytest.raises(UserError, match="cannot be read"):
        assert_replay_matches(BAGS / "version_3", tolerance=tmp_path / "none.yaml")


USERS_TEST = """

def test_as_a_user_writes_it(assert_replay_matches):
    assert_replay_matches({bag!r})

def test_the_plugin_is_there(request):
    assert request.config.pluginmanager.has_plugin("sal_height")
"""


def test_pytest_finds_the_plugin_by_itself_and_it_loads_no_ros(tmp_path: Path) -> None:
    (tmp_path / "test_flight.py").write_text(USERS_TEST.format(bag=str(BAGS / "version_3")))
    words = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(tmp_path)]
    done = subprocess.run(words, check=False, cwd=tmp_path, capture_output=True, text=True, timeout=6000)  # noqa: S603
    assert "2 passed" in done.stdout, done.stdout
    import_only = (
        "import sys, sal_height.pytest_plugin; print([m for m in sys.modules if m.startswith(('rclpy', 'mcap'))])"
    )
    done = subprocess.run([sys.executable, "-c", import_only], capture_output=True, text=True, timeout=600, check=True)  # noqa: S603
    assert done.stdout.strip() == "[]"
