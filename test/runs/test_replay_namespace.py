"""Bags of graphs in namespaces."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from helpers import assert_one_sentence
from rewritten_bag import copied
from written_bag import changed, frame, key, told, written

from sal_height.bag.namespace import NamespacedReader, open_bag
from sal_height.bag.reader import BagReader
from sal_height.commands import main
from sal_height.errors import UserError
from sal_height.runs.chain.entry import Part
from sal_height.runs.chain.timeline import timeline_of

HEIGHTS = {"/ml/height", "/monopulse/height", "/tracked/height"}


def moved(bag: Path, copy: Path, namespaces: Sequence[str], outside: Sequence[str] = ("/diagnostics",)) -> Path:
    """A bag with the messages of another one in namespaces, in each of them."""
    return copied(
        bag, copy, names=lambda topic: [topic] if topic in outside else [f"{space}{topic}" for space in namespaces]
    )


@pytest.mark.parametrize("outside", [["/diagnostics"], ["/diagnostics", "/platform/odometry"]])
def test_a_bag_of_a_namespace_is_replayed_without_it(
    outside: list[str], recorded: Path, tmp_path: Path, replay: Any
) -> None:
    bag = moved(recorded / "bag", tmp_path / "bag", ["/north/lidar"], outside)
    result = replay(bag, tmp_path / "out", {})
    assert {topic: (one.matched, one.verdict) for topic, one in result.compared.items()} == dict.fromkeys(
        HEIGHTS, (2, "equal")
    )
    assert BagReader(tmp_path / "out" / "bag").topics.keys() >= HEIGHTS
    from_heights = replay(bag, tmp_path / "tracked", {}, part=Part("heights"))
    assert from_heights.compared["/tracked/height"].verdict == "equal"


def test_one_of_several_namespaces_is_chosen(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], replay: Any, replay_words: list[str]
) -> None:
    bag = moved(recorded / "bag", tmp_path / "bag", ["/lidar", "/radar"])
    for namespace, parts in ((None, ["/lidar, /radar", "--namespace"]), ("sonar", ["'sonar'", "/lidar, /radar"])):
        with pytest.raises(UserError) as error:
            replay(bag, tmp_path / "out", {}, part=Part(namespace=namespace))
        assert_one_sentence(str(error.value), str(bag), "phase_history", *parts)
    assert main([*replay_words, str(bag), "--out", str(tmp_path / "out"), "--namespace", "radar"]) == 0
    assert "/ml/height" in capsys.readouterr().out


def test_topics_have_their_names_without_the_namespace(recorded: Path, tmp_path: Path) -> None:
    """A topic outside that is called alike is another one; without a namespace, nothing changes."""
    bag = moved(recorded / "bag", tmp_path / "bag", ["", "/lidar"])
    plain, reader = BagReader(bag), open_bag(bag, "/lidar/", ["phase_history"])
    assert open_bag(bag, None, ["phase_history"]).topics == plain.topics
    assert reader.topics.keys() == BagReader(recorded / "bag").topics.keys()
    for topics in (["/phase_history", "/none"], None):
        ours = [(m.topic, m.cdr) for m in reader.messages(topics)]
        theirs = BagReader(recorded / "bag").messages([topics[0]] if topics else None)
        assert sorted(ours) == sorted((m.topic, m.cdr) for m in theirs)


def test_parameters_are_those_of_the_nodes_in_the_namespace(tmp_path: Path) -> None:
    said = [
        *(told("lidar/ml_height", range_looks=4), told("radar/ml_height", range_looks=8), frame(0)),
        *(changed("radar/ml_height", range_looks=3), changed("lidar/ml_height", range_looks=2), frame(1)),
    ]
    bag = written(tmp_path / "bag", said).path
    found = timeline_of(NamespacedReader(bag, "lidar"))
    assert found.start == {("ml_height", "range_looks"): (4, "parameter event")}
    assert [(one.dwell, one.value) for one in found.changes] == [(key(1), 2)]
