"""What the player does before the dwells that something happened before."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import pytest
from helpers import assert_one_sentence
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from sal_height_msgs.msg import Calibration, ChannelFrame, SensorInfo
from written_bag import calibration, frame, key

from sal_height import messages
from sal_height.bag.definitions import Definition
from sal_height.bag.writer import BagWriter
from sal_height.errors import UserError
from sal_height.nodes.account import CALIBRATIONS
from sal_height.nodes.cues import Cue, cues_to_text
from sal_height.nodes.graph import Graph
from sal_height.nodes.height import HEIGHT_NODES
from sal_height.nodes.player import Player
from sal_height.nodes.stage import FRAMES_QOS, LATCHED_QOS

TIMEOUT_S = 20.0
TOPICS = {SensorInfo: "/sensor_info", Odometry: "/platform/odometry", ChannelFrame: "/phase_history"}


def odometry(stamp_s: float) -> Odometry:
    message = Odometry()
    message.header.stamp = messages.to_stamp(round(stamp_s * 1e9))
    return message


def bag(folder: Path, recorded: Iterable[Any], other: Mapping[type, Definition] = MappingProxyType({})) -> Path:
    """A bag of a sensor with two detectors, with `other` definitions of types than those that are installed."""
    info = SensorInfo()
    info.beams.elevation_boresights = [0.0, 0.1]
    topics = {**TOPICS, Calibration: "/calibration"}
    with BagWriter(folder, {}) as writer:
        for kind, name in topics.items():
            type_name = f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"
            writer.add_topic(name, type_name, [FRAMES_QOS], definition=other.get(kind))
        for time_ns, message in enumerate([info, *recorded], 1):
            writer.write(topics[type(message)], serialize_message(message), time_ns, time_ns)
    return folder


class Listener(Node):
    """Hears what is played."""

    def __init__(self, **node_arguments: Any) -> None:
        super().__init__("listener", **node_arguments)
        self.dwells: list[int] = []
        self.calibrations: list[str] = []
        self.create_subscription(ChannelFrame, "phase_history", lambda m: self.dwells.append(m.dwell), FRAMES_QOS)
        self.create_subscription(Calibration, "calibration", lambda m: self.calibrations.append(m.id), LATCHED_QOS)


def player_of(graph: Graph, path: Path, *cues: Cue) -> Player:
    values = {"bag": str(path), "cues": cues_to_text(cues)}
    overrides = [Parameter(name, value=value) for name, value in values.items()]
    player = graph.add(Player(context=graph.context, parameter_overrides=overrides))
    assert graph.spin_until(lambda: player.is_ready, TIMEOUT_S)
    return player


def played(graph: Graph, player: Player, listener: Listener) -> list[list[int]]:
    """The dwells of the frames of each step, until the bag has ended."""
    steps: list[list[int]] = []
    outlet = player._outlets["/phase_history"]
    assert graph.spin_until(lambda: outlet.subscribers == 1, TIMEOUT_S)
    while player._step()[0]:
        assert graph.spin_until(lambda: not player.jobs, TIMEOUT_S)
        assert graph.spin_until(lambda: len(listener.dwells) == outlet.published, TIMEOUT_S)
        sent = player.tally.summary().get(CALIBRATIONS, 0)  # a latched topic keeps only the last
        assert graph.spin_until(lambda count=sent: len(listener.calibrations) == count, TIMEOUT_S)
        steps.append(listener.dwells[sum(map(len, steps)) :])
    return steps


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
