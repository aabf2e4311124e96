"""A sensor that is played at its pace."""

from __future__ import annotations

from pathlib import Path

from rclpy.node import Node
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from sal_height import messages
from sal_height.messages.types import ChannelFrame
from sal_height.nodes.playing.paced_player import PacedPlayer
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.message_types import subscribe
from sal_height.nodes.transport.quality import FRAMES_QOS

BAG = Path(__file__).parents[3] / "bags" / "version_3"
TIMEOUT_S = 20.0


def test_who_asks_again_is_told_the_same(graph: Graph) -> None:
    """An answer may be lost: a server that has just started may not know yet who has asked."""
    values = {"bag": str(BAG), "rate": 0.01}
    overrides = [Parameter(name, value=value) for name, value in values.items()]
    graph.add(PacedPlayer(context=graph.context, parameter_overrides=overrides))
    asker = graph.add(Node("asker", context=graph.context))
    stamps: list[int] = []
    subscribe(
        asker,
        ChannelFrame,
        "phase_history",
        lambda frame: stamps.append(messages.to_ns(frame.header.stamp)),
        FRAMES_QOS,
    )
    client = asker.create_client(Trigger, "paced_player/start")
    assert graph.spin_until(client.service_is_ready, TIMEOUT_S)
    answers = [client.call_async(Trigger.Request()) for _ in range(3)]
    assert graph.spin_until(lambda: all(answer.done() for answer in answers), TIMEOUT_S)
    assert all(answer.result().success for answer in answers)
    (first_ns,) = {int(answer.result().message) for answer in answers}
    assert graph.spin_until(lambda: bool(stamps), TIMEOUT_S)
    assert stamps[0] >= first_ns
