"""The engine needs no ROS, no bag, no file and no clock: not by what it imports, and not where there are none."""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
from collections.abc import Mapping
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = "sal_height"
ENGINE = sorted(
    f"{PACKAGE}.engine.{path.stem}" for path in (ROOT / PACKAGE / "engine").glob("*.py") if path.stem != "__init__"
)

FORBIDDEN = "time", "threading", "pathlib"

ALLOWED: Mapping[str, tuple[set[str], str]] = {
    "sal_height.numeric.jit": (
        {"pathlib"},
        "compares the sources of loops with those that were compiled",
    ),
    "sal_height.numeric.threads": (
        {"threading", "pathlib"},
        "spreads loops over threads, as many as a container allows, and sets the number of threads of BLAS",
    ),
    "sal_height.rehearsal": ({"threading"}, "a lock around what the nodes of one process have rehearsed"),
    "sal_height.elevation.monopulse.sum_difference": (
        {"pathlib", "open"},
        "reads the file of a setting when the settings are checked, which is before the start",
    ),
}
"""Modules that the engine reaches and that use one of these all the same, and why."""


@cache
def source_of(module: str) -> Path | None:
    """File of a module of ours; None: it is none."""
    path = ROOT.joinpath(*module.split("."))
    return next((file for file in (path.with_suffix(".py"), path / "__init__.py") if file.is_file()), None)


@cache
def tree_of(module: str) -> ast.Module:
    return ast.parse((source_of(module) or Path()).read_text(encoding="utf-8"))


@cache
def imported(module: str) -> list[tuple[str, str]]:
    """Each module and name that is imported anywhere in a module; name "": the module as such."""
    found: list[tuple[str, str]] = []
    for node in ast.walk(tree_of(module)):
        if isinstance(node, ast.Import):
            found += [(alias.name, "") for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            found += [(node.module or "", alias.name) for alias in node.names]
    return found


@cache
def defining(module: str, name: str) -> str:
    """The module of ours that defines a name which another one may only pass on."""
    if not name or source_of(f"{module}.{name}"):
        return f"{module}.{name}" if name else module
    for base, passed_on in imported(module):
        if passed_on == name and base.startswith(PACKAGE):
            return defining(base, name)
    return module


def used_by(module: str) -> set[str]:
    """Which of what is forbidden a module uses."""
    used = {base.partition(".")[0] for base, _ in imported(module)} & set(FORBIDDEN)
    calls = [node.func for node in ast.walk(tree_of(module)) if isinstance(node, ast.Call)]
    names = {one.id if isinstance(one, ast.Name) else getattr(one, "attr", "") for one in calls}
    return used | (names & {"open"})


@cache
def reached_from(*modules: str) -> set[str]:
    """The modules, and those that define what they import, and so on."""
    found: set[str] = set()
    waiting = set(modules)
    while waiting:
        module = waiting.pop()
        found.add(module)
        ours = [(base, name) for base, name in imported(module) if base.partition(".")[0] == PACKAGE]
        waiting |= {defining(base, name) for base, name in ours} - found
    return found


def test_the_engine_reaches_no_clock_no_thread_and_no_file() -> None:
    reached = reached_from(*ENGINE)
    assert len(reached) > 150
    found = {module: used for module in reached if (used := used_by(module))}
    assert found == {module: used for module, (used, _) in ALLOWED.items()}


def test_the_engine_reaches_nothing_after_it() -> None:
    """No messages, bags, nodes or runs."""
    after = {"messages", "bag", "nodes", "graph", "budget", "runs", "view", "exports", "imports", "commands"}
    after |= {"simulation", "figures"}
    assert not {module for module in reached_from(*ENGINE) if module.split(".")[1:2] and module.split(".")[1] in after}


def test_the_walk_finds_what_it_looks_for() -> None:
    """In a function, through a package that passes names on, and in the call of a method."""
    assert used_by("sal_height.beams.table_files") == {"pathlib", "open"}
    assert defining("sal_height.calibration", "load_calibration") == "sal_height.calibration.files"
    assert defining("sal_height.geometry", "Mounting") == "sal_height.geometry.frames"
    assert "sal_height.calibration.files" in reached_from("sal_height.calibration.__init__")
    assert "sal_height.calibration.files" not in reached_from(*ENGINE)


WITHOUT = """
import sys, time

class Blocker:
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        if top in ("rclpy", "mcap", "rosbags", "rclcpp", "rosidl_runtime_py") or top.endswith("_msgs"):
            raise ImportError("blocked: " + name)

def refused(original):
    def read(*arguments):
        frame = sys._getframe(1)
        while frame is not None:  # numba reads clocks while it compiles, once on a machine
            if frame.f_globals.get("__name__", "").partition(".")[0] == "numba":
                return original(*arguments)
            frame = frame.f_back
        raise RuntimeError("a clock was read")
    return read

sys.meta_path.insert(0, Blocker())
import {program}
for name in ("time", "time_ns", "monotonic", "monotonic_ns", "perf_counter", "perf_counter_ns", "sleep"):
    setattr(time, name, refused(getattr(time, name)))
{program}.{function}()
"""


def start(program: str, function: str = "main") -> subprocess.CompletedProcess[str]:
    """A program without ROS, bags and clocks."""
    code = WITHOUT.format(program=program, function=function)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}
    return subprocess.run(  # noqa: S603 (our own code)
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=600, env=environment
    )


def test_a_flight_goes_through_all_stages_where_there_is_no_ros_and_no_clock() -> None:
    ended = start("flight_without_ros")
    assert ended.returncode == 0, ended.stderr
    assert json.loads(ended.stdout) == {
        "flight": {
            "map_origin": 1,
            "platform/odometry": 9,
            "slc": 3,
            "monopulse/height": 3,
            "ml/height": 3,
            "capon/height": 3,
            "music/height": 3,
            "tracked/height": 3,
            "adjusted/height": 3,
            "adjusted/odometry": 6,
            "adjusted/mounting": 3,
            "calibration": 1,
            "psf_calibration: calibrated already": 8,
            "movers": 3,
            "map/relief": 1,
            "map.tif": 1,
            "ground/relief": 1,
            "ground.tif": 1,
            "calibration.npz": 1,
        },
        "sum and difference": {"slc": 2, "sum_difference/height": 2},
        "few pixels": {"slc": 2, "canopy_ground/height": 2},
        "strip": {
            "slc": 2,
            "monopulse/height": 2,
            "ml/height": 2,
            "capon/height": 2,
            "music/height": 2,
            "tracked/height": 2,
            "adjusted/odometry": 7,
            "adjusted/mounting": 2,
            "adjusted/height": 2,
            "map/relief": 1,
            "map.tif": 1,
            "ground/relief": 1,
            "ground.tif": 1,
        },
    }


@pytest.mark.parametrize(
    ("program", "function", "said"),
    [
        ("rclpy", "init", "blocked: "),
        ("rosbags.highlevel", "AnyReader", "blocked: "),
        ("time", "monotonic", "a clock was read"),
    ],
)
def test_what_needs_them_fails_there(program: str, function: str, said: str) -> None:
    """Or else the test above would prove nothing."""
    ended = start(program, function)
    assert ended.returncode != 0
    assert said in ended.stderr
