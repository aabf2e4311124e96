"""A program that runs the commands that need no ROS, and those that do, and reads their bag with foreign readers.

`python test/commands/commands_without_ros.py` works in a temporary folder and ends with status 1 if a command has
another status than it should. A test runs it where neither ROS nor what only POSIX has can be imported; CI runs it on
Linux, macOS and Windows after `pip install .`.
"""

from __future__ import annotations

import os
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from sal_height.commands import main

BAGS = Path(__file__).resolve().parents[2] / "bags"
BAG, OLDER = str(BAGS / "version_3"), str(BAGS / "version_2")

FLOWN = "flown/bag"
"""Bag of the run."""

NEEDS_ROS = (["live"], ["top", "--seconds", "1"], ["record"], ["view"], ["transport"])

COMMANDS: tuple[tuple[str, int], ...] = (
    ("run --preset small --dwells 2 --out flown", 0),
    (f"replay {FLOWN} --out again", 0),
    (f"replay {FLOWN} --remap ml/height:=/north/height --jobs 2 --out side_by_side", 0),
    (f"replay {FLOWN} --from heights --out tracked", 0),
    (f"bag info {FLOWN} --dwells", 0),
    (f"bag check {FLOWN}", 0),
    (f"bag cut {FLOWN} --dwells 1:1 --out cut", 0),
    (f"bag diff {FLOWN} again/bag --out same", 0),
    (f"bag upgrade {OLDER} --out upgraded", 0),
    (f"bag recover {FLOWN} --out recovered", 0),
    (f"salvage {FLOWN} --out salvaged", 0),
    (f"export {FLOWN} --film heights.gif", 0),
    (f"irf {FLOWN} --channel 4 --dwell 0 --out irf", 0),
    (f"psf {FLOWN} --channel 4 --dwell 0 --out psf", 1),  # a street without a reflector determines little
    (f"calibrate {FLOWN} --out calibrated", 0),
    (f"movers {FLOWN} --out moving", 0),
    (f"tomogram {FLOWN} --looks 1x4 --out tomogram", 0),
    (f"adjust {FLOWN} --out adjusted", 1),  # two dwells determine nothing of the mounting
    ("budget small --out budget", 0),
    ("montecarlo pair --theta 0.25 --cnr-db 5 --look-count 4 --trials 100", 0),
    ("irf --windows", 0),
)
"""Words of a command, with its status."""

OF_EXTRAS: tuple[tuple[str, str, int], ...] = (
    ("distributed", f"batch {FLOWN} --out campaign", 0),
    ("rerun", f"view {FLOWN} --save flight.rrd", 0),
    ("h5netcdf", f"export {FLOWN} --netcdf heights.nc", 0),
)
"""A module that a command needs in addition, its words and its status."""


def wrong_statuses() -> list[str]:
    """Run all commands in the current folder; sentences on those that ended otherwise than they should."""
    optional = [(words, status) for module, words, status in OF_EXTRAS if find_spec(module)]
    wrong = []
    for words, expected in (*COMMANDS, *optional):
        status = main(words.split())
        if status != expected:
            wrong.append(f"Status {status} instead of {expected}: sal-height {words}")
    wanted = [words for words in NEEDS_ROS if find_spec("rclpy") is None]
    return wrong + [f"It needs no ROS: sal-height {' '.join(words)}" for words in wanted if main(words) != 2]


def unreadable_by_others() -> list[str]:
    """Sentences on what foreign readers do not find in the bag of the run."""
    wrong = []
    with (Path(FLOWN) / "bag_0.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    if summary is None:
        return ["The bag of the run has no summary."]
    texts = {schema.name: schema.data.decode() for schema in summary.schemas.values()}
    if "sal_height_msgs/Surface" not in texts.get("sal_height_msgs/msg/HeightImage", ""):
        wrong.append("The text of HeightImage lacks that of the types that it contains.")
    with AnyReader([Path(FLOWN)]) as reader:
        read = {
            connection.topic for connection, _, raw in reader.messages() if reader.deserialize(raw, connection.msgtype)
        }
    if missing := {"/sensor_info", "/phase_history", "/platform/odometry", "/ml/height", "/tracked/height"} - read:
        wrong.append(f"rosbags finds no messages on {', '.join(sorted(missing))}.")
    return wrong


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        sentences = wrong_statuses() + unreadable_by_others()
        os.chdir(BAGS)  # Windows removes no folder that a process is in
    sys.stderr.writelines(f"{sentence}\n" for sentence in sentences)
    sys.exit(1 if sentences else 0)
