"""Console scripts of the nodes."""

from __future__ import annotations

import subprocess
import sys

import pytest

from sal_height.nodes.processing import PROCESSING
from sal_height.nodes.scripts import MODULES, main

WITHOUT_ROS = """
import sys
from sal_height.nodes.scripts import MODULES, main
sys.modules["rclpy"] = None
for name in ["ml_height", *MODULES]:
    sys.argv = [f"/usr/bin/sal-height-{name}"]
    print(main())
"""


def test_without_ros_they_say_what_to_install() -> None:
    command = [sys.executable, "-c", WITHOUT_ROS]
    told = subprocess.run(command, check=True, capture_output=True, text=True)  # noqa: S603 (our own program)
    names = ["ml_height", *MODULES]
    assert told.stdout.split() == ["2"] * len(names)
    assert [line.split()[1] for line in told.stderr.splitlines()] == [f"sal-height-{name}" for name in names]
    said = "module rclpy is not installed; install both with: pip install '.[ros]' ./msg_defs"
    assert told.stderr.count(said) == len(names)


@pytest.mark.parametrize("program", ["sal-height-relief_tracker", "relief_tracker", "paced_player", "live_host"])
def test_the_name_is_that_of_the_node(
    program: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", [f"/usr/bin/{program}", "--help"])
    assert main() == 0
    said = capsys.readouterr().out
    assert said.startswith(f"usage: {program} ")
    assert ("odometry" in said) == (program == "paced_player") or program == "live_host" or "prior" in said


def test_every_other_node_is_a_stage() -> None:
    assert not set(MODULES) & set(PROCESSING)
