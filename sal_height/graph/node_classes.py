"""The classes of all nodes by name; what runs know of a node are the attributes of its class (`nodes.managed`)."""

from __future__ import annotations

from typing import Any

from sal_height.nodes.playing.player import PacedPlayer, Player
from sal_height.nodes.processing import PROCESSING
from sal_height.nodes.recording.recorder import Recorder
from sal_height.nodes.simulator import Simulator

NODES: dict[str, type[Any]] = {
    "simulator": Simulator,
    "player": Player,
    "paced_player": PacedPlayer,
    **PROCESSING,
    "recorder": Recorder,
}
"""Every node by its name."""
