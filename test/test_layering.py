"""The core knows no ROS: not by import, not by import of an import, and not at run time."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "sal_height"
SHELL = {"sal_height.messages", "sal_height.cli"}
"""Modules beside the core's that may know ROS."""

LAYERS = (
    ("numeric",),
    ("geometry", "response"),
    ("beams",),
    ("sensor", "elevation"),
    ("imaging", "relief", "simulation", "calibration"),
    ("theory",),
    ("messages", "nodes", "bag", "runs", "figures"),
)
CORE = sorted(
    ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__")
    for layer in LAYERS[:-1]
    for package in layer
    for path in (PACKAGE / package).rglob("*.py")
)
FORBIDDEN = (
    *("rclpy", "mcap", "sal_height_msgs", "std_msgs", "nav_msgs", "sensor_msgs", "geometry_msgs", "diagnostic_msgs"),
    *("builtin_interfaces", "rosidl_runtime_py", "sal_height.nodes", "sal_height.bag", "sal_height.runs"),
    *sorted(SHELL),
)


def imports_of(source: str, package: str) -> set[str]:
    """Dotted names of all that a module imports, wherever in it; `package` is that of relative imports."""
    names = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            names |= {base} | {f"{base}.{alias.name}" for alias in node.names}
    return names


def source_of(module: str) -> Path | None:
    """File of a module of ours, if there is one of that name."""
    path = PACKAGE.parent / Path(*module.split("."))
    return next((file for file in (path.with_suffix(".py"), path / "__init__.py") if file.is_file()), None)


def reachable_from(module: str) -> set[str]:
    """All that a module imports, directly or through modules of ours."""
    found: set[str] = set()
    waiting = {module}
    while waiting:
        file = source_of(waiting.pop())
        if file:
            package = ".".join(file.parent.relative_to(PACKAGE.parent).parts)
            new = imports_of(file.read_text(), package) - found
            found |= new
            waiting |= {name for name in new if name.partition(".")[0] == PACKAGE.name}
    return found


def is_forbidden(module: str) -> bool:
    return any(module == name or module.startswith(f"{name}.") for name in FORBIDDEN)


def test_core_is_all_beside_the_shell() -> None:
    assert {
        "sal_height.elevation.likelihood",
        "sal_height.geometry.frames",
        "sal_height.nodes.tally",
        "sal_height.simulation.scenes",
    } <= set(CORE)
    assert all(source_of(name) for name in SHELL)


@pytest.mark.parametrize("module", [*CORE, "sal_height"])
def test_module_of_the_core_imports_nothing_of_ros(module: str) -> None:
    assert not {name for name in reachable_from(module) if is_forbidden(name)}


def test_the_walk_finds_what_it_looks_for() -> None:
    """In the one module that imports messages, through another one, inside functions and relatively."""
    assert any(is_forbidden(name) for name in reachable_from("sal_height.messages"))
    assert "sal_height.messages" in reachable_from("sal_height.nodes.sar_compression")
    inner = imports_of(
        "def f():\n    import rclpy.node\n    from . import convert\n    from .nodes import graph", "sal_height"
    )
    assert {"rclpy.node", "sal_height.messages", "sal_height.nodes.graph"} <= inner


BLOCKED_IMPORT = """
import importlib, sys

class Blocker:
    def find_spec(self, name, path=None, target=None):
        if any(name == other or name.startswith(other + ".") for other in {forbidden!r}):
            raise ImportError("blocked: " + name)

sys.meta_path.insert(0, Blocker())
for name in {modules!r}:
    importlib.import_module(name)
"""


def import_without_ros(modules: list[str]) -> subprocess.CompletedProcess[str]:
    code = BLOCKED_IMPORT.format(forbidden=FORBIDDEN, modules=modules)
    command = [sys.executable, "-c", code]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)  # noqa: S603 (our own code)


def test_core_can_be_imported_where_ros_is_not() -> None:
    result = import_without_ros(CORE)
    assert result.returncode == 0, result.stderr


def test_shell_cannot_be_imported_where_ros_is_not() -> None:
    """Or else the test above would prove nothing."""
    result = import_without_ros(["sal_height.nodes.sar_compression"])
    assert result.returncode != 0
    assert "blocked: " in result.stderr
