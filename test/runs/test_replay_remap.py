"""Replays in which topics of the bag or of the nodes have other names."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from helpers import assert_one_sentence
from rclpy.parameter import Parameter
from rewritten_bag import copied

from sal_height.bag.namespace import NamespacedReader
from sal_height.bag.reader import BagReader
from sal_height.commands import main
from sal_height.errors import UserError
from sal_height.nodes.playing.player import Player
from sal_height.nodes.transport.graph import Graph
from sal_height.runs.chain.entry import Part
from sal_height.runs.replay.bag_replay import IN_LOCKSTEP, Playing, Remapping, Replay, remapping_of, replay

HEIGHTS = {"/ml/height", "/monopulse/height", "/tracked/height"}
FOREIGN = {"/sensor_info": "/radar/info", "/platform/odometry": "/odom", "/phase_history": "/radar/raw"}
"""Names that another program might give to what the sensor delivers."""
THOROUGH_LOCKSTEP, THOROUGH_BURST = (
    pytest.param(playing, marks=pytest.mark.thorough) for playing in (IN_LOCKSTEP, Playing("burst"))
)


def verdicts(result: Replay) -> dict[str, tuple[int, str]]:
    return {topic: (one.matched, one.verdict) for topic, one in result.compared.items()}


@pytest.mark.parametrize("playing", [THOROUGH_LOCKSTEP, Playing("paced")], ids=["lockstep", "paced"])
def test_a_bag_with_foreign_names_is_played(playing: Playing, recorded: Path, tmp_path: Path) -> None:
    bag = copied(recorded / "bag", tmp_path / "bag", names=lambda topic: [FOREIGN.get(topic, topic)])
    with pytest.raises(UserError, match="has no messages on /sensor_info"):
        replay(bag, tmp_path / "out", {})
    rules = [f"{new}:={old}" for old, new in FOREIGN.items()]
    result = replay(bag, tmp_path / "out", {}, playing=playing, remap=rules)
    assert result.shortfalls(changed=False) == []
    assert {topic: matched for topic, (matched, _) in verdicts(result).items()} == dict.fromkeys(HEIGHTS, 2)
    assert BagReader(tmp_path / "out" / "bag").topics.keys() >= {*HEIGHTS, *FOREIGN}
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["remapped"] == {new: old for old, new in FOREIGN.items()}


@pytest.mark.parametrize("playing", [IN_LOCKSTEP, THOROUGH_BURST], ids=["lockstep", "burst"])
def test_topics_of_the_nodes_get_other_names(playing: Playing, recorded: Path, tmp_path: Path) -> None:
    """They are published, counted, recorded and compared so; one that is asked for by either name is recorded, too."""
    renamed = {"phase_history": "radar/phase_history", "ml/height": "north/ml", "tracked/height": "ml/height"}
    result = replay(
        recorded / "bag", tmp_path / "out", {}, playing=playing, remap=[f"{a}:=/{b}" for a, b in renamed.items()]
    )
    assert result.shortfalls(changed=False) == []
    assert {topic: matched for topic, (matched, _) in verdicts(result).items()} == dict.fromkeys(HEIGHTS, 2)
    made = BagReader(tmp_path / "out" / "bag")
    counts = {name: topic.count for name, topic in made.topics.items() if name != "/diagnostics"}
    assert counts.pop("/platform/odometry") > 0
    assert counts.pop("/tf") > 0
    views = {f"/{product}/{view}": 2 for product in ("ml", "monopulse", "tracked") for view in ("image", "points")}
    assert counts == {
        "/sensor_info": 1,
        "/radar/phase_history": 16,
        "/monopulse/height": 2,
        "/north/ml": 2,
        "/ml/height": 2,
        "/losses": 0,
        "/tf_static": 1,
        **views,
    }
    (tracked, *_) = made.messages(["/ml/height"])
    assert made.decode(tracked.type_name, tracked.cdr).estimator == "tracked"
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["stages"]["player"]["published"]["radar/phase_history"] == 16
    assert set(report["estimators"]) == {"monopulse", "ml", "tracked"}


@pytest.mark.thorough
def test_calibrations_images_and_heights_are_followed_by_their_names(recorded: Path, tmp_path: Path) -> None:
    rules = ["slc:=images", "sensor_info:=info", "platform/odometry:=odom"]
    assert (
        main(["replay", str(recorded / "bag"), "--out", str(tmp_path / "out"), "--record", "slc", *options(rules)]) == 0
    )
    back = ["images:=slc", "info:=sensor_info"]
    images = replay(tmp_path / "out" / "bag", tmp_path / "again", {}, part=Part("slc"), remap=back)
    assert images.shortfalls(changed=False) == []
    assert verdicts(images) == dict.fromkeys(HEIGHTS, (2, "equal"))
    heights = replay(recorded / "bag", tmp_path / "heights", {}, part=Part("heights"), remap=["ml/height:=in"])
    assert verdicts(heights) == {"/tracked/height": (2, "equal")}


def options(rules: list[str]) -> list[str]:
    return [word for rule in rules for word in ("--remap", rule)]


def test_a_topic_in_a_namespace_gets_its_name_there(recorded: Path, tmp_path: Path) -> None:
    names = {topic: f"/lidar{topic}" for topic in FOREIGN} | {"/phase_history": "/lidar/raw"}
    bag = copied(recorded / "bag", tmp_path / "bag", names=lambda topic: [names.get(topic, topic)])
    rule = "/lidar/raw:=/lidar/phase_history"
    reader = Part().open(bag, remapping_of([rule], bag, "phase_history").of_bag)
    assert reader.namespace == "/lidar"
    assert reader.topics.keys() >= FOREIGN.keys()
    result = replay(bag, tmp_path / "out", {}, remap=[rule])
    assert {verdict for _, verdict in verdicts(result).values()} == {"equal"}


def test_a_rule_is_for_the_bag_if_that_can_be_played(recorded: Path) -> None:
    bag = recorded / "bag"
    for rule, entry, of_bag, of_nodes in (
        ("ml/height:=capon/height", "heights", {"/ml/height": "/capon/height"}, {}),
        ("ml/height:=capon/height", "phase_history", {}, {"ml/height": "capon/height"}),
        ("phase_history:=radar/phase_history", "phase_history", {}, {"phase_history": "radar/phase_history"}),
        ("/ml/height:=/heights", "heights", {}, {"ml/height": "heights"}),
        ("/radar/raw:=phase_history", "phase_history", {}, {"radar/raw": "phase_history"}),  # which the bag lacks
    ):
        assert remapping_of([rule], bag, entry) == Remapping(of_bag, of_nodes), rule


def test_a_topic_takes_the_place_of_the_one_that_is_called_so(recorded: Path) -> None:
    reader = NamespacedReader(recorded / "bag", "", {"/ml/height": "/monopulse/height", "/none": "/tracked/height"})
    others = {"/sensor_info", "/platform/odometry", "/phase_history", "/diagnostics", "/losses"}
    views = {name for name in reader.topics if name.endswith(("/image", "/points")) or name.startswith("/tf")}
    assert reader.topics.keys() - views == {*others, *READ}
    (first, *_) = reader.messages(["/monopulse/height"])
    assert reader.decode(first.type_name, first.cdr).estimator == "ml"


READ = {"/monopulse/height"}


@pytest.mark.parametrize(
    ("rules", "parts"),
    [
        (["phase_history"], ["'phase_history'", "OLD:=NEW"]),
        (["a:=b:=c"], ["'a:=b:=c'", "OLD:=NEW"]),
        (["a b:=c"], ["'a b:=c'", "OLD:=NEW"]),
        (["slc:="], ["'slc:='", "OLD:=NEW"]),
        (["slc:=a", "/slc:=b"], ["--remap /slc:=b", "another"]),
        (["slc:=a", "ml/height:=a"], ["--remap ml/height:=a", "another"]),
        (["/platform/odometry:=phase_history"], ["nav_msgs/msg/Odometry", "ChannelFrame"]),
        (["/radar/raw:=images"], ["'radar/raw'", "ml/height", "phase_history"]),
        (["/clock:=/time"], ["'clock'", "phase_history"]),
        (["slc:=ml/height"], ["slc", "'ml/height'", "another"]),
    ],
)
def test_what_cannot_be_renamed_is_told(rules: list[str], parts: list[str], recorded: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError) as error:
        replay(recorded / "bag", tmp_path / "out", {}, remap=rules)
    assert_one_sentence(str(error.value), "--remap", *parts)
    assert not (tmp_path / "out").exists()


def test_the_player_refuses_a_rule_that_is_none(graph: Graph, recorded: Path) -> None:
    values = {"bag": str(recorded / "bag"), "renamed": ["/radar/raw"]}
    overrides = [Parameter(name, value=value) for name, value in values.items()]
    with pytest.raises(UserError) as error:
        Player(context=graph.context, parameter_overrides=overrides)
    assert_one_sentence(str(error.value), "Parameter renamed", "/radar/raw")
