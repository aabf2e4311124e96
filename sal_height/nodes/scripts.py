"""Console scripts of the nodes: `sal-height-NODE` where pip installs them, `NODE` where `ros2 run sal_height` looks.

Each imports its node only when it runs, so that without ROS it can say what to install.
"""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

from sal_height.extras import how_to_install_ros, is_of_ros

PREFIX = "sal-height-"

MODULES = {
    "live_host": "sal_height.nodes.live_host",
    "paced_player": "sal_height.nodes.playing.player",
    "player": "sal_height.nodes.playing.player",
    "recorder": "sal_height.nodes.recording.recorder",
    "simulator": "sal_height.nodes.simulator",
}
"""Modules of the nodes that are no stage of the engine; `sal_height.nodes.processing` has all others."""


def node_of_script() -> str:
    """Usual name of the node that the running console script starts."""
    return Path(sys.argv[0]).stem.removeprefix(PREFIX)


def main() -> int:
    """Run the node of the console script.

    Returns:
        The exit status; 2 with a message on stderr if a package of ROS is not installed.
    """
    try:
        return import_module(MODULES.get(node_of_script(), "sal_height.nodes.processing")).main()
    except ModuleNotFoundError as error:
        if not is_of_ros(error.name or ""):
            raise
        sys.stderr.write(f"{how_to_install_ros(error.name or '', Path(sys.argv[0]).name)}\n")
        return 2
