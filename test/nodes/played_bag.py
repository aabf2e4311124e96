"""Bags of a few messages, a player of them, and a node that hears what is played."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from rclpy.node import Node
from rclpy.parameter import Parameter

from sal_height import messages
from sal_height.bag import qos
from sal_height.bag.writer import BagWriter
from sal_height.graph.plan import DwellChanges
from sal_height.messages import serialize
from sal_height.messages.definition import Definition
from sal_height.messages.types import Calibration, ChannelFrame, Odometry, SensorInfo, Temperature
from sal_height.nodes.accounts.account import CALIBRATIONS
from sal_height.nodes.playing.player import Player
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.message_types import subscribe
from sal_height.nodes.transport.qos import FRAMES_QOS, LATCHED_QOS

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
    topics = {**TOPICS, Calibration: "/calibration", Temperature: "/air/temperature"}
    with BagWriter(folder, {}) as writer:
        for kind, name in topics.items():
            writer.add_topic(name, kind.__msgtype__, [qos.FRAMES], definition=other.get(kind))
        for time_ns, message in enumerate([info, *recorded], 1):
            writer.write(topics[type(message)], serialize(message), time_ns, time_ns)
    return folder


class Listener(Node):
    """Hears what is played."""

    def __init__(self, **node_arguments: Any) -> None:
        super().__init__("listener", **node_arguments)
        self.dwells: list[int] = []
        self.calibrations: list[str] = []
        subscribe(self, ChannelFrame, "phase_history", lambda m: self.dwells.append(m.dwell), FRAMES_QOS)
        subscribe(self, Calibration, "calibration", lambda m: self.calibrations.append(m.id), LATCHED_QOS)


def player_of(graph: Graph, path: Path, *changes: DwellChanges, **values: object) -> Player:
    """A player of a bag, with the calibrations of these changes and these values of its other parameters."""
    overrides = [Parameter(name, value=value) for name, value in {"bag": str(path), **values}.items()]
    player = graph.add(Player(context=graph.context, parameter_overrides=overrides))
    player.schedule({change.dwell: change.calibrations for change in changes}, {})
    assert graph.spin_until(lambda: player.is_ready, TIMEOUT_S)
    return player


def played(graph: Graph, player: Player, listener: Listener) -> list[list[int]]:
    """The dwells of the frames of each step, until the bag has ended."""
    steps: list[list[int]] = []
    outlet = player._outlets["/phase_history"]
    assert graph.spin_until(lambda: outlet.subscribers == 1, TIMEOUT_S)
    while player.step()[0]:
        assert graph.spin_until(lambda: not player.jobs, TIMEOUT_S)
        assert graph.spin_until(lambda: len(listener.dwells) == outlet.published, TIMEOUT_S)
        sent = player.tally.summary().get(CALIBRATIONS, 0)  # a latched topic keeps only the last
        assert graph.spin_until(lambda count=sent: len(listener.calibrations) == count, TIMEOUT_S)
        steps.append(listener.dwells[sum(map(len, steps)) :])
    return steps
