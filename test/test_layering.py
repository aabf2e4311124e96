"""The core knows no ROS: not by import, not by import of an import, and not at run time."""

from __future__ import annotations

import ast
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "sal_height"
LAYERS = (
    ("errors",),
    ("numeric", "extras", "io", "settings", "configuration", "tables", "array_files"),
    ("geometry", "response"),
    ("beams",),
    ("sensor",),
    ("elevation",),
    ("imaging", "relief", "simulation"),
    ("calibration", "adjustment", "movers"),
    ("theory",),
    ("pipeline",),
    ("rehearsal", "passes"),
    ("messages", "figures"),
    ("bag",),
    ("nodes",),
    ("runs",),
    ("view", "exports", "imports", "pytest_plugin"),
    ("commands",),
    ("__main__",),
)
"""Packages and modules of sal_height in the order of the data: each imports from layers above it in this list only.

Packages of one layer do not know each other.
"""

LAYER = {name: number for number, names in enumerate(LAYERS) for name in names}

SHELL = {"messages", "bag", "nodes", "runs", "view", "exports", "imports", "pytest_plugin", "commands", "__main__"}
"""Those that may know ROS and MCAP."""


def name_of(path: Path) -> str:
    """Dotted name of the module in a file."""
    return ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__")


MODULES = {name_of(path): path for path in sorted(PACKAGE.rglob("*.py"))}
CORE = sorted(name for name in MODULES if name.partition(".")[2].partition(".")[0] not in SHELL)
FORBIDDEN = (
    *("rclpy", "mcap", "sal_height_msgs", "std_msgs", "nav_msgs", "sensor_msgs", "geometry_msgs", "diagnostic_msgs"),
    *("builtin_interfaces", "rosidl_runtime_py"),
    *(f"sal_height.{name}" for name in sorted(SHELL)),
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


@cache
def imports_of_file(path: Path) -> frozenset[str]:
    """Dotted names of all that the module in a file of ours imports."""
    package = ".".join(path.parent.relative_to(PACKAGE.parent).parts)
    return frozenset(imports_of(path.read_text(), package))


@cache
def imports_of_module(module: str) -> frozenset[str]:
    """Dotted names of all that a module of ours imports; empty for others' modules."""
    file = source_of(module)
    return imports_of_file(file) if file else frozenset()


def reachable_from(module: str) -> set[str]:
    """Dotted names of all that a module imports, directly or through modules of ours."""
    found: set[str] = set()
    waiting = {module}
    while waiting:
        new = imports_of_module(waiting.pop()) - found
        found |= new
        waiting |= {name for name in new if name.partition(".")[0] == PACKAGE.name}
    return found


def is_forbidden(module: str) -> bool:
    return any(module == name or module.startswith(f"{name}.") for name in FORBIDDEN)


def layer_of(module: str) -> tuple[int, str] | None:
    """Layer and package of a module of ours; None for the package sal_height itself and for others' modules."""
    top, _, rest = module.partition(".")
    name = rest.partition(".")[0]
    return (LAYER[name], name) if top == PACKAGE.name and name in LAYER else None


def wrong_imports(module: str) -> set[str]:
    """What a module imports from a layer that is not above its own."""
    own = layer_of(module)
    others = {name: layer_of(name) for name in imports_of_file(MODULES[module])}
    return {name for name, other in others.items() if own and other and other[1] != own[1] and other[0] >= own[0]}


def test_every_module_has_a_layer() -> None:
    assert not {name for name in MODULES if name != "sal_height" and not layer_of(name)}
    assert {"sal_height.elevation.likelihood", "sal_height.geometry.grid", "sal_height.simulation.scenes"} <= set(CORE)


def test_modules_import_from_the_layers_above_theirs_only() -> None:
    wrong = {module: wrong_imports(module) for module in MODULES}
    assert not {module: names for module, names in wrong.items() if names}


def test_an_import_against_the_order_is_found(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    wrong = tmp_path / "sal_height" / "imaging" / "wrong.py"
    wrong.parent.mkdir(parents=True)
    wrong.write_text("def f():\n    from sal_height.simulation.scene import Scene\n    import sal_height.nodes.stage")
    monkeypatch.setitem(MODULES, "sal_height.imaging.wrong", wrong)
    monkeypatch.setattr(f"{__name__}.PACKAGE", tmp_path / "sal_height")
    assert {"sal_height.simulation.scene", "sal_height.nodes.stage"} <= wrong_imports("sal_height.imaging.wrong")


def test_the_core_imports_nothing_of_ros() -> None:
    reached = {module: {name for name in reachable_from(module) if is_forbidden(name)} for module in CORE}
    assert not {module: names for module, names in reached.items() if names}


def test_the_walk_finds_what_it_looks_for() -> None:
    """In the one module that imports messages, through another one, inside functions and relatively."""
    assert any(is_forbidden(name) for name in reachable_from("sal_height.messages"))
    assert "sal_height.messages" in reachable_from("sal_height.nodes.sar_compression")
    inner = imports_of(
        "def f():\n    import rclpy.node\n    from . import messages\n    from .nodes import graph", "sal_height"
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
