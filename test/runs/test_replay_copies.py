"""Bags made of bags, by a cut or an upgrade, give the heights that the originals give."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from sal_height.bag.compare import EQUAL, TopicComparison, compare_bags
from sal_height.bag.cut import Range, cut
from sal_height.bag.reader import BagReader
from sal_height.bag.upgrade import upgrade


def compare(golden: Path, made: Path) -> dict[str, TopicComparison]:
    return compare_bags(BagReader(golden), BagReader(made))


BAGS = Path(__file__).parents[2] / "bags"


@pytest.mark.parametrize("number", [pytest.param(0, marks=pytest.mark.thorough), 1])
def test_a_cut_bag_gives_the_heights_of_its_dwells(number: int, recorded: Path, tmp_path: Path, replay: Any) -> None:
    """Value for value; those of the tracker depend on the dwells before."""
    cut(recorded / "bag", tmp_path / "cut", Range(dwells=(number, number)))
    result = replay(tmp_path / "cut", tmp_path / "replay", {})
    assert not result.outcome.losses
    for topic in ("/ml/height", "/monopulse/height"):
        compared = result.compared[topic]
        assert compared.verdict == EQUAL
        assert (compared.matched, compared.missing, compared.extra) == (1, 0, 0)
        (height,) = BagReader(tmp_path / "cut").messages([topic])
        (replayed,) = BagReader(tmp_path / "replay" / "bag").messages([topic])
        assert height.cdr == [m.cdr for m in BagReader(recorded / "bag").messages([topic])][number]
        assert BagReader(recorded / "bag").decode(replayed.type_name, replayed.cdr).dwell == number
    if number == 0:
        assert compare(tmp_path / "cut", tmp_path / "replay" / "bag")["/tracked/height"].verdict == EQUAL


@pytest.mark.parametrize("version", [0, pytest.param(1, marks=pytest.mark.thorough)])
def test_an_upgraded_bag_gives_the_heights_of_the_old_one(version: int, tmp_path: Path, replay: Any) -> None:
    """With the parameters of the old one, which lie in a file beside that of version 0."""
    old, new = BAGS / f"version_{version}", tmp_path / "new"
    upgrade(old, new)
    for bag in (old, new):
        replay(bag, tmp_path / f"replay_{bag.name}", {})
    compared = compare(tmp_path / f"replay_{old.name}" / "bag", tmp_path / "replay_new" / "bag")
    assert set(compared) == {"/ml/height", "/monopulse/height", "/tracked/height"}
    assert all(result.verdict == EQUAL and result.matched == 2 for result in compared.values())
    assert all(result.verdict == EQUAL for result in compare(old, new).values())
