"""Plugin of pytest: bags under test. A replay, through nodes where ROS is, must give the heights of a golden bag.

    def test_the_flight_of_may_is_as_it_was(assert_replay_matches):
        assert_replay_matches("bags/may", golden="bags/may_golden")

pytest finds it by itself where sal_height is installed. docs/replay.md states what is compared, and how tolerances are
written.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from sal_height.runs.replay.bag_replay import Replay


def replay_and_compare(
    bag: str | PathLike[str],
    golden: str | PathLike[str] | None = None,
    *,
    out: Path,
    tolerance: str | PathLike[str] | None = None,
    parameters: Mapping[str, Mapping[str, Any]] | None = None,
) -> Replay:
    """Replay a bag through the nodes, and make sure that its heights are those of a golden bag.

    Args:
        bag: the bag that is replayed.
        golden: the bag with the heights that are right; None: those recorded in `bag`.
        out: folder of the new bag, report.json and comparison.png; new or empty.
        tolerance: YAML file with rules by field; None: what processors differ by in rounding.
        parameters: values of nodes' parameters in the place of those that the bag was made with.

    Returns:
        The replay, with the comparison of each topic.

    Raises:
        AssertionError: there is nothing to compare, or a topic misses images, has more, or differs by more than the
            tolerance.
        UserError: a bag or the tolerances cannot be used, or the replay failed.
    """
    from sal_height.bag.compare import CHANGED  # noqa: PLC0415 (ROS only for tests that need it)
    from sal_height.bag.tolerance import ROUNDING, read_tolerances  # noqa: PLC0415
    from sal_height.extras import lacking_of_ros  # noqa: PLC0415
    from sal_height.graph.reporting import comparison_table  # noqa: PLC0415
    from sal_height.runs.replay.bag_replay import Against, replay  # noqa: PLC0415
    from sal_height.runs.replay.judge import verdict_of  # noqa: PLC0415

    tolerances = read_tolerances(Path(tolerance)) if tolerance else ROUNDING
    against = Against(Path(golden) if golden else None, tolerances)
    values = {name: dict(one) for name, one in (parameters or {}).items()}
    if lacking_of_ros():
        warnings.warn("ROS is not installed here: bags are replayed without nodes, as by --jobs 1.", stacklevel=2)
    done = replay(Path(bag), out, values, against=against)
    if verdict_of(done.compared) == CHANGED:
        said = comparison_table(done.compared) if done.compared else "The golden bag has no heights to compare with."
        raise AssertionError(f"The replay of {bag} differs from {golden or bag}; see {out}.\n{said}")
    return done


@pytest.fixture
def assert_replay_matches(tmp_path: Path) -> Callable[..., Replay]:
    """`replay_and_compare` with folders of the test for what it makes, as many times as the test calls it."""
    calls = []

    def check(bag: str | PathLike[str], golden: str | PathLike[str] | None = None, **options: Any) -> Replay:
        __tracebackhide__ = True
        calls.append(bag)
        return replay_and_compare(bag, golden, out=tmp_path / f"replay_{len(calls)}", **options)

    return check
