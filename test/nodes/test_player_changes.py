"""What the player does before the dwells that something happened before."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers import assert_one_sentence
from played_bag import Listener, bag, odometry, played, player_of
from written_bag import calibration, frame, key

from sal_height.errors import UserError
from sal_height.graph.plan import DwellChanges
from sal_height.messages.definition import Definition
from sal_height.messages.types import Odometry
from sal_height.nodes.accounts.account import CALIBRATIONS
from sal_height.nodes.processing import PROCESSING
from sal_height.nodes.transport.graph import Graph


def test_a_calibration_is_played_before_the_first_frame_of_its_dwell(graph: Graph, tmp_path: Path) -> None:
    """Though frames of dwells before it follow, to which the nodes do not apply it."""
    frames = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (2, 1)]
    among = [odometry(0.0), *(frame(dwell, channel) for dwell, channel in frames)]
    order = [*among, odometry(5.0), frame(3), frame(3, 1), calibration("a")]
    path = bag(tmp_path / "bag", order)
    listener = graph.add(Listener(context=graph.context))
    assert played(graph, player_of(graph, path), listener) == [[0, 1, 0], [2, 1, 2], [3, 3]]
    listener.dwells.clear()
    graph.nodes.pop().destroy_node()
    change = DwellChanges(key(2), calibrations=("a",))
    assert played(graph, player_of(graph, path, change), listener) == [[0, 1, 0], [], [2, 1, 2], [3, 3]]


def test_calibrations_are_steps_of_their_own(graph: Graph, tmp_path: Path) -> None:
    order = [odometry(5.0), frame(0), frame(0, 1), calibration("a"), frame(1), frame(1, 1), calibration("b")]
    listener = graph.add(Listener(context=graph.context))
    player = player_of(graph, bag(tmp_path / "bag", order), DwellChanges(key(1), calibrations=("b", "a")))
    assert played(graph, player, listener) == [[0, 0], [], [], [1, 1]]
    assert listener.calibrations == ["b", "a"]
    assert player.tally.summary()[CALIBRATIONS] == 2


def test_a_calibration_that_the_bag_lacks_is_refused(graph: Graph, tmp_path: Path) -> None:
    with pytest.raises(UserError) as error:
        player_of(graph, bag(tmp_path / "bag", [frame(0)]), DwellChanges(key(0), calibrations=("lost",)))
    assert_one_sentence(str(error.value), "'lost'", str(tmp_path / "bag"))


def test_a_bag_with_another_definition_of_what_is_played_is_refused(graph: Graph, tmp_path: Path) -> None:
    """Of a type that is not ours: messages of our own older ones are made again."""
    path = bag(tmp_path / "bag", [frame(0)], {Odometry: Definition("uint8 other", "")})
    with pytest.raises(UserError, match=r"^Topic /platform/odometry .* another definition of nav_msgs/.*\.$"):
        player_of(graph, path)


def test_a_parameter_that_a_node_refuses_is_told_with_its_value(graph: Graph) -> None:
    node = graph.add(PROCESSING["ml_height"](context=graph.context))
    with pytest.raises(UserError) as error:
        node.set_before(key(2), {"range_looks": 0})
    assert_one_sentence(str(error.value), "ml_height", "range_looks=0", "refuses")
