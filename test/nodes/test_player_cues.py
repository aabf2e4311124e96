"""What the player does before the dwells that something happened before."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from helpers import assert_one_sentence
from played_bag import Listener, bag, odometry, played, player_of
from rclpy.parameter import Parameter
from written_bag import calibration, frame, key

from sal_height.bag.definitions import Definition
from sal_height.errors import UserError
from sal_height.messages.types import Odometry
from sal_height.nodes.account import CALIBRATIONS
from sal_height.nodes.cues import Cue
from sal_height.nodes.graph import Graph
from sal_height.nodes.height import HEIGHT_NODES
from sal_height.nodes.player import Player


def test_a_dwell_with_a_cue_is_played_after_those_it_lies_among(graph: Graph, tmp_path: Path) -> None:
    """Without a cue, three dwells are one step; the odometry that closes a group comes late."""
    frames = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (2, 1)]
    order = [odometry(0.0), *(frame(dwell, channel) for dwell, channel in frames), odometry(5.0), frame(3), frame(3, 1)]
    path = bag(tmp_path / "bag", order)
    listener = graph.add(Listener(context=graph.context))
    assert played(graph, player_of(graph, path), listener) == [[0, 1, 0, 2, 1, 2], [3, 3]]
    listener.dwells.clear()
    graph.nodes.pop().destroy_node()
    cues = [Cue(key(1), calibrations=()), Cue(key(2))]
    assert played(graph, player_of(graph, path, *cues), listener) == [[0, 0], [1, 1], [2, 2], [3, 3]]


def test_calibrations_are_steps_of_their_own(graph: Graph, tmp_path: Path) -> None:
    order = [odometry(5.0), frame(0), frame(0, 1), calibration("a"), frame(1), frame(1, 1), calibration("b")]
    listener = graph.add(Listener(context=graph.context))
    player = player_of(graph, bag(tmp_path / "bag", order), Cue(key(1), calibrations=("b", "a")))
    assert played(graph, player, listener) == [[0, 0], [], [], [1, 1]]
    assert listener.calibrations == ["b", "a"]
    assert player.tally.summary()[CALIBRATIONS] == 2


def test_a_calibration_that_the_bag_lacks_is_refused(graph: Graph, tmp_path: Path) -> None:
    with pytest.raises(UserError) as error:
        player_of(graph, bag(tmp_path / "bag", [frame(0)]), Cue(key(0), calibrations=("lost",)))
    assert_one_sentence(str(error.value), "'lost'", str(tmp_path / "bag"))


def test_a_bag_with_another_definition_of_what_is_played_is_refused(graph: Graph, tmp_path: Path) -> None:
    """Of a type that is not ours: messages of our own older ones are made anew."""
    path = bag(tmp_path / "bag", [frame(0)], {Odometry: Definition("uint8 other", "")})
    with pytest.raises(UserError, match=r"^Topic /platform/odometry .* another definition of nav_msgs/.*\.$"):
        player_of(graph, path)


def test_cues_that_are_none_are_refused(graph: Graph, tmp_path: Path) -> None:
    path = bag(tmp_path / "bag", [frame(0)])
    for text in ("1", "[1]", '[{"dwell": 1}]', "dwell"):
        overrides = [Parameter("bag", value=str(path)), Parameter("cues", value=text)]
        with pytest.raises(UserError) as error:
            Player(context=graph.context, parameter_overrides=overrides)
        assert_one_sentence(str(error.value), "Parameter cues", text)


def test_parameters_are_set_before_the_dwell_or_the_step_fails(graph: Graph, tmp_path: Path) -> None:
    path = bag(tmp_path / "bag", [odometry(5.0), *(frame(dwell, channel) for dwell in (0, 1, 2) for channel in (0, 1))])
    listener = graph.add(Listener(context=graph.context))
    node = graph.add(HEIGHT_NODES["ml_height"](context=graph.context))
    known: list[int] = []
    cues = [
        Cue(key(1), {"ml_height": {"range_looks": 3, "objective": "numerator"}}),
        Cue(key(2), {"ml_height": {"range_looks": 0}}),
    ]
    player = player_of(graph, path, *cues)
    publish = player._publish

    def noted(recorded: Any) -> None:
        known.append(node.current_parameters().range_looks)
        publish(recorded)

    before = node.current_parameters().range_looks
    player._publish = noted  # type: ignore[method-assign]
    assert played(graph, player, listener)[:2] == [[0, 0], [1, 1]]
    assert known == [before, before, before, 3, 3, 3, 3]  # of the odometry and six frames
    assert before != 3
    assert node.current_parameters().objective == "numerator"
    assert_one_sentence(player.last_drop, "ml_height", "range_looks=0", "refuses")
